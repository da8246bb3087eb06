"""The stepper: a step edge turns the motor's field by one step, and nobody looks whether the rotor follows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.axis.drive import new_record


class Stepper:
    """A stepping motor without a loop, what an axis has if nothing else is said.

    Its step length, torque, friction and backlash are the machine's (``table`` in its TOML file, and the MJCF).
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
