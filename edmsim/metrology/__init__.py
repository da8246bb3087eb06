"""Edges of the cut; profile error, corners, kerf, roughness."""
