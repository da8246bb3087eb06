"""Learning curves in words, and as tables of the examples."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from edmsim.learning.score import in_words


def test_a_curve_says_when_it_rises():
    steps = np.arange(0, 300_001, 1_000).tolist()
    noise = np.random.default_rng(1).normal(0.0, 10.0, len(steps))
    late = [-8.0 + 800.0 / (1 + math.exp(-(step - 130_000) / 8_000)) for step in steps] + noise
    assert in_words(steps, late.tolist()) == "flat until about 120,000 steps, then rising from -8 to 792"


def test_flat_rising_and_unknown_curves():
    assert in_words([100, 200, 300, 400], [math.nan, 1.0, 50.0, 100.0]) == "rising from the beginning, from 1 to 100"
    assert in_words([100, 200], [math.nan] * 2) == "unknown, as no episode has ended: give more --steps"
    steps = list(range(1_000, 41_000, 1_000))
    early = in_words(steps, [100.0 * (1.0 - math.exp(-step / 8_000)) for step in steps])
    assert early == "rising from the beginning, from 27 to 99"  # the first part's own rise is no scatter
    falling = in_words([100, 200, 300], [9.0, 5.0, 1.0])
    assert falling == "no rise above the scatter in 300 steps: from 9 to 1"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ppo", "ppo_lag", "recurrent_ppo"])
def test_an_example_makes_the_folder_of_its_curve(load_script, tmp_path, monkeypatch, name):
    table = tmp_path / "new" / "curve.csv"
    monkeypatch.setattr(sys, "argv", [name, "--steps", "1024", "--out", str(table)])
    load_script(Path(__file__).parents[2] / "examples" / "learning" / f"{name}.py").main()
    assert table.read_text().startswith("decisions,")
