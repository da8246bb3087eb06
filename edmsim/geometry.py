"""Plane curves: polylines by arc length, and the tractrix."""

import math
from itertools import pairwise

import numpy as np

from edmsim.errors import InputError

Floats = np.typing.NDArray[np.float64]
Ints = np.typing.NDArray[np.int64]

POINTS_PER_LAG = 64
"""Points of the wire's path per lag of travel while its direction changes (ours: chords err by 1e-4 of the lag)."""
CORNER_DEG = 20.0
"""A path has a corner where it turns by at least this many degrees (ours: chords of arcs turn by less)."""
SETTLED_RAD = 1e-6
"""Angle below which the wire is assumed to follow straight behind the guides (ours)."""


def arc_lengths(points: np.typing.ArrayLike) -> Floats:
    """Return the length of a polyline (n, 2) up to every point (n,)."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def interpolated(places: Floats, known: Floats | Ints, rows: Floats | Ints) -> Floats:
    """Interpolate `rows` (m, k), known at the increasing values `known` (m,), linearly at `places` (n,)."""
    return np.stack([np.interp(places, known, column) for column in rows.T], axis=1)


class Polyline:
    """An open or closed polyline (its last point equals its first), queried by arc length in mm."""

    def __init__(self, points_mm: Floats, closed: bool) -> None:
        # points within 0.1 um of the previous point are dropped, because they have no direction
        step = np.hypot(*np.diff(points_mm, axis=0).T)
        self.points = points_mm[np.concatenate([[True], step > 1e-4])]
        pieces = np.diff(self.points, axis=0)
        self.s = arc_lengths(self.points)  # (n,): at every point
        self.length = float(self.s[-1])
        self.closed = closed
        heading = _heading_deg(pieces)
        before = np.concatenate([heading[-1:] if closed else heading[:1], heading[:-1]])
        # (n,): change of direction at every point, left positive; 0 at both ends of an open line. The turn where a
        # closed line ends is stored at its first point, and its last has 0
        self.turn_deg = np.append(_signed_angle(heading - before), 0.0)

    def corners(self, min_turn_deg: float) -> np.typing.NDArray[np.intp]:
        """Return the indices of the points that turn by at least this angle."""
        return np.flatnonzero(np.abs(self.turn_deg) >= min_turn_deg)

    def stations(self, step: float, vertices: np.typing.NDArray[np.intp]) -> Floats:
        """Return arc lengths at most `step` apart that include `vertices`, the start, and the end of an open line."""
        stops = np.unique(np.concatenate([[0.0], self.s[vertices], [self.length]]))
        rows = [np.linspace(a, b, int(np.ceil((b - a) / step)), endpoint=False) for a, b in pairwise(stops)]
        return np.concatenate(rows if self.closed else [*rows, [self.length]])

    def at(self, s: Floats) -> Floats:
        """Return the points (n, 2) at arc lengths, which wrap round a closed line and are clamped to an open one."""
        s = s % self.length if self.closed else s
        return interpolated(s, self.s, self.points)

    def tangent(self, s: Floats, reach: float) -> Floats:
        """Return the unit directions (n, 2) of the chords from `reach` before to `reach` after these arc lengths."""
        chord = self.at(s + reach) - self.at(s - reach)
        return np.asarray(chord / np.maximum(np.hypot(*chord.T), 1e-12)[:, None], np.float64)

    def bend_deg(self, s: Floats, reach: float) -> Floats:
        """Return the unsigned angle (n,) between the chords over `reach` before and after these arc lengths."""
        before, after = self.at(s) - self.at(s - reach), self.at(s + reach) - self.at(s)
        return np.abs(_signed_angle(_heading_deg(after) - _heading_deg(before)))

    def distance_along(self, s: Floats, marks: Floats) -> Floats:
        """Return the arc length from each of `s` to the nearest of `marks`; infinite if there are none."""
        if self.closed:
            marks = np.concatenate([marks - self.length, marks, marks + self.length])
        fence = np.concatenate([[-np.inf], np.sort(marks), [np.inf]])
        after = np.searchsorted(fence, s)
        return np.asarray(np.minimum(s - fence[after - 1], fence[after] - s), np.float64)


def path_corners(points_um: Floats | Ints) -> tuple[Floats, Floats]:
    """Return the length in um of a path (n, 2) up to each corner, and the turn there in degrees, left positive."""
    line = Polyline(np.asarray(points_um * 1e-3, np.float64), closed=False)
    corners = line.corners(CORNER_DEG)
    return line.s[corners] * 1e3, line.turn_deg[corners]


def left_of(direction: Floats) -> Floats:
    """Return directions (n, 2) turned by 90 degrees to the left."""
    return np.stack([-direction[:, 1], direction[:, 0]], axis=1)


def _heading_deg(direction: Floats) -> Floats:
    return np.asarray(np.degrees(np.arctan2(direction[:, 1], direction[:, 0])), np.float64)


def _signed_angle(degrees: Floats) -> Floats:
    """Wrap angles to -180 to 180 degrees."""
    return np.asarray((degrees + 180.0) % 360.0 - 180.0, np.float64)


def pursuit(path_um: np.typing.ArrayLike, lag_um: float) -> Floats:
    """Return the wire's path at a constant lag for a path of the guides: its tractrix.

    A wire that is bent back by a constant distance always moves towards its guides. Along a straight stretch the
    path has a closed form: with ``a`` the angle from the stretch to the direction wire-to-guide,
    ``tan(a / 2) = tan(a0 / 2) exp(-s / lag)`` after ``s`` of travel. Where the path turns by more than 90 degrees
    the wire rests in its kerf until the guides are a lag away again.

    Parameters
    ----------
    path_um : array (n, 2)
        Corners of the guides' path, straight between them; at least two different ones.
    lag_um : float
        Distance by which the wire trails the guides, 0 or more.

    Returns
    -------
    float64 array (m, 2)
        Begins a lag straight behind the first point of the guides; every point lies on the exact curve.

    Raises
    ------
    InputError
        If the path has no direction, or the lag is negative: a wire ahead of its guides is not led by them.
    """
    path = _checked(path_um)
    if not 0 <= lag_um < math.inf:
        raise InputError(f"the lag is {lag_um:g} um; it must be 0 or more")
    if lag_um == 0:
        return path
    steps = np.diff(path, axis=0)
    lengths = np.hypot(*steps.T)
    headings = steps / lengths[:, None]
    wire = [path[:1] - lag_um * headings[0]]
    for start, heading, length in zip(path, headings, lengths, strict=False):
        taut = _until_taut(start - wire[-1][-1], heading, lag_um)
        if taut < length:
            wire.append(_follow(start + taut * heading, wire[-1][-1], heading, float(length - taut), lag_um))
    return np.concatenate(wire)


def _checked(path_um: np.typing.ArrayLike) -> Floats:
    """Return the path without repeated points."""
    path = np.asarray(path_um, float)
    if path.ndim != 2 or path.shape[1] != 2 or not np.isfinite(path).all():
        raise InputError(f"a path is a list of points (x, y) in um, not an array of shape {path.shape}")
    moved = np.hypot(*np.diff(path, axis=0).T) > 0
    if not moved.any():
        raise InputError("a path needs at least two different points")
    return np.asarray(path[np.append(True, moved)])


def _until_taut(offset: Floats, heading: Floats, lag: float) -> float:
    """Return the travel along `heading` after which the guides, `offset` from the wire before, are a lag away."""
    along = float(offset @ heading)
    return max(0.0, -along + math.sqrt(max(0.0, along**2 - float(offset @ offset) + lag**2)))


def _follow(guide: Floats, wire: Floats, heading: Floats, length: float, lag: float) -> Floats:
    """Return the wire's path while the guides travel `length` from `guide`, a lag away from the wire."""
    across = np.array([-heading[1], heading[0]])
    half = math.atan2(float((guide - wire) @ across), float((guide - wire) @ heading)) / 2
    turning = lag * max(0.0, math.log(max(abs(math.tan(half)), 1e-300) * 2 / SETTLED_RAD))
    dense = min(length, turning)
    travelled = np.linspace(0.0, dense, math.ceil(POINTS_PER_LAG * dense / lag) + 1)[1:]
    if dense < length:
        travelled = np.append(travelled, length)
    angle = 2 * np.arctan(math.tan(half) * np.exp(-travelled / lag))
    along, aside = travelled - lag * np.cos(angle), -lag * np.sin(angle)
    return np.asarray(guide + along[:, None] * heading + aside[:, None] * across)
