"""What is compiled to machine code, and how: numba's settings, vectors, elementary functions, random draws."""

PROGRESS = "EDMSIM_PROGRESS"
"""Variable of the environment: with 0 a notebook shows neither how far long work is nor that code is compiled."""
