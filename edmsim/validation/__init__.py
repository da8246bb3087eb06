"""Validation: published facts beside what the plant does, a row each."""
