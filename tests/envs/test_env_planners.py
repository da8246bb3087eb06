"""Environments with the planners of a cut: units, greatest feed, whole corners, and the planner's own steps."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import edmsim
from edmsim.controllers.planner.registry import PLANNERS, make_planner
from edmsim.errors import InputError

COUNTING = tuple(name for name, kind in PLANNERS.items() if kind.counts)


@pytest.mark.parametrize("planner", PLANNERS)
def test_a_sub_environment_goes_where_its_planner_goes_alone(planner, make_task):
    task = make_task("Corner", planner=planner, leg_mm=0.05)
    task.reset(seed=3)
    alone = make_planner(planner, task.scenario.legs_um[0])
    unit, start_ns = alone.speed_unit_nm_s, 0
    for feed in [30.0] * 60 + [-20.3] * 20 + [0.0, 100.0, 5.0] * 8:
        result = task.advance(feed)
        units = round(min(feed, alone.max_feed_um_s) * 1e3 / unit)
        end_ns = task.plant.time_ns
        alone.advance(start_ns, end_ns, units)
        start_ns = end_ns
        assert result.observation.path_um == alone.path_um
        assert task.plant.commanded_um == alone.position_um
        assert result.observation.feed_um_s == pytest.approx(units * unit * 1e-3)
        assert result.done == (alone.done and not result.broken)
        if result.over:
            break
    assert start_ns > 10**9


@pytest.mark.parametrize("planner", COUNTING)
def test_single_and_vector_agree_and_survive_a_pickle(make_env, make_envs, planner):
    env, envs = make_env("Contour", planner=planner), make_envs("Contour", 2, planner=planner)
    one, both = env.reset(seed=5)[0], envs.reset(seed=[5, 6])[0]
    rng = np.random.default_rng(1)
    for step in range(40):
        assert (one == both[0]).all()
        actions = rng.uniform(-1, 1, (2, 1)).astype(np.float32)
        one, both = env.step(actions[0])[0], envs.step(actions)[0]
        if step == 20:
            env, envs = pickle.loads(pickle.dumps(env)), pickle.loads(pickle.dumps(envs))


@pytest.mark.parametrize("planner", COUNTING)
def test_feed_is_held_to_the_planners_greatest_and_shown_as_commanded(make_env, planner):
    env = make_env("GapFeed", action="speed", planner=planner)
    env.reset(seed=1)
    for action, feed in ((1.0, 33.3375), (-1.0, -33.3375), (0.2, 19.95)):
        observation, *_, info = env.step(np.array([action], np.float32))
        assert info["feed_um_s"] == pytest.approx(feed)
        assert observation[6] == pytest.approx(feed / 100, abs=1e-6)  # the scale stays


def test_changes_of_feed_do_not_pile_up_beyond_the_greatest(make_env):
    env = make_env("GapFeed", planner="poscal", start_feed_um_s=32.0, max_change_um_s=2.0)
    env.reset(seed=1)
    feeds = [env.step(np.array([a], np.float32))[4]["feed_um_s"] for a in (1.0, 1.0, 1.0, -1.0)]
    assert feeds == pytest.approx([33.3375, 33.3375, 33.3375, 31.2375])


def test_corners_are_whole_um_where_the_planner_counts(make_task):
    legs = {}
    for planner in ("poscal", "exact"):
        task = make_task("Corner", planner=planner)
        task.reset(seed=3)
        legs[planner] = task.scenario.legs_um[0]
        assert task.scenario.drawn["turn_deg"] % 1.0
    assert (legs["poscal"] == np.rint(legs["exact"])).all()
    assert (legs["exact"] != np.rint(legs["exact"])).any()


def test_a_machine_whose_steps_the_planner_cannot_count_is_refused(tmp_path, make_task):
    text = edmsim.models.path("machines/agiecut-dem15.toml").read_text(encoding="utf-8")
    (tmp_path / "own.toml").write_text(text.replace("step_um = { value = 2.0", "step_um = { value = 2.5"))
    machine = edmsim.Machine.load(str(tmp_path / "own.toml"))
    with pytest.raises(InputError, match=r"table.step_um is 2.5"):
        make_task("GapFeed", planner="poscal", machine=machine)
    task = make_task("GapFeed", machine=machine, planner="exact")
    task.reset(seed=1)
    for _ in range(40):
        result = task.advance(20.0)
    travelled_um = task.plant.commanded_um[0] - task.scenario.legs_um[0][0, 0]
    assert abs(travelled_um - result.observation.path_um) <= 1.25 + 1e-6
