"""Machines: constants with their sources, read from `models/` and validated; draws within their ranges."""
