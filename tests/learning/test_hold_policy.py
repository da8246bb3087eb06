"""A policy above a law: the law cuts, the policy says what flux is held, and is shown what the law measured."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from edmsim.controllers import from_text
from edmsim.controllers.protocols import WindowObservation, tell
from edmsim.envs.episode import Task
from edmsim.envs.registry import make_family
from edmsim.errors import InputError
from edmsim.evaluation.episode import Episode
from edmsim.learning import held
from edmsim.learning.policy_file import Hold, write_policy

ENV_ID, ENVIRONMENT = "edmsim/MaxRateShift-v0", {"decision_s": 0.2, "history": 1, "resolution": "fast"}
HOLD = Hold(law="heat-flux:shortest_us=12.5", low=0.05, high=0.8)
ENTRIES = len(make_family(ENV_ID, **ENVIRONMENT).entries()) + len(held.ENTRIES)


def write(file, hold=HOLD, bias=(0.0, 0.0), cells=6, **options):
    rng = np.random.default_rng(3)
    lstm = rng.normal(0, 0.3, (ENTRIES, 4 * cells)), rng.normal(0, 0.3, (cells, 4 * cells)), np.zeros(4 * cells)
    return write_policy(
        file, env_id=options.pop("env_id", ENV_ID), environment=ENVIRONMENT, hold=hold, mean=np.zeros(ENTRIES),
        variance=np.ones(ENTRIES), lstm=lstm, weights=[rng.normal(0, 0.5, (cells, 2))], biases=[np.array(bias)],
        algorithm="none", command="none: random", seed=0, steps=0, **options,
    )


@pytest.fixture
def policy(tmp_path):
    write(tmp_path / "held.json")
    return from_text(f"policy:{tmp_path / 'held.json'}")


def windows(count, **changes):
    usual = WindowObservation(0.0, 0.0102, 5, 15, 30.0, 10.0, 9.0, 20.0, 0.0, fifths=(47, 47, 47, 47, 47))
    return [usual._replace(time_s=0.0102 * k, **changes) for k in range(count)]


def test_actions_are_fluxes_on_a_scale_of_logarithms():
    assert HOLD.flux(-1.0) == pytest.approx(0.05)
    assert HOLD.flux(1.0) == pytest.approx(0.8)
    assert HOLD.flux(0.0) == pytest.approx(0.2)


def test_the_law_holds_what_the_policy_says_and_the_policy_sees_it(policy):
    episode = Episode(Task(ENV_ID, episode_s=2.0), policy, 3, "held")
    holds, outcome = set(), None
    while outcome is None:
        outcome = episode.step()
        holds.add(policy._below.law.period.hold)
    assert outcome == "time"
    assert 8 <= len(holds) <= 12  # decisions of 0.2 s
    assert all(HOLD.low <= hold <= HOLD.high for hold in holds)
    observed = dict(zip([e.name for e in held.ENTRIES], policy.observation[-3:], strict=True))
    assert math.exp(observed["held"]) in [pytest.approx(hold, rel=1e-5) for hold in holds]
    assert 0.01 < math.exp(observed["flux"]) < 2.0
    assert observed["broke_flux"] == 0.0


def test_a_lost_wire_shows_at_which_flux_it_broke(policy):
    tell(policy, Task(ENV_ID).machine, np.array([[0.0, 0.0], [9000.0, 0.0]]), 0.0)
    policy.reset(400.0)
    for window in windows(60):
        policy.update(window)
    flux = float(policy._below.law.gauge.flux.max())
    policy.wire_lost()
    assert math.exp(policy.observation[-1]) == pytest.approx(flux, rel=0.01)  # steady for six time constants


def test_a_snapshot_goes_on_bit_for_bit(policy, tmp_path):
    machine, path = Task(ENV_ID).machine, np.array([[0.0, 0.0], [9000.0, 0.0]])
    second = from_text(f"policy:{tmp_path / 'held.json'}")
    for each in (policy, second):
        tell(each, machine, path, 0.0)
        each.reset(400.0)
    for window in windows(45):
        policy.update(window)
    second.restore(json.loads(json.dumps(policy.snapshot())))
    assert [policy.update(w) for w in windows(30, short=40)] == [second.update(w) for w in windows(30, short=40)]
    assert policy.snapshot() == second.snapshot()


@pytest.mark.parametrize("law", ["adaptive-hold", "counts", "heat-flux:hold=2", "nobody"])
def test_another_law_is_refused(tmp_path, law):
    with pytest.raises(InputError, match="the law below the policy"):
        write(tmp_path / "other.json", hold=HOLD.model_copy(update={"law": law}))


def test_an_environment_without_located_discharges_is_refused(tmp_path):
    with pytest.raises((InputError, ValueError)):
        write(tmp_path / "other.json", env_id="edmsim/ThinWire-v1")
