"""The example that adapts to a machine: it finds what machines have in common, and its policy cuts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edmsim.controllers import from_text
from edmsim.envs.episode import Task
from edmsim.evaluation.episode import Episode
from edmsim.learning import bandit_file
from edmsim.learning.bandit_file import Belief, Segment

FILE = Path(__file__).parents[2] / "examples" / "learning" / "adapt.py"
ABOUT = {"command": "a test", "seed": 0, "steps": 0}


@pytest.fixture(scope="module")
def adapt(load_script):
    return load_script(FILE)


def histories(adapt, count=60, noise=0.04):
    """Return histories of machines of two kinds, and their rates: on one a wide gap pays, on the other shorts do."""
    rng, made, rates = np.random.default_rng(2), [], []
    for machine in range(count):
        wide = machine % 2
        rate = np.array([0.0, 0.1, 0.2, 0.3, -0.1, -0.2]) * (1 if wide else -1) + 0.03 * rng.normal(size=adapt.COUNT)
        short = np.array([0.2, 0.1, 0.05, 0.0, 0.3, 0.4]) if wide else np.full(adapt.COUNT, 0.4)
        offset, rows = rng.normal(5.0, 1.0), []
        for _ in range(adapt.PASSES):
            offset += 0.05 * rng.normal()
            for setting in rng.permutation(adapt.COUNT):
                area = 8.0 * np.exp(offset + rate[setting] + noise * rng.normal())
                rows.append([setting, 0.1, short[setting] + 0.01 * rng.normal(), 8.0, area])
        made.append(np.array(rows))
        rates.append(rate - rate.mean())
    return made, np.array(rates)


def test_the_prior_is_what_machines_have_in_common(adapt):
    made, rates = histories(adapt)
    card = adapt.prior_of(made, **ABOUT)
    assert card.noise[0] == pytest.approx(0.05, rel=0.2)  # with the meter's
    assert card.noise[2] == pytest.approx(0.01, rel=0.2)
    assert card.mean[: adapt.COUNT] == pytest.approx(rates.mean(axis=0), abs=0.02)
    assert np.diag(card.covariance)[: adapt.COUNT] == pytest.approx(rates.var(axis=0), rel=0.3, abs=2e-3)


def test_with_the_prior_one_segment_tells_which_setting_pays(adapt):
    made, _ = histories(adapt)
    card = adapt.prior_of(made, **ABOUT)
    for short, best in ((0.2, {2, 3}), (0.4, {4, 5})):
        belief = Belief(card)
        belief.learn(0, Segment(6.0, 0.1, short))
        assert belief.best(0.0) in best


def test_the_policy_is_saved_and_cuts(adapt, tmp_path):
    bandit_file.write(adapt.prior_of(histories(adapt, count=8)[0], **ABOUT), tmp_path / "policy.json")
    controller = from_text(f"policy:{tmp_path / 'policy.json'}")
    assert Episode(Task(adapt.ENV_ID, episode_s=1.5), controller, 3, "bandit").run().outcome == "time"


def test_a_history_is_recorded_and_read(adapt, tmp_path, monkeypatch):
    for name, seconds in (("SEGMENT_S", 0.4), ("SETTLE_S", 0.1), ("START_S", 0.2)):
        monkeypatch.setattr(adapt, name, seconds)
    adapt.record(3, 3, tmp_path / "3.npy")
    rows = np.load(tmp_path / "3.npy")
    assert rows.shape == (3, 5)
    assert rows[:, 3] == pytest.approx(0.3, abs=0.05)  # what is left of a segment
    assert (rows[1:, 4] > 0).all()
    assert len(set(rows[1:, 0].tolist())) == 2
