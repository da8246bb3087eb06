"""The 1982 controller's terminal: an operator's dialogue with the simulated machine, live."""
