"""The unit of a program's lengths: what its codes say, and mm or whole um where they say millimetres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from edmsim.errors import InputError
from edmsim.program.blocks import Block
from edmsim.program.words import UNITS

INCH_MM = 25.4
TABLE_MM = 65.0
"""Coordinates without a decimal point that span more than this many mm are whole um (row T-61)."""

LEAST_WHOLE_UM = 500
"""They must then span at least this many um (ours: nothing smaller is cut with a wire)."""

_INCH: float = 20


@dataclass(frozen=True)
class Units:
    """Units of a program.

    Attributes
    ----------
    metric_mm : float
        What G21 means, in mm: 1, or 0.001 in a program in whole um.
    stated : frozenset of float
        Which of G20 and G21 the program has.
    """

    metric_mm: float
    stated: frozenset[float]

    @property
    def only_inches(self) -> bool:
        """Whether inches are the only unit that the program states."""
        return self.stated == {_INCH}

    @property
    def at_start_mm(self) -> float:
        """The unit before any is stated, in mm: the program's only one, else millimetres."""
        return INCH_MM if self.only_inches else self.metric_mm

    def of_code_mm(self, code: float) -> float | None:
        """Return the unit in mm that a G code sets, None if it sets none."""
        by_code: dict[float, float] = {_INCH: INCH_MM, 21: self.metric_mm}
        return by_code.get(UNITS.get(code, code))


def units_of(blocks: Sequence[Block], file: str) -> tuple[Units, list[str]]:
    """Return the units of a program and notices of what was decided; raises `InputError` where nothing fits."""
    stated = {UNITS.get(number, number) for block in blocks for letter, number in block.codes if letter == "G"}
    metric_mm, notices = _metric_unit(blocks, file, _INCH in stated)
    return Units(metric_mm, frozenset(stated & {_INCH, 21})), notices


def _metric_unit(blocks: Sequence[Block], file: str, has_inches: bool) -> tuple[float, list[str]]:
    """Decide between mm and whole um: um if no coordinate has a point and the table is too small for mm."""
    extent = 0.0 if has_inches or any(block.pointed for block in blocks) else _extent(blocks)
    if extent == 0:
        return 1.0, []
    span = f"no coordinate has a decimal point and they span {extent:g}"
    if extent <= TABLE_MM:
        return 1.0, [f"{span}: they are read as mm"]
    if extent < LEAST_WHOLE_UM:
        raise InputError(f"{span}: too much in mm, too little in um; write decimal points", file)
    return 0.001, [f"{span}: they are read as whole um"]


def _extent(blocks: Sequence[Block]) -> float:
    """Return the larger span of X and Y as written, G91 summed up, arcs by their ends."""
    absolute = True
    reached: dict[str, list[float]] = {"X": [], "Y": []}
    for block in blocks:
        absolute = absolute if not {("G", 90), ("G", 91)} & set(block.codes) else ("G", 90) in block.codes
        if ("G", 4) in block.codes:
            continue
        for axis in block.values.keys() & reached.keys():
            if absolute or ("G", 92) in block.codes:
                reached[axis].append(block.values[axis])
            else:
                here = reached[axis][-1] if reached[axis] else 0.0
                reached[axis] += [here, here + block.values[axis]]
    return max(max(values) - min(values) if values else 0.0 for values in reached.values())
