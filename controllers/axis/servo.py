"""The reference servo: a direct-current motor with an encoder, and a proportional-derivative loop in whole numbers.

Use it as a template for your own drive. Its constants are in ``models/drives/servo.toml``.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import FAULT, SampleFunction, carray, sample
from edmsim.controllers.axis.drive import axis_row, data_of, new_record

COUNTS_PER_EDGE, KP, KD, LAST_ERROR, LARGEST_ERROR = range(5)  # registers


@sample
def _servo(drive_at: Any, axis_at: Any) -> None:
    drive, axis = carray(drive_at, 1)[0], carray(axis_at, 1)[0]
    error = drive.setpoint * drive.reg[COUNTS_PER_EDGE] - axis.count
    duty = drive.reg[KP] * error + drive.reg[KD] * (error - drive.reg[LAST_ERROR])
    drive.reg[LAST_ERROR] = error
    if abs(error) > drive.reg[LARGEST_ERROR]:
        drive.lines |= FAULT
    if drive.lines & FAULT:
        duty = 0
    drive.command = min(max(duty, -32768), 32768) / 32768.0


class PositionServo:
    """A position servo for step edges, without a serial dialogue.

    If the following error exceeds ``largest_error`` counts, the drive reports a fault and switches the motor's
    voltage off until the plant is reset.
    """

    name = "servo"
    sample: SampleFunction = _servo

    def __init__(self) -> None:
        data = data_of(self.name)
        loop = data["loop"]
        self.record: NDArray[np.void] = new_record(tuple(loop["period_ns"]))
        self.record["reg"][0, : LARGEST_ERROR + 1] = (
            loop["counts_per_edge"], loop["kp"], loop["kd"], 0, loop["largest_error"],
        )
        self.motor: NDArray[np.void] | None = axis_row("table", **data["motor"])

    @property
    def counts_per_step(self) -> float:
        """Encoder counts of a step edge."""
        return float(self.record["reg"][0, COUNTS_PER_EDGE])

    def why_stopped(self) -> str:
        """Say why it reports a fault."""
        if not self.record["lines"][0] & FAULT:
            return ""
        return f"its following error passed the limit of {self.record['reg'][0, LARGEST_ERROR]} counts"

    def line(self, text: bytes) -> bytes:
        """Answer nothing: this servo has no serial line."""
        return b""
