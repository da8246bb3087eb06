"""A configuration (.CNF): variables, cards on the bus, inputs and outputs by slot, and the internal devices.

``Axis_X EANPOS 2 2.CNT02 3 3.INP01 3.AN01`` declares a device that samples every 2 ms, with counter 2 of slot 2,
interrupt line 3, input 1 and analogue output 1 of slot 3 (manual 1.1). ``X.X``, or ``X`` for a line, omits one.

For timers and data groups the manual has only the sections; their lines follow QEM's manual of QVIEW::

    TIMER
    tmPause
    DATAGROUP
    dgParts
    DATAPROGRAM
    10                ; recipes, 1 to 10: speed[3]
    speed L
    STEP
    4                 ; steps of each, 1 to 4: place[3, 1]
    place L
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from edmsim.controllers.axis.eanpos.drive import Resources
from edmsim.controllers.axis.eanpos.registers import DEVICE
from edmsim.controllers.qcl.text import Problem, QclError, code_lines, whole_number
from edmsim.errors import InputError

_NAME = re.compile(r"[A-Za-z_]\w*$")
_NUMBER = re.compile(r"[0-9]{1,4}$")
_SIZES = {"F": (0, 1), "B": (-128, 127), "W": (-32768, 32767), "L": (-(2**31), 2**31 - 1), "S": (-3.4e38, 3.4e38)}
"""Flag, byte, word, long and single float, and what fits into each."""


_PARTS = {"DATAPROGRAM": "recipes", "STEP": "steps"}
"""Parts of a data group: variables with a value for each recipe, and for each step of each; what counts them."""
_MOST = 65534  # steps of a data group at most (QVIEW); here recipes, too


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


@dataclass(frozen=True)
class DataVariable:
    """A variable of a data group: its values by recipe, 1 to ``recipes``, and by step, if ``steps`` is not 0."""

    variable: Variable
    recipes: int
    steps: int


@dataclass
class _DataGroup:
    """A data group that is being read: its counts, None until they are given, and which part its lines are of."""

    recipes: int | None = None
    steps: int | None = None
    part: str = ""


@dataclass
class Configuration:
    """Declarations of a configuration, by name."""

    constants: dict[str, int] = field(default_factory=dict)
    variables: dict[str, Variable] = field(default_factory=dict)
    timers: set[str] = field(default_factory=set)
    data: dict[str, DataVariable] = field(default_factory=dict)
    cards: dict[int, str | None] = field(default_factory=dict)  # slots of the bus, None where they are empty
    inputs: dict[str, str] = field(default_factory=dict)  # slot addresses, such as ``2.INP01``
    outputs: dict[str, str] = field(default_factory=dict)
    devices: dict[str, Declaration] = field(default_factory=dict)
    shared: list[str] = field(default_factory=list)  # addresses that two users have: allowed, but seldom meant
    _groups: dict[str, _DataGroup] = field(default_factory=dict)

    @property
    def names(self) -> set[str]:
        """All names, in lower case."""
        groups = (
            self.constants, self.variables, self.timers, self.data, self._groups, self.inputs, self.outputs,
            self.devices,
        )  # fmt: skip
        return {name for group in groups for name in group}


def read_configuration(text: str, file: str | None = None) -> Configuration:
    """Read a configuration; `file` is its name in errors.

    Raises
    ------
    QclError
        Lines are invalid; the error lists all of them.
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
        raise InputError(f"{name!r} is not a name: a letter, then letters, digits or _")
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
        variable = _variable(found, fields, retained)
        found.variables[variable.name] = variable

    return declare


def _variable(found: Configuration, fields: list[str], retained: bool) -> Variable:
    name, size = _fields(fields, "NAME", "SIZE")
    if size.upper() not in _SIZES:
        raise InputError(f"{name} has size {size!r}; it must be F, B, W, L or S")
    return Variable(_new(found, name), size.upper(), retained)


def _timer(found: Configuration, fields: list[str]) -> None:
    found.timers.add(_new(found, *_fields(fields, "NAME")))


def _data(found: Configuration, fields: list[str]) -> None:
    """Read a line of a data group: its name, the begin of a part, the part's count, or a variable of it."""
    group = list(found._groups.values())[-1] if found._groups else None
    word = fields[0].upper()
    if len(fields) == 1 and word in _PARTS:
        if group is None:
            raise InputError(f"{word} comes before the name of its data group")
        group.part = word
    elif group is not None and group.part and getattr(group, _PARTS[group.part]) is None:
        setattr(group, _PARTS[group.part], _count(found, fields, group.part))
    elif len(fields) == 1:
        found._groups[_new(found, fields[0])] = _DataGroup()
    elif group is None or not group.part:
        raise InputError(f"{' '.join(fields)!r} comes before DATAPROGRAM; a data group is its name, then its parts")
    elif group.recipes is None:
        raise InputError("STEP comes before DATAPROGRAM, which says how many recipes there are")
    else:
        variable = _variable(found, fields, retained=True)
        steps = (group.steps or 0) if group.part == "STEP" else 0
        found.data[variable.name] = DataVariable(variable, group.recipes, steps)


def _count(found: Configuration, fields: list[str], part: str) -> int:
    text = " ".join(fields)
    number = found.constants.get(text.lower(), int(text) if re.fullmatch("[0-9]{1,6}", text) else 0)
    if not 1 <= number <= _MOST:
        raise InputError(f"{part} is followed by {text!r}; it must be how many there are, 1 to {_MOST}")
    return number


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
        raise InputError(f"{text!r} is not an address; it must be SLOT.{kind}NN")
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


_SECTIONS: dict[str, Callable[[Configuration, list[str]], None]] = {
    "CONST": _constant, "SYSTEM": _variables(True), "GLOBAL": _variables(False), "TIMER": _timer,
    "DATAGROUP": _data, "BUS": _slot, "INPUT": _terminal("INP"), "OUTPUT": _terminal("OUT"),
    "INTDEVICE": _device,
}  # fmt: skip
