"""The single environments: Gymnasium's contract, seeding, endings, errors, copies."""

import importlib.util
import pickle
import re
import subprocess
import sys
from itertools import repeat

import gymnasium as gym
import matplotlib.style
import numpy as np
import pytest
from gymnasium.error import InvalidAction, ResetNeeded
from gymnasium.utils.env_checker import check_env

import edmsim
from edmsim.envs import render
from edmsim.envs.observation import SETUP_ENTRIES
from edmsim.envs.registry import env_id_of
from edmsim.errors import InputError
from edmsim.recording.figures.palette import VERMILION, rgb

from .conftest import NAMES, infos_of, played


def bits(env, actions):
    """Observations, rewards, endings and machine times of an episode, bit for bit."""
    return [(entries.tobytes(), *more, info["time_s"]) for entries, *more, info in played(env, actions, seed=7)]


@pytest.mark.slow
def test_gymnasium_finds_nothing_wrong(make_env, env_name):
    check_env(make_env(env_name).unwrapped)


@pytest.mark.skipif(importlib.util.find_spec("stable_baselines3") is None, reason="needs the extra rl")
def test_stable_baselines3_finds_nothing_wrong(make_env, env_name):
    from stable_baselines3.common.env_checker import check_env as check

    check(make_env(env_name))


@pytest.mark.slow
def test_name_with_its_module_needs_no_import():
    code = "import gymnasium; print(gymnasium.make('edmsim:edmsim/GapFeed-v2', resolution='fast').spec.id)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "edmsim/GapFeed-v2"


@pytest.mark.slow
def test_same_seed_same_trajectory(make_env, env_name, actions_of):
    env, other = make_env(env_name), make_env(env_name)
    actions = actions_of(env.action_space, 60, 1)[:, 0]
    first = bits(env, actions)
    assert bits(env, actions) == bits(other, actions) == first
    env.reset(seed=8)
    one, two = (e.unwrapped._batch.sub_envs.scenarios[0] for e in (env, other))
    assert one.plant_seed != two.plant_seed


def test_draws_go_on_without_a_seed(make_env):
    env, other = make_env("HeightStep"), make_env("HeightStep")
    firsts = [env.reset(seed=3)[1]["plant_seed"], env.reset()[1]["plant_seed"]]
    assert len(set(firsts)) == 2
    assert [other.reset(seed=3)[1]["plant_seed"], other.reset()[1]["plant_seed"]] == firsts


@pytest.mark.slow
def test_observation_is_finite_and_within_its_space(make_env, env_name, actions_of):
    env = make_env(env_name)
    observation, _ = env.reset(seed=1)
    assert not observation[:40].any()  # nothing has been seen yet
    for action in actions_of(env.action_space, 100, 1, seed=2)[:, 0]:
        observation, *_, terminated, _, _ = env.step(action)
        assert env.observation_space.contains(observation)
        if terminated:
            break


def test_observation_is_what_its_entries_say(make_env):
    env = make_env("GapFeed", action="speed", history=2, planner="exact")
    env.reset(seed=1)
    names = [entry.name for entry in env.unwrapped.family.entries()]
    assert len(names) == env.observation_space.shape[0]
    for _ in range(120):
        before = env.step(np.array([0.28], np.float32))
    observation, *_, info = env.step(np.array([0.2], np.float32))
    entries = dict(zip(names, observation.tolist(), strict=True))
    assert entries["short"] == pytest.approx(info["short"] / 255)
    assert entries["open"] == pytest.approx(info["open"] / 255)
    assert entries["spark"] == pytest.approx((info["spark"] + info["arc"]) / 255)
    assert (entries["commanded_feed"], entries["commanded_feed[-1]"]) == pytest.approx((0.2, 0.28))
    assert entries["actual_feed"] == pytest.approx(0.2)
    assert (entries["t_on"], entries["t_period"]) == pytest.approx((np.log10(30) / 3, 0.5))
    values = [entries[name] for name in ("tension", "height", "flushing_lower")]
    assert values == pytest.approx([1.0, 0.4, 0.3], abs=0.02)
    assert entries["short[-1]"] == before[0][0]
    assert 0.05 < entries["mean_voltage"] < 0.3  # pulses of 30 us in 100
    assert 0.1 < entries["mean_current"] < 1


def test_the_dials_show_the_pressure_that_a_stand_off_leaves():
    machine = edmsim.Machine.load("production", generator="production", standoff_upper_mm=0.5)
    entries = {entry.name: entry.value(machine) for entry in SETUP_ENTRIES}
    assert (entries["flushing_lower"], entries["flushing_upper"]) == pytest.approx((2.0, 0.624), rel=1e-3)  # bar


def test_reward_is_the_sum_of_its_terms(make_env):
    weights = edmsim.envs.Weights(progress=0.7, short=0.3, open=0.2, profile=0.5, time=0.1)
    env = make_env(
        "Corner", machine="agiecut-dem15", action="speed", decision_s=None, near_corner_um=None, weights=weights
    )
    env.reset(seed=1)
    for _ in range(80):
        _, reward, *_, info = env.step(np.array([0.25, 0, 0.4, 0], np.float32))
        pulses = sum(info[kind] for kind in ("short", "open", "spark", "arc"))
        passed, window = info["area_mm2"] / 0.01275, 255e-6 * info["t_period_us"] / 0.0255
        expected = 0.7 * passed - (0.3 * info["short"] / pulses + 0.2 * info["open"] / pulses + 0.1) * window
        expected -= 0.5 * info["error_um"] / 10 * passed
        assert reward == pytest.approx(expected, abs=1e-9)


def test_going_back_and_forth_gains_nothing(make_env):
    env = make_env("GapFeed", action="speed", planner="exact", weights=edmsim.envs.Weights(short=0, open=0))
    env.reset(seed=1)
    gained = [env.step(np.array([feed], np.float32))[1] for feed in [0.28] * 150 + [-0.28] * 100 + [0.28] * 100]
    assert sum(gained[:150]) > 100
    assert abs(sum(gained[151:])) < 0.03 * sum(gained[:150])
    for _ in range(100):
        *_, info = env.step(np.array([-1.0], np.float32))
    assert info["path_um"] == 0.0  # never beyond the start


def test_progress_is_the_path_that_was_cut(make_env):
    infos = infos_of(make_env("GapFeed", action="speed"), [[0.25]] * 400)
    cut_um = sum(info["area_mm2"] for info in infos) / 20e-3
    assert cut_um == pytest.approx(infos[-1]["path_um"], abs=15)  # the wire leads or lags by some um


def test_pushing_against_metal_gains_nothing_and_ends_the_episode(make_env):
    steps = played(make_env("GapFeed", action="speed", planner="exact"), repeat([0.9]))
    rewards = [reward for _, reward, *_, info in steps if info["short"] == 255]
    assert steps[-1][4]["cause"] in ("persistent-short", "out-of-range")
    assert len(rewards) > 10
    assert set(rewards[:-1]) == {-0.5}
    assert rewards[-1] == pytest.approx(-0.5 - 60 / 0.0255)  # another wire has to be threaded


def test_refused_setting_is_reported_and_not_done(make_env):
    env = make_env(
        "Corner", machine="agiecut-dem15", action="speed", decision_s=None, detents_us=(1.0, 5.0)
    )
    env.reset(seed=1)
    *_, info = env.step(np.array([0.1, 0.0, -0.5, 0.0], np.float32))
    assert "above the generator's 2 A" in info["refused"]
    assert (info["t_on_us"], info["t_period_us"]) == (30.0, 100.0)
    *_, info = env.step(np.array([0.1, 0.5, -0.5, 0.0], np.float32))  # the on-time counts all the same
    assert "t_period must be at least" in info["refused"]
    assert (info["t_on_us"], info["t_period_us"]) == (60.0, 200.0)
    for knobs, setting in (((0.0, 0.5), (30.0, 200.0)), ((0.5, 0.0), (60.0, 200.0)), ((1.0, 1.0), (120.0, 1600.0))):
        *_, info = env.step(np.array([0.1, *knobs, 0.0], np.float32))
        assert info["refused"] == ""
        assert (info["t_on_us"], info["t_period_us"]) == setting


def test_what_is_drawn_is_reported(make_env):
    env = make_env(
        "GapFeed", height_mm=(10, 40), tension=(8, 12), materials=("tool-steel", "copper"), randomise=("dielectric",)
    )
    drawn = [env.reset(seed=seed)[1]["drawn"] for seed in range(6)]
    assert {d["material"] for d in drawn} == {"tool-steel", "copper"}
    assert all(10 <= d["height_mm"] <= 40 and 8 <= d["tension"] <= 12 for d in drawn)
    assert len({d["dielectric.conductivity_uS_cm"] for d in drawn}) == 6
    assert not any(key.startswith("gap.") for d in drawn for key in d)
    assert len({tuple(d) for d in drawn}) == 1


def test_machine_may_be_passed(make_env):
    env = make_env("GapFeed", height_mm=(10, 40))
    machine = edmsim.Machine.load(height_mm=33.0)
    assert env.reset(seed=1, options={"machine": machine})[1]["drawn"]["height_mm"] == 33.0


@pytest.mark.parametrize(("planner", "start_um_s", "actions", "feeds_um_s"), [
    ("exact", 10.0, (0.5, 1.0, -1.0, 3.0), [11, 13, 11, 13]),  # beyond 1 is clipped
    ("poscal", 32.0, (1.0, 1.0, 1.0, -1.0), [33.3375, 33.3375, 33.3375, 31.2375]),  # nothing piles up beyond its most
])  # fmt: skip
def test_feed_changes_by_the_action(make_env, planner, start_um_s, actions, feeds_um_s):
    env = make_env("GapFeed", start_feed_um_s=start_um_s, max_change_um_s=2.0, planner=planner)
    infos = infos_of(env, np.transpose([actions]))
    assert [info["feed_um_s"] for info in infos] == pytest.approx(feeds_um_s)


def test_discrete_levels(make_env):
    """Those of Gymnasium: of the knobs, one bin each keeps the first setting."""
    env = gym.wrappers.DiscretizeAction(make_env("Corner", action="speed", offset_um=None), bins=(4, 1, 1))
    assert env.action_space == gym.spaces.Discrete(4)
    env.reset(seed=1)
    steps = [env.step(k)[4] for k in range(4)]
    assert [step["feed_um_s"] for step in steps] == pytest.approx([-75, -25, 25, 75])
    assert len({(step["t_on_us"], step["t_period_us"]) for step in steps}) == 1


def test_step_before_reset_and_after_the_end(make_env):
    env = make_env("GapFeed", length_mm=0.001, action="speed")
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(1, np.float32))
    with pytest.raises(ResetNeeded, match="no episode has begun"):
        env.unwrapped.step(np.zeros(1, np.float32))
    env.reset(seed=1)
    while not env.step(np.ones(1, np.float32))[2]:
        pass
    with pytest.raises(ResetNeeded, match="has ended"):
        env.step(np.zeros(1, np.float32))


@pytest.mark.parametrize(("action", "message"), [
    (np.array([np.nan], np.float32), "finite"), (np.array([np.inf], np.float32), "finite"), ([1e300], "not [1e+300]"),
    (np.zeros(2, np.float32), "shape (1,), not (2,)"), (np.float32(0), "shape (1,), not ()"), ("fast", "numbers"),
    (["0.5"], "numbers"), (np.array([0.5j]), "numbers"), ([0.5, [0.5]], "numbers"),
])  # fmt: skip
def test_bad_action(make_env, action, message):
    env = make_env("GapFeed").unwrapped
    env.reset(seed=1)
    with pytest.raises(InvalidAction, match=re.escape(message)):
        env.step(action)


@pytest.mark.parametrize(("name", "options", "message"), [
    ("GapFeed", {"resolution": "finest"}, "unknown resolution 'finest'"),
    ("GapFeed", {"action": "thrust"}, "unknown action 'thrust'"), ("GapFeed", {"history": 0}, "history is 0"),
    ("GapFeed", {"mechanics": "clay"}, "unknown mechanics 'clay'"),
    ("GapFeed", {"knobs": ["period", "period_ratio"]}, "period or period_ratio, not both"),
    ("GapFeed", {"knobs": ["volume"]}, "unknown knob 'volume'"),
    ("GapFeed", {"objectives": ["beauty"]}, "unknown objective 'beauty'"),
    ("GapFeed", {"randomise": False}, "randomise is False"),
    ("GapFeed", {"randomise": ["table"]}, "'table', which has no effect here"),
    ("GapFeed", {"randomise": ["dielectric.nozzle_mm"]}, "'dielectric.nozzle_mm', which has no effect here"),
    ("GapFeed", {"wires": 0}, "wires is 0"), ("GapFeed", {"decision_s": -1.0}, "decision_s is -1.0"),
    ("GapFeed", {"sensors": {"bits": 20}}, "bits is 20"), ("GapFeed", {"height_mm": (30, 10)}, "height_mm"),
    ("GapFeed", {"height_mm": 1000.0}, "1000"), ("GapFeed", {"materials": "copper"}, "give a list of texts"),
    ("GapFeed", {"weights": 3}, r"weights is 3: give Weights or None \(`Weights`, or a mapping"),
    ("GapFeed", {"sensors": True}, "sensors is True: give Sensors or None"),
    ("GapFeed", {"machine": 5}, "machine is 5: give Machine or None"),
    ("GapFeed", {"machine": {"base": 3}}, "machine: name: missing"),
    ("GapFeed", {"planner": 3}, "planner is 3: give a text"),
    ("GapFeed", {"resolution": None}, "resolution is None: give a text"),
    ("GapFeed", {"knobs": True}, "knobs is True: give a list of texts"),
    ("GapFeed", {"servo_gains": [10]}, r"servo_gains is \(10,\): give two numbers"),
    ("GapFeed", {"servo_target_share": [0.2, 0.2]}, "give two that differ"),
    ("GapFeed", {"detents_us": (1.0, 1e-9)}, "detents_us is 1e-09: give a number from 0.001"),
    ("GapFeed", {"history": 10**8}, "history is 100000000: give a whole number from 1 to 10000"),
    ("GapFeed", {"episode_s": 1e300}, "episode_s is 1e"),
    ("GapFeed", {"decision_s": 1e9}, "decision_s is 1000000000.0"),
    ("GapFeed", {"energy_bound_mJ": 1e-300}, "energy_bound_mJ is 1e-300"),
    ("GapFeed", {"max_feed_um_s": 1e12}, "max_feed_um_s is 1000000000000.0"),
    ("GapFeed", {"weights": {"short": 1e300}}, "the weight short is 1e"),
    ("GapFeed", {"tension": (8.0, 50.0)}, "50 N breaks the 250 um brass wire at rest: it holds 46.6 N; None"),
    ("ThinWire", {"tension": (1.0, 9.0)}, r"tension is \(1.0, 9.0\): wire tension 9 N breaks the 100 um"),
    ("GapFeed", {"length_mm": 1e-9}, "length_mm is 1e-09: give a number from 0.0005"),
    ("Corner", {"leg_mm": 6e-4, "planner": "poscal"}, "leg_mm is 0.0006: give a number from 0.001"),
    ("HeightStep", {"band_mm": 1e-6}, "band_mm is 1e-06: give a number from 0.05"),
    ("Trim", {"wave_mm": 1e-6}, "wave_mm is 1e-06: give a number from 0.05"),
    ("Contour", {"program": 5}, "program is 5: give a text, a path or None"),
    ("GapFeed", {"materials": ("cheese",)}, "cheese"), ("GapFeed", {"randomise": ("weather",)}, "weather"),
    ("GapFeed", {"length_mm": -1.0}, "length_mm"), ("GapFeed", {"planner": "straight"}, "no planner 'straight'"),
    ("GapFeed", {"max_feed_um_s": float("nan")}, "max_feed_um_s"), ("GapFeed", {"render_mode": "ascii"}, "ascii"),
    ("HeightStep", {"low_share": 0.0}, "low_share"), ("Corner", {"turn_deg": (5, 90)}, "turn_deg"),
    ("Contour", {"program": "nowhere.ngc"}, "nowhere.ngc"),
])  # fmt: skip
@pytest.mark.filterwarnings("ignore:.*render_mode.*")
def test_bad_arguments(make_env, name, options, message):
    with pytest.raises(InputError, match=message):
        make_env(name, **options)


@pytest.mark.parametrize(("arguments", "message"), [
    ({"options": {"machin": None}}, "no option 'machin'"),
    ({"options": {"machine": "agiecut"}}, "give an edmsim.Machine"),
    ({"options": "abc"}, "the options of a reset are 'abc': give a mapping, as {'machine': ...}"),
    ({"seed": -1}, "seed is -1: give a whole number, 0 or more"),
    ({"seed": 1.5}, "seed is 1.5: give a whole number, 0 or more"),
])  # fmt: skip
def test_bad_resets(make_env, make_envs, arguments, message):
    for env in (make_env("GapFeed"), make_envs("GapFeed", 2)):
        with pytest.raises(InputError, match=re.escape(message)):
            env.reset(**arguments)


@pytest.mark.slow
def test_copies_go_on_bit_for_bit(make_env, env_name, actions_of):
    env = make_env(env_name)
    actions = 0.3 * actions_of(env.action_space, 30, 1)[:, 0]  # the shortest periods break a wire of Corner
    env.reset(seed=5)
    for action in actions[:15]:
        env.step(action)
    twin = pickle.loads(pickle.dumps(env))  # as copy.deepcopy does it
    for action in actions[15:]:
        ours, theirs = env.step(action), twin.step(action)
        assert (ours[0] == theirs[0]).all()
        assert ours[1:] == theirs[1:]
    assert env.reset()[1] == twin.reset()[1]


@pytest.mark.slow
@pytest.mark.parametrize(("env_name", "gl"), [*((name, True) for name in NAMES), ("Corner", False)],
                         indirect=["env_name"])  # fmt: skip
def test_pictures(make_env, env_name, monkeypatch, gl):
    if not gl:
        monkeypatch.setattr("edmsim.envs.render.has_gl", lambda: False)
    env = make_env(env_name, render_mode="rgb_array")
    env.reset(seed=1)
    picture = env.render()
    assert picture.shape == (480, 640, 3)
    assert picture.dtype == np.uint8
    assert picture.std() > 5
    with matplotlib.style.context("dark_background"):  # the user's
        assert (env.render() == picture).all()
    env.step(env.action_space.sample())
    strip = render.STRIP
    after = env.render()
    assert (after[-strip:] != picture[-strip:]).any()  # feed, pulses, reward
    vermilion = (np.abs(after[:-strip].astype(int) - rgb(VERMILION)).max(axis=2) < 4).sum()
    assert gl or vermilion > 20  # the wire and its sign in the legend
    env.close()


def test_picture_needs_an_episode(make_env):
    with pytest.raises(ResetNeeded):
        make_env("GapFeed", render_mode="rgb_array").unwrapped.render()


@pytest.mark.filterwarnings("ignore:.*out of date.*")
@pytest.mark.parametrize("make", [gym.make, gym.make_vec, edmsim.envs.Task])
def test_ids_are_registered_and_other_versions_refused(env_name, make):
    present = env_id_of(env_name)
    assert present in gym.registry
    for version in range(int(present[-1])):
        with pytest.raises((gym.error.DeprecatedEnv, InputError), match=present):
            make(f"edmsim/{env_name}-v{version}")
