"""Shifts: by the clock, a test cut first, water that drifts."""

import pickle
from itertools import repeat

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import edmsim
from edmsim.controllers import make
from edmsim.envs import families
from edmsim.envs.episode import Task
from edmsim.envs.task import Drift
from edmsim.errors import InputError
from edmsim.evaluation.episode import Episode
from edmsim.machine.ranges import with_values
from edmsim.machine.setting import flushing_Pa
from edmsim.plant.constants import faces_Pa

from .conftest import infos_of, played


@pytest.fixture(scope="module")
def weak():
    """A set-up whose wire breaks in its first second, on a table for a shift."""
    strained = edmsim.Machine.load(wire="brass-100", tension=2.0, height_mm=10.0, t_on_us=10.0, t_period_us=50.0)
    return families.on_a_large_table(with_values(strained, {"wire.half_strength_K": 310.0}))


def test_a_lost_wire_costs_its_time_and_nothing_else(make_env, weak):
    """Three wires of a minute's threading fit into 150 s by the clock, though each breaks in its first second."""
    steps = played(make_env("ThinWireShift", machine=weak, episode_s=150.0), repeat([-1.0, 0.0]))
    observed, _, over, late, info = steps[-1]
    assert (over, late) == (False, True)
    assert info["wires_lost"] == sum(step[4]["cost"] for step in steps) == 3
    assert not any(step[4]["reward_terms"]["wire_break"] for step in steps)
    assert 150.0 <= info["time_s"] < 182.0
    assert info["dt_s"] > 60.0
    assert observed[-2] == 1.0  # the share of the shift that is over


def test_the_threading_of_a_wire_that_breaks_last_is_in_the_rate(weak):
    stronger = with_values(weak, {"wire.half_strength_K": 460.0})
    task = Task("ThinWireShift", machine=stronger, episode_s=10.0, test_s=0.0)
    made = Episode(task, make("fixed", feed_um_s=60.0), 1, "fixed").run()
    assert (made.outcome, made.wires_lost) == ("time", 1)
    assert made.area_mm2 > 0.0
    assert made.rate_mm2_min == pytest.approx(60.0 * made.area_mm2 / (made.time_s + 60.0))


def test_a_test_cut_earns_nothing(make_env):
    infos = infos_of(make_env("MaxRateShift", test_s=1.0), [[-1.0, 0.0]] * 16)
    time_s, area, path_um = (np.array([info[name] for info in infos]) for name in ("time_s", "area_mm2", "path_um"))
    assert (area[time_s <= 1.0] == 0.0).all()
    assert area[time_s > 1.11].min() > 0.0
    assert path_um[time_s <= 1.0][-1] > 5.0


def test_water_drifts_evenly_and_the_gauge_does_not_show_it():
    machine = edmsim.Machine.load()
    drift = Drift(100.0, 10.0, 20.0, 0.5)
    half, whole, later = (drift.machine(machine, time_s) for time_s in (50.0, 100.0, 500.0))
    assert half.base.dielectric.conductivity_uS_cm.value == pytest.approx(15.0)
    assert flushing_Pa(half) == pytest.approx(tuple(0.75 * value for value in flushing_Pa(machine)))
    assert faces_Pa(whole) == pytest.approx(tuple(0.5 * value for value in faces_Pa(machine)))
    assert later == whole
    assert drift.machine(machine, 0.0).base == machine.base


def test_a_drifting_plant_is_deterministic_copies_go_on_and_the_next_shift_is_fresh(make_env, monkeypatch):
    monkeypatch.setattr(families, "DRIFT_EVERY_S", 0.3)
    env = make_env("ThinWireShift", episode_s=4.0, decision_s=0.1, machine_episodes=2, flushing_left=0.5)
    other = make_env("ThinWireShift", episode_s=4.0, decision_s=0.1, flushing_left=1.0, conductivity_uS_cm=None)
    action = np.array([-1.0, -0.5], np.float32)

    def steps_of(env, steps):
        return [np.append(observed, reward) for observed, reward, *_ in (env.step(action) for _ in range(steps))]

    env.reset(seed=3)
    first = steps_of(env, 8)
    copied = pickle.loads(pickle.dumps(env.unwrapped))
    on = steps_of(env, 8)
    assert np.array_equal(on, steps_of(copied, 8))
    plant = env.unwrapped._batch.sub_envs.fleet.plants[0]
    assert flushing_Pa(plant.machine)[0] < 0.95 * flushing_Pa(env.unwrapped.family.base)[0]
    env.reset(seed=3)
    assert np.array_equal(first, steps_of(env, 8))
    other.reset(seed=3)
    assert not np.array_equal(on, steps_of(other, 16)[8:])
    env.reset()
    env.step(action)
    assert flushing_Pa(plant.machine)[0] > 0.99 * flushing_Pa(env.unwrapped.family.base)[0]


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", ["MaxRateShift", "ThinWireShift"])
def test_gymnasium_checks_a_shift(make_env, name):
    check_env(make_env(name, episode_s=0.3, test_s=0.1, decision_s=0.05).unwrapped, skip_render_check=True)


@pytest.mark.parametrize(("options", "said"), [
    ({"test_s": -1.0}, "test_s"), ({"flushing_left": 0.0}, "flushing_left"),
    ({"flushing_left": 1.5}, "flushing_left"), ({"conductivity_uS_cm": 0.0}, "conductivity_uS_cm"),
    ({"length_mm": 396.0}, "length_mm"),
])  # fmt: skip
def test_bad_input_is_refused(make_env, options, said):
    with pytest.raises(InputError, match=said):
        make_env("MaxRateShift", **options)
