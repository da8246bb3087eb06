"""The search of gains: it finds, it repeats itself, and it stays away from the held-back seeds."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence

import pytest

from edmsim import models
from edmsim.controllers import make
from edmsim.errors import InputError
from edmsim.evaluation import scenarios, search
from edmsim.evaluation.episode import Result
from edmsim.evaluation.search import BOUNDS, as_toml, training_cuts


@pytest.fixture(autouse=True)
def short_cuts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenarios, "LENGTH_UM", 60.0)
    monkeypatch.setattr(scenarios, "STRETCH_UM", 30.0)


@pytest.mark.slow
def test_a_search_finds_the_best_it_tried_and_repeats_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    tried, scores, score = [], [], search.score

    def noted(results: Sequence[Result], bound: Sequence[float]) -> float:
        scores.append(score(results, bound))
        return scores[-1]

    monkeypatch.setattr(search, "score", noted)
    found = search.search("voltage", 3, seeds=1, population=8, generations=1, watch=tried.append)
    assert tried == list(range(1, 17))
    *searched, default = scores
    assert (found.score, found.default_score) == (max(searched), default)
    assert search.search("voltage", 3, seeds=1, population=8, generations=1) == found
    for name, value in found.gains.items():
        low, high = BOUNDS["voltage"][name]
        assert low <= value <= high


def test_held_back_seeds_are_never_trained_on() -> None:
    assert max(seed for _, seed in training_cuts(scenarios.HELD_BACK - 2, 2)) == scenarios.HELD_BACK - 1
    for seed in (-1, scenarios.HELD_BACK - 1, scenarios.HELD_BACK):
        with pytest.raises(InputError, match="training seeds lie from 0"):
            training_cuts(seed, 2)


def test_a_controller_without_bounds_is_refused() -> None:
    with pytest.raises(InputError, match="no gains of 'fixed' are searched"):
        search.search("fixed", 0)


@pytest.mark.parametrize("name", ["voltage", "delay", "fuzzy", "adaptive-off-time", "oracle"])
def test_the_found_gains_are_used_and_name_their_command(name: str) -> None:
    text = models.path(f"gains/{name}.toml").read_text(encoding="utf-8")
    assert f"python -m edmsim.evaluation.search {name} --seed 0 --write models/gains" in text
    gains = tomllib.loads(text)["gains"]
    assert set(gains) == set(BOUNDS[name])
    for gain, value in gains.items():
        low, high = BOUNDS[name][gain]
        assert low <= value <= high
        assert getattr(make(name), gain) == value
    assert getattr(make(name, **{gain: low}), gain) == low


def test_the_file_reads_back() -> None:
    found = search.Found({"reference_V": 12.0, "filter_s": 0.1}, 0.9, 0.8)
    assert tomllib.loads(as_toml("voltage", 0, found))["gains"] == found.gains
