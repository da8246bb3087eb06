"""The record of a cut: the table of windows, the wire's frames, report, figures and rerun recording."""
