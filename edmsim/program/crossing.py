"""A drawn line must not cross or touch itself; where it does, say so."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError

_AT_ONCE = 100


def refuse_self_crossing(points: NDArray[np.float64], line_numbers: Sequence[int]) -> None:
    """Check a polyline.

    Parameters
    ----------
    points : float64 array (n, 2)
        In mm; closed if the first and last are equal.
    line_numbers : sequence of int
        For each chord the line of the program, 0 if there is none.

    Raises
    ------
    InputError
        With the place and the lines of the two moves that meet.
    """
    line = shapely.LineString(points)
    if line.is_simple:
        return
    first, second = _crossing_chords(points)
    chords = [shapely.LineString(points[i : i + 2]) for i in (first, second)]
    x, y = shapely.get_coordinates(chords[0].intersection(chords[1]))[0]
    numbers = [line_numbers[i] for i in (first, second)]
    lines = f" (lines {numbers[0]} and {numbers[1]})" if numbers[0] else ""
    reason = f"the contour crosses or retraces itself at X{x:.3f} Y{y:.3f}{lines}: draw it without crossings"
    raise InputError(reason, line=numbers[1] or None)


def chords_of(points: NDArray[np.float64]) -> list[shapely.LineString]:
    """Return the ``n - 1`` chords of a polyline (n, 2)."""
    return list(np.asarray(shapely.linestrings(np.stack([points[:-1], points[1:]], axis=1)), np.object_))


def _crossing_chords(points: NDArray[np.float64]) -> tuple[int, int]:
    """Return two chords of a line that is not simple, which meet elsewhere than end to start."""
    chords = chords_of(points)
    tree = shapely.STRtree(chords)
    joined_ends = np.array_equal(points[0], points[-1])
    for first in range(0, len(chords), _AT_ONCE):  # a line that retraces itself throughout has pairs without number
        left, right = tree.query(chords[first : first + _AT_ONCE], predicate="intersects")
        for a, b in sorted(zip((left + first).tolist(), right.tolist(), strict=True)):
            neighbours = b == a + 1 or (joined_ends and a == 0 and b == len(chords) - 1)
            if b > a and not (neighbours and chords[a].intersection(chords[b]).length == 0):
                return a, b
    raise AssertionError("a line that is not simple has two chords that meet")
