"""Recordings for rerun: written, laid out, played back."""
