"""Compiling to machine code: settings of numba, vectors, elementary functions, random draws."""

PROGRESS = "EDMSIM_PROGRESS"
"""Environment variable: with 0 a notebook shows neither progress bars nor the notice that code is compiled."""
