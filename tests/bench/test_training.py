"""``docs/make/training_speed.py``."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

needs_rl = pytest.mark.skipif(
    not all(importlib.util.find_spec(name) for name in ("stable_baselines3", "torch")),
    reason="the extra rl is not installed",
)


@needs_rl
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_training_is_timed_against_half_cheetah(load_script, monkeypatch):
    training = load_script(Path(__file__).parents[2] / "docs" / "make" / "training_speed.py")

    monkeypatch.setattr(training, "ROLLOUT", 8)
    monkeypatch.setattr(training, "SPELLS", 1)
    found = training.measure(counts=(2,))
    assert list(found) == [
        f"{name}_{what}_2" for name in ("training", "half_cheetah_training") for what in ("steps_per_s", "env_share")
    ]
    assert all(value > 0.0 for value in found.values())
    assert all(value < 1.0 for name, value in found.items() if "share" in name)
