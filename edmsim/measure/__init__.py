"""The machine measured: its table as ISO 230 asks, its wire guides from a test cut."""
