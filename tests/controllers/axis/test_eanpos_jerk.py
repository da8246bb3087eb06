"""Ramps of limited jerk, beyond the EANPOS manual, against ruckig's time-optimal motion from rest to rest."""

from __future__ import annotations

import numpy as np
import pytest

from tests.controllers.axis.eanpos_bench import TOP, Positioner

ruckig = pytest.importorskip("ruckig", reason="an extra of the tests")


def optimal(way, speed, acceleration, jerk):
    """Ruckig's motion over a way: no intermediate places, which that library would send over the network."""
    wanted, found = ruckig.InputParameter(1), ruckig.Trajectory(1)
    wanted.current_position, wanted.target_position = [0.0], [way]
    wanted.max_velocity, wanted.max_acceleration, wanted.max_jerk = [speed], [acceleration], [jerk]
    ruckig.Ruckig(1).calculate(wanted, found)
    return found


@pytest.mark.parametrize(
    ("way", "speed", "ramp", "jerk"),
    [
        (2000, 50000, 100, 10000),  # the acceleration is reached, and the speed
        (2000, 50000, 100, 2000),  # the acceleration is not
        (300, 100000, 100, 20000),  # the speed is not
        (40, 100000, 50, 3000),  # neither
        (-1500, 80000, 30, 90000),
    ],
)
def test_a_placement_is_time_optimal_under_its_limits(way, speed, ramp, jerk):
    p = Positioner(tcamp_ms=1, setpos=way, setvel=speed, taccdec=ramp, settings={"jerk_limit": jerk})
    best = optimal(way, speed / 60, TOP / (ramp * 0.01), jerk)
    p.do("START")
    gaps = []
    while not p["st_still"]:
        place, velocity, _ = (value[0] for value in best.at_time(p.since_s))
        gaps.append((p.theory[0] - place, p.theory[1] - abs(velocity)))
        p.sample()
    assert p.since_s == pytest.approx(best.duration, abs=1.1e-3)
    assert np.abs(gaps).max(axis=0) == pytest.approx([0.0, 0.0], abs=1e-6)


def test_a_speed_change_in_motion_keeps_the_jerk():
    p = Positioner(tcamp_ms=1, setpos=9000, settings={"jerk_limit": 5000})
    p.do("START")
    p.run(1.5)
    p["setvel"] = 100000
    speeds = []
    for _ in range(1500):
        p.sample()
        speeds.append(p.theory[1])
    assert max(speeds) == pytest.approx(TOP)
    assert np.abs(np.diff(speeds, 2)).max() * 1e6 == pytest.approx(5000, rel=0.01)
