"""Where the stacks of a worker's hanging test are printed: pytest-xdist gives a worker no standard output."""

import os

import pytest


@pytest.hookimpl(trylast=True)  # the terminal of pytest itself comes first
def pytest_configure(config: pytest.Config) -> None:
    """Let what pytest-timeout prints in a worker go to standard error, as long as no test captures that."""
    if hasattr(config, "workerinput"):
        config.get_terminal_writer()._file = os.fdopen(os.dup(2), "w", encoding="utf-8")
