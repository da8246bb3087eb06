r"""QCL, the language of QEM's QMOVE controls: the configurations and programs of the EANPOS manual.

>>> from edmsim.controllers.qcl import Control, read_configuration, read_program
>>> plant = read_configuration("GLOBAL\ncount L\nEND")
>>> control = Control(plant, read_program("count = 10 * 99999 / 100\nEND", plant))
>>> control.run_pass()
>>> control.variables["count"]
9999
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import accumulate
from typing import NamedTuple

from edmsim.controllers.axis.eanpos.drive import Eanpos, Resources, parameter_name, state_name
from edmsim.controllers.axis.eanpos.registers import COMMANDS, DEVICE
from edmsim.errors import InputError, refuses_wrong_types

# QCL text: lines without comments, the words of a line, and errors.

_WORD = re.compile(r"\s*([0-9]+|[A-Za-z_]\w*(?::[A-Za-z_]\w*)?|[=*/+()<>,[\]-])")


MOST_DIGITS = 18  # digits of a number (ours: the widest variable, of 32 bits, has ten)


class Problem(NamedTuple):
    """Error in a line: its number, from 1, and the reason."""

    line: int
    what: str

    def __str__(self) -> str:
        return f"line {self.line}: {self.what}"


class QclError(InputError):
    """A text is not valid QCL.

    Attributes
    ----------
    problems : list of Problem
        All problems, in order of lines.
    """

    def __init__(self, problems: list[Problem], file: str | None) -> None:
        self.problems = sorted(problems)
        first, more = self.problems[0], len(problems) - 1
        super().__init__(first.what + (f" (and {more} more)" if more else ""), file or "QCL", first.line)


def whole_number(text: str) -> int:
    """Return a number of digits with an optional minus; raises `InputError` for more digits than a variable has."""
    if not re.fullmatch(f"-?[0-9]{{1,{MOST_DIGITS}}}", text):
        raise InputError(f"{text!r}; it must be a whole number of at most {MOST_DIGITS} digits")
    return int(text)


def code_lines(text: str) -> list[tuple[int, str]]:
    """Return lines with their numbers, without comments (from a semicolon on) and without empty lines."""
    numbered = ((k, line.split(";")[0].strip()) for k, line in enumerate(text.splitlines(), 1))
    return [(k, line) for k, line in numbered if line]


def words_of(line: str) -> list[str]:
    """Split a line of a program into numbers, names, names of a device's member (``Axis:setvel``), and operators."""
    words, at = [], 0
    while at < len(line):
        found = _WORD.match(line, at)
        if found is None:
            raise InputError(f"{line[at:]!r} is not a word of QCL")
        words.append(found[1])
        at = found.end()
    return words


# A configuration (.CNF): variables, cards on the bus, inputs and outputs by slot, and the internal devices.
# ``Axis_X EANPOS 2 2.CNT02 3 3.INP01 3.AN01`` declares a device that samples every 2 ms, with counter 2 of slot 2,
# interrupt line 3, input 1 and analogue output 1 of slot 3 (manual 1.1). ``X.X``, or ``X`` for a line, omits one.
# For timers and data groups the manual names only the sections; their lines follow QEM's manual of QVIEW::
#     TIMER
#     tmPause
#     DATAGROUP
#     dgParts
#     DATAPROGRAM
#     10                ; recipes, 1 to 10: speed[3]
#     speed L
#     STEP
#     4                 ; steps of each, 1 to 4: place[3, 1]
#     place L

_NAME = re.compile(r"[A-Za-z_]\w*$")
_NUMBER = re.compile(r"[0-9]{1,4}$")
_SIZES = {"F": (0, 1), "B": (-128, 127), "W": (-32768, 32767), "L": (-(2**31), 2**31 - 1), "S": (-3.4e38, 3.4e38)}
"""Ranges of a flag, byte, word, long and single float."""


_PARTS = {"DATAPROGRAM": "recipes", "STEP": "steps"}
"""Parts of a data group, with the name of their count: variables with a value per recipe, or per recipe and step."""
_MOST = 65534  # greatest number of steps of a data group (QVIEW); here also of recipes


class Variable(NamedTuple):
    """A variable: its name, its size (F, B, W, L or S), and whether it is retained without power (SYSTEM)."""

    name: str
    size: str
    retained: bool


class Declaration(NamedTuple):
    """A device of the section INTDEVICE; an omitted address is None."""

    name: str
    tcamp_ms: int
    counter: str | None
    interrupt: int | None
    home_input: str | None
    output: str | None

    @property
    def resources(self) -> Resources:
        """Resources of the device: those whose address was not omitted."""
        return Resources(*(part is not None for part in self[2:]))


@dataclass(frozen=True)
class DataVariable:
    """A variable of a data group: its values by recipe, 1 to ``recipes``, and by step, if ``steps`` is not 0."""

    variable: Variable
    recipes: int
    steps: int


@dataclass
class _DataGroup:
    """A data group while it is read: its counts, None until they are known, and the part of the present line."""

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
    cards: dict[int, str | None] = field(default_factory=dict)  # cards by slot of the bus, None for an empty slot
    inputs: dict[str, str] = field(default_factory=dict)  # slot addresses, such as ``2.INP01``
    outputs: dict[str, str] = field(default_factory=dict)
    devices: dict[str, Declaration] = field(default_factory=dict)
    _groups: dict[str, _DataGroup] = field(default_factory=dict)

    @property
    def names(self) -> set[str]:
        """All names, in lower case."""
        groups = (
            self.constants, self.variables, self.timers, self.data, self._groups, self.inputs, self.outputs,
            self.devices,
        )  # fmt: skip
        return {name for group in groups for name in group}


@refuses_wrong_types
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
                    raise InputError(f"{line!r} comes before the first section; a comment begins with ;")
                _SECTIONS[section](found, line.split())
            except InputError as error:
                problems.append(Problem(number, str(error)))
    if problems:
        raise QclError(problems, file)
    return found


def _new(found: Configuration, name: str) -> str:
    if not _NAME.match(name):
        raise InputError(f"{name!r} is not a name: a letter, then letters, digits or _")
    if name.upper() in _RESERVED:
        raise InputError(f"{name!r} is a word of the language: choose another name")
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


def _add_variable(found: Configuration, fields: list[str], retained: bool) -> None:
    variable = _variable(found, fields, retained)
    found.variables[variable.name] = variable


def _variable(found: Configuration, fields: list[str], retained: bool) -> Variable:
    name, size = _fields(fields, "NAME", "SIZE")
    if size.upper() not in _SIZES:
        raise InputError(f"{name} has size {size!r}; it must be F, B, W, L or S")
    return Variable(_new(found, name), size.upper(), retained)


def _timer(found: Configuration, fields: list[str]) -> None:
    found.timers.add(_new(found, *_fields(fields, "NAME")))


def _data(found: Configuration, fields: list[str]) -> None:
    """Read a line of a data group: its name, the begin of a part, a part's count, or a variable."""
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


def _terminal(found: Configuration, fields: list[str], kind: str) -> None:
    name, size, address = _fields(fields, "NAME", "F", f"SLOT.{kind}NN")
    if size.upper() != "F":
        raise InputError(f"{name} has size {size!r}; an input or output is a flag, F")
    group = found.inputs if kind == "INP" else found.outputs
    group[_new(found, name)] = _address(found, address, kind)


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
    "CONST": _constant, "SYSTEM": partial(_add_variable, retained=True),
    "GLOBAL": partial(_add_variable, retained=False), "TIMER": _timer, "DATAGROUP": _data, "BUS": _slot,
    "INPUT": partial(_terminal, kind="INP"), "OUTPUT": partial(_terminal, kind="OUT"), "INTDEVICE": _device,
}  # fmt: skip


# A program of QCL: a list of statements, with the targets of IF, ELSE and JUMP.
# ``Axis:prsvel = (20 * Axis:maxvel)/100`` assigns, ``START Axis`` sends a command, ``WAIT NOT Axis:st_emrg`` waits,
# ``IF NOT (gfMovAuto OR gfMovMan)`` to ENDIF is conditional, ``MAIN:`` is a label for JUMP. ``place[3, 1]`` is a
# data group's variable in recipe 3 and step 1.

Expression = tuple["str | int | Expression", ...]
"""An operation and its operands: ``("*", left, right)``, ``("NOT", other)``, ``("number", 3)``,
``("name", "speed")``, ``("member", "axis", "setpos")``, ``("element", "place", recipe, step)``."""
_COMPARISONS = ("EQ", "NE", "LT", "GT", "LE", "GE")
_OPERATORS = ("AND", "OR", "NOT", *_COMPARISONS)
_RESERVED = {*_OPERATORS, "IF", "ELSE", "ENDIF", "WAIT", "JUMP", "END"}
_LEVELS: tuple[tuple[str, ...], ...] = (("OR",), ("AND",), (), _COMPARISONS, ("+", "-"), ("*", "/"))
"""Operators by precedence, lowest first; NOT is at the empty level."""

MOST_WORDS, DEEPEST = 200, 20
"""Limits of an expression's words and nested brackets (ours), which keep its results and its recursion small."""


class Statement(NamedTuple):
    """A statement: its line, verb, target, expression, and jump."""

    line: int
    verb: str  # assign, command, wait, if, jump or end
    target: tuple[str, ...] = ()  # a name, or device and member or command
    value: Expression = ()
    to: int = 0  # number of the next statement after a JUMP, or after an IF whose condition is false
    at: tuple[Expression, ...] = ()  # recipe and step of a data group's variable


QclProgram = tuple[Statement, ...]


@refuses_wrong_types
def read_program(text: str, configuration: Configuration, file: str | None = None) -> QclProgram:
    """Read a program; a configuration declares its names; `file` is its name in errors.

    Raises
    ------
    QclError
        Lines are not statements, or names are not declared; the error lists all of them.
    """
    reader = _Reader(configuration)
    for number, line in code_lines(text):
        try:
            reader.take(number, line)
        except InputError as error:
            reader.problems.append(Problem(number, str(error)))
    return reader.finish(file)


def _depth(words: list[str]) -> int:
    """Return the depth of an expression's nested brackets."""
    return max(accumulate(((word in "([") - (word in ")]") for word in words), initial=0))


class _Reader:
    def __init__(self, configuration: Configuration) -> None:
        self._configuration = configuration
        self._statements: list[Statement] = []
        self._labels: dict[str, int] = {}
        self._jumps: dict[int, str] = {}
        self._open: list[tuple[int, int]] = []
        self.problems: list[Problem] = []

    def take(self, number: int, line: str) -> None:
        """Read a line."""
        label = re.match(r"([A-Za-z_]\w*)\s*:$", line)
        if label:
            if label[1].lower() in self._labels:
                raise InputError(f"the label {label[1]} is defined twice")
            self._labels[label[1].lower()] = len(self._statements)
            return
        words = words_of(line)
        verb = words[0].upper()
        if verb in ("IF", "WAIT"):
            if verb == "IF":
                self._open.append((len(self._statements), number))
            self._add(number, verb.lower())
            self._statements[-1] = self._statements[-1]._replace(value=self._expression(words[1:]))
        elif verb in ("ELSE", "ENDIF", "END") and len(words) == 1:
            self._block(number, verb)
        elif verb == "JUMP" and len(words) == 2:
            self._jumps[len(self._statements)] = words[1].lower()
            self._add(number, "jump")
        elif verb in COMMANDS and len(words) == 2:
            self._add(number, "command", (self._device(words[1]), verb))
        elif "=" in words[1:-1]:
            equals = words.index("=", 1)
            target, at = self._target(words[:equals])
            self._statements.append(Statement(number, "assign", target, self._expression(words[equals + 1 :]), at=at))
        else:
            raise InputError(f"{line!r} is not a statement; a comment begins with ;")

    def _add(self, number: int, verb: str, target: tuple[str, ...] = ()) -> None:
        self._statements.append(Statement(number, verb, target))

    def _block(self, number: int, verb: str) -> None:
        if verb == "END":
            self._add(number, "end")
            return
        if not self._open or (verb == "ELSE" and self._statements[self._open[-1][0]].verb == "jump"):
            raise InputError(f"{verb} without IF")
        begin, _ = self._open.pop()
        if verb == "ELSE":
            self._open.append((len(self._statements), number))
            self._add(number, "jump")
        self._statements[begin] = self._statements[begin]._replace(to=len(self._statements))

    def finish(self, file: str | None) -> QclProgram:
        """Return the program with its jumps resolved."""
        problems = self.problems + [Problem(number, "IF without ENDIF") for _, number in self._open]
        for place, label in self._jumps.items():
            if label in self._labels:
                self._statements[place] = self._statements[place]._replace(to=self._labels[label])
            else:
                problems.append(Problem(self._statements[place].line, f"there is no label {label!r} to jump to"))
        if not (problems or self._statements):
            problems.append(Problem(1, "the program has no statements"))
        if problems:
            raise QclError(problems, file)
        return tuple(self._statements)

    def _device(self, name: str) -> str:
        if name.lower() not in self._configuration.devices:
            raise InputError(f"{name} is not a device that the configuration declares")
        return name.lower()

    def _target(self, words: list[str]) -> tuple[tuple[str, ...], tuple[Expression, ...]]:
        """Return the target of an assignment, and recipe and step of a data group's variable."""
        word, found = words[0], self._configuration
        if word.lower() in found.data:
            (_, name, *at), rest = self._element(word, words[1:])
            if rest:
                raise InputError(f"{' '.join(rest)!r} is left over before =")
            return (str(name),), tuple(at)  # type: ignore[arg-type]
        if len(words) > 1:
            raise InputError(f"{' '.join(words)!r} cannot be assigned to")
        if ":" in word:
            device, member = word.split(":")
            return (self._device(device), parameter_name(member)), ()
        if word.lower() not in found.variables.keys() | found.outputs.keys() | found.timers:
            raise InputError(f"{word} is not a variable or output that the configuration declares")
        return (word.lower(),), ()

    def _element(self, word: str, words: list[str]) -> tuple[Expression, list[str]]:
        """Read recipe and step after the name of a data group's variable."""
        steps = self._configuration.data[word.lower()].steps
        form = f"{word}[recipe, step]" if steps else f"{word}[recipe]"
        count, at, rest = 2 if steps else 1, [], words
        for separator in "[,"[:count]:
            if not rest or rest[0] != separator:
                raise InputError(f"{word} is a data group's variable; it is written {form}")
            value, rest = self._operation(rest[1:], 0)
            at.append(value)
        if not rest or rest[0] != "]":
            raise InputError(f"{word} is a data group's variable; it is written {form}")
        return ("element", word.lower(), *at), rest[1:]

    def _expression(self, words: list[str]) -> Expression:
        if len(words) > MOST_WORDS or _depth(words) > DEEPEST:
            raise InputError(
                f"an expression of {len(words)} words, {_depth(words)} brackets deep, is too long: it may have "
                f"{MOST_WORDS} words and {DEEPEST} brackets within brackets"
            )
        value, rest = self._operation(words, 0)
        if rest:
            raise InputError(f"{' '.join(rest)!r} is left over")
        return value

    def _operation(self, words: list[str], level: int) -> tuple[Expression, list[str]]:
        if level == len(_LEVELS):
            return self._term(words)
        if not _LEVELS[level]:
            if words and words[0].upper() == "NOT":
                value, rest = self._operation(words[1:], level)
                return ("NOT", value), rest
            return self._operation(words, level + 1)
        value, rest = self._operation(words, level + 1)
        while rest and rest[0].upper() in _LEVELS[level]:
            other, after = self._operation(rest[1:], level + 1)
            value, rest = (rest[0].upper(), value, other), after
        return value, rest

    def _term(self, words: list[str]) -> tuple[Expression, list[str]]:
        if not words:
            raise InputError("an expression ends early")
        word, rest = words[0], words[1:]
        if word == "(":
            value, rest = self._operation(rest, 0)
            if not rest or rest[0] != ")":
                raise InputError("a bracket is not closed")
            return value, rest[1:]
        if word == "-":
            value, rest = self._term(rest)
            return ("-", ("number", 0), value), rest
        if word.isdigit():
            return ("number", whole_number(word)), rest
        if not re.match(r"[A-Za-z_]", word) or word.upper() in _OPERATORS:
            raise InputError(f"{word!r} is not a value")
        if word.lower() in self._configuration.data:
            return self._element(word, rest)
        return self._named(word), rest

    def _named(self, word: str) -> Expression:
        if ":" in word:
            device, member = word.split(":")
            known = state_name if member.lower().startswith("st_") else parameter_name
            return "member", self._device(device), known(member)
        found = self._configuration
        groups = found.constants, found.variables, found.timers, found.inputs, found.outputs
        if not any(word.lower() in group for group in groups):
            raise InputError(f"{word} is not a name that the configuration declares")
        return "name", word.lower()


# The control: it executes a program pass by pass, on devices, inputs and outputs.
# A pass ends at the next WAIT, whose condition is checked once a pass (ours: the manual does not define how tasks
# alternate). A read of a device with a pending command first executes that command (manual 1.4.4). A timer is set to
# a time in ms; it reads 1 when the time is over, else 0 (ours).

LONGEST_PASS = 10_000  # greatest number of statements of a pass (ours), so a loop without WAIT does not stop the rest


LONGEST_MS = 2**31 - 1  # longest time of a timer (ours: a long)


class _WaitsFor(Exception):
    """Raised if a device must run a sample before it can be read."""


class Control:
    """A control with a program.

    Parameters
    ----------
    configuration : Configuration
    program : QclProgram
        A program for this configuration.
    devices : mapping of str to Eanpos
        Devices by their configured names, in lower case.

    Attributes
    ----------
    variables : dict of str to int
        Values by name, in lower case.
    data : dict of (str, int, int) to int
        Values of data groups by name, recipe and step; the step is 0 if the variable has no steps. Missing values
        are 0.
    now_ms : int
        The control's clock for timers; the caller sets it.
    inputs, outputs : dict of str to bool
        By slot address.
    line : int
        Line of the next statement, 0 after the end.
    """

    def __init__(
        self, configuration: Configuration, program: QclProgram, devices: Mapping[str, Eanpos] | None = None
    ) -> None:
        self._configuration, self._program = configuration, program
        self._devices = dict(devices or {})
        self.variables = dict.fromkeys(configuration.variables, 0)
        self.data: dict[tuple[str, int, int], int] = {}
        self.now_ms = 0
        self._over_ms: dict[str, int] = {}
        self.inputs = dict.fromkeys(configuration.inputs.values(), False)
        self.outputs = dict.fromkeys(configuration.outputs.values(), False)
        self._next = 0

    @property
    def line(self) -> int:
        """Line of the next statement, 0 after the end."""
        return self._program[self._next].line if self._next < len(self._program) else 0

    def restart(self) -> None:
        """Restart as at power-up; SYSTEM variables and data groups keep their values."""
        for name, variable in self._configuration.variables.items():
            if not variable.retained:
                self.variables[name] = 0
        self.outputs = dict.fromkeys(self.outputs, False)
        self._over_ms.clear()
        self._next = 0

    def run_pass(self) -> str | None:
        """Execute statements until the pass ends.

        Returns
        -------
        str or None
            Device that must run a sample before this pass can continue; None at the end of the pass.

        Raises
        ------
        InputError
            A division by zero, or a value out of its variable's range; the error names the line.
        """
        for _ in range(LONGEST_PASS):
            if self._next >= len(self._program) or self._program[self._next].verb == "end":
                self._next = len(self._program)
                return None
            line, verb, target, value, to, at = self._program[self._next]
            try:
                if verb == "wait":
                    self._next += 1 if self._value(value) else 0
                    return None
                if verb == "assign":
                    self._assign(target, at, self._value(value))
                elif verb == "command":
                    self._devices[target[0]].command(target[1])
                leads = verb == "jump" or (verb == "if" and not self._value(value))
                self._next = to if leads else self._next + 1
            except _WaitsFor as device:
                return str(device)
            except InputError as error:
                raise InputError(f"line {line}: {error}") from None
        return None

    def _assign(self, target: tuple[str, ...], at: tuple[Expression, ...], value: int) -> None:
        found = self._configuration
        if len(target) == 2:
            self._devices[target[0]].parameters[target[1]] = value
        elif at:
            self.data[self._place(target[0], at)] = _fitting(found.data[target[0]].variable, value)
        elif target[0] in found.timers:
            if not 0 <= value <= LONGEST_MS:
                raise InputError(f"the timer {target[0]} cannot run for {value} ms; it must be 0 to {LONGEST_MS}")
            self._over_ms[target[0]] = self.now_ms + value
        elif target[0] in self._configuration.outputs:
            self.outputs[self._configuration.outputs[target[0]]] = value != 0
        else:
            self.variables[target[0]] = _fitting(found.variables[target[0]], value)

    def _place(self, name: str, at: tuple[Expression, ...]) -> tuple[str, int, int]:
        """Return name, recipe and step of a data group's variable."""
        found = self._configuration.data[name]
        recipe, step = [*(self._value(part) for part in at), 0][:2]
        for what, number, most in (("recipe", recipe, found.recipes), ("step", step, found.steps)):
            if most and not 1 <= number <= most:
                raise InputError(f"{name} has no {what} {number}; it must be 1 to {most}")
        return name, recipe, step

    def _value(self, expression: Expression) -> int:
        kind = str(expression[0])
        if kind == "number":
            return int(expression[1])  # type: ignore[arg-type]
        if kind == "name":
            return self._named(str(expression[1]))
        if kind == "member":
            return self._member(str(expression[1]), str(expression[2]))
        if kind == "element":
            return self.data.get(self._place(str(expression[1]), expression[2:]), 0)  # type: ignore[arg-type]
        values = [self._value(part) for part in expression[1:]]  # type: ignore[arg-type]
        if kind == "NOT":
            return int(not values[0])
        return _operate(kind, *values)

    def _named(self, name: str) -> int:
        found = self._configuration
        if name in found.constants:
            return found.constants[name]
        if name in found.inputs:
            return int(self.inputs[found.inputs[name]])
        if name in found.outputs:
            return int(self.outputs[found.outputs[name]])
        if name in found.timers:
            return int(self.now_ms >= self._over_ms.get(name, 0))
        return self.variables[name]

    def _member(self, device: str, member: str) -> int:
        if self._devices[device].pending:
            raise _WaitsFor(device)
        found = self._devices[device]
        return int(found.states[member] if member.startswith("st_") else found.parameters[member])


def _fitting(variable: Variable, value: int) -> int:
    """Return a value; raises `InputError` unless it fits into a variable."""
    least, greatest = _SIZES[variable.size]
    if not least <= value <= greatest:
        raise InputError(f"{variable.name} cannot hold {value}; it must be {least} to {greatest}")
    return value


def _operate(kind: str, left: int, right: int) -> int:
    """Apply an operator to two whole numbers; a quotient is truncated (row Q-82)."""
    if kind == "/":
        if right == 0:
            raise InputError(f"{left} is divided by zero")
        return abs(left) // abs(right) * (1 if (left < 0) == (right < 0) else -1)
    results = {
        "+": left + right, "-": left - right, "*": left * right, "AND": int(bool(left and right)),
        "OR": int(bool(left or right)), "EQ": int(left == right), "NE": int(left != right), "LT": int(left < right),
        "GT": int(left > right), "LE": int(left <= right), "GE": int(left >= right),
    }  # fmt: skip
    return results[kind]
