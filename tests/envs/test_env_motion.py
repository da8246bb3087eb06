"""Steps along a path: exact, in order, back the way they came."""

from __future__ import annotations

import numpy as np
import pytest

from edmsim.envs import path_follower as motion
from edmsim.envs import reward
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.plant.fleet import Fleet
from edmsim.plant.kernel.state import STATE
from edmsim.plant.plant import Plant

PATH = np.array([(1000.0, 1000.0), (1010.0, 1000.0), (1013.3, 1008.1), (1002.5, 1013.0)])
WINDOW_NS = 25_500_000


@pytest.fixture
def lane():
    """Rows, path, states and room for one lane on a path of three pieces."""
    rows, states = np.zeros(1, motion.LANE), np.zeros(1, STATE)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(PATH, axis=0).T))])
    rows["corners"], rows["step_um"], rows["longest_ns"] = len(PATH), 2.0, WINDOW_NS
    rows["end"] = int(along[-1] * motion.FINE_PER_UM)
    states["commanded_um"][0, :2] = PATH[0]
    return rows, PATH[None].copy(), along[None], states, np.zeros((1, 64, 3), np.int64)


def run(lane, feeds_um_s):
    """Plan and carry out windows; yields each one's steps."""
    rows, points, along, states, out = lane
    for feed in feeds_um_s:
        rows["feed_nm_s"] = round(feed * 1e3)
        motion.plan(np.zeros(1, np.int64), rows, points, along, states, out)
        steps = out[0, : rows["steps"][0]].copy()
        for _, axis, direction in steps:
            states["commanded_um"][0, axis] += 2.0 * direction
        states["time_ns"] += WINDOW_NS
        place = int(rows["place"][0]) + round(feed * 1e3) * WINDOW_NS
        rows["place"] = min(max(place, 0), int(rows["end"][0]))
        yield steps


def place_of(lane):
    rows, _, along, _, _ = lane
    s = rows["place"][0] / motion.FINE_PER_UM
    return np.array([np.interp(s, along[0], PATH[:, k]) for k in (0, 1)])


def test_counters_follow_the_path_within_half_a_step(lane):
    for steps in run(lane, [37.3] * 40):
        assert (np.diff(steps[:, 0]) >= 0).all()
        assert np.abs(lane[3]["commanded_um"][0, :2] - place_of(lane)).max() <= 1.0 + 1e-9
    assert lane[0]["place"][0] == lane[0]["end"][0]
    assert lane[3]["commanded_um"][0, :2].tolist() == [1002.0, 1014.0] or (
        np.abs(lane[3]["commanded_um"][0, :2] - PATH[-1]).max() <= 1.0
    )


def test_steps_fall_in_their_window_and_at_their_places(lane):
    start = 0
    for steps in run(lane, [100.0] * 3):
        assert (steps[:, 0] >= start).all()
        assert (steps[:, 0] <= start + WINDOW_NS).all()
        start += WINDOW_NS
    # the first step of x leads over the middle between two steps, 1 um on
    lane[0]["place"], lane[0]["segment"], lane[3]["time_ns"] = 0, 0, 0
    lane[3]["commanded_um"][0, :2] = PATH[0]
    first = next(run(lane, [100.0]))[0]
    assert first.tolist() == [10_000_000, 0, 1]


def test_the_way_back_is_the_way_there(lane):
    there = [lane[3]["commanded_um"][0, :2].copy() for _ in run(lane, [61.7] * 12)]
    back = [lane[3]["commanded_um"][0, :2].copy() for _ in run(lane, [-61.7] * 12)]
    assert lane[0]["place"][0] == 0  # no rounding gathers
    assert np.array_equal(np.array(there[:-1][::-1]), np.array(back[:-1]))
    assert (lane[3]["commanded_um"][0, :2] == PATH[0]).all()
    assert not len(next(run(lane, [-61.7])))  # never beyond the start


def test_slow_feeds_are_not_lost(lane):
    list(run(lane, [0.013] * 5000))
    assert lane[0]["place"][0] == 13 * WINDOW_NS * 5000
    assert np.abs(lane[3]["commanded_um"][0, :2] - place_of(lane)).max() <= 1.0


def test_constants_written_twice_agree():
    assert (reward._DONE, reward._WIRE_BREAK) == (motion.DONE, motion.WIRE_BREAK)
    assert max(motion.DONE, motion.WIRE_BREAK) < min(
        motion.LIMIT_SWITCH, motion.PERSISTENT_SHORT, motion.OUT_OF_RANGE
    )


def test_fleet_fires_what_plants_fire_alone():
    machine = Machine.load()
    alone, company = Plant(machine, 3, resolution="fast"), [Plant(machine, k, resolution="fast") for k in (2, 3)]
    fleet, lanes = Fleet(company, threads=2), np.arange(2)
    none = np.zeros((2, 0, 3), np.int64)
    for _ in range(5):
        fleet.advance(lanes, none, np.zeros(2, np.int64))
        assert company[1].window() == alone.advance()
    fleet.close()


def test_fleet_refuses_mixed_plants_and_bad_steps():
    machine = Machine.load()
    plants = [Plant(machine, 1, resolution=name) for name in ("fast", "default")]
    with pytest.raises(InputError, match="one resolution"):
        Fleet(plants)
    fleet = Fleet(plants[:1])
    with pytest.raises(InputError, match="axis"):
        fleet.advance(np.arange(1), np.array([[[0, 4, 1]]]), np.ones(1, np.int64))
