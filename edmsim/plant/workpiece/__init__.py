"""The metal: kerf field, craters, stepped workpieces, the slot that straight cuts start from."""
