"""The compiled pulse loop, its data, and how it is called."""
