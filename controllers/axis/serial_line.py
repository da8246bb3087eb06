"""The typed line of a drive's terminal and its numbers; both drives read lines this way, the UHU with echo.

A line ends with CR; LF is ignored (rows U-A14, M-A14). Blanks before, in and after a command are ignored, and lower
case equals upper case (rows U-A13, U-A15). A byte that is not printable ASCII makes the line an unknown command, so
neither noise nor a wrong baud rate sets a parameter or moves a motor.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

RETURN, LINE_FEED = 0x0D, 0x0A
BACKSPACE, DELETE = 0x08, 0x7F
"""Either takes back the last character (ours: terminals send one or the other, the manuals name none)."""
NEW_LINE = b"\r\n"
_RUB_OUT = b"\b \b"
LONGEST = 32
"""Characters of a line (ours; the longest command that means something has seven). A longer line is spoilt."""
_COMMAND = re.compile(r"([^0-9])(-?[0-9]+)?")
_NUMBER = re.compile(r"-?[0-9]+")


class Command(NamedTuple):
    """A letter and the number behind it, None if there is none."""

    letter: str
    number: int | None


class LineEditor:
    """Gathers bytes into lines; never echoes a byte with bit 7, by which the UHU marks its stream (row U-35)."""

    def __init__(self, *, echo: bool) -> None:
        self._echo = echo
        self._typed = bytearray()
        self._spoilt = False

    def take(self, byte: int) -> tuple[bytes, str | None]:
        """Take a byte; returns the echo and, once a line has ended, its text in upper case without blanks."""
        if byte == RETURN:
            text = "\x00" if self._spoilt else self._typed.decode("ascii").replace(" ", "").upper()
            self.clear()
            return self._sent(NEW_LINE), text
        if byte == LINE_FEED:
            return b"", None
        if byte in (BACKSPACE, DELETE):
            rubbed = _RUB_OUT if self._typed else b""
            del self._typed[-1:]
            return self._sent(rubbed), None
        if not 0x20 <= byte < DELETE or len(self._typed) == LONGEST:
            self.spoil()
            return b"", None
        self._typed.append(byte)
        return self._sent(bytes([byte])), None

    def spoil(self) -> None:
        """Let the line count for nothing, as when a byte of it was not received well."""
        self._spoilt = True

    def clear(self) -> None:
        """Forget what was typed, as a reset does."""
        self._typed.clear()
        self._spoilt = False

    def _sent(self, echo: bytes) -> bytes:
        return echo if self._echo else b""


def lines_of(texts: Iterable[str]) -> bytes:
    """Return lines of text as a drive sends them."""
    return b"".join(text.encode("ascii") + NEW_LINE for text in texts)


def command_in(text: str) -> Command | None:
    """Return the command that a line holds, None if it holds no command: ``P600`` is ``Command("P", 600)``."""
    found = _COMMAND.fullmatch(text)
    return Command(found[1], None if found[2] is None else int(found[2])) if found else None


def number_in(text: str) -> int | None:
    """Return the whole number that a line is, None if it is not one."""
    return int(text) if _NUMBER.fullmatch(text) else None
