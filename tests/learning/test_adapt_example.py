"""The example that adapts to a machine: it records, fits, and shows what its policy expects on a new machine."""

import sys
from pathlib import Path

import pytest

from edmsim.learning import bandit

FILE = Path(__file__).parents[2] / "examples" / "learning" / "adapt.py"


@pytest.fixture(scope="module")
def adapt(load_script):
    return load_script(FILE)


@pytest.mark.slow
def test_the_example_learns_and_shows_what_it_expects(adapt, tmp_path, monkeypatch, capsys):
    short = {"segment_s": 0.4, "settle_s": 0.1, "first_s": 0.2, "start_s": 0.2, "trial_s": 1.0, "passes": 3}
    monkeypatch.setattr(adapt, "SETTINGS", adapt.SETTINGS.model_copy(update=short))
    words = ["adapt.py", "--machines", "2", "--watch", "2", "--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", words)
    adapt.main()
    lines = capsys.readouterr().out.splitlines()
    assert lines[2] == "2 of 2 machines recorded"
    assert next(line.split()[-1] for line in lines if "next:" in line) in ("1", "2")  # an untried setting
    assert "mm2/min" in lines[-1]
    assert bandit.load(tmp_path / "out" / "policy.json").steps == 18
