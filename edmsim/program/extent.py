"""How large a contour is as drawn, not as its chords are."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from edmsim.program.arcs import CHORD_TOLERANCE_UM

Floats = NDArray[np.float64]


def extent_mm(points: Floats, elements: Sequence[int]) -> Floats:
    """Return the extent in X and Y of an edge drawn in chords, whose curves bulge beyond their points.

    Parameters
    ----------
    points : float64 array (n, 2)
    elements : sequence of int
        For every chord the line, arc or curve it belongs to; empty if nobody knows.
    """
    begins = [0, *(np.flatnonzero(np.diff(elements)) + 1), len(elements)]
    parts = [points[first : last + 1] for first, last in pairwise(begins)]
    high = np.max([points.max(axis=0), *map(_peak, parts)], axis=0)
    low = -np.max([-points.min(axis=0), *(_peak(-part) for part in parts)], axis=0)
    return np.asarray(high - low)


def _peak(points: Floats) -> Floats:
    """Return the highest X and Y of the parabolas through three neighbours each; -inf where none peaks."""
    if len(points) < 3:
        return np.full(2, -np.inf)
    a, b, c = points[:-2], points[1:-1], points[2:]
    before, after = np.hypot(*(b - a).T)[:, None], np.hypot(*(c - b).T)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):  # a repeated point, a straight line: no peak
        up, down = (b - a) / before, (c - b) / after
        bend = (down - up) / (before + after)
        slope = up + before * bend
        at, peak = -slope / (2 * bend), b - slope**2 / (4 * bend)
    # a curve leaves its chords by their tolerance at most; what rises more is a corner
    smooth = peak <= np.maximum(np.maximum(a, b), c) + CHORD_TOLERANCE_UM / 1000
    return np.asarray(np.where((bend < 0) & (at >= -before) & (at <= after) & smooth, peak, -np.inf).max(axis=0))
