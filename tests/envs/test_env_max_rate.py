"""MaxRate: what its id says, where its discharges are, and what a lost wire costs."""

import gymnasium as gym
import numpy as np
import pytest

from edmsim.controllers import make
from edmsim.envs import Task
from edmsim.envs.families import KNOWN, KNOWN_TO_SHARE, MaxRate
from edmsim.errors import InputError

from .conftest import played

ID = "edmsim/MaxRate-v1"
FIRST_FIFTH = 10


def test_an_id_is_the_benchmark():
    family = gym.make(ID).unwrapped.family
    assert (family.height_mm, family.tension, family.flushing_Pa) == ((30.0, 80.0), (18.0, 26.0), (50e3, 300e3))
    assert (family.length_mm, family.band_mm, family.low_share) == (8.0, (0.15, 0.5), 0.25)
    assert (family.resolution, family.mechanics, family.planner, family.history) == ("fast", "modal", "exact", 4)
    assert (family.episode_s, family.wires, family.decision_s, family.randomise) == (25.0, 20, 0.1, ())
    assert (family.action_names, family.setting_octaves) == (("target", "period"), 2.0)
    weights = family.reward_weights
    assert (weights.progress, weights.wire_break, weights.limit) == (1, 2, 2)
    assert (weights.short, weights.open, weights.profile, weights.time, weights.done) == (0, 0, 0, 0, 0)
    assert (family.base.t_on_us, family.base.t_period_us, family.base.wire_diameter_um) == (1.4, 50.0, 300.0)
    task = Task("MaxRate")
    task.reset(1_000_000)
    assert task.scenario.drawn["tension"] == pytest.approx(19.6683, abs=1e-3)


def test_what_a_shop_knows_of_its_machine_is_drawn_narrowly_and_dials_are_shown():
    rng = np.random.default_rng(5)
    family = MaxRate.of()
    base = family.base.uncertain()
    for _ in range(5):
        scenario = family.draw(rng)
        own = scenario.machine.uncertain()
        for name in KNOWN:
            assert abs(own[name].value / base[name].value - 1) <= KNOWN_TO_SHARE + 1e-9
        assert min(scenario.machine.flushing_lower_Pa, scenario.machine.flushing_upper_Pa) >= 50e3
        assert scenario.machine.flushing_lower_Pa != scenario.machine.flushing_upper_Pa
        assert not {"dielectric.flushing_pressure_Pa", "guides.wire_speed_m_s"} & set(scenario.drawn)


@pytest.mark.parametrize("pressure", [-1.0, 4e6, (1e5, 5e6), "high"])
def test_pressures_no_nozzle_has_are_refused(pressure):
    with pytest.raises(InputError, match="flushing_Pa"):
        MaxRate.of(flushing_Pa=pressure)


@pytest.mark.slow
def test_discharges_are_observed_where_the_metal_is():
    """In a low band only the lower fifths take part; what is located are all the ignitions."""
    task = Task("MaxRate", height_mm=60.0, tension=22.0, flushing_Pa=1e5, randomise=None, band_mm=(0.2, 0.2))
    task.reset(seed=7)
    starts, heights = task.scenario.heights
    assert heights[1] < 0.3 * heights[0]
    first, second = np.zeros(5), np.zeros(5)
    law = make("fixed-period")
    command = law.reset(task.max_feed_um_s)
    while task.path_um < starts[2]:
        result = task.advance(command.feed_um_s, None, command.t_period_us)
        command = law.update(result.observation)
        assert sum(result.observation.fifths) == result.truth.spark + result.truth.arc
        if task.path_um < 100.0:
            first += result.observation.fifths
        elif task.path_um > starts[2] - 10.0:  # walls of the higher band before are out of reach
            second += result.observation.fifths
    assert (first / first.sum()).min() > 0.1
    assert second[4] < 0.05 * second.sum() < 0.3 * second[0]


def test_the_observation_has_the_shares_of_the_fifths():
    observed = played(gym.make(ID, decision_s=None), [[-1.0, 0.5]] * 60, seed=3)[-1][0]
    shares = observed[FIRST_FIFTH : FIRST_FIFTH + 5]
    assert shares.sum() == pytest.approx(1.0, abs=1e-6)
    before = observed[15 + FIRST_FIFTH : 15 + FIRST_FIFTH + 5]
    assert before.sum() == pytest.approx(1.0, abs=1e-6)
    assert (shares != before).any()


def test_a_lost_wire_costs_what_the_machine_loses_and_the_next_begins_as_set_up():
    env = gym.make(ID, height_mm=30.0, tension=26.0)
    env.reset(seed=1)
    lost, steps = 0, 0
    while not lost:
        *_, info = env.step(np.array([-1.0, -1.0], np.float32))
        lost, steps = info["wires_lost"], steps + 1
        assert steps < 250
    assert info["reward_terms"]["wire_break"] == pytest.approx(-lost * 2 * 20.0 / 0.0255)
    assert info["cost"] == lost
    assert info["time_s"] > 20.0 * lost
