"""What ``edmsim servo`` puts together: a drive by name on an axis by name."""

from __future__ import annotations

from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis.drive import axis_row
from edmsim.controllers.axis.servo_module import ServoModule
from edmsim.controllers.axis.uhu import Uhu
from edmsim.errors import InputError

CHIPS: dict[str, type[Uhu] | type[ServoModule]] = {kind.name: kind for kind in (Uhu, ServoModule)}
"""Drives with a serial line, by name."""


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
    row = axis_row(axis)
    return AxisBench({"x": CHIPS[name].tuned(axis) if tuned else CHIPS[name](row)})
