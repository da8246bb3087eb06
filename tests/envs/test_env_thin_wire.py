"""ThinWire: what is remembered of the wires, and laws that go on after a break."""

from itertools import repeat

import numpy as np
import pytest

import edmsim
from edmsim.controllers import make
from edmsim.controllers.feed.laws import ClimbController
from edmsim.evaluation.episode import Episode
from edmsim.machine.ranges import with_values

from .conftest import played


@pytest.fixture(scope="module")
def weak():
    """A set-up whose wire breaks in its first second."""
    strained = edmsim.Machine.load(wire="brass-100", tension=2.0, height_mm=5.0, t_on_us=10.0, t_period_us=50.0)
    return with_values(strained, {"wire.half_strength_K": 310.0})


def test_the_operator_remembers_the_wires(make_env, weak):
    env = make_env("ThinWire", machine=weak, wires=3, episode_s=30.0)
    assert env.reset(seed=1)[0][-4:].tolist() == [0, 0, 0, 0]
    steps = played(env, repeat([-1.0, 0.0]))
    rows = np.array([(info["wires_lost"], *entries[-4:]) for entries, *_, info in steps])
    lost, share, age, spent, broke_at = rows.T
    assert lost[-1] == 3
    np.testing.assert_allclose(share, lost / 3, atol=1e-6)
    assert (np.diff(spent) > 0).all()
    fresh = np.flatnonzero(np.diff(lost) > 0) + 1
    assert (age[fresh] * 60 < 0.6).all()
    assert broke_at[lost > 0] == pytest.approx(np.log2(5) / 10)
    assert (broke_at[lost == 0] == 0).all()


def test_a_wire_is_remembered_at_the_setting_that_broke_it(make_env, weak):
    """The next wire begins at the first setting again, which is not the one to remember."""
    env = make_env("ThinWire", machine=weak, wires=3, episode_s=30.0)
    ((observed, *_, info),) = played(env, [[-1.0, 0.1]])
    assert info["wires_lost"] > 1
    assert info["t_period_us"] / info["t_on_us"] == 5.0
    assert observed[-1] == pytest.approx(np.log2(5.5) / 10)


def test_a_law_goes_on_with_the_next_wire(make_task, weak):
    task = make_task("ThinWire", machine=weak, wires=3, episode_s=20.0)
    law = make("climb", period_factor=2.0)
    episode = Episode(task, law, 1, "climb")
    windows = episode.windows()
    while task.wires_lost < 1:
        next(windows)
    assert law.period.factor_at(0.0, law) == pytest.approx(2.0 * law.back_factor)
    assert task.wires_lost == 1
    next(windows)
    assert episode.outcome is None
    assert task.machine.t_period_us == pytest.approx(100 * law.back_factor, abs=2.5)


class Watcher(ClimbController):
    """Notes for how long each wire cut, by what it was shown."""

    observed_s = (0.0,)

    def update(self, window):
        self.observed_s = (*self.observed_s[:-1], self.observed_s[-1] + window.duration_s)
        return super().update(window)

    def wire_lost(self):
        self.observed_s += (0.0,)
        return super().wire_lost()


def test_a_law_at_a_sub_environment_sees_every_window_and_every_lost_wire(make_env, weak):
    """Also where a step has some twenty windows: of each wire all but the partial window in which it broke."""
    env, law = make_env("ThinWire", machine=weak, wires=100), Watcher()
    env.reset(seed=1)
    attached = env.unwrapped.attach_controller(law)
    assert attached.begin().t_period_us == 50.0
    *_, info = env.step(np.array([-1.0, 0.0], np.float32))
    assert attached.command().t_period_us > 50.0
    lost = info["wires_lost"]
    assert lost > 1
    assert len(law.observed_s) == lost + 1
    partial_s = 255 * 60e-6
    assert info["dt_s"] - lost * partial_s < sum(law.observed_s) < info["dt_s"]
    assert law.period.factor_at(0.0, law) == pytest.approx(law.back_factor**lost)
    attached.stop()
    before = law.observed_s
    env.step(np.array([-1.0, 0.0], np.float32))
    assert law.observed_s == before
