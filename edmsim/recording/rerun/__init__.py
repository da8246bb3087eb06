"""Recordings for rerun: writing, layout, playback."""
