"""ELCAM, the cam tables of the control MCU-G3, and compensation by them."""
