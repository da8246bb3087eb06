"""Errors of the real corners of a contour."""

from __future__ import annotations

from typing import TypedDict

import numpy as np

from edmsim.geometry import Polyline
from edmsim.metrology.profile import ProfileError
from edmsim.program.path import WireContour

CORNER_REACH_MM = 0.15
"""Arc length on both sides of a corner over which its error is taken."""


class CornerError(TypedDict):
    """A real corner of the edge as drawn and what became of it."""

    x_mm: float
    y_mm: float
    turn_deg: float
    error_um: float


def corners(contour: WireContour, profile: ProfileError, min_turn_deg: float = 15.0) -> list[CornerError]:
    """List the real corners of the nominal edge with their errors.

    Parameters
    ----------
    contour : WireContour
    profile : ProfileError
        Of that contour.
    min_turn_deg : float
        Vertices that turn by less are chords of an arc.

    Returns
    -------
    list of dict
        ``x_mm``, ``y_mm``, ``turn_deg`` (left positive) and ``error_um``: the error, averaged over the
        height, of largest magnitude within 0.15 mm of the corner; NaN where none was measured.
    """
    line = Polyline(contour.nominal_mm, contour.closed)
    found: list[CornerError] = []
    for vertex in line.corners(min_turn_deg):
        near = profile.mean_um[line.distance_along(profile.s_mm, line.s[[vertex]]) <= CORNER_REACH_MM]
        near = near[np.isfinite(near)]
        error = float(near[np.abs(near).argmax()]) if len(near) else float("nan")
        x, y = (float(value) for value in line.points[vertex])
        found.append(CornerError(x_mm=x, y_mm=y, turn_deg=float(line.turn_deg[vertex]), error_um=error))
    return found
