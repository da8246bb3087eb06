"""What ``edmsim terminal`` does: puts machine, screen and session together."""

from __future__ import annotations

import os
from pathlib import Path

from edmsim.errors import InputError

from .devices import Interrupts, Keyboard, Pipe, is_terminal
from .rig import Rig
from .session import Session

REAL_TIME = 1.0


def run(rig: Rig, host: Path | None, speed: float | None, view: bool) -> int:
    """Serve the operator at standard input and output; return the exit status.

    Parameters
    ----------
    rig : Rig
    host : path or None
        File that the host minicomputer sends.
    speed : float or None
        Machine seconds per second; by default 1 for a person, and as fast as it goes for a script.
    view : bool
        Whether a person gets the live view.
    """
    if speed is not None and not speed > 0:
        raise InputError(f"--speed is above 0, in machine seconds per second, not {speed:g}")
    if host is not None and not os.access(host, os.R_OK):
        raise InputError("cannot be read; --host takes a file with the host's program", host)
    interrupts = Interrupts()
    with interrupts.caught():
        if not is_terminal():
            return Session(rig, Pipe(interrupts), interrupts, speed=speed, host=host).run()
        keyboard = _screen(interrupts, view)
        session = Session(rig, keyboard, interrupts, speed=speed or REAL_TIME, host=host, person=True)
        with keyboard.in_character_mode(), keyboard:
            return session.run()


def _screen(interrupts: Interrupts, view: bool) -> Keyboard:
    if not view or os.environ.get("TERM", "dumb") == "dumb":
        return Keyboard(interrupts)
    from .view import View

    return View(interrupts)
