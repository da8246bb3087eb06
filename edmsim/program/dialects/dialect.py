"""The record of a dialect: the words of one machine's control beyond those that all controls share."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Action = Literal[
    "thread", "cut off", "adaptive", "constant", "end", "idle", "no taper", "taper left", "taper right", "conical",
    "cylindrical", "two planes off", "two planes left", "two planes right",
]
"""What a code does. "idle": nothing to a contour, as tank, water and wire on and off."""

Codes = Mapping[tuple[str, float], Action]
TAPER: Codes = {("G", 50): "no taper", ("G", 51): "taper left", ("G", 52): "taper right"}


@dataclass(frozen=True)
class Dialect:
    """A dialect: words and what they mean."""

    name: str  # as ``--dialect`` has it
    machines: str  # the machines it is for, in notices
    # codes that only this dialect has, or to which it gives a meaning, and what they do
    codes: Codes = field(default_factory=dict)
    condition: str = ""  # letter that calls a machining condition; empty where none does
    # columns of its table of conditions, in their usual order; empty where programs hold no table
    columns: tuple[str, ...] = ()
    angle: str = ""  # letter of a taper's angle in degrees; empty where there is none
    signed_angle: bool = False  # whether the angle leans the wire without G51 or G52, by its sign
    # how the second plane is written: U V from X Y, U V as coordinates, or a move behind a colon
    upper: Literal["relative", "absolute", "colon"] | None = None
    planes: bool = False  # whether TP and TN give the heights of the two planes
    registers_in_um: bool = False  # whether ``H001=100`` are um, in whatever unit the coordinates are
    ends_blocks: bool = False  # whether ``;`` ends a block, so that another may follow on the line
    numbered: bool = False  # whether subprograms begin at N numbers as well as at O numbers
    # what the dialect is recognised by: regular expressions of which all of one tuple are found in the program,
    # in upper case, without comments and blanks
    evidence: tuple[tuple[str, ...], ...] = ()
    comment: str = ""  # a regular expression that is found in its comments; empty if they tell nothing

    @property
    def letters(self) -> str:
        """Letters whose numbers are used here, besides those of all dialects."""
        return self.angle + {"relative": "UVK", "absolute": "UV"}.get(self.upper or "", "")

    def action_of(self, code: tuple[str, float]) -> Action | None:
        """Return what a code does here, None where it has its usual meaning or none."""
        return self.codes.get(code)

    def found_in(self, words: str, comments: str) -> str | None:
        """Return what a program, in upper case without comments and blanks, is recognised by; None if by nothing."""
        for alternative in self.evidence:
            found = [re.search(pattern, words, re.MULTILINE) for pattern in alternative]
            if all(found):
                return " and ".join(match[0] for match in found if match)
        remark = re.search(self.comment, comments, re.IGNORECASE) if self.comment else None
        return f"the comment '{remark[0]}'" if remark else None


ISO = Dialect("iso", "any machine")
"""The words that controls have in common; for programs in which no other dialect is recognised."""
