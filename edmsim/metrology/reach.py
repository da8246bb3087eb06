"""The profile error without what no wire of this radius and gap can do better, and where the largest one lies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.geometry import Polyline
from edmsim.metrology.profile import CORNER_REACH_MM, EDGE_CORNER_DEG, ProfileError, wire_line
from edmsim.metrology.shares import SHARES
from edmsim.program.offset import REACH_TOLERANCE_MM
from edmsim.program.path import WireContour

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class WorstPlace:
    """Place of a largest error on the table; positive is metal left."""

    x_mm: float
    y_mm: float
    error_um: float
    why: str  # start mark, out of reach (the round wire leaves most of it), inner corner, outer corner or edge
    made_by: str | None  # name of the error's largest share (`shares.SHARES`); None if they are unknown


def unreachable_um(profile: ProfileError, contour: WireContour) -> Floats:
    """Return the metal (n,) that a wire exactly on its path leaves at every point of the edge; rounding is 0."""
    path = shapely.LineString(wire_line(contour).points)
    left_um = shapely.distance(path, shapely.points(profile.points_mm)) * 1e3 - contour.offset_um
    return np.where(left_um > REACH_TOLERANCE_MM * 1e3, left_um, 0.0)


def mean_error_um(
    contours: Sequence[WireContour], profiles: Sequence[ProfileError], unreachable: Sequence[Floats]
) -> float:
    """Return the mean error in um of walls, without corners, start marks and places out of reach.

    The offset was too large by this error. Uncompensated contours do not count; NaN if nothing was measured.
    """
    known = []
    for contour, profile, left_um in zip(contours, profiles, unreachable, strict=True):
        if not contour.compensated:
            continue
        line = Polyline(contour.nominal_mm, contour.closed)
        corner = line.distance_along(profile.s_mm, line.s[line.corners(EDGE_CORNER_DEG)]) <= CORNER_REACH_MM
        error = profile.error_um[:, ~corner & ~profile.at_lead_in & (left_um == 0)]
        known.append(error[np.isfinite(error)])
    every = np.concatenate([np.zeros(0), *known])
    return float(every.mean()) if len(every) else math.nan


def worst_place(
    contours: Sequence[WireContour], profiles: Sequence[ProfileError], unreachable: Sequence[Floats],
    shares: Sequence[Floats | None], reachable: bool,
) -> WorstPlace | None:
    """Find the place of the largest error over all contours and slices, perhaps without metal out of reach."""
    worst: WorstPlace | None = None
    for contour, profile, left_um, split in zip(contours, profiles, unreachable, shares, strict=True):
        error = profile.error_um - left_um if reachable else profile.error_um
        if not np.isfinite(error).any():
            continue
        row, place = np.unravel_index(np.nanargmax(np.abs(error)), error.shape)
        largest = float(error[row, place])
        if worst is None or abs(largest) > abs(worst.error_um):
            x, y = profile.points_mm[place].tolist()
            out_of_reach = not reachable and left_um[place] > abs(largest) / 2
            why = "out of reach" if out_of_reach else _what_lies_at(contour, profile, int(place))
            known = split is not None and bool(np.isfinite(split[:, place]).all())
            made_by = SHARES[int(np.abs(split[:, place]).argmax())] if split is not None and known else None
            worst = WorstPlace(x, y, largest, why, made_by)
    return worst


def _what_lies_at(contour: WireContour, profile: ProfileError, place: int) -> str:
    if profile.at_lead_in[place]:
        return "start mark"
    line = Polyline(contour.nominal_mm, contour.closed)
    vertices = line.corners(EDGE_CORNER_DEG)
    away = np.array([line.distance_along(profile.s_mm[[place]], line.s[[k]])[0] for k in vertices])
    if not len(away) or away.min() > CORNER_REACH_MM:
        return "edge"
    left_turn = line.turn_deg[vertices[away.argmin()]] > 0
    return "outer corner" if left_turn == (contour.part_side == "left") else "inner corner"
