"""What is compiled to machine code, and how: numba's settings, vectors, elementary functions, random draws."""
