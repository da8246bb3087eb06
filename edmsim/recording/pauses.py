"""When a machine cuts and when it does not: every picture, figure and table takes that from here.

A *pause* lies between two windows: the wire is threaded, and brought to where the next contour begins by a way in
air. No pulse is fired, so it has no windows, and lines over time or along the path break there. A *stretch* is what
lies between two pauses.

*The cut alone* is, of every stretch, the time from when the wire's centre leaves the start hole, and with its whole
width is in metal, to the last discharge. What comes before is a way in air and the bite into the hole's wall; behind
it, the wire runs in its own kerf. Threading, ways between contours and start holes are no part of it; retracts,
shorts and dwells are.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

THREADING_S = 1.0
"""Least time that it takes to thread a wire (ours)."""
_JUMP_UM = 20.0
"""A way longer than the path cut meanwhile by more than this is one between contours (ours: rounding is 1 um)."""


class CutAlone(NamedTuple):
    """The cut alone: of the windows, of the time, and of the path.

    Attributes
    ----------
    rows : bool array (n,)
        Whether a window belongs to it.
    time_s : float
    ways_um : tuple of (float, float)
        From and to which place along the path the wire has cut, stretch by stretch.
    """

    rows: NDArray[np.bool_]
    time_s: float
    ways_um: tuple[tuple[float, float], ...]


def cut_alone(t_s: Floats, place_um: Floats, path_um: Floats, ignited: Floats, holes_um: Floats) -> CutAlone:
    """Return what of a cut's windows is the cut alone.

    Parameters
    ----------
    t_s, path_um, ignited : float64 arrays (n,)
        Time at the end of each window, place along the path, and discharges in it.
    place_um : float64 array (n, 2)
        The wire's place on the table.
    holes_um : float64 array (m, 3)
        Centres and radii of the start holes on the table.
    """
    away = np.hypot(place_um[:, None, 0] - holes_um[:, 0], place_um[:, None, 1] - holes_um[:, 1])
    in_hole: NDArray[np.bool_] = np.any(away <= holes_um[:, 2], axis=1)
    rows, time_s, ways = np.zeros(len(t_s), bool), 0.0, []
    for part in stretches(len(t_s), pause_rows(t_s)):
        outside = part.start + np.flatnonzero(~in_hole[part])
        lit = part.start + np.flatnonzero(ignited[part] > 0)
        if len(outside) and len(lit) and lit[-1] >= outside[0]:
            first, last = max(int(outside[0]), part.start + 1), int(lit[-1])
            rows[first : last + 1] = True
            time_s += float(t_s[last] - t_s[first - 1])
            ways.append((float(path_um[first - 1]), float(path_um[first - 1 : last + 1].max())))
    return CutAlone(rows, time_s, tuple(ways))


def pause_rows(t_s: Floats) -> NDArray[np.intp]:
    """Return the rows of the table of windows, times (n,), before which a wire was threaded.

    Windows may be long, of long periods or thinned; a pause is longer than those beside it.
    """
    took = np.diff(t_s)
    beside = np.concatenate([t_s[:1], took, [np.inf]])
    return np.flatnonzero(took > THREADING_S + 2.0 * np.minimum(beside[: len(took)], beside[2:])) + 1


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
