"""What the host minicomputer sends over the second serial channel (row T-59)."""

from __future__ import annotations

from pathlib import Path

from edmsim.controllers.mcu.dialogue.line_input import DELETE, LINE_FEED, SPACE, TAB, InputBuffer, Line
from edmsim.errors import InputError
from edmsim.terminal.serial_lines import SerialLines


def read_host(file: Path, lines: SerialLines) -> list[bytes]:
    """Lines of the host's file as LINE takes them from the second channel: 64 characters, in capitals, no echo.

    Raises
    ------
    InputError
        If the file cannot be read, or a line is too long or holds what no line can.
    """
    data = bytes_of(file)
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


def bytes_of(file: Path) -> bytes:
    """What a file of the host holds; raises `InputError` if it cannot be read."""
    try:
        return file.read_bytes()
    except OSError as error:
        raise InputError(f"the host's file cannot be read: {error.strerror}", file) from None
