"""Consoles for a person, a script or another program."""
