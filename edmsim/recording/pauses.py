"""Pauses of a cut, in which a wire is threaded: lines over time or along the path break there."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

THREADING_S = 1.0
"""Windows that far apart in time have had a new wire threaded between them."""
_JUMP_UM = 20.0
"""A way longer than the path cut meanwhile by more than this is one between contours (ours: rounding is 1 um)."""


def pause_rows(t_s: Floats) -> NDArray[np.intp]:
    """Return the rows of the table of windows, times (n,), before which a wire was threaded."""
    return np.flatnonzero(np.diff(t_s) > THREADING_S) + 1


def jump_rows(place_um: Floats, path_um: Floats) -> NDArray[np.intp]:
    """Return the rows of a thinned way, places (n, 2) and lengths of path (n,), before which a wire was threaded."""
    way = np.hypot(*np.diff(place_um, axis=0).T)
    return np.flatnonzero(way > np.abs(np.diff(path_um)) + _JUMP_UM) + 1


def stretches(count: int, breaks: NDArray[np.intp]) -> list[slice]:
    """Return the rows between breaks, stretch by stretch."""
    edges = [0, *breaks.tolist(), count]
    return [slice(a, b) for a, b in pairwise(edges) if b > a]


def broken(values: Floats, breaks: NDArray[np.intp]) -> Floats:
    """Return values (n, ...) with NaN before every break, so that a line drawn through them stops there."""
    return np.insert(values, breaks, np.nan, axis=0)
