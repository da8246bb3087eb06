"""The compiled pulse loop, what it works on, and how it is called."""
