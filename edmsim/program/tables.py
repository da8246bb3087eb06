"""Tables that a program refers to: offset registers and machining conditions, in the program or a user's file."""

import math
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import NamedTuple

from edmsim.errors import InputError, one_of, refuses_wrong_types
from edmsim.files import read_toml
from edmsim.numeric import real
from edmsim.program.dialects import Dialect

# Offset registers: values of D1 or H1, from the program itself or from a file.

_ZERO = frozenset({"D0", "H0"})
_NAME = re.compile(r"([DH])0*(\d{1,4})")
GREATEST_MM = 10.0  # greatest offset (ours: no wire is thicker)


def register(letter: str, number: str | float) -> str:
    """Return a register's name as tables have it, ``D1`` for ``D01`` or ``D1.``."""
    return f"{letter}{int(number)}"


@refuses_wrong_types
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
    path, table = Path(file), dict[str, float]()
    for name, value in read_toml(path, "a table of offsets with lines as D1 = 0.155").items():
        found = _NAME.fullmatch(name.strip().upper())
        if found is None:
            raise InputError(f"there is no offset register {name!r}: name them D1, D2 or H1, H2", path)
        offset_mm = real(value)
        if offset_mm is None or not 0 <= offset_mm <= GREATEST_MM:
            raise InputError(f"the offset {name} is {value!r}: give 0 to {GREATEST_MM:g} mm{in_um(value)}", path)
        if (known := register(found[1], found[2])) in table:
            raise InputError(f"the offset {known} occurs twice: remove one", path)
        table[known] = float(offset_mm)
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
        return f"{self.register} {self.mm:g} mm"


class OffsetRegisters:
    """The registers of a program while it is read; values in the program override those of a file."""

    def __init__(self, offsets: Mapping[str, float], defined: Collection[str]) -> None:
        self._table = dict(offsets)
        self._defined = frozenset(defined)
        self._called: str | None = None

    def define(self, name: str, offset_mm: float) -> None:
        """Set a register to the value in the program."""
        if not (math.isfinite(offset_mm) and 0 <= offset_mm <= GREATEST_MM):
            raise InputError(f"the offset {name} is {offset_mm:g} mm: give 0 to {GREATEST_MM:g} mm")
        self._table[name] = offset_mm

    def value_of(self, name: str, used_by: str) -> float:
        """Return the value in mm of a register that the register `used_by` refers to."""
        if name not in self._table:
            reason = f"{used_by} refers to {name}, which has no value there: write {name}=0. before it"
            raise InputError(f"{reason}, or give it by --offsets")
        return self._table[name]

    def call(self, names: list[str]) -> list[str]:
        """Call the registers of a block's D and H words; return notices about them."""
        if self._table:
            self._table |= {name: 0.0 for name in names if name in _ZERO and name not in self._table}
        known = [name for name in names if name in self._table]
        if len(known) > 1:
            raise InputError(f"{' and '.join(known)} are both offsets: call one in a block")
        if known:
            self._called = known[0]
        elif not self._defined.isdisjoint(names):
            name = next(name for name in names if name in self._defined)
            raise InputError(f"the offset {name} is called before the program gives it a value: give it earlier")
        elif names and self._table:
            there = ", ".join(sorted(self._table))
            raise InputError(f"the offset register {names[0]} is not in the table: there are {there}")
        return [
            f"offset register {name} is {self._table[name]:g} mm" if name in known
            else f"offset register {name} is not in the program: the offset is that of the cut or its passes"
            for name in names if name in known or not known
        ]  # fmt: skip

    @property
    def uncalled(self) -> bool:
        """Whether there are registers, but the program has called none."""
        return bool(self._table) and self._called is None

    @property
    def in_force(self) -> Offset | None:
        """The register called last, with its value; None if the program calls none that has a value."""
        return None if self._called is None else Offset(self._called, self._table[self._called])


# Tables of machining conditions: the one at the head of a program, and a user's with settings for each condition.

_COMMENT = re.compile(r"\(([^()]*)\)")
_FEWEST_COLUMNS = 3
_CALLED = re.compile(r"([A-Z])0*(\d{1,4})", re.ASCII)

SETTINGS: dict[str, tuple[float, float]] = {
    "t_on_us": (0.0, 1e4), "t_period_us": (0.0, 1e5), "open_voltage_V": (0.0, 1e3), "peak_current_A": (0.0, 1e4),
    "resistance_ohm": (0.0, 1e4), "tension_N": (0.0, 100.0), "wire_speed_m_s": (0.0, 100.0),
    "flushing_lower_Pa": (0.0, 1e8), "flushing_upper_Pa": (0.0, 1e8), "open_target_share": (0.0, 1.0),
    "feed_um_s": (0.0, 1e4),
}  # fmt: skip
"""Keys of a condition in a user's table, and ranges of their values (ours: outside them, the unit is wrong). The
limits of the machine are checked when it is set."""
_MAY_BE_ZERO = frozenset({"flushing_lower_Pa", "flushing_upper_Pa", "open_target_share"})


def key_of(name: str) -> str:
    """Return a condition's name without leading zeros: ``C1`` for ``C001``."""
    found = _CALLED.fullmatch(name.strip().upper())
    return f"{found[1]}{found[2]}" if found else name.strip().upper()


class ConditionTable:
    """The table of conditions in a program, read line by line; `values` are by condition and column, as written."""

    def __init__(self, dialect: Dialect) -> None:
        self.values: dict[str, dict[str, float]] = {}
        self._columns, self._known = dialect.columns, frozenset(dialect.columns)
        self._line = re.compile(rf"\s*(?:N\d+\s*)?({dialect.condition or 'C'}\d{{1,4}})\s*=(.*)")

    def read_line(self, raw: str) -> bool:
        """Parse a line of the table, or columns in a comment; return whether the line belongs to the table."""
        if not self._columns:
            return False
        for comment in _COMMENT.findall(raw.upper()):
            names = comment.split()
            if len(names) >= _FEWEST_COLUMNS and self._known.issuperset(names):
                self._columns = tuple(names)
        found = self._line.fullmatch(_COMMENT.sub("", raw).partition(";")[0].upper())
        if found is None:
            return False
        name, written = found[1], found[2].split()
        if name in self.values:
            raise InputError(f"the condition {name} occurs twice in the table: remove one")
        if len(written) != len(self._columns):
            reason = f"the condition {name} has {len(written)} values, its table {len(self._columns)} columns"
            raise InputError(f"{reason}: write one each for {' '.join(self._columns)}")
        self.values[name] = {
            column: _number(name, column, text) for column, text in zip(self._columns, written, strict=True)
        }
        return True


def _number(name: str, column: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"the condition {name} has {text[:12]!r} for {column}: write a number") from None


@refuses_wrong_types
def read_conditions(file: str | Path) -> dict[str, dict[str, float]]:
    """Read settings of machining conditions from TOML.

    Parameters
    ----------
    file : path
        A section per condition, ``[C001]``, with lines like ``t_on_us = 1.2``; `SETTINGS` lists the keys.

    Returns
    -------
    dict of str to dict of str to float
        By condition without leading zeros, ``C1``, and setting.

    Raises
    ------
    InputError
        If the file is missing, a name unknown, a number out of range, or both feeds are set.
    """
    path = Path(file)
    sections = read_toml(path, "a table of conditions, [C001] and t_on_us = 1.2")
    table: dict[str, dict[str, float]] = {}
    for name, settings in sections.items():
        if _CALLED.fullmatch(name.strip().upper()) is None or not isinstance(settings, dict):
            raise InputError(f"invalid condition name {name!r}: write it as in the program, [C001] or [E1221]", path)
        if key_of(name) in table:
            raise InputError(f"the condition {name} occurs twice: remove one", path)
        if not settings:
            raise InputError(f"the condition {name} is empty: give t_on_us or another setting", path)
        if settings.keys() >= {"open_target_share", "feed_um_s"}:
            raise InputError(f"the condition {name} has a set point and a constant feed: give one", path)
        table[key_of(name)] = {key: _setting(name, key, value, path) for key, value in settings.items()}
    if not table:
        raise InputError("the table is empty: give a section for each condition, [C001] and t_on_us = 1.2", path)
    return table


def _setting(name: str, key: str, value: object, path: Path) -> float:
    if key not in SETTINGS:
        raise InputError(f"unknown setting '{key}' of condition {name}; there are: {one_of(key, SETTINGS)}", path)
    number, (least, most) = real(value), SETTINGS[key]
    if number is None or not least <= number <= most or (number == least and key not in _MAY_BE_ZERO):
        above = f"{least:g}" if key in _MAY_BE_ZERO else f"above {least:g}"
        raise InputError(f"the condition {name}: {key} = {value!r} is out of range, give {above} to {most:g}", path)
    return float(number)


def settings_for(
    called: Mapping[str, int], table: Mapping[str, Mapping[str, float]], in_program: Collection[str]
) -> dict[str, dict[str, float]]:
    """Return the settings of the conditions that a program calls, by name as written there.

    `called` has the line of each one's first call. Raises `InputError` if a condition is missing in `table` or, if
    this is empty, in the program's table.
    """
    known = {key_of(name) for name in in_program}
    found: dict[str, dict[str, float]] = {}
    for name, line in called.items():
        key = key_of(name)
        if key in table:
            found[name] = dict(table[key])
        elif table or (known and key not in known):
            there = ", ".join(sorted(table or in_program))
            where = "the table of conditions" if table else "the program's table"
            raise InputError(f"the condition {name} is not in {where}: there are {there}", line=line)
    return found
