"""ELCAM, the cam tables and error compensation of the control MCU-G3."""
