"""``edmsim bench --training``."""

import pytest

from edmsim.bench import training


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_training_is_timed_against_half_cheetah(monkeypatch):
    monkeypatch.setattr(training, "ROLLOUT", 8)
    monkeypatch.setattr(training, "SPELLS", 1)
    observed = []
    found = training.measure(observed.append, counts=(2,))
    assert list(found) == [
        f"{name}_{what}_2" for name in ("training", "half_cheetah_training") for what in ("steps_per_s", "env_share")
    ]
    assert observed == ["first rollouts of 2 environments", "2 environments, 1 of 1"]
    assert all(value > 0.0 for value in found.values())
    assert all(value < 1.0 for name, value in found.items() if "share" in name)
