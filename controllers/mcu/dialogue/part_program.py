"""The words of a path: an operator types them before START, and the host minicomputer sends them as a program.

The thesis says that programs come from the host through the second serial channel (4.1), without an example; the
lines are ours. They use the terminal's words, so the host can send all that you can type::

    * a punch                       (a comment)
    TI 30 TP 100 SPEED 100          settings from this place on
    NEW 33000 32500                 a straight move, um
    CW 33500 32000 33000 32000      an arc to a place about a centre; CCW the other way round
    END
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import NamedTuple

from edmsim.controllers.mcu.chips.dac import MOST_CODE, PulseSettings
from edmsim.controllers.mcu.dialogue.line_input import SEPARATORS, InputBuffer, getnum, gnumhx, skip
from edmsim.controllers.mcu.firmware.memory_map import PROGRAM_ENTRIES
from edmsim.controllers.mcu.firmware.timers import MAX_SPEED
from edmsim.errors import InputError

LAST_WORD, COMMENT = b"END", b"*"


class Move(NamedTuple):
    """A way to a new position in um: straight, or about a centre."""

    end_um: tuple[int, int]
    centre_um: tuple[int, int] | None = None
    clockwise: bool = False

    def __str__(self) -> str:
        """Return the line that would be typed."""
        if self.centre_um is None:
            return f"NEW {self.end_um[0]} {self.end_um[1]}"
        word = "CW" if self.clockwise else "CCW"
        return f"{word} {self.end_um[0]} {self.end_um[1]} {self.centre_um[0]} {self.centre_um[1]}"


class Setting(NamedTuple):
    """Codes of V(t(i)) and V(t(p)), 0..511, and the cutting speed in units, 1..127; None leaves one as it is."""

    t_i: int | None = None
    t_p: int | None = None
    speed: int | None = None

    def __str__(self) -> str:
        """Return the line that would be typed."""
        pulses = [f"{word} {code:02X}H" for word, code in (("TI", self.t_i), ("TP", self.t_p)) if code is not None]
        return " ".join(pulses + ([] if self.speed is None else [f"SPEED {self.speed}"]))


Entry = Move | Setting


def read_word(buffer: InputBuffer) -> str:
    """Read the letters (and question marks) at the pointer, after separators; empty at the end of the line."""
    skip(buffer)
    word = ""
    while chr(buffer.waiting).isalpha() or buffer.waiting == ord("?"):
        word += chr(buffer.waiting)
        buffer.advance()
    return word


def until_separator(text: bytes) -> bytes:
    """Return what stands before the first separator."""
    return re.split(rb"[%b]" % re.escape(SEPARATORS), text)[0]


def is_code(text: bytes) -> bool:
    """Say whether a text is a code, hexadecimal digits and an H; the codes from AH on begin like a word."""
    return re.fullmatch(rb"[0-9A-F]+H", text) is not None


def read_number(buffer: InputBuffer) -> int:
    """Read a decimal number of 16 bits that ends where it should: at a separator or the end of the line."""
    column, written = buffer.column, buffer.rest
    number = getnum(buffer)
    if buffer.waiting and buffer.waiting not in SEPARATORS:
        found = until_separator(written)
        raise InputError(f"a decimal number must stand at column {column}, not {found.decode('ascii')}")
    return number


def read_numbers(buffer: InputBuffer, count: int, what: str) -> list[int]:
    """Read `count` decimal numbers of 16 bits, separated; `what` names them in an error."""
    numbers: list[int] = []
    while len(numbers) < count:
        if not skip(buffer):
            raise InputError(f"{what} is wanted")
        numbers.append(read_number(buffer))
    return numbers


def at_end(buffer: InputBuffer) -> None:
    """Refuse what is left of a line; raises `InputError` if anything but separators is left."""
    if skip(buffer):
        raise InputError(f"{buffer.rest.decode('ascii')} is more than is wanted here")


def read_move(word: str, buffer: InputBuffer) -> Move:
    """Read the numbers of NEW, CW or CCW and the end of the line."""
    if word == "NEW":
        x, y = read_numbers(buffer, 2, "NEW x y")
        at_end(buffer)
        return Move((x, y))
    x, y, xc, yc = read_numbers(buffer, 4, f"{word} x y and the centre's x y")
    at_end(buffer)
    return Move((x, y), (xc, yc), word == "CW")


def read_setting(word: str, buffer: InputBuffer, pulses: PulseSettings) -> Setting:
    """Read one or more of TI, TP and SPEED with their numbers: decimal us, or hexadecimal codes (``4DH``)."""
    found: dict[str, int] = {}
    while word:
        if word == "SPEED":
            found["speed"] = check_speed(read_numbers(buffer, 1, f"SPEED 1 to {MAX_SPEED} in units")[0])
        elif word == "TI":
            found["t_i"] = read_code(buffer, pulses.code_of_t_i, "TI in us or as a code 0H to 1FFH")
        elif word == "TP":
            found["t_p"] = read_code(buffer, pulses.code_of_t_p, "TP in us or as a code 0H to 1FFH")
        else:
            raise InputError(f"{word} cannot stand beside settings; TI, TP and SPEED can")
        word = read_word(buffer)
    at_end(buffer)
    return Setting(**found)


def check_speed(units: int) -> int:
    """Return a cutting speed; raises `InputError` if it is invalid."""
    if not 1 <= units <= MAX_SPEED:
        raise InputError(f"SPEED is 1 to {MAX_SPEED} units, not {units}")
    return units


def read_code(buffer: InputBuffer, code_of: Callable[[int], int], what: str) -> int:
    """Read a time in us, turned into its code, or the code itself."""
    if not skip(buffer):
        raise InputError(f"{what} is wanted")
    number = until_separator(buffer.rest)
    if not number.endswith(b"H"):
        return code_of(read_number(buffer))
    code = gnumhx(buffer)
    buffer.advance()  # the H
    if code > MOST_CODE:
        raise InputError(f"a code is 0H to {MOST_CODE:X}H, not {code:X}H")
    return code


def read_program(lines: Iterable[bytes], pulses: PulseSettings) -> list[Entry]:
    """Read the host's lines, in capitals, up to END; an error names its line."""
    entries: list[Entry] = []
    for number, text in enumerate(lines, 1):
        if text.strip() == LAST_WORD:
            if not any(isinstance(entry, Move) for entry in entries):
                raise InputError("the host's program moves nothing")
            return entries
        try:
            entry = _read_line(InputBuffer(text), pulses)
        except InputError as error:
            raise InputError(f"line {number} of the host's program: {error.reason}") from None
        if entry is not None:
            entries.append(entry)
        if len(entries) > PROGRAM_ENTRIES:
            raise InputError(f"line {number} of the host's program is one more than the {PROGRAM_ENTRIES} that fit")
    raise InputError("the host's program ends without END")


def _read_line(buffer: InputBuffer, pulses: PulseSettings) -> Entry | None:
    if not skip(buffer) or buffer.rest.startswith(COMMENT):
        return None
    word = read_word(buffer)
    if word in ("NEW", "CW", "CCW"):
        return read_move(word, buffer)
    if word in ("TI", "TP", "SPEED"):
        return read_setting(word, buffer, pulses)
    raise InputError(f"{word or buffer.rest.decode('ascii')} is not one of NEW, CW, CCW, TI, TP, SPEED, END")
