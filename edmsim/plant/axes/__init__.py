"""The machine's axes: steps, motors, encoders and servo drives."""
