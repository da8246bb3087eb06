"""Offset registers: what D1 or H1 of a program mean, from the program itself or from a file."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from edmsim.errors import InputError
from edmsim.numeric import real

_ZERO = frozenset({"D0", "H0"})
_NAME = re.compile(r"([DH])0*(\d{1,4})")
GREATEST_MM = 10.0  # of an offset (ours: no wire is thicker)


def register(letter: str, number: str | float) -> str:
    """Return a register's name as tables have it, ``D1`` for ``D01`` or ``D1.``."""
    return f"{letter}{int(number)}"


def read_offsets(file: str | Path) -> dict[str, float]:
    """Read a table of offsets: lines like ``D1 = 0.155`` in mm; ``#`` begins a comment.

    Returns
    -------
    dict of str to float
        By register, in mm.

    Raises
    ------
    InputError
        If the file is missing or a line invalid.
    """
    path = Path(file)
    return checked_offsets(read_table(path, "a table of offsets with lines as D1 = 0.155"), path)


def read_table(path: Path, what: str) -> dict[str, Any]:
    """Read a user's TOML file; raises `InputError` that says what it is to be."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise InputError(f"no such file: give {what}", path) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", path) from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"not {what}: {error}", path) from None


def checked_offsets(offsets: Mapping[str, object], file: str | Path | None = None) -> dict[str, float]:
    """Return offsets in mm by register; raises `InputError` for invalid names and values."""
    table: dict[str, float] = {}
    for name, value in offsets.items():
        found = _NAME.fullmatch(name.strip().upper())
        if found is None:
            raise InputError(f"there is no offset register {name!r}: name them D1, D2 or H1, H2", file)
        offset_mm = real(value)
        if offset_mm is None or not 0 <= offset_mm <= GREATEST_MM:
            raise InputError(f"the offset {name} is {value!r}: give 0 to {GREATEST_MM:g} mm{in_um(value)}", file)
        table[register(found[1], found[2])] = float(offset_mm)
    return table


def in_um(value: object) -> str:
    """Return a hint for an offset that is too large for mm and is probably in um."""
    meant_mm = (real(value) or 0.0) / 1e3
    return f"; {value:g} um are {meant_mm:g} mm" if GREATEST_MM < 1e3 * meant_mm <= 1e3 * GREATEST_MM else ""


class Offset(NamedTuple):
    """A register and the value in mm that it has when a move is compensated by it."""

    register: str
    mm: float

    def __str__(self) -> str:
        """Return both, for messages."""
        return f"{self.register} {self.mm:g} mm"


class OffsetRegisters:
    """The registers of a program while it is read; what the program itself says comes before those of a file."""

    def __init__(self, offsets: Mapping[str, float], defined: Collection[str], file: str, zero: bool = False) -> None:
        self._table = dict(offsets)
        self._zero = zero
        self._defined = frozenset(defined)
        self._file = file
        self._called: str | None = None

    def define(self, name: str, offset_mm: float, line: int) -> None:
        """Take over what the program says of a register."""
        if not (math.isfinite(offset_mm) and 0 <= offset_mm <= GREATEST_MM):
            raise InputError(f"the offset {name} is {offset_mm:g} mm: give 0 to {GREATEST_MM:g} mm", self._file, line)
        self._table[name] = offset_mm

    def value_of(self, name: str, used_by: str, line: int) -> float:
        """Return a register that another is made of, in mm."""
        if name not in self._table:
            reason = f"{used_by} is made of {name}, which has no value there: write {name}=0. before it"
            raise InputError(f"{reason}, or give it by --offsets", self._file, line)
        return self._table[name]

    def call(self, names: list[str], line: int) -> list[str]:
        """Take D and H words of a block, and return what to tell of them."""
        if self._zero and self._table:
            self._table |= {name: 0.0 for name in names if name in _ZERO and name not in self._table}
        known = [name for name in names if name in self._table]
        if len(known) > 1:
            raise InputError(f"{' and '.join(known)} are both offsets: call one in a block", self._file, line)
        if known:
            self._called = known[0]
        elif not self._defined.isdisjoint(names):
            name = next(name for name in names if name in self._defined)
            reason = f"the offset {name} is called before the program gives it a value: give it earlier"
            raise InputError(reason, self._file, line)
        elif names and self._table:
            there = ", ".join(sorted(self._table))
            reason = f"the offset register {names[0]} is not in the table: there are {there}"
            raise InputError(reason, self._file, line)
        return [
            f"offset register {name} is {self._table[name]:g} mm" if name in known
            else f"offset register {name} is not in the program: the offset is the one given for the cut"
            for name in names if name in known or not known
        ]  # fmt: skip

    @property
    def in_force(self) -> Offset | None:
        """The register called last, with its value; None if the program calls none that has a value."""
        return None if self._called is None else Offset(self._called, self._table[self._called])
