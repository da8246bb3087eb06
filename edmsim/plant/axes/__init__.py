"""The machine's axes: steps, motors, encoders and the drives that close a loop over them."""
