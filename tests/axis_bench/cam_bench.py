"""A control with ELCAM on its bench, and tables for it."""

import numpy as np
import pytest

from edmsim.axis_bench.control_rig import ControlRig
from edmsim.controllers.axis.drive import axis_row
from edmsim.controllers.axis.elcam.mcu_g3 import AxisLoop, ControlAxis
from edmsim.controllers.axis.elcam.module import CallStatus, Descriptor
from edmsim.controllers.axis.elcam.table import Function, Mode

X, Y, U, V = range(4)
COUNTS = 1000.0  # in a mm
HAT = ((0.0, 0.0), (10.0, 5.0), (20.0, 0.0))
STAIR = ((0.0, 0.0), (10.0, 4.0), (20.0, 10.0))
SWITCH = Descriptor(1200, 0, 30, 0)


def smooth_loop():
    """A motor with counts of 1 um whose ways do not rub: it rests within a count."""
    return AxisLoop(axis_row("bench", counts_per_rad=1591.5494309189535, way_friction_N=0.0, way_stiction_N=0.0,
                             friction_Nm=0.0, stiction_Nm=0.0))  # fmt: skip


def rig_of(names="xy", steppers="", **options):
    axes = {n: ControlAxis(500.0 if n in steppers else COUNTS, stepper=n in steppers) for n in names}
    return ControlRig(axes, {n: smooth_loop() for n in names if n not in steppers}, **options)


def write(rig, index, **values):
    """Write functions of a table by name; every one must be taken."""
    at = rig.control.elcam.at(index)
    for name, value in values.items():
        call = at.write_double if isinstance(value, float) else at.write_int
        assert call(Function[name.upper()], value) is CallStatus.OK, name


def enter(rig, index, points):
    at = rig.control.elcam.at(index)
    for x, y in points:
        assert at.write_double(Function.ADD_MASTER, float(x)) == 0, (x, y)
        assert at.write_double(Function.ADD_FOLLOW, float(y)) == 0


def table(rig, index, points, axis=Y, master=X, mode=0, size=None, marked=True, **values):
    """Set a table up in the document's order, short of running it; one of errors is marked by function 30."""
    write(rig, index, axis=axis, master=master)
    if mode & Mode.SINGLE:
        write(rig, index, mode=int(Mode.SINGLE))
    write(rig, index, buffer_size=size or len(points), **values)
    enter(rig, index, points)
    if mode & Mode.COMPENSATION and marked:
        write(rig, index, compensation=1)
    write(rig, index, mode=int(mode))


def run(rig, index, more=0):
    at = rig.control.elcam.at(index)
    return at.write_int(Function.MODE, int(at.read_int(Function.MODE).value) | Mode.RUN | more)


def stop(rig, index):
    at = rig.control.elcam.at(index)
    return at.write_int(Function.MODE, int(at.read_int(Function.MODE).value) & ~Mode.RUN)


def read(rig, index, function):
    at = rig.control.elcam.at(index)
    answer = at.read_double(function) if function == Function.TARGET_POSITION else at.read_int(function)
    assert answer.status is CallStatus.OK
    return answer.value


def go(rig, axis, place, speed=50.0):
    """Move an axis and wait until it rests."""
    assert rig.control.move_absolute(axis, place, speed)
    moving = rig.control.axes[axis]
    while moving.target is not None:
        rig.run(0.02)
    rig.run(0.4)


def jumps(traces, axis):
    """Greatest step of an axis' setpoint from cycle to cycle."""
    return np.abs(np.diff(traces.setpoint[:, axis])).max(initial=0.0)


def compensate(rig, on=1):
    assert rig.control.elcam.write_int(SWITCH, on) == 0


def settle(rig):
    rig.run(0.6)


def watch(rig):
    """Discard the records, but keep the present state."""
    rig.traces()
    rig.run(0.002)


def at(rig, index=0):
    return rig.control.elcam.at(index)


def follows(rig, index=0, master=5.0, place=2.5):
    """Whether the table runs and its follower goes where the hat leads it."""
    go(rig, X, master)
    started = run(rig, index) is CallStatus.OK
    settle(rig)
    return started and rig.count("y") / COUNTS == pytest.approx(place, abs=0.002)


def sized(rig, index=0, points=3, mode=0):
    write(rig, index, axis=Y, master=X)
    if mode:
        write(rig, index, mode=int(mode))
    write(rig, index, buffer_size=points)
