"""The spark gap: rays across it, ignition, how a pulse ends, debris, the generator."""
