"""Feed controllers: from what a window of 255 pulses showed to the speed along the path."""
