"""Planners: from a path and a speed to the steps of two motors."""
