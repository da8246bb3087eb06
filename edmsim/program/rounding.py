"""How finely a program writes its numbers, and how far apart two places may then be that mean the same one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from edmsim.program.blocks import Block
from edmsim.program.outline import JOIN_TOLERANCE_MM
from edmsim.program.units import Units

SAME_PLACE_MM = 1e-6
"""Places closer than this many mm differ by numerical noise only."""

RADIUS_TOLERANCE_MM = 0.005
"""Least allowed difference in mm between the start and end radius of an arc (ours: rounding of some um)."""

COARSEST_MM = 0.0254
"""Numbers written more coarsely than this, 0.001 inch, are taken as exact (ours: no program for a wire rounds so)."""


@dataclass(frozen=True)
class Rounding:
    """What follows from the last decimal place that a program writes.

    Attributes
    ----------
    resolution_mm : float
        Value of the last place in mm; 0 where the numbers are exact.
    """

    resolution_mm: float = 0.0

    @property
    def radius_mm(self) -> float:
        """Greatest difference of an arc's radii: I and J err by half a place, the end from the centre by three."""
        return max(RADIUS_TOLERANCE_MM, 2 * math.sqrt(2) * self.resolution_mm)

    @property
    def join_mm(self) -> float:
        """Greatest distance between ends that are one place: either may err by half a place along both axes."""
        return max(JOIN_TOLERANCE_MM, math.sqrt(2) * self.resolution_mm)


def rounding_of(blocks: Sequence[Block], units: Units) -> Rounding:
    """Find the resolution of a program: the finest number under each unit, and of several units the coarsest."""
    unit_mm, decimals = units.at_start_mm, dict[float, int]()
    for block in blocks:
        for letter, number in block.codes:
            unit_mm = (units.of_code_mm(number) if letter == "G" else None) or unit_mm
        if block.decimals is not None:
            decimals[unit_mm] = max(decimals.get(unit_mm, 0), block.decimals)
    written = [unit * 10.0**-places for unit, places in decimals.items()]
    return Rounding(max((mm for mm in written if mm <= COARSEST_MM * (1 + 1e-9)), default=0.0))
