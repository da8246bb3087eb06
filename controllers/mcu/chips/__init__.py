"""The chips of the 1982 controller, one file each."""
