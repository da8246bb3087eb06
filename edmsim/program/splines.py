"""Splines of drawings as points: also closed and periodic ones, whose knots do not stop at the ends."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError

_MOST_HALVINGS = 16
_FEWEST_CHORDS = 16


def spline_points(entity: Any, tolerance: float) -> NDArray[np.float64]:
    """Return the points (n, 2) of a SPLINE, in drawing units.

    A periodic spline is drawn between the first and last knot that all its control points bear on; one whose control
    points are written once, for as many knots as if they were repeated, is closed with the first of them. A spline
    that is said to be closed and has only fit points is a periodic cubic through them.

    Parameters
    ----------
    entity : ezdxf.entities.Spline
    tolerance : float
        Largest distance of the chords from the curve, in drawing units.
    """
    control = np.array([tuple(p)[:2] for p in entity.control_points], np.float64).reshape(-1, 2)
    if len(control) == 0 and entity.closed and len(entity.fit_points) > 2:
        return _through(np.array([tuple(p)[:2] for p in entity.fit_points], np.float64), tolerance)
    knots, degree = np.array(entity.knots, np.float64), int(entity.dxf.degree)
    usual = _is_clamped(knots, degree) and len(knots) == len(control) + degree + 1 if len(knots) else True
    if len(control) == 0 or usual:
        points = [tuple(p)[:2] for p in entity.flattening(tolerance, segments=_FEWEST_CHORDS)]
        return np.array(points, np.float64).reshape(-1, 2)
    weights = np.array(entity.weights, np.float64) if len(entity.weights) else np.ones(len(control))
    if len(knots) == len(control) + 2 * degree + 1:
        control, weights = np.concatenate([control, control[:degree]]), np.concatenate([weights, weights[:degree]])
    if len(knots) != len(control) + degree + 1 or (np.diff(knots) < 0).any():
        raise InputError(f"a SPLINE has {len(control)} control points and {len(knots)} knots at degree {degree}: "
                         "these make no curve, export it again")
    return _along(knots, control, weights, degree, tolerance)


def _is_clamped(knots: NDArray[np.float64], degree: int) -> bool:
    return bool(knots[0] == knots[degree] and knots[-1] == knots[-degree - 1])


def _along(
    knots: NDArray[np.float64], control: NDArray[np.float64], weights: NDArray[np.float64], degree: int,
    tolerance: float,
) -> NDArray[np.float64]:
    from scipy.interpolate import BSpline

    curve = BSpline(knots, np.column_stack([control * weights[:, None], weights]), degree)
    breaks = np.unique(knots[degree : len(control) + 1])
    return _chords(lambda t: curve(t)[:, :2] / curve(t)[:, 2:], breaks, tolerance)


def _through(points: NDArray[np.float64], tolerance: float) -> NDArray[np.float64]:
    from scipy.interpolate import CubicSpline

    ring = points if np.array_equal(points[0], points[-1]) else np.concatenate([points, points[:1]])
    ring[-1] = ring[0]
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(ring, axis=0).T))])
    return _chords(CubicSpline(length, ring, bc_type="periodic"), length, tolerance)


def _chords(curve: Any, breaks: NDArray[np.float64], tolerance: float) -> NDArray[np.float64]:
    """Halve the chords between breaks until their middles lie within the tolerance of the curve."""
    t = np.unique(np.linspace(breaks[:-1], breaks[1:], _FEWEST_CHORDS // 4 + 1))
    for _ in range(_MOST_HALVINGS):
        points, middle = curve(t), (t[1:] + t[:-1]) / 2
        far = np.hypot(*(curve(middle) - (points[1:] + points[:-1]) / 2).T) > tolerance
        if not far.any():
            break
        t = np.sort(np.concatenate([t, middle[far]]))
    return np.asarray(curve(t))
