"""QCL text: lines without comments, the words of a line, and the problems of a text."""

from __future__ import annotations

import re
from typing import NamedTuple

from edmsim.errors import InputError

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
    """Return the number that digits, perhaps behind a minus, write; `InputError` for more than any variable has."""
    if not re.fullmatch(f"-?[0-9]{{1,{MOST_DIGITS}}}", text):
        raise InputError(f"{text!r}; it must be a whole number of at most {MOST_DIGITS} digits")
    return int(text)


def code_lines(text: str) -> list[tuple[int, str]]:
    """Return the lines that have more than a comment, which begins with a semicolon, with their numbers."""
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
