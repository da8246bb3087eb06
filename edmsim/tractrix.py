"""Where the wire goes when it trails its guides at a constant lag: the tractrix of the guides' path.

A wire that is bent back by a constant distance, always against its own cutting direction, follows the guides
as a load follows on a rope: it is only ever pulled. Along a straight stretch that has a closed form: with
``a`` the angle from the stretch to the direction wire-to-guide, ``tan(a / 2) = tan(a0 / 2) exp(-s / lag)``
after ``s`` of travel. Where the path turns by more than 90 degrees the wire rests in its kerf until the guides
are a lag away again.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edmsim.errors import InputError

POINTS_PER_LAG = 64
"""Points of the wire's path per lag of travel while it still turns in (ours: chords bulge by 1e-4 of the lag)."""
SETTLED_RAD = 1e-6
"""An angle at which the wire is taken to run straight behind the guides (ours)."""


def pursuit(path_um: ArrayLike, lag_um: float) -> NDArray[np.float64]:
    """Return the wire's path for a path of the guides.

    Parameters
    ----------
    path_um : array (n, 2)
        Corners of the guides' path, straight between them; at least two different ones.
    lag_um : float
        Distance by which the wire trails the guides, 0 or more.

    Returns
    -------
    float64 array (m, 2)
        From the wire's place straight behind the first point on; every point lies on the true curve.

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


def _checked(path_um: ArrayLike) -> NDArray[np.float64]:
    """Return the path without repeated points."""
    path = np.asarray(path_um, float)
    if path.ndim != 2 or path.shape[1] != 2 or not np.isfinite(path).all():
        raise InputError(f"a path is a list of points (x, y) in um, not an array of shape {path.shape}")
    moved = np.hypot(*np.diff(path, axis=0).T) > 0
    if not moved.any():
        raise InputError("a path needs at least two different points")
    return np.asarray(path[np.append(True, moved)])


def _until_taut(offset: NDArray[np.float64], heading: NDArray[np.float64], lag: float) -> float:
    """Travel along `heading` until the guides, `offset` from the wire, are a lag away from it."""
    along = float(offset @ heading)
    return max(0.0, -along + math.sqrt(max(0.0, along**2 - float(offset @ offset) + lag**2)))


def _follow(
    guide: NDArray[np.float64], wire: NDArray[np.float64], heading: NDArray[np.float64], length: float, lag: float
) -> NDArray[np.float64]:
    """Return the wire's path while the guides travel `length` from where the wire is taut."""
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
