"""Episodes for a controller, bit for bit as the environment's; the table, terms of the reward, and planners."""

from dataclasses import fields
from itertools import repeat

import numpy as np
import pytest

import edmsim
from edmsim.controllers.planner.registry import PLANNERS, make_planner
from edmsim.envs import Task, Weights
from edmsim.errors import InputError

from .conftest import played


def test_a_task_is_its_environment(make_env, env_name, make_task):
    env, task = make_env(env_name, action="speed", decision_s=None, max_feed_um_s=100.0), make_task(env_name)
    _, info = env.reset(seed=3)
    observed = task.reset(seed=3)
    assert (observed.short, observed.open, observed.path_um) == (0, 0, 0.0)
    assert task.scenario.plant_seed == info["plant_seed"]
    assert task.total_um == info["total_um"]
    action = np.zeros(env.action_space.shape, np.float32)
    action[0] = 0.25
    for _ in range(60):
        *_, info = env.step(action)
        result = task.advance(25.0)
    assert (result.observation.short, result.observation.open) == (info["short"], info["open"])
    assert result.observation.path_um == info["path_um"]
    assert result.truth.wire_temperature_K == info["wire_temperature_K"]
    assert result.area_mm2 == info["area_mm2"]
    assert not result.over


def test_setting_is_rounded_refused_or_done(make_task):
    task = make_task("Corner", machine="agiecut-dem15", detents_us=(1.0, 5.0))
    task.reset(seed=1)
    result = task.advance(10.0, t_on_us=40.0)
    assert "2 A" in result.refused
    result = task.advance(10.0, t_on_us=20.4, t_period_us=148.0)
    assert result.refused is None
    assert (task.machine.t_on_us, task.machine.t_period_us) == (20.0, 150.0)
    assert result.observation.duration_s == pytest.approx(255 * 150e-6)
    task.reset(seed=1)
    assert task.machine.t_on_us == 30.0


@pytest.mark.slow
def test_program_of_two_contours_threads_between(tmp_path, make_task):
    square = "G1 X{0} Y0.05\nY0.1\nX{1}\nY0\nX{0}\nY0.05\nG40\n"
    file = tmp_path / "two.ngc"
    file.write_text(
        "G21 G90\nG0 X-0.5 Y0.05\nG41 D1\n" + square.format(0, 0.1) + "G0 X3 Y0.05\nG41 D1\n"
        + square.format(3.5, 3.6) + "M2\n"
    )
    task = make_task("Contour", program=file, height_mm=0.5)
    task.reset(seed=1)
    assert len(task.scenario.legs_um) == 2
    first, x = np.hypot(*np.diff(task.scenario.legs_um[0], axis=0).T).sum(), []
    while True:
        result = task.advance(60.0)
        x.append(task._sub_envs.fleet.plants[0].commanded_um[0])
        if result.over or task.path_um > first + 20:
            break
    assert task.path_um > first
    assert np.diff(x).max() > 1000  # a jump to the other contour's start


def test_it_refuses_what_it_cannot_do(make_task):
    task = make_task("GapFeed", length_mm=0.001)
    with pytest.raises(InputError, match="call reset"):
        task.advance(10.0)
    task.reset(seed=1)
    with pytest.raises(InputError, match="feed_um_s is nan"):
        task.advance(float("nan"))
    with pytest.raises(InputError, match="offset_um is inf: give a finite number"):
        task.advance(5.0, offset_um=float("inf"))
    while not (result := task.advance(50.0)).over:
        pass
    assert result.done
    with pytest.raises(InputError, match=r"has ended \(done\)"):
        task.advance(10.0)
    with pytest.raises(InputError, match="no environment 'Lathe'"):
        Task("Lathe")


# Cuts begin on the middle of the machine's table, whatever its travel.


@pytest.fixture
def small_table(own_file):
    """The standard machine with a travel of 30 mm: its file."""
    return own_file("machines", "agiecut-dem15", ("travel_mm = { value = 65", "travel_mm = { value = 30"))


def test_a_small_table_is_not_left(make_env, env_name, small_table):
    env = make_env(env_name, machine=edmsim.Machine.load(small_table), action="speed")
    *_, over, _, info = played(env, [np.full(env.action_space.shape, 0.1)] * 5)[-1]
    assert not over, info["cause"]


def test_where_the_cut_begins(small_table, make_task):
    for machine, centre_um in ((edmsim.Machine.load(small_table), 15_000.0), (edmsim.Machine.load(), 32_500.0)):
        task = make_task("Corner", machine=machine)
        task.reset(1)
        assert task.scenario.legs_um[0][0].tolist() == [centre_um, centre_um]
        assert machine.base.table.centre_um == (centre_um, centre_um)


def test_a_cut_beyond_the_table_is_refused(small_table, make_task):
    with pytest.raises(InputError, match=r"length_mm is 20\.0: give a number from 0\.0005 to 12\.5"):
        make_task("GapFeed", machine=small_table, length_mm=20.0)
    with pytest.raises(InputError, match="to 30"):
        make_task("GapFeed", length_mm=31.0)


# The reward is the sum of its named terms, at every step of every environment.

NAMES = [f.name for f in fields(Weights)]
ALL = {"progress": 0.7, "short": 0.3, "open": 0.2, "profile": 0.5, "time": 0.1, "done": 5.0, "limit": 1.0}
ROUNDING = 1e-12


@pytest.mark.slow
@pytest.mark.parametrize(("feed", "end"), [(0.05, None), (0.8, "limit"), (1.0, "limit")])
def test_single(make_env, env_name, feed, end):
    # feeds at which wires jam
    env = make_env(env_name, action="speed", planner="exact", decision_s=None, weights=ALL)
    env.reset(seed=4)
    action = np.zeros(env.action_space.shape, np.float32)
    action[0] = feed
    lost = {"Corner": 20.0}.get(env_name, 60.0) / 0.0255  # of threading, in reference windows
    for _ in range(300):
        _, reward, over, _, info = env.step(action)
        terms = info["reward_terms"]
        assert list(terms) == NAMES
        assert all(type(term) is float for term in terms.values())
        assert sum(terms.values()) == pytest.approx(reward, abs=ROUNDING, rel=ROUNDING)
        assert (terms["limit"], terms["wire_break"], terms["done"]) == (-lost if over else 0.0, 0.0, 0.0)
        if over:
            break
    assert over == (end is not None and env_name != "Trim")  # nothing is in front of a wire that goes along a wall


def test_at_the_path_s_end(make_env):
    env = make_env("GapFeed", action="speed", length_mm=0.005, weights=ALL)
    for _, reward, *_, info in played(env, repeat([0.2])):
        assert sum(info["reward_terms"].values()) == pytest.approx(reward, abs=ROUNDING)
    assert info["cause"] == "done"
    assert info["path_um"] == pytest.approx(5.0, abs=1e-6)
    assert info["reward_terms"]["done"] == 5.0


@pytest.mark.slow
def test_vector(make_envs, env_name):
    mode = "NextStep" if env_name == "GapFeed" else "SameStep"  # of all environments alike
    options = {"action": "speed", "decision_s": None, "weights": ALL, "max_episode_steps": 60}
    envs = make_envs(env_name, 3, autoreset_mode=mode, **options)
    envs.reset(seed=2)
    actions = np.zeros(envs.action_space.shape, np.float32)
    actions[:, 0] = 0.1, 0.3, 1.0
    ended = 0
    for _ in range(140):
        _, rewards, over, cut_off, info = envs.step(actions)
        final = info.get("final_info", info)
        mask = final["_reward_terms"]
        total = sum(final["reward_terms"][name] for name in NAMES)
        assert total.shape == (3,)
        np.testing.assert_allclose(total[mask], rewards[mask], rtol=ROUNDING, atol=ROUNDING)
        assert [name for name in final["reward_terms"] if name[0] != "_"] == NAMES
        ended += int((over | cut_off).sum())
    assert ended >= 3
    envs.close()


# Environments with the planners of a cut: units, greatest feed, whole corners, and the planner's own steps.

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
def test_feed_is_held_to_the_planners_greatest_and_shown_as_commanded(make_env, planner):
    env = make_env("GapFeed", action="speed", planner=planner)
    env.reset(seed=1)
    for action, feed in ((1.0, 33.3375), (-1.0, -33.3375), (0.2, 19.95)):
        observation, *_, info = env.step(np.array([action], np.float32))
        assert info["feed_um_s"] == pytest.approx(feed)
        assert observation[6] == pytest.approx(feed / 100, abs=1e-6)  # the scale stays


def test_corners_are_whole_um_where_the_planner_counts(make_task):
    legs = {}
    for planner in ("poscal", "exact"):
        task = make_task("Corner", planner=planner)
        task.reset(seed=3)
        legs[planner] = task.scenario.legs_um[0]
        assert task.scenario.drawn["turn_deg"] % 1.0
    assert (legs["poscal"] == np.rint(legs["exact"])).all()
    assert (legs["exact"] != np.rint(legs["exact"])).any()


def test_a_machine_whose_steps_the_planner_cannot_count_is_refused(own_file, make_task):
    own = own_file("machines", "agiecut-dem15", ("step_um = { value = 2.0", "step_um = { value = 2.5"))
    machine = edmsim.Machine.load(own)
    with pytest.raises(InputError, match=r"table.step_um is 2.5"):
        make_task("GapFeed", planner="poscal", machine=machine)
    task = make_task("GapFeed", machine=machine, planner="exact")
    task.reset(seed=1)
    for _ in range(40):
        result = task.advance(20.0)
    travelled_um = task.plant.commanded_um[0] - task.scenario.legs_um[0][0, 0]
    assert abs(travelled_um - result.observation.path_um) <= 1.25 + 1e-6
