"""Every argument of the registered environments can be written as JSON, and comes back as the same environment."""

import json
from dataclasses import replace
from importlib import resources

import gymnasium as gym
import numpy as np
import pytest

import edmsim
from edmsim.envs import Corner, GapFeed
from edmsim.errors import InputError

COMMON = {
    "machine": {"height_mm": 8.0, "wire": "brass-200"}, "weights": {"short": 2.0}, "materials": ["tool-steel"],
    "height_mm": [5.0, 9.0], "tension": 9.0, "randomise": ["gap"], "action": "speed", "history": 2,
}
OWN = {
    "GapFeed": {"length_mm": 1.0}, "HeightStep": {"band_mm": [0.05, 0.1], "low_share": 0.5},
    "Corner": {"leg_mm": 0.1, "turn_deg": [60.0, 90.0], "setting_octaves": 1.0},
    "Contour": {"program": str(resources.files("edmsim.envs") / "small_punch.ngc")},
    "ThinWire": {"length_mm": 1.0, "wires": 2, "decision_s": 0.1}, "Trim": {"wave_um": [5.0, 6.0], "offset_um": 4.0},
}  # fmt: skip


def first_steps(env):
    """Bits of a reset and a step."""
    observation, info = env.reset(seed=3)
    action = np.full(env.action_space.shape, 0.2, np.float32)
    return observation.tobytes(), info["drawn"], env.step(action)[0].tobytes(), env.step(action)[1]


def test_a_specification_comes_back_from_json(make_env, env_name):
    env = make_env(env_name, **COMMON, **OWN[env_name])
    text = env.spec.to_json()
    assert json.loads(json.dumps(env.spec.kwargs)) == env.spec.kwargs
    again = gym.make(gym.envs.registration.EnvSpec.from_json(text))
    assert again.unwrapped.family == env.unwrapped.family
    assert type(again.unwrapped) is type(env.unwrapped)
    assert first_steps(again) == first_steps(env)


def test_lists_and_mappings_mean_what_tuples_and_objects_mean(make_env, env_name):
    written = make_env(env_name, **COMMON).unwrapped.family
    kind = type(written)
    machine = edmsim.Machine.load(height_mm=8.0, wire="brass-200")
    assert written == kind(
        resolution="fast", machine=machine, weights=replace(kind.own_weights, short=2.0), materials=("tool-steel",),
        height_mm=(5.0, 9.0), tension=9.0, randomise=("gap",), action="speed", history=2,
    )
    assert hash(written) == hash(kind.of(resolution="fast", **COMMON))


def test_a_machine_by_name_or_file(own_file):
    assert GapFeed.of(machine="agiecut-dem15").base == edmsim.Machine.load()
    assert GapFeed.of(machine=own_file("machines", "agiecut-dem15")).base.base == edmsim.Machine.load().base


@pytest.mark.parametrize(("arguments", "message"), [
    ({"weights": {"speed": 1.0}}, "weights has no entry 'speed'; it has progress, short"),
    ({"weights": {"short": -1.0}}, "the weight short is -1.0"),
    ({"machine": {"hight_mm": 3.0}}, "machine has no entry 'hight_mm'; it has name, material"),
    ({"machine": "unheard-of"}, "unheard-of"),
])  # fmt: skip
def test_what_is_unknown_is_refused_by_name(arguments, message):
    with pytest.raises(InputError, match=message):
        Corner.of(**arguments)


def test_an_unknown_argument_is_refused_by_name(make_env, env_name):
    with pytest.raises(InputError, match="has no argument 'colour'"):
        make_env(env_name, colour="red")


@pytest.mark.parametrize(("name", "ranged"), [("Corner", "turn_deg"), ("HeightStep", "band_mm")])
def test_a_number_is_a_range_of_its_own(make_env, name, ranged):
    value = {"turn_deg": 90.0, "band_mm": 0.1}[ranged]
    assert first_steps(make_env(name, **{ranged: value})) == first_steps(make_env(name, **{ranged: (value, value)}))
