"""Consoles: what a person, a script or another program operates by hand."""
