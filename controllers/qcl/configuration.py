"""A configuration (.CNF): variables, cards on the bus, inputs and outputs by slot, and the internal devices.

``Axis_X EANPOS 2 2.CNT02 3 3.INP01 3.AN01`` declares a device that samples every 2 ms, with counter 2 of slot 2,
interrupt line 3, input 1 and analogue output 1 of slot 3 (manual 1.1). ``X.X``, or ``X`` for a line, leaves one out.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from edmsim.controllers.axis.eanpos import Resources
from edmsim.controllers.axis.eanpos_registers import DEVICE
from edmsim.controllers.qcl.text import Problem, QclError, code_lines, whole_number
from edmsim.errors import InputError

_NAME = re.compile(r"[A-Za-z_]\w*$")
_NUMBER = re.compile(r"[0-9]{1,4}$")
_SIZES = {"F": (0, 1), "B": (-128, 127), "W": (-32768, 32767), "L": (-(2**31), 2**31 - 1), "S": (-3.4e38, 3.4e38)}
"""Flag, byte, word, long and single float, and what fits into each."""


class Variable(NamedTuple):
    """A variable: its name, its size (F, B, W, L or S), and whether it outlasts the power (SYSTEM)."""

    name: str
    size: str
    retained: bool

    @property
    def limits(self) -> tuple[float, float]:
        """Least and largest value."""
        return _SIZES[self.size]


class Declaration(NamedTuple):
    """A device of the section INTDEVICE; an address is None where it was left out."""

    name: str
    tcamp_ms: int
    counter: str | None
    interrupt: int | None
    home_input: str | None
    output: str | None

    @property
    def resources(self) -> Resources:
        """Which of them the device has."""
        return Resources(*(part is not None for part in self[2:]))


@dataclass
class Configuration:
    """What a configuration declares.

    Attributes
    ----------
    constants, variables
        By name.
    cards : dict of int to str or None
        Slots of the bus, None where they are empty.
    inputs, outputs : dict of str to str
        Slot addresses, such as ``2.INP01``, by name.
    devices : dict of str to Declaration
    shared : list of str
        Addresses that two users have: allowed, but seldom meant.
    """

    constants: dict[str, int] = field(default_factory=dict)
    variables: dict[str, Variable] = field(default_factory=dict)
    cards: dict[int, str | None] = field(default_factory=dict)
    inputs: dict[str, str] = field(default_factory=dict)
    outputs: dict[str, str] = field(default_factory=dict)
    devices: dict[str, Declaration] = field(default_factory=dict)
    shared: list[str] = field(default_factory=list)

    @property
    def names(self) -> set[str]:
        """All names, in lower case."""
        groups = (self.constants, self.variables, self.inputs, self.outputs, self.devices)
        return {name for group in groups for name in group}


def read_configuration(text: str, file: str | None = None) -> Configuration:
    """Read a configuration; `file` is its name in an error.

    Raises
    ------
    QclError
        It has lines that are none; all of them are listed.
    """
    found, problems = Configuration(), []
    section = ""
    for number, line in code_lines(text):
        if line.upper() in _SECTIONS:
            section = line.upper()
        elif line.upper() == "END":
            break
        else:
            try:
                if not section:
                    raise InputError(f"{line!r} stands before the first section; a comment begins with ;")
                _SECTIONS[section](found, line.split())
            except InputError as error:
                problems.append(Problem(number, str(error)))
    if problems:
        raise QclError(problems, file)
    users = [*found.inputs.values(), *(device.home_input for device in found.devices.values() if device.home_input)]
    found.shared = sorted({address for address in users if users.count(address) > 1})
    return found


def _new(found: Configuration, name: str) -> str:
    if not _NAME.match(name):
        raise InputError(f"{name!r} is no name: a letter, then letters, digits or _")
    if name.lower() in found.names:
        raise InputError(f"{name} is declared twice")
    return name.lower()


def _fields(fields: list[str], *want: str) -> list[str]:
    if len(fields) != len(want):
        raise InputError(f"{' '.join(fields)!r} must be {' '.join(want)}, all on one line")
    return fields


def _constant(found: Configuration, fields: list[str]) -> None:
    name, value = _fields(fields, "NAME", "VALUE")
    try:
        number = whole_number(value)
    except InputError as error:
        raise InputError(f"the constant {name} is {error}") from None
    found.constants[_new(found, name)] = number


def _variables(retained: bool) -> Callable[[Configuration, list[str]], None]:
    def declare(found: Configuration, fields: list[str]) -> None:
        name, size = _fields(fields, "NAME", "SIZE")
        if size.upper() not in _SIZES:
            raise InputError(f"{name} has size {size!r}; it must be F, B, W, L or S")
        key = _new(found, name)
        found.variables[key] = Variable(key, size.upper(), retained)

    return declare


def _slot(found: Configuration, fields: list[str]) -> None:
    if not _NUMBER.match(fields[0]) or len(fields) not in (2, 3) or (fields[1] == ":") != (len(fields) == 2):
        raise InputError(f"{' '.join(fields)!r} must be SLOT CARD VERSION, or SLOT : for an empty slot")
    if int(fields[0]) in found.cards:
        raise InputError(f"slot {fields[0]} is declared twice")
    found.cards[int(fields[0])] = None if fields[1] == ":" else fields[1]


def _terminal(kind: str) -> Callable[[Configuration, list[str]], None]:
    def declare(found: Configuration, fields: list[str]) -> None:
        name, size, address = _fields(fields, "NAME", "F", f"SLOT.{kind}NN")
        if size.upper() != "F":
            raise InputError(f"{name} has size {size!r}; an input or output is a flag, F")
        group = found.inputs if kind == "INP" else found.outputs
        group[_new(found, name)] = _address(found, address, kind)

    return declare


def _address(found: Configuration, text: str, kind: str) -> str:
    parts = re.match(rf"([0-9]{{1,4}})\.{kind}([0-9][0-9])$", text.upper())
    if not parts:
        raise InputError(f"{text!r} is no address; it must be SLOT.{kind}NN")
    if found.cards.get(int(parts[1])) is None:
        raise InputError(f"{text} is on slot {parts[1]}, which has no card")
    return text.upper()


def _device(found: Configuration, fields: list[str]) -> None:
    name, kind, tcamp, counter, line, home, output = _fields(
        fields, "NAME", "EANPOS", "TCAMP", "ICONT", "INTL", "IAZERO", "IOUTA"
    )
    if kind.upper() != "EANPOS":
        raise InputError(f"{name} is a {kind}; the only device here is EANPOS")
    most_ms, lines = DEVICE["greatest_tcamp_ms"], DEVICE["interrupt_lines"]
    if not (_NUMBER.match(tcamp) and 1 <= int(tcamp) <= most_ms):
        raise InputError(f"TCamp of {name} is {tcamp!r}; it must be 1 to {most_ms} ms")
    if line.upper() != "X" and not (_NUMBER.match(line) and 1 <= int(line) <= lines):
        raise InputError(f"IntL of {name} is {line!r}; it must be 1 to {lines}, or X")

    def optional(text: str, what: str) -> str | None:
        return None if text.upper() == "X.X" else _address(found, text, what)

    key = _new(found, name)
    found.devices[key] = Declaration(
        key, int(tcamp), optional(counter, "CNT"), None if line.upper() == "X" else int(line),
        optional(home, "INP"), optional(output, "AN"),
    )  # fmt: skip


def _none_such(_found: Configuration, fields: list[str]) -> None:
    raise InputError(f"{' '.join(fields)!r}: timers and data groups are not supported; their sections must be empty")


_SECTIONS: dict[str, Callable[[Configuration, list[str]], None]] = {
    "CONST": _constant, "SYSTEM": _variables(True), "GLOBAL": _variables(False), "TIMER": _none_such,
    "DATAGROUP": _none_such, "BUS": _slot, "INPUT": _terminal("INP"), "OUTPUT": _terminal("OUT"),
    "INTDEVICE": _device,
}  # fmt: skip
