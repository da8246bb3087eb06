"""Trainings for tests: short ones, through the command line or not."""

from __future__ import annotations

import sys

import pytest

from edmsim import cli
from edmsim.learning import hyperparameters


@pytest.fixture
def edmsim(monkeypatch, capsys):
    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["edmsim", *map(str, arguments)])
        with pytest.raises(SystemExit) as left:
            cli.main()
        return left.value.code or 0, *capsys.readouterr()

    return run


@pytest.fixture
def short(monkeypatch):
    """Let trainings be short: few lanes, few windows between updates."""
    load = hyperparameters.load

    def shorter(env_id, algo):
        given = load(env_id, algo)
        change = {"n_steps": 32, "batch_size": 32} if algo == "ppo" else {"learning_starts": 40, "buffer_size": 500}
        return given.model_copy(update={
            "num_envs": 2, "environment": {"resolution": "fast"}, "algorithm": {**given.algorithm, **change},
        })  # fmt: skip

    monkeypatch.setattr(hyperparameters, "load", shorter)
