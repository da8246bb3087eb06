"""The spark gap: rays across it, breakdown, outcome of a pulse, debris, gas, the generator."""
