"""The operator's dialogue with the 1982 controller."""
