"""The stepper: a step edge turns the motor's field by one step, without feedback from the rotor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.axis.drive import new_record


class Stepper:
    """A stepping motor without a loop, the default drive of an axis.

    Its step length, torque, friction and backlash come from the machine (``table`` in its TOML file, and the MJCF).
    """

    name = "stepper"
    sample = None
    counts_per_step = 0.0

    def __init__(self) -> None:
        self.record: NDArray[np.void] = new_record()
        self.motor: NDArray[np.void] | None = None

    def line(self, text: bytes) -> bytes:
        """Answer nothing: a stepper has no serial line."""
        return b""
