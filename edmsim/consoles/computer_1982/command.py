"""``edmsim console 1982``: connects machine, screen and session."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from edmsim.consoles.computer_1982.devices import Interrupts, Keyboard, Pipe, is_terminal
from edmsim.consoles.computer_1982.rig import END_SWITCHES, Rig
from edmsim.consoles.computer_1982.session import Session
from edmsim.controllers.mcu.board import Faults
from edmsim.controllers.mcu.chips.faults import DropOut, SerialNoise
from edmsim.controllers.mcu.chips.switches import WIRE_BREAK
from edmsim.errors import InputError, one_of

REAL_TIME = 1.0  # machine seconds per second for a person
SERIAL_NOISE, DROP_OUT = "serial-noise", "drop-out"  # the faults of 1982, rows T-29 and T-30
STUCK = {"stuck-end-switch": frozenset(END_SWITCHES), "stuck-wire-sensor": frozenset({WIRE_BREAK})}
"""Switches that never open, by the fault's name."""
FAULTS = (SERIAL_NOISE, DROP_OUT, *STUCK)


def run(
    rig: Rig, host: Path | None, speed: float | None, view: bool, monitor: bool = False, tapes: Path | None = None
) -> int:
    """Serve the operator at standard input and output; returns the exit status.

    The speed is in machine seconds per second; by default 1 for a person, the highest for a script.
    """
    if speed is not None and not speed > 0:
        raise InputError(f"--speed is above 0, in machine seconds per second, not {speed:g}")
    if host is not None and not os.access(host, os.R_OK):
        raise InputError("cannot be read; --host takes a file with the host's program", host)
    if tapes is not None and not tapes.is_dir():
        raise InputError("is not a folder; --tapes takes the one in which tapes lie", tapes)
    begin = partial(Session, rig, host=host, monitor=monitor, tapes=tapes)
    interrupts = Interrupts()
    with interrupts.caught():
        if not is_terminal():
            return begin(Pipe(interrupts), interrupts, speed=speed).run()
        keyboard = _screen(interrupts, view)
        session = begin(keyboard, interrupts, speed=speed or REAL_TIME, person=True)
        with keyboard.in_character_mode(), keyboard:
            return session.run()


def choose_faults(names: Sequence[str], seed: int) -> Faults:
    """Make the faults that are to be injected; raises `InputError` if there is no such fault."""
    for name in names:
        if name not in FAULTS:
            raise InputError(f"there is no fault {name!r}; there are {one_of(name, FAULTS)}")
    return Faults(
        noise=SerialNoise(seed) if SERIAL_NOISE in names else None,
        drop_out=DropOut(seed) if DROP_OUT in names else None,
        stuck=frozenset().union(*(STUCK[name] for name in names if name in STUCK)),
    )


def _screen(interrupts: Interrupts, view: bool) -> Keyboard:
    if not view or os.environ.get("TERM", "dumb") == "dumb":
        return Keyboard(interrupts)
    from edmsim.consoles.computer_1982.view import View

    return View(interrupts)
