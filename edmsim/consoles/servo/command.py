"""``edmsim console servo``: a drive by name on an axis by name, to operate or to tune."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis import CHIPS
from edmsim.controllers.axis import tuned as tuned_drive
from edmsim.controllers.axis.drive import axis_names, axis_row
from edmsim.errors import InputError, one_of
from edmsim.files import make_writable

_MACHINE_AXES = ("x", "y")
_MACHINE_MOTOR = "table"  # motor on the screws of the machine's own axes, as ``edmsim cut --drive`` has it


def bench_for(name: str, axis: str, tuned: bool) -> AxisBench:
    """Return a bench with a drive, as delivered or tuned, on a motor's own axis or on the machine's.

    The axes ``x`` and ``y`` are those of the DEM-15, moved by MuJoCo with its screw, mass and travel, from its
    middle.
    """
    if name not in CHIPS:
        raise InputError(f"there is no drive {name!r} with a serial line; choose one of {one_of(name, CHIPS)}")
    machine_axis = axis in _MACHINE_AXES
    if not machine_axis and axis not in axis_names():
        raise InputError(f"there is no axis {axis!r}; choose one of {one_of(axis, (*_MACHINE_AXES, *axis_names()))}")
    motor = _MACHINE_MOTOR if machine_axis else axis
    drive = tuned_drive(name, motor) if tuned else CHIPS[name](axis_row(motor))
    return AxisBench({axis: drive}, mechanics="mujoco") if machine_axis else AxisBench({"x": drive})


def tune(name: str, axis: str, out: Path | None, say: Callable[[str], None]) -> tuple[str, ...]:
    """Tune a drive for an axis (see `bench_for`), perhaps draw it before and after; returns what to type."""
    from edmsim.consoles.servo.autotune import autotune, draw
    from edmsim.recording.figures import write_figure

    if out is not None:
        if out.suffix != ".png":
            raise InputError("the picture is written as .png", out)
        make_writable(out.parent)
    motor = np.array([bench_for(name, axis, tuned=False).motor()])  # of x and y with the machine's screw and table
    tuning = autotune(name, motor, say)
    for title, one in (("as delivered", tuning.before.figures), ("tuned", tuning.after.figures)):
        say(
            f"{title}: overshoot {100 * one.overshoot:.0f} %, settled after {1e3 * one.settling_s:.0f} ms, "
            f"following error of a move {one.rms:.1f} counts rms"
        )
    if out is not None:
        write_figure(draw(tuning), out)
    return tuning.lines
