"""All types of real and whole numbers are accepted wherever a user passes a number; bool and str are refused."""

import json
import math
from decimal import Decimal
from fractions import Fraction

import gymnasium as gym
import numpy as np
import pytest

import edmsim
from edmsim import controllers
from edmsim.closed_loop.straight import Traverse
from edmsim.envs import EdmVectorEnv, GapFeed, HeightStep, MaxRate, RecordRerun, Sensors, Task, Weights
from edmsim.errors import InputError
from edmsim.job.options import CutSettings
from edmsim.learning import hyperparameters
from edmsim.machine.overrides import with_overrides
from edmsim.numeric import finite, plain, real, whole, whole_from

EIGHTS = (8, 8.0, np.float32(8), np.float64(8), np.float16(8), np.longdouble(8), np.int8(8), np.uint64(8),
          Fraction(8), np.array(8), np.array(8.0, np.float32))  # fmt: skip
WHOLE = tuple(value for value in EIGHTS if whole(value) is not None)
NONE = (True, np.True_, np.array(True), "8", None, 8j, [8], np.array([8.0]), math.nan, Decimal("NaN"))


def kind_of(value):
    return f"{type(value).__name__}-{value!r}"


@pytest.mark.parametrize("value", EIGHTS, ids=kind_of)
def test_a_number_becomes_pythons_own(value):
    assert real(value) == finite("it", value) == 8
    assert type(real(value)) in (int, float)
    assert type(plain((value, [value], "8"))[1][0]) in (int, float)


def test_whole_numbers_are_distinguished_from_others():
    assert len(WHOLE) == 4
    assert all(whole_from("it", value, 8) == 8 for value in WHOLE)
    for value in (8.0, Fraction(17, 2), np.float64(8), *NONE):
        with pytest.raises(InputError, match=r"it is .*: give a whole number, 1 or more"):
            whole_from("it", value, 1)


@pytest.mark.parametrize("value", [*NONE, math.inf, -math.inf, Fraction(10**400), -10**400], ids=kind_of)
def test_what_is_no_finite_number_is_refused(value):
    with pytest.raises(InputError, match=r"it is .*: give a finite number"):
        finite("it", value)


@pytest.mark.parametrize("value", EIGHTS, ids=kind_of)
def test_an_environment_takes_it_and_is_the_same(value):
    values = {"height_mm": (value, value), "tension": value, "episode_s": value, "max_change_um_s": value,
             "detents_us": (value, value), "cost_limit": value, "start_feed_um_s": value, "length_mm": value,
             "weights": {"short": value}, "decision_s": value, "setting_octaves": Fraction(1, 2)}  # fmt: skip
    usual = {name: (8.0, 8.0) if isinstance(v, tuple) else 8.0 for name, v in values.items()}
    usual |= {"weights": {"short": 8.0}, "setting_octaves": 0.5}
    made = GapFeed.of(**values)
    assert made == GapFeed.of(**usual)
    assert made.draw(np.random.default_rng(1)).machine == GapFeed.of(**usual).draw(np.random.default_rng(1)).machine
    env = gym.make("edmsim/GapFeed-v2", **values)
    assert json.loads(json.dumps(env.spec.kwargs)) == env.spec.kwargs
    assert MaxRate.of(tension=(value, 16)) == MaxRate.of(tension=(8.0, 16.0))


@pytest.mark.parametrize("value", WHOLE, ids=kind_of)
def test_an_environment_takes_whole_numbers_and_seeds(value, tmp_path):
    assert GapFeed.of(history=value, wires=value, machine_episodes=value) == GapFeed.of(
        history=8, wires=8, machine_episodes=8
    )
    assert Sensors(bits=value, noise_share=np.float32(0.5)) == Sensors(bits=8, noise_share=0.5)
    envs = EdmVectorEnv("GapFeed", num_envs=value, threads=value, max_episode_steps=value)
    assert envs.num_envs == 8
    seeds = [envs.reset(seed=seed)[1]["plant_seed"].tolist() for seed in (8, value, [value, *range(9, 16)])]
    assert seeds[0] == seeds[1] == seeds[2]
    env = gym.make("edmsim/GapFeed-v2")
    assert env.reset(seed=value)[1]["plant_seed"] == seeds[0][0]
    assert RecordRerun(env, tmp_path, every=value)


@pytest.mark.parametrize("value", NONE, ids=kind_of)
def test_an_environment_refuses_what_is_no_number(value):
    for name in ("episode_s", "tension", "length_mm", "max_feed_um_s", "latency_s", "start_feed_um_s", "history"):
        if value is not None or name not in ("episode_s", "tension"):
            with pytest.raises(InputError, match=name):
                GapFeed.of(**{name: value})
    for make in (lambda: Weights(short=value), lambda: Sensors(bits=value), lambda: HeightStep(low_share=value)):
        with pytest.raises(InputError, match=r"short|bits|low_share"):
            make()
    env, envs = gym.make("edmsim/GapFeed-v2"), EdmVectorEnv("GapFeed", num_envs=2)
    if value is not None:
        with pytest.raises(InputError, match="seed"):
            env.reset(seed=value)
        with pytest.raises(InputError, match="seed"):
            envs.reset(seed=value)
        with pytest.raises(InputError, match="seed"):
            envs.reset(seed=[value, 1])


@pytest.mark.parametrize("value", EIGHTS, ids=kind_of)
def test_a_cut_and_a_machine_take_it_and_are_the_same(value):
    values = {"height_mm": value, "tension": value, "t_on_us": value, "offset": value, "max_time_s": value,
             "heights": [(value, value)], "constants": {"gap.critical_um": value}}  # fmt: skip
    usual = {**dict.fromkeys(values, 8.0), "heights": [(8.0, 8.0)], "constants": {"gap.critical_um": 8.0}}
    settings = CutSettings.model_validate(values)
    assert settings.model_dump_json() == CutSettings.model_validate(usual).model_dump_json()
    machine = edmsim.Machine.load(height_mm=value, tension=value, t_on_us=value)
    assert machine == edmsim.Machine.load(height_mm=8.0, tension=8.0, t_on_us=8.0)
    assert machine.with_(tension=value, wire_speed_m_s=value) == machine.with_(tension=8.0, wire_speed_m_s=8.0)
    assert repr(machine.with_pulses(value, Fraction(800))) == repr(machine.with_pulses(8.0, 800.0))
    assert with_overrides(machine, {"gap.critical_um": value}.items()).base.gap.critical_um.value == 8.0


@pytest.mark.parametrize("value", [True, np.True_, np.array(False), 8j, [8], np.array([8.0])], ids=kind_of)
def test_a_cut_and_a_machine_refuse_what_is_no_number(value):
    for name in ("height_mm", "tension", "peak_current_A", "offset", "max_time_s", "seed"):
        with pytest.raises(InputError, match=name):
            CutSettings.model_validate({name: value})
    changes = {"heights": [(2.0, value)]}, {"heights": [(value, 5.0)]}, {"constants": {"gap.critical_um": value}}
    for values in changes:
        with pytest.raises(InputError, match=r"height|critical_um is"):
            CutSettings.model_validate(values)
    machine = edmsim.Machine.load()
    for name in ("height_mm", "tension", "wire_diameter_um", "peak_current_A"):
        with pytest.raises(InputError, match=name):
            machine.with_(**{name: value})


@pytest.mark.slow
@pytest.mark.parametrize("value", WHOLE, ids=kind_of)
def test_a_task_and_a_plant_take_it_and_are_the_same(value):
    task, other = Task("GapFeed"), Task("GapFeed")
    task.reset(value), other.reset(8)
    assert task.scenario.plant_seed == other.scenario.plant_seed
    assert task.advance(value).observation == other.advance(8.0).observation
    machine = edmsim.Machine.load(height_mm=3.0)
    windows = [edmsim.Plant(machine, seed=seed, resolution="fast").advance() for seed in (value, 8)]
    assert windows[0] == windows[1]


@pytest.mark.parametrize("value", [True, np.True_, "8", math.nan], ids=kind_of)
def test_a_task_refuses_what_is_no_number(value):
    task = Task("GapFeed")
    with pytest.raises(InputError, match="seed"):
        task.reset(value)
    task.reset(1)
    with pytest.raises(InputError, match="feed_um_s is"):
        task.advance(value)


def test_a_truth_value_is_no_number_of_settings(tmp_path):
    file = tmp_path / "settings.toml"
    for line in ("steps = true", "[network]\nwidths = [true]"):
        file.write_text(line, encoding="utf-8")
        with pytest.raises(InputError, match="not a truth value"):
            hyperparameters.load("GapFeed", "ppo", file)


def test_a_truth_value_is_no_constant_of_a_file(tmp_path):
    file = tmp_path / "wire.toml"
    file.write_text('like = "brass"\nmelting_K = { value = true, source = "a slip" }\n', encoding="utf-8")
    with pytest.raises(InputError, match=r"melting_K.value.*not a truth value"):
        edmsim.Machine.load(wire=str(file))


@pytest.mark.parametrize("value", EIGHTS, ids=kind_of)
def test_a_controller_takes_it_as_parameter(value):
    assert controllers.make("fixed", feed_um_s=value) == controllers.make("fixed", feed_um_s=8.0)
    assert type(controllers.make("voltage", reference_V=value).reference_V) in (int, float)
    assert Traverse(edmsim.Plant(edmsim.Machine.load(), resolution="fast"), value).feed_um_s == 8.0


@pytest.mark.parametrize("value", [True, np.True_, "8", None, math.nan], ids=kind_of)
def test_a_controller_refuses_what_is_no_number(value):
    with pytest.raises(InputError, match="feed_um_s of the fixed controller must be a number of 0 or more"):
        controllers.make("fixed", feed_um_s=value)
