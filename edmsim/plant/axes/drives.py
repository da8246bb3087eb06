"""A plant's drives: their rows in the memory of the pulse loop, and what of them belongs into a snapshot."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import DRIVE, FAULT, N_AXES, SampleFunction
from edmsim.errors import InputError
from edmsim.plant.axes.motor import check_motor, transitions
from edmsim.plant.kernel.declare import ArraySizes, allocate
from edmsim.plant.kernel.state import Axes

AXIS_NAMES = ("x", "y", "u", "v")
"""The machine's axes: x and y of the lower guide, u and v of the upper guide relative to it."""


class AxisDrive(Protocol):
    """What a plant needs of a drive (see `edmsim.controllers.axis.drive.Drive`)."""

    record: NDArray[np.void]
    motor: NDArray[np.void] | None

    @property
    def sample(self) -> SampleFunction | None:
        """The compiled sample; None for a stepper."""
        ...


class Drives:
    """The drives of one plant.

    Parameters
    ----------
    drives : mapping of str to drive
        By axis, see `AXIS_NAMES`; an axis that is not named has a stepper. They are copied, so that one drive may be
        given to several plants; ``record`` of a copy is its row in the plant.
    travel_um : float
        Travel of x and y, behind whose ends the switches open.

    Attributes
    ----------
    axes : Axes
        The rows as the loop has them.
    given, by_axis : dict
        The drives as they were given, and the plant's own copies.

    Raises
    ------
    InputError
        If there is no such axis, or a drive's record, period or motor is none.
    """

    def __init__(self, drives: Mapping[str, AxisDrive], travel_um: float, sizes: ArraySizes) -> None:
        for name in drives:
            if name not in AXIS_NAMES:
                raise InputError(f"there is no axis {name!r} to drive; there are: {', '.join(AXIS_NAMES)}")
        self.given = dict(drives)
        self.by_axis: dict[str, AxisDrive] = {name: copy.deepcopy(drive) for name, drive in drives.items()}
        made = allocate(Axes, sizes, loops=0)
        self._motors: list[bytes | None] = [None] * N_AXES
        for k, name in enumerate(AXIS_NAMES):
            drive = self.by_axis.get(name)
            if drive is None:
                continue
            if drive.record.dtype != DRIVE or drive.record.shape != (1,):
                raise InputError(f"the record of the {name} drive is not one row of edmsim.compiled.axis_rows.DRIVE")
            made.drives[k] = drive.record[0]
            drive.record = made.drives[k : k + 1]
            if drive.sample is None or drive.motor is None:
                continue
            _check_period(name, drive.record)
            check_motor(drive.motor)
            made.motors[k] = drive.motor[0]
            self._motors[k] = drive.motor.tobytes()
        self._first = made.drives.copy()
        self._travel_um = travel_um
        self.axes = made._replace(loops=sum(row is not None for row in self._motors))

    def set_grid(self, grid_us: float) -> Axes:
        """Return the axes with their tables on a setting's time grid."""
        self.axes = self.axes._replace(transition=transitions(tuple(self._motors), grid_us))
        return self.axes

    def reset(self, axis_um: NDArray[np.float64]) -> None:
        """Switch the drives on at time 0, with the axes at rest at some places."""
        rows, drives = self.axes.rows, self.axes.drives
        rows[:] = 0
        rows["place_um"] = rows["zero_um"] = axis_um
        rows["low_um"], rows["high_um"] = (0.0, 0.0, -np.inf, -np.inf), (*[self._travel_um] * 2, np.inf, np.inf)
        drives[:] = self._first
        self._connect()
        for k in self._looped():
            drives["index"][k] = 1
            drives["due_ns"][k] = int(drives["num"][k]) // int(drives["den"][k])
        self._find_marks()

    def pass_by(self, moved_um: NDArray[np.float64], duration_ns: int) -> None:
        """Let a move happen that is not simulated: the drives sleep, and hold the same counts afterwards."""
        for name in ("place_um", "zero_um"):
            self.axes.rows[name] += moved_um
        self.axes.rows["time_ns"] += duration_ns
        for name in ("epoch_ns", "due_ns"):
            self.axes.drives[name] += duration_ns
        self._find_marks()

    def has_loop(self, axis: int) -> bool:
        """Return whether the drive of an axis, by its number, has a loop."""
        return self._motors[axis] is not None

    def faults(self) -> int:
        """Return which drives report a fault: bit k for axis k."""
        lines = self.axes.drives["lines"].tolist()
        return sum(1 << k for k in range(N_AXES) if lines[k] & FAULT)

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return what changes, without addresses; `restore` continues bit for bit."""
        drives = self.axes.drives.copy()
        drives["sample"] = 0
        return {"drives": drives, "axes": self.axes.rows.copy()}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take back a `snapshot` of drives of the same kinds."""
        self.axes.rows[:] = state["axes"]
        self.axes.drives[:] = state["drives"]
        self._connect()

    def _find_marks(self) -> None:
        for k in self._looped():
            self.axes.rows["mark"][k] = self.axes.rows["place_um"][k] // self.axes.motors["index_um"][k]

    def _looped(self) -> list[int]:
        return [k for k, motor in enumerate(self._motors) if motor is not None]

    def _connect(self) -> None:
        """Put the addresses of the samples, which differ from process to process."""
        self.axes.drives["sample"] = 0
        for k in self._looped():
            sample = self.by_axis[AXIS_NAMES[k]].sample
            assert sample is not None
            self.axes.drives["sample"][k] = sample.address


def _check_period(name: str, record: NDArray[np.void]) -> None:
    num, den = int(record["num"][0]), int(record["den"][0])
    if den < 1 or num < 1000 * den:
        raise InputError(f"the {name} drive's period is {num}/{den} ns; it must be 1 us or more")
