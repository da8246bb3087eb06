"""Fitting the model's constants to a machine's own log: what ``edmsim calibrate`` does."""

from edmsim.calibration.fit import DEFAULT_CONSTANTS, Fit, calibrate, settings_for
from edmsim.calibration.log import Log, read_log

__all__ = ["DEFAULT_CONSTANTS", "Fit", "Log", "calibrate", "read_log", "settings_for"]
