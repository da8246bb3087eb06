"""What ``edmsim servo`` puts together: a drive by name on an axis by name."""

from __future__ import annotations

from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis import CHIPS
from edmsim.controllers.axis import tuned as tuned_drive
from edmsim.controllers.axis.drive import axis_row
from edmsim.errors import InputError


def bench_for(name: str, axis: str, tuned: bool) -> AxisBench:
    """Return a bench with a drive on x.

    Parameters
    ----------
    name : str
        ``uhu`` or ``servo-module``.
    axis : str
        See `edmsim.controllers.axis.drive.axis_row`.
    tuned : bool
        Whether somebody has tuned it for the axis; else it is as delivered.

    Raises
    ------
    InputError
        There is no such drive, no such axis, or nobody has tuned the drive for it.
    """
    if name not in CHIPS:
        raise InputError(f"there is no drive {name!r} with a serial line; choose one of {', '.join(CHIPS)}")
    return AxisBench({"x": tuned_drive(name, axis) if tuned else CHIPS[name](axis_row(axis))})
