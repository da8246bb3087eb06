"""Which words of G-code a program may have, which of them cannot change a contour, and which a user leaves out."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from edmsim.errors import InputError

VALUES = frozenset("NFDHXYIJRPLQ")
"""Letters whose numbers are used, by a motion or by the code they belong to."""
BELONGS: dict[float, str] = {64: "PQ", 39: "IJ", 43: "H", 44: "H", 96: "D"}
"""G codes without effect, and the letters in their block that are theirs: the tolerance of a path, the direction of a
corner, a tool's length, the greatest speed of a spindle."""
IDLE = frozenset("OTSCZ")
"""Letters that cannot change a contour in two axes: program and technology numbers, the height of the upper guide. E
is none of them: ``X1E2`` may be meant as a number."""
IDLE_CODES = frozenset(
    [("G", number) for number in (9, 15, 17, 38, 39, 43, 44, 49, 50, 59.1, 59.2, 59.3, 61.1, 64, 69, 80)]
    + [("G", number) for number in (*range(54, 62), *range(93, 100))]
    + [("M", number) for number in (*range(3, 12), 28, 40, 50, 60, *range(78, 90))]
)
"""Codes without effect on a contour in two axes: exact stop, plane XY, cancelled offsets, tapers, turns and cycles,
the work offset, the mode of the feed; spindle, water, tank, wire and generator; threading, which G0 does here."""
UNITS: dict[float, float] = {70: 20, 71: 21}
"""Codes of some controls for inch and mm, and what they are elsewhere."""
_USED_G = frozenset({0, 1, 2, 3, 4, 10, 20, 21, 40, 41, 42, 90, 91, 90.1, 91.1, 92, *UNITS})
KNOWN_G = _USED_G | {n for g, n in IDLE_CODES if g == "G"}
KNOWN_M = frozenset({0, 1, 2, 30, 98, 99}) | {n for m, n in IDLE_CODES if m == "M"}

_CODE = re.compile(r"0*\d{1,4}(\.\d)?")
_MOST_NAMED = 12
_NEEDED = frozenset({*"GNXYIJRPL", *(f"G{code:g}" for code in _USED_G - {4}), "M98", "M99"})
_ASKED = re.compile(r"([A-Z])(\d+\.?\d*)?")


@dataclass(frozen=True)
class Ignored:
    """Words that a user leaves out of a program.

    Attributes
    ----------
    letters : frozenset of str
        Left out with any number.
    words : frozenset of (str, float)
    """

    letters: frozenset[str] = frozenset()
    words: frozenset[tuple[str, float]] = frozenset()

    @classmethod
    def of(cls, asked: Sequence[str]) -> Ignored:
        """Read words as ``G51``, or letters as ``U``; raises `InputError` at others, and at what makes a contour."""
        letters, words = set(), set()
        for text in asked:
            word = _ASKED.fullmatch(text.strip().upper())
            if word is None:
                raise InputError(f"ignore has {text!r}: give letters or words as a program has them: U,M77")
            plain = word[1] if word[2] is None else f"{word[1]}{float(word[2]):g}"
            if plain in _NEEDED:
                raise InputError(f"ignore has {plain}: the contour cannot be read without it")
            if word[2] is None:
                letters.add(word[1])
            else:
                words.add((word[1], float(word[2])))
        return cls(frozenset(letters), frozenset(words))

    def has(self, letter: str, number: str) -> bool:
        """Say whether a word is left out."""
        return letter in self.letters or (letter, float(number)) in self.words


def offered_to_ignore(words: Iterable[str]) -> list[str]:
    """Return the unknown words that a user may be offered to leave out: M codes. Others may decide the contour."""
    return [word for word in words if re.fullmatch(r"M\d+", word)]


class UnknownWordsError(InputError):
    """A program has words that are not known here.

    Parameters
    ----------
    found : sequence of (str, int)
        Every one, with its line.
    file : path

    Attributes
    ----------
    words : dict of str to list of int
        Each word with its lines.
    """

    def __init__(self, found: Sequence[tuple[str, int]], file: str | Path) -> None:
        self.words: dict[str, list[int]] = {}
        for word, line in found:
            self.words.setdefault(word, []).append(line)
        named = [
            f"{word!r} (line {lines[0]}" + (f", {len(lines)} times)" if len(lines) > 1 else ")")
            for word, lines in self.words.items()
        ]
        more = f" and {len(named) - _MOST_NAMED} more" if len(named) > _MOST_NAMED else ""
        reason = f"unknown word{'s' * (len(named) > 1)} {', '.join(named[:_MOST_NAMED])}{more}: correct "
        reason += "them" if len(named) > 1 else "it"
        idle = offered_to_ignore(self.words)
        if idle:
            reason += f", or leave out what you know to be without effect: --ignore {','.join(idle[:_MOST_NAMED])}"
        super().__init__(reason, file, found[0][1])


def code_of(letter: str, number: str) -> float | None:
    """Return the number of a G or M code, as 41 or 90.1; None if no such code is known."""
    if not _CODE.fullmatch(number):
        return None
    code = float(number) if number.rstrip("0").partition(".")[2] else int(float(number))
    return code if code in (KNOWN_G if letter == "G" else KNOWN_M) else None
