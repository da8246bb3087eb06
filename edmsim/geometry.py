"""Lines of straight pieces, asked by arc length: stations, directions, corners, distances along."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Polyline:
    """A line of straight pieces, open or closed, asked by arc length. All lengths are in mm.

    Parameters
    ----------
    points_mm : array (n, 2)
        Corners in mm. Points nearer than 0.1 um to the one before are left out: they give no direction.
    closed : bool
        Whether the line goes round; then the last point is the first.

    Attributes
    ----------
    points : array (n, 2)
    s : array (n,)
        Arc length in mm at every point.
    length : float
        In mm.
    turn_deg : array (n,)
        Change of direction at every point, left positive; 0 at the ends of an open line, and at the last
        point of a closed one, where the first has it.
    """

    def __init__(self, points_mm: Floats, closed: bool) -> None:
        step = np.hypot(*np.diff(points_mm, axis=0).T)
        self.points = points_mm[np.concatenate([[True], step > 1e-4])]
        pieces = np.diff(self.points, axis=0)
        self.s = np.concatenate([[0.0], np.cumsum(np.hypot(*pieces.T))])
        self.length = float(self.s[-1])
        self.closed = closed
        heading = _heading_deg(pieces)
        before = np.concatenate([heading[-1:] if closed else heading[:1], heading[:-1]])
        self.turn_deg = np.append(_signed_angle(heading - before), 0.0)

    def corners(self, min_turn_deg: float) -> NDArray[np.intp]:
        """Vertices that turn by at least that much."""
        return np.flatnonzero(np.abs(self.turn_deg) >= min_turn_deg)

    def stations(self, step: float, vertices: NDArray[np.intp]) -> Floats:
        """Arc lengths at most `step` apart that meet the given vertices, and the end of an open line."""
        stops = np.unique(np.concatenate([[0.0], self.s[vertices], [self.length]]))
        rows = [np.linspace(a, b, int(np.ceil((b - a) / step)), endpoint=False) for a, b in pairwise(stops)]
        return np.concatenate(rows if self.closed else [*rows, [self.length]])

    def at(self, s: Floats) -> Floats:
        """Points (n, 2) at these arc lengths; a closed line goes round, an open one ends."""
        s = s % self.length if self.closed else s
        return np.stack([np.interp(s, self.s, self.points[:, axis]) for axis in (0, 1)], axis=1)

    def tangent(self, s: Floats, reach: float) -> Floats:
        """Unit directions (n, 2) of the chords from `reach` before to `reach` after these arc lengths."""
        chord = self.at(s + reach) - self.at(s - reach)
        return np.asarray(chord / np.maximum(np.hypot(*chord.T), 1e-12)[:, None], np.float64)

    def bend_deg(self, s: Floats, reach: float) -> Floats:
        """Angle (n,) without sign between the chords before and after these arc lengths."""
        before, after = self.at(s) - self.at(s - reach), self.at(s + reach) - self.at(s)
        return np.abs(_signed_angle(_heading_deg(after) - _heading_deg(before)))

    def distance_along(self, s: Floats, marks: Floats) -> Floats:
        """Arc length from each of `s` to the nearest of `marks`; infinite if there are none."""
        if self.closed:
            marks = np.concatenate([marks - self.length, marks, marks + self.length])
        fence = np.concatenate([[-np.inf], np.sort(marks), [np.inf]])
        after = np.searchsorted(fence, s)
        return np.asarray(np.minimum(s - fence[after - 1], fence[after] - s), np.float64)


def left_of(direction: Floats) -> Floats:
    """Directions (n, 2) turned by 90 degrees to the left."""
    return np.stack([-direction[:, 1], direction[:, 0]], axis=1)


def _heading_deg(direction: Floats) -> Floats:
    return np.asarray(np.degrees(np.arctan2(direction[:, 1], direction[:, 0])), np.float64)


def _signed_angle(degrees: Floats) -> Floats:
    """The same angles within -180 to 180."""
    return np.asarray((degrees + 180.0) % 360.0 - 180.0, np.float64)
