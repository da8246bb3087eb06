"""Plant and controller run together, window by window."""
