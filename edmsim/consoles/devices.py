"""Input and output of bytes: a pipe, a file, a pseudo-terminal, or a person's terminal, key by key."""

from __future__ import annotations

import errno
import math
import os
import select
import signal
import sys
import termios
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from edmsim.consoles.computer_1982.operation import Operation

_CHUNK = 4096
_INPUT, _OUTPUT = 0, 1
_POLL_S = 0.2  # period at which a wait for input checks for Ctrl-C


class Interrupts:
    """Count presses of Ctrl-C, the emergency stop; more than `patience` untaken ones raise `KeyboardInterrupt`."""

    def __init__(self, patience: int = 2) -> None:
        self._patience = patience
        self._count = 0

    def take(self) -> bool:
        """Whether Ctrl-C was pressed since the last call."""
        pressed, self._count = self._count > 0, 0
        return pressed

    @property
    def pending(self) -> bool:
        """Whether Ctrl-C was pressed and not taken yet."""
        return self._count > 0

    def press(self) -> None:
        """Count one press."""
        self._count += 1
        if self._count > self._patience:
            raise KeyboardInterrupt

    @contextmanager
    def caught(self) -> Iterator[None]:
        """Count Ctrl-C; exit on a hang-up or SIGTERM, so that the terminal is restored."""

        def leave(number: int, frame: FrameType | None) -> None:
            raise SystemExit(128 + number)

        before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
        signal.signal(signal.SIGINT, lambda number, frame: self.press())
        signal.signal(signal.SIGTERM, leave)
        signal.signal(signal.SIGHUP, leave)
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


class Pipe:
    """Input from a pipe or file, output to standard output; a closed input is at its end, a closed output drops all.

    Python's streams are checked, because another file may have the number of a closed one.
    """

    def __init__(self, interrupts: Interrupts) -> None:
        self._interrupts = interrupts
        self.at_end = sys.stdin is None

    def read(self, timeout_s: float | None) -> bytes:
        """Return received bytes; empty after the timeout (None: no timeout), at the end, and after Ctrl-C."""
        if self.at_end:
            time.sleep(timeout_s or 0.0)
            return b""
        until = math.inf if timeout_s is None else time.monotonic() + timeout_s
        while not self._interrupts.pending:
            left = min(_POLL_S, max(until - time.monotonic(), 0.0))
            if select.select([_INPUT], [], [], left)[0]:
                data = b""
                with suppress(OSError):  # a pseudo-terminal whose other side is closed
                    data = os.read(_INPUT, _CHUNK)
                self.at_end = not data
                return data
            if time.monotonic() >= until:
                break
        return b""

    def write(self, data: bytes) -> None:
        """Print; the terminal adds a CR before every LF."""
        put(data.replace(b"\r\n", b"\n"))

    def refresh(self, operation: Operation) -> None:
        """Do nothing: only the dialogue is shown."""


class Keyboard(Pipe):
    """A person's terminal: characters are read as they are typed, and only the program echoes them."""

    @contextmanager
    def in_character_mode(self) -> Iterator[None]:
        """Read character by character; only Ctrl-C remains a signal. On leaving, the terminal is restored."""
        before = termios.tcgetattr(_INPUT)
        try:
            tty.setcbreak(_INPUT)
            now = termios.tcgetattr(_INPUT)
            off = os.fpathconf(_INPUT, "PC_VDISABLE")
            for key in (termios.VQUIT, termios.VSUSP):
                now[6][key] = bytes([off])
            termios.tcsetattr(_INPUT, termios.TCSANOW, now)
            yield
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            raise SystemExit(128 + signal.SIGHUP) from None  # the terminal's window was closed
        finally:
            with suppress(termios.error):  # a closed terminal
                termios.tcsetattr(_INPUT, termios.TCSADRAIN, before)


class PseudoTerminal:
    """A serial port without a wire; a terminal program opens its `name`, such as ``/dev/pts/3``."""

    at_end = False

    def __init__(self) -> None:
        self._ours, self._theirs = os.openpty()  # `_theirs` stays open, so programs may close and reopen it
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.name = os.ttyname(self._theirs)

    def fileno(self) -> int:
        """Return the descriptor of this side, for `select`."""
        return self._ours

    def read(self, timeout_s: float | None) -> bytes:
        """Return received bytes; empty after the timeout."""
        if not select.select([self._ours], [], [], timeout_s)[0]:
            return b""
        return os.read(self._ours, _CHUNK)

    def write(self, data: bytes) -> None:
        """Send bytes; if the system's buffer is full, unread bytes are lost, as on an open line."""
        while data and (sent := self.send(data)):
            data = data[sent:]

    def send(self, data: bytes) -> int:
        """Send as many bytes as the system's buffer takes, and return their number."""
        try:
            return os.write(self._ours, data)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Close both sides."""
        for end in (self._ours, self._theirs):
            os.close(end)


def put(data: bytes) -> None:
    """Write all bytes to standard output; do nothing if it is closed, exit if its reader is gone."""
    view = memoryview(b"" if sys.stdout is None else data)
    try:
        while view:
            view = view[os.write(_OUTPUT, view) :]
    except BrokenPipeError:
        raise SystemExit(128 + signal.SIGPIPE) from None


def is_terminal() -> bool:
    """Return whether standard input and output are both a terminal; either may be closed."""
    return all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stdout))
