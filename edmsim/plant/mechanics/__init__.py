"""Table and wire: the MJCF, its modes, and MuJoCo in the loop."""
