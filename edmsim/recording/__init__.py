"""What a cut leaves behind: the table of windows, the wire's frames, report, figure and rerun recording."""
