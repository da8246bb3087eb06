"""What ``edmsim servo`` puts together: a drive by name on an axis by name."""

from __future__ import annotations

from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis import CHIPS
from edmsim.controllers.axis import tuned as tuned_drive
from edmsim.controllers.axis.drive import axis_names, axis_row
from edmsim.errors import InputError

_MACHINE_AXES = ("x", "y")
_MACHINE_MOTOR = "table"
"""Motor on the screws of the machine's own axes, as ``edmsim cut --drive`` has it."""


def bench_for(name: str, axis: str, tuned: bool) -> AxisBench:
    """Return a bench with a drive.

    Parameters
    ----------
    name : str
        ``uhu`` or ``servo-module``.
    axis : str
        ``x`` or ``y`` of the DEM-15, moved by MuJoCo with its screw, mass and travel, from its middle; or a motor
        with a screw and a table of its own, see `edmsim.controllers.axis.drive.axis_row`.
    tuned : bool
        Whether somebody has tuned it for the axis; else it is as delivered.

    Raises
    ------
    InputError
        There is no such drive, no such axis, or nobody has tuned the drive for it.
    """
    if name not in CHIPS:
        raise InputError(f"there is no drive {name!r} with a serial line; choose one of {', '.join(CHIPS)}")
    machine_axis = axis in _MACHINE_AXES
    if not machine_axis and axis not in axis_names():
        raise InputError(f"there is no axis {axis!r}; choose one of {', '.join((*_MACHINE_AXES, *axis_names()))}")
    motor = _MACHINE_MOTOR if machine_axis else axis
    drive = tuned_drive(name, motor) if tuned else CHIPS[name](axis_row(motor))
    return AxisBench({axis: drive}, mechanics="mujoco") if machine_axis else AxisBench({"x": drive})
