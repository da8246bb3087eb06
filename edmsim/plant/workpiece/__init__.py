"""The metal: kerf field, craters, stepped workpieces, and slots in which straight cuts start."""
