"""Trainings for tests: short ones, through the command line or not."""

from __future__ import annotations

import sys

import pytest

from edmsim.cli import app as cli


@pytest.fixture
def edmsim(monkeypatch, capsys):
    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["edmsim", *map(str, arguments)])
        with pytest.raises(SystemExit) as left:
            cli.main()
        return left.value.code or 0, *capsys.readouterr()

    return run
