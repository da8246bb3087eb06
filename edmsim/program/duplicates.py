"""What is drawn twice, found by distance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.program.chains import Chain
from edmsim.program.outline import JOIN_TOLERANCE_MM

_CELL_MM = 16 * JOIN_TOLERANCE_MM
_LEAST_SHARE = 0.25
"""Lines that lie apart by more of their own extent than this are two, however short they are (ours)."""


def without_duplicates(chains: Sequence[Chain]) -> list[Chain]:
    """Return the chains without those that lie on an earlier one from end to end, whatever their direction.

    Candidates share the box around them; boxes are looked up through a grid, with the cells beside it.
    """
    cells: dict[tuple[int, ...], list[Chain]] = {}
    kept = []
    for chain in chains:
        box = np.concatenate([chain.points.min(axis=0), chain.points.max(axis=0)])
        low, high = (np.floor((box + step) / _CELL_MM).astype(int).tolist() for step in
                     (-JOIN_TOLERANCE_MM, JOIN_TOLERANCE_MM))
        near = product(*({a, b} for a, b in zip(low, high, strict=True)))
        if not any(_are_same(chain, other) for cell in near for other in cells.get(cell, ())):
            kept.append(chain)
            cells.setdefault(tuple(math.floor(c / _CELL_MM) for c in box.tolist()), []).append(chain)
    return kept


def _are_same(one: Chain, other: Chain) -> bool:
    """Compare by the distance of every point and middle of a chord of each from the other."""
    if one.closed != other.closed:
        return False
    reach = min(JOIN_TOLERANCE_MM, *(_LEAST_SHARE * float(np.ptp(c.points, axis=0).max()) for c in (one, other)))
    if not one.closed:
        apart = [np.hypot(*(one.points[[0, -1]] - ends).T).max() for ends in
                 (other.points[[0, -1]], other.points[[-1, 0]])]
        if min(apart) > reach:
            return False
    return _lies_on(one.points, other.points, reach) and _lies_on(other.points, one.points, reach)


def _lies_on(points: NDArray[np.float64], line: NDArray[np.float64], reach: float) -> bool:
    spots = np.concatenate([points, (points[1:] + points[:-1]) / 2])
    drawn = shapely.LineString(line)
    shapely.prepare(drawn)
    return bool(shapely.dwithin(drawn, shapely.points(spots), reach).all())
