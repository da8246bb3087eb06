"""A machine with a thin workpiece, coarsely resolved, and a screen that types a script and keeps what is printed."""

from functools import partial
from typing import NamedTuple

import pytest

import edmsim
from edmsim.consoles.computer_1982.rig import Rig
from edmsim.consoles.computer_1982.session import Session
from edmsim.consoles.devices import Interrupts


class Script:
    """Types bytes, then nothing more; keeps what is printed."""

    def __init__(self, typed):
        self._typed = typed
        self.at_end = False
        self.printed = bytearray()

    def read(self, timeout_s):
        data, self._typed = self._typed, b""
        self.at_end = not data
        return data

    def write(self, data):
        self.printed += data

    def refresh(self, rig):
        pass


class Outcome(NamedTuple):
    """What a session came to: exit status, every line printed, and the machine."""

    status: int
    lines: list[str]
    rig: Rig

    def after(self, line):
        """What was printed right after a line was typed."""
        return self.lines[self.lines.index(f"> {line}") + 1]

    @property
    def refusals(self):
        return [line for line in self.lines if line.startswith("? ")]


@pytest.fixture(scope="session")
def machine():
    return edmsim.Machine.load(height_mm=5.0)


@pytest.fixture
def rig(machine):
    return Rig(machine, seed=1, resolution="fast")


def run_script(rig, *lines, **options):
    """Type lines at a machine up to the end of the session."""
    screen = Script("".join(f"{line}\n" for line in lines).encode())
    status = Session(rig, screen, Interrupts(), **options).run()
    return Outcome(status, screen.printed.decode("ascii", "replace").split("\r\n"), rig)


@pytest.fixture
def operate(rig):
    """Type a script, line by line, at a fresh machine."""
    return partial(run_script, rig)
