"""What the operator of the 1982 controller types and reads."""
