"""What cam tables can do here beyond their document, on the bench: curves, coming in on a ramp, PLCopen's names."""

from __future__ import annotations

import numpy as np
import pytest

from edmsim.controllers.axis.elcam.registers import Function, Mode

from .cam_bench import COUNTS, HAT, X, Y, go, jumps, read, rig_of, run, settle, table, watch


@pytest.mark.slow
def test_a_curve_passes_through_the_points_without_corners():
    bends = {}
    for cubic in (False, True):
        rig = rig_of()
        points = [(x, 5.0 * np.sin(2 * np.pi * x / 40.0)) for x in np.arange(0.0, 41.0, 4.0)]
        table(rig, 0, points)
        rig.control.elcam.tables[0].extensions.cubic = cubic
        run(rig, 0)
        for x, y in points[1:4]:
            go(rig, X, x)
            assert rig.control.axes[Y].setpoint == pytest.approx(y)
        go(rig, X, 8.0)
        rig.control.axes[X].accel = 1e6
        rig.control.move_velocity(X, 20.0)
        rig.run(0.01)
        watch(rig)
        rig.run(1.0)
        bends[cubic] = np.abs(np.diff(rig.traces().setpoint[:, Y], 2)).max()
    assert bends[True] < 0.1 * bends[False]


def test_a_follower_can_come_in_on_a_ramp():
    rig = rig_of()
    go(rig, X, 5.0)
    table(rig, 0, HAT)
    watch(rig)
    assert rig.control.cam_in(0, ramp_s=0.2)
    rig.run(0.1)
    assert not rig.control.in_sync(0)
    rig.run(0.15)
    assert rig.control.in_sync(0)
    settle(rig)
    assert jumps(rig.traces(), Y) < 0.02  # of 2.5
    assert rig.count("y") / COUNTS == pytest.approx(2.5, abs=0.002)


def test_names_of_plcopen():
    rig = rig_of()
    table(rig, 0, HAT)
    assert not rig.control.in_sync(0)
    assert rig.control.cam_in(0)
    assert rig.control.in_sync(0)
    assert not rig.control.move_absolute(Y, 3.0, 10.0)
    rig.control.cam_out(0)
    assert not rig.control.in_sync(0)
    assert not read(rig, 0, Function.MODE) & Mode.RUN
    assert rig.control.halt(Y)
    assert not rig.control.cam_in(1)  # a table without points
