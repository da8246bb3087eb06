"""Comparing feed controllers on the same randomised machines, the highest stable rate, and technologies of passes."""
