"""One cut from program file to outputs."""
