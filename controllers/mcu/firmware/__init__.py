"""The routines of the 1982 controller."""
