"""The position loop of a control's servo axis: proportional and integral, on the count less its compensation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import SampleFunction, carray, sample
from edmsim.controllers.axis.drive import axis_row, new_record
from edmsim.controllers.axis.elcam.registers import DATA

TARGET, COMPENSATION, FEED_FORWARD, PROPORTIONAL, PER_SAMPLE, STILL, SUM = range(7)
"""Numbers of a record's ``real``: target and compensation in counts, the command that holds the speed, gains, the
error within which the integrator rests, the integrator in shares of the supply."""


@sample
def _hold(drive_at: Any, axis_at: Any) -> None:
    drive, axis = carray(drive_at, 1)[0], carray(axis_at, 1)[0]
    real = drive.real
    actual = axis.count - real[COMPENSATION]
    error = real[TARGET] - actual
    demand = real[FEED_FORWARD] + real[PROPORTIONAL] * error + real[SUM]
    drive.command = min(max(demand, -1.0), 1.0)
    if abs(error) > real[STILL] and abs(demand) < 1.0:
        real[SUM] += real[PROPORTIONAL] * real[PER_SAMPLE] * error


class AxisLoop:
    """A motor in a control's position loop, for a servo axis of `mcu_g3.MotionControl`."""

    name = "mcu-g3"
    counts_per_step = 0.0  # its control writes the target

    def __init__(self, motor: NDArray[np.void] | None = None) -> None:
        data = DATA["axis"]
        self.record: NDArray[np.void] = new_record((data["cycle_ns"], 1))
        real = self.record["real"][0]
        real[PROPORTIONAL], real[STILL] = data["proportional"], data["still_counts"]
        real[PER_SAMPLE] = data["cycle_ns"] * 1e-9 / data["integral_s"]
        self.motor: NDArray[np.void] | None = motor
        if motor is None:
            bench = axis_row("bench")
            self.motor = axis_row("bench", counts_per_rad=float(bench["um_per_rad"][0]))

    @property
    def sample(self) -> SampleFunction:
        """The compiled loop, the same for all axes."""
        return _hold

    def line(self, text: bytes) -> bytes:
        """Answer nothing: the control talks to its axes without a line."""
        return b""
