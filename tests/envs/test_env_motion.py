"""Steps along a path: exact, in order, back the way they came."""

import numpy as np
import pytest

from edmsim.controllers.planner.kinds import EXACT, FINE_PER_UM, PLANNER, addresses, advance, done
from edmsim.controllers.planner.registry import Course
from edmsim.envs import path_follower as motion
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.plant.fleet import Fleet
from edmsim.plant.kernel.state import STATE
from edmsim.plant.plant import Plant

PATH = np.array([(1000.0, 1000.0), (1010.0, 1000.0), (1013.3, 1008.1), (1002.5, 1013.0)])
WINDOW_NS = 25_500_000


@pytest.fixture
def sub_env():
    """Rows, planner, path, states and room for one environment with the planner `exact` on a path of three pieces."""
    rows, states = np.zeros(1, motion.SUB_ENV), np.zeros(1, STATE)
    rows["step_um"], rows["longest_ns"] = 2.0, WINDOW_NS
    states["commanded_um"][0, :2] = PATH[0]
    return rows, started(), states, np.zeros((1, 64, 3), np.int64)


def started():
    """The path's start, without the rounding of going through mm."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(PATH, axis=0).T))])
    return Course.of(EXACT, PATH)._replace(points_um=PATH, along_um=along)


def run(sub_env, feeds_um_s):
    """Plan and carry out windows; yields each one's steps."""
    rows, course, states, out = sub_env
    ahead, nowhere = np.zeros(1, PLANNER), np.zeros((0, 3), np.int64)
    path = course.points_um, course.along_um, course.lengths
    for feed in feeds_um_s:
        motion.plan(
            np.zeros(1, np.int64), rows, np.array([feed]), 1e3, 1.0, False, addresses().advance, course.row, ahead,
            *(a[None] for a in path), states, out,
        )
        steps = out[0, : rows["steps"][0]].copy()
        for _, axis, direction in steps:
            states["commanded_um"][0, axis] += 2.0 * direction
        start_ns = int(states["time_ns"][0])
        states["time_ns"] += WINDOW_NS
        made = advance(course.row[0], *path, start_ns, start_ns + WINDOW_NS, round(feed * 1e3), nowhere)
        assert made == len(steps)
        yield steps


def place_of(sub_env):
    along = sub_env[1].along_um
    s = sub_env[1].row["along"][0] / FINE_PER_UM
    return np.array([np.interp(s, along, PATH[:, k]) for k in (0, 1)])


def test_counters_follow_the_path_within_half_a_step(sub_env):
    for steps in run(sub_env, [37.3] * 40):
        assert (np.diff(steps[:, 0]) >= 0).all()
        assert np.abs(sub_env[2]["commanded_um"][0, :2] - place_of(sub_env)).max() <= 1.0 + 1e-9
    assert done(sub_env[1].row[0], *sub_env[1][1:])
    assert sub_env[2]["commanded_um"][0, :2].tolist() == [1002.0, 1014.0] or (
        np.abs(sub_env[2]["commanded_um"][0, :2] - PATH[-1]).max() <= 1.0
    )


def test_steps_fall_in_their_window_and_at_their_places(sub_env):
    start = 0
    for steps in run(sub_env, [100.0] * 3):
        assert (steps[:, 0] >= start).all()
        assert (steps[:, 0] < start + WINDOW_NS).all()
        start += WINDOW_NS
    # the first step of x leads over the middle between two steps, 1 um on
    sub_env[2]["time_ns"] = 0
    first = next(run((sub_env[0], started(), *sub_env[2:]), [100.0]))[0]
    assert first.tolist() == [10_000_000, 0, 1]


def test_the_way_back_is_the_way_there(sub_env):
    there = [sub_env[2]["commanded_um"][0, :2].copy() for _ in run(sub_env, [61.7] * 12)]
    back = [sub_env[2]["commanded_um"][0, :2].copy() for _ in run(sub_env, [-61.7] * 12)]
    assert sub_env[1].row["along"][0] == 0  # no rounding gathers
    assert np.array_equal(np.array(there[:-1][::-1]), np.array(back[:-1]))
    assert (sub_env[2]["commanded_um"][0, :2] == PATH[0]).all()
    assert not len(next(run(sub_env, [-61.7])))  # never beyond the start


def test_slow_feeds_are_not_lost(sub_env):
    list(run(sub_env, [0.013] * 5000))
    assert sub_env[1].row["along"][0] == 13 * WINDOW_NS * 5000
    assert np.abs(sub_env[2]["commanded_um"][0, :2] - place_of(sub_env)).max() <= 1.0


def test_fleet_fires_what_plants_fire_alone():
    machine = Machine.load()
    alone, company = Plant(machine, 3, resolution="fast"), [Plant(machine, k, resolution="fast") for k in (2, 3)]
    fleet, indices = Fleet(company, threads=2), np.arange(2)
    for _ in range(5):
        assert not len(fleet.advance(indices, np.zeros(2, np.int64)))
        assert company[1].window() == alone.advance()
    fleet.close()


@pytest.mark.slow
def test_fleet_refuses_mixed_plants_and_bad_steps():
    machine = Machine.load()
    plants = [Plant(machine, 1, resolution=name) for name in ("fast", "default")]
    with pytest.raises(InputError, match="one resolution"):
        Fleet(plants)
    fleet = Fleet(plants[:1])
    fleet.steps[0, 0] = 0, 4, 1
    with pytest.raises(InputError, match="axis"):
        fleet.advance(np.arange(1), np.ones(1, np.int64))
