"""A program of QCL: a list of statements, with the targets of IF, ELSE and JUMP.

``Axis:prsvel = (20 * Axis:maxvel)/100`` assigns, ``START Axis`` sends a command, ``WAIT NOT Axis:st_emrg`` waits,
``IF NOT (gfMovAuto OR gfMovMan)`` to ENDIF is conditional, ``MAIN:`` is a label for JUMP. ``place[3, 1]`` is a data
group's variable in recipe 3 and step 1.
"""

from __future__ import annotations

import re
from itertools import accumulate
from typing import NamedTuple

from edmsim.controllers.axis.eanpos.drive import parameter_name, state_name
from edmsim.controllers.axis.eanpos.registers import COMMANDS
from edmsim.controllers.qcl.configuration import Configuration
from edmsim.controllers.qcl.text import Problem, QclError, code_lines, whole_number, words_of
from edmsim.errors import InputError

Expression = tuple["str | int | Expression", ...]
"""An operation on others: ``("*", left, right)``, ``("NOT", other)``, ``("number", 3)``, ``("name", "speed")``,
``("member", "axis", "setpos")``, ``("element", "place", recipe, step)``."""
_COMPARISONS = ("EQ", "NE", "LT", "GT", "LE", "GE")
_KEYWORDS = ("AND", "OR", "NOT", *_COMPARISONS)
_LEVELS: tuple[tuple[str, ...], ...] = (("OR",), ("AND",), (), _COMPARISONS, ("+", "-"), ("*", "/"))
"""Operators by how tightly they bind, loosest first; NOT stands at the empty place."""

MOST_WORDS, DEEPEST = 200, 20
"""Words of an expression, and brackets within brackets (ours): what it computes stays small, and so do its calls."""


class Statement(NamedTuple):
    """A statement: its line, what it does, on what, with which expression, and where it may lead."""

    line: int
    verb: str  # assign, command, wait, if, jump or end
    target: tuple[str, ...] = ()  # a name, or device and member or command
    value: Expression = ()
    to: int = 0  # number of the statement that an IF that fails, or a JUMP, leads to
    at: tuple[Expression, ...] = ()  # recipe and step of a data group's variable


class QclProgram(NamedTuple):
    """A program: its statements."""

    statements: tuple[Statement, ...]


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
    """Return how many brackets of an expression are within each other."""
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
                raise InputError(f"the label {label[1]} stands twice")
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
            equals = words.index("=")
            target, at = self._target(words[:equals])
            self._add(number, "assign", target, self._expression(words[equals + 1 :]))
            self._statements[-1] = self._statements[-1]._replace(at=at)
        else:
            raise InputError(f"{line!r} is not a statement; a comment begins with ;")

    def _add(self, number: int, verb: str, target: tuple[str, ...] = (), value: Expression = ()) -> None:
        self._statements.append(Statement(number, verb, target, value))

    def _block(self, number: int, verb: str) -> None:
        if verb == "END":
            self._add(number, "end")
            return
        if not self._open:
            raise InputError(f"{verb} without IF")
        begin, _ = self._open.pop()
        if verb == "ELSE":
            self._open.append((len(self._statements), number))
            self._add(number, "jump")
        self._statements[begin] = self._statements[begin]._replace(to=len(self._statements))

    def finish(self, file: str | None) -> QclProgram:
        """Return the program, its jumps resolved."""
        problems = self.problems + [Problem(number, "IF without ENDIF") for _, number in self._open]
        for place, label in self._jumps.items():
            if label in self._labels:
                self._statements[place] = self._statements[place]._replace(to=self._labels[label])
            else:
                problems.append(Problem(self._statements[place].line, f"there is no label {label!r} to jump to"))
        if problems:
            raise QclError(problems, file)
        return QclProgram(tuple(self._statements))

    def _device(self, name: str) -> str:
        if name.lower() not in self._configuration.devices:
            raise InputError(f"{name} is not a device that the configuration declares")
        return name.lower()

    def _target(self, words: list[str]) -> tuple[tuple[str, ...], tuple[Expression, ...]]:
        """Return what is assigned to, and the recipe and step of a data group's variable."""
        word, found = words[0], self._configuration
        if word.lower() in found.data:
            (_, name, *at), rest = self._element(word, words[1:])
            if rest:
                raise InputError(f"{' '.join(rest)!r} is left over before =")
            return (str(name),), tuple(at)  # type: ignore[arg-type]
        if len(words) > 1:
            raise InputError(f"{' '.join(words)!r} is nothing that can be assigned to")
        if ":" in word:
            device, member = word.split(":")
            return (self._device(device), parameter_name(member)), ()
        if word.lower() not in found.variables.keys() | found.outputs.keys() | found.timers:
            raise InputError(f"{word} is not a variable or output that the configuration declares")
        return (word.lower(),), ()

    def _element(self, word: str, words: list[str]) -> tuple[Expression, list[str]]:
        """Read recipe and step behind the name of a data group's variable."""
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
        if not re.match(r"[A-Za-z_]", word) or word.upper() in _KEYWORDS:
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
