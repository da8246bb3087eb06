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
_Box = tuple[float, float, float, float]
_LEAST_SHARE = 0.25
"""Lines that lie apart by more of their own extent than this are two, however short they are (ours)."""


def without_duplicates(chains: Sequence[Chain]) -> list[Chain]:
    """Return the chains without those that lie on an earlier one from end to end, whatever their direction.

    Candidates share the box around them; boxes are looked up through a grid, with the cells beside it.
    """
    cells: dict[tuple[int, ...], list[tuple[_Box, Chain]]] = {}
    kept = []
    for chain in chains:
        box = (*chain.points.min(axis=0).tolist(), *chain.points.max(axis=0).tolist())
        low, high = (
            [math.floor((c + step) / _CELL_MM) for c in box] for step in (-JOIN_TOLERANCE_MM, JOIN_TOLERANCE_MM)
        )
        near = product(*({a, b} for a, b in zip(low, high, strict=True)))
        if not any(_are_same(chain, box, *other) for cell in near for other in cells.get(cell, ())):
            kept.append(chain)
            cells.setdefault(tuple(math.floor(c / _CELL_MM) for c in box), []).append((box, chain))
    return kept


def _are_same(one: Chain, box: _Box, other_box: _Box, other: Chain) -> bool:
    """Compare by the distance of every point and middle of a chord of each from the other."""
    extent = min(max(x1 - x0, y1 - y0) for x0, y0, x1, y1 in (box, other_box))
    reach = min(JOIN_TOLERANCE_MM, _LEAST_SHARE * extent)
    if any(abs(a - b) > reach for a, b in zip(box, other_box, strict=True)) or one.closed != other.closed:
        return False
    if not one.closed:
        ends = one.points[[0, -1]]
        if min(np.hypot(*(ends - other.points[[a, -1 - a]]).T).max() for a in (0, -1)) > reach:
            return False
    return _lies_on(one.points, other.points, reach) and _lies_on(other.points, one.points, reach)


def _lies_on(points: NDArray[np.float64], line: NDArray[np.float64], reach: float) -> bool:
    spots = np.concatenate([points, (points[1:] + points[:-1]) / 2])
    drawn = shapely.LineString(line)
    shapely.prepare(drawn)
    return bool(shapely.dwithin(drawn, shapely.points(spots), reach).all())
