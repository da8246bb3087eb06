"""Printing the stacks of a hanging test in a worker, because workers of pytest-xdist have no standard output."""

import os

import pytest


@pytest.hookimpl(trylast=True)  # after pytest has set up its terminal
def pytest_configure(config: pytest.Config) -> None:
    """Let pytest-timeout print to standard error in a worker, unless a test captures it."""
    if hasattr(config, "workerinput"):
        config.get_terminal_writer()._file = os.fdopen(os.dup(2), "w", encoding="utf-8")
