"""The session: bytes through LINE to MAIN, machine time between them, and what the machine says by itself.

Live, the machine runs at a multiple of the clock on the wall and lines are taken as they come. In a script, time
stands still while lines are read: WAIT lets it pass, and the end of the input waits until the machine stands still.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

from edmsim.controllers.mcu.dialogue.line_input import CANCEL, DELETE, LINE_FEED, SPACE, TAB, InputBuffer, Line
from edmsim.controllers.mcu.dialogue.main_program import MainProgram
from edmsim.errors import InputError
from edmsim.terminal.devices import Interrupts
from edmsim.terminal.keys import TOGGLE
from edmsim.terminal.operation import Operation
from edmsim.terminal.rig import Rig
from edmsim.terminal.serial_lines import SerialLines

ETX, EOT = 0x03, 0x04
"""Ctrl-C as a character is the emergency stop, Ctrl-D on an empty line leaves."""
FINE, REFUSED, STOPPED = 0, 2, 3
"""Exit statuses: all was done; a line of a script was refused; the machine was left in an emergency."""
_BEHIND_S = 0.5
"""A machine that cannot keep up with the clock on the wall catches up by no more than this."""
_IDLE_S = 0.05
"""Longest wait between two looks at the machine."""


class Screen(Protocol):
    """Where the operator's bytes come from and go to."""

    @property
    def at_end(self) -> bool:
        """Whether nothing more will come."""

    def read(self, timeout_s: float | None) -> bytes:
        """Bytes that have come."""

    def write(self, data: bytes) -> None:
        """Print."""

    def refresh(self, operation: Operation) -> None:
        """Show the machine as it is now, where there is something to show it on."""


class Session:
    """An operator at the machine.

    Parameters
    ----------
    rig : Rig
    screen : Screen
    interrupts : Interrupts
    speed : float or None
        Machine seconds per second, live; None for a script.
    host : path, optional
        File that the host minicomputer sends.
    person : bool
        A person types: refused lines are part of the work and do not count for the exit status.

    Attributes
    ----------
    refused : int
        Lines that were refused.
    """

    def __init__(
        self, rig: Rig, screen: Screen, interrupts: Interrupts, *, speed: float | None = None,
        host: Path | None = None, person: bool = False,
    ) -> None:
        self.refused = 0
        self._rig = rig
        self._operation = Operation(rig)
        self._lines = SerialLines(rig.computer)
        self._screen = screen
        self._interrupts = interrupts
        self._speed = speed
        self._host = host
        self._person = person
        self._pending = bytearray()
        self._leaving = False
        self._wait_until_ns: int | None = None
        self._waits_for_rest = False
        self._buffer = InputBuffer()
        self._line = Line(self._buffer, self._transmit)
        self._main = MainProgram(self._operation, self, self._say)
        self._prompted = False

    def run(self) -> int:
        """Serve the operator until he leaves; return the exit status."""
        self._say(self._operation.greeting)
        if self._speed is None:
            self._run_script()
        else:
            self._run_live(self._speed)
        stopped = self._rig.in_emergency
        self._operation.init()
        if stopped:
            return STOPPED
        return REFUSED if self.refused and not self._person else FINE

    def _run_script(self) -> None:
        while not self._leaving:
            if self._interrupts.take():
                self._leaving = True
                self._stop_everything()
            elif self._waiting:
                self._advance()
            elif self._pending:
                for character in self._lines.heard(bytes([self._pending.pop(0)])):
                    self._take(character)
            elif self._screen.at_end:
                self._waits_for_rest = self._rig.moving
                self._leaving = not self._rig.moving
            else:
                self._prompt()
                self._pending += self._screen.read(None)
        self._end_line()

    def _run_live(self, speed: float) -> None:
        began_s, began_ns = time.monotonic(), self._rig.time_ns
        while not self._leaving:
            self._hear_interrupts()
            while self._pending and not self._waiting and not self._leaving:
                self._take(self._pending.pop(0))
            if not self._waiting:
                self._prompt()
            due_s = (self._rig.time_ns - began_ns) * 1e-9 / speed - (time.monotonic() - began_s)
            if due_s < -_BEHIND_S:
                began_s, began_ns = time.monotonic(), self._rig.time_ns
            if due_s <= 0:
                self._advance()
            self._screen.refresh(self._operation)
            self._receive(min(max(due_s, 0.0), _IDLE_S))
            if self._screen.at_end and not self._pending and not self._rig.moving and not self._waiting:
                self._leaving = True
        self._end_line()

    def _receive(self, timeout_s: float) -> None:
        """Take in what was typed; Ctrl-C acts at once, and what was typed before it is forgotten."""
        data = self._to_panel(self._screen.read(timeout_s))
        data = self._lines.heard(data)
        if ETX in data:
            self._interrupts.press()
            data = data[data.rindex(ETX) + 1 :]
        if self._waiting and CANCEL in data:
            self._end_wait()
            data = data[data.rindex(CANCEL) + 1 :]
        self._pending += data

    def _to_panel(self, data: bytes) -> bytes:
        """Give what is typed between two Ctrl-K to the keys of the front panel; return the rest."""
        rest = b""
        for number, part in enumerate(data.split(bytes([TOGGLE]))):
            if number:
                self._operation.at_panel = not self._operation.at_panel
            if self._operation.at_panel and ETX not in part:
                self._operation.press_typed(part)
            else:
                rest += part
        return rest

    def _hear_interrupts(self) -> None:
        if self._interrupts.take():
            self._pending.clear()
            self._line.clear()
            self._stop_everything()

    def _stop_everything(self) -> None:
        self._operation.emergency()
        self._tell()

    def _take(self, character: int) -> None:
        """Give LINE a character; a finished line goes to MAIN."""
        if character == ETX:
            self._stop_everything()
        elif character == EOT:
            self._leaving |= not self._line.typed
        else:
            self._prompt()
            self._obey(character)

    def _obey(self, character: int) -> None:
        try:
            if self._line.take(character):
                self._prompted = False
                self._main.obey(self._buffer)
        except InputError as error:
            self._prompted = False
            self._refuse(error.reason)
        self._tell()

    def _advance(self) -> None:
        """Let a window of machine time pass."""
        for reason in self._operation.advance():
            self._refuse(reason)
        self._tell()
        over = self._wait_until_ns is not None and self._rig.time_ns >= self._wait_until_ns
        if over or (self._waits_for_rest and not self._rig.moving):
            self._end_wait()

    def _tell(self) -> None:
        """Print what the machine has to say; an emergency ends every wait."""
        events = self._rig.take_events()
        if events:
            self._clear_line()
            self._say("\n".join(events))
        if self._rig.in_emergency:
            self._end_wait()

    def _refuse(self, reason: str) -> None:
        """Say why a line or a key did nothing."""
        self._clear_line()
        self.refused += 1
        self._say(f"? {reason}")

    @property
    def _waiting(self) -> bool:
        return self._waits_for_rest or self._wait_until_ns is not None or self._operation.pressing

    def _end_wait(self) -> None:
        self._waits_for_rest, self._wait_until_ns = False, None

    def _prompt(self) -> None:
        """Print the prompt and what was typed after it, if they are not on the screen."""
        if not self._prompted and not self._leaving:
            self._transmit(self._main.prompt.encode("ascii") + self._line.typed)
            self._prompted = True

    def _clear_line(self) -> None:
        """Leave a line that is begun on the screen."""
        if self._prompted:
            self._transmit(b"\r\n")
            self._prompted = False

    def _end_line(self) -> None:
        """Close the dialogue; a line without its end is not executed (row T-53)."""
        self._clear_line()
        if self._line.typed:
            self.refused += 1
            self._say("? the last line has no end; nothing was done")

    def _say(self, text: str) -> None:
        for line in text.splitlines():
            self._transmit(line.encode("ascii", "replace") + b"\r\n")

    def _transmit(self, data: bytes) -> None:
        self._screen.write(self._lines.spoken(data))

    def wait(self, seconds: int | None) -> None:
        """Take no further line until some machine time has passed, or the machine stands still."""
        if seconds is None:
            self._waits_for_rest = self._rig.moving
        else:
            self._wait_until_ns = self._rig.time_ns + seconds * 1_000_000_000
        if self._person and self._waiting:
            self._say("WAITING; CTRL-X ENDS IT, CTRL-C IS THE EMERGENCY STOP")

    def host_lines(self) -> Iterable[bytes]:
        """Lines the host sends through the second serial channel (row T-59)."""
        if self._host is None:
            raise InputError("no host is connected; edmsim terminal --host FILE connects one")
        if self._rig.moving:
            raise InputError("the machine moves; a program is loaded while it stands still")
        return read_host(self._host, self._lines)

    def leave(self) -> None:
        """End the session."""
        self._leaving = True


def read_host(file: Path, lines: SerialLines) -> list[bytes]:
    """Lines of the host's file as LINE takes them from the second channel: 64 characters, in capitals, no echo.

    Raises
    ------
    InputError
        If the file cannot be read, or a line is too long or holds what no line can.
    """
    try:
        data = file.read_bytes()
    except OSError as error:
        raise InputError(f"the host's file cannot be read: {error.strerror}", file) from None
    buffer, taken = InputBuffer(), []
    line = Line(buffer, lambda echo: None)
    for number, text in enumerate(lines.heard_from_host(data).splitlines(), 1):
        try:
            for character in text:
                if not (SPACE <= character < DELETE or character == TAB):
                    raise InputError(f"{character:02X}H is no character of a line")
                line.take(character)
            line.take(LINE_FEED)
        except InputError as error:
            raise InputError(f"line {number} of the host's program: {error.reason}") from None
        taken.append(buffer.text)
    return taken
