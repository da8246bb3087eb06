"""How far cams lead the upper guide away from the lower one, and how far they may."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.axis.elcam.file import NAMES, PLACES
from edmsim.controllers.axis.elcam.module import Elcam
from edmsim.controllers.axis.elcam.table import CamTable
from edmsim.errors import InputError

_STEEPEST_WIRE = 0.1
"""The upper guide may lead by this share of the guides' distance (ours): the gap is computed slice by slice, as if
each were upright, which holds for small angles."""
_PLACES = 1000  # places of its master at which a cam is evaluated, besides its points (ours)


def check_cams(elcam: Elcam, contours_um: Sequence[NDArray[np.int64]], guide_distance_mm: float) -> None:
    """Refuse a cam that leads the upper guide too far on a way: which axis, how far, and how far it may go."""
    points_mm = np.concatenate(contours_um) * 1e-3
    length_mm = sum(float(np.hypot(*np.diff(points, axis=0).T).sum()) for points in contours_um) * 1e-3
    ranges = {0: points_mm[:, 0], 1: points_mm[:, 1], len(PLACES) - 1: np.array([0.0, length_mm])}
    most_mm = _STEEPEST_WIRE * guide_distance_mm
    for table in elcam.tables.values():
        if not table.leads:
            continue
        places = ranges[table.master]
        place_mm, lead_mm = _furthest(table, float(places.min()), float(places.max()))
        if lead_mm > most_mm:
            raise InputError(
                f"the cam of {NAMES[table.axis]} leads the upper guide {lead_mm:.3f} mm away from the lower one, at "
                f"{PLACES[table.master]} {place_mm:.3f} mm; between guides {guide_distance_mm:g} mm apart it may be "
                f"{most_mm:.3f} mm"
            )


def _furthest(table: CamTable, low_mm: float, high_mm: float) -> tuple[float, float]:
    """Return where a master in some range leads its follower furthest away from 0, and how far (mm)."""
    own = table.points[: table.size_master, 0]
    period = own[-1] - own[0]
    first, last = (np.floor((end - own[0]) / period) for end in (low_mm, high_mm))
    passes = np.unique([first, first + 1, last - 1, last])
    corners = (own[None, :] + passes[:, None] * period).ravel()
    corners = corners[(corners > low_mm) & (corners < high_mm)]
    places = np.concatenate([corners, np.linspace(low_mm, high_mm, _PLACES)])
    lead = np.abs([table.follow(place, 0.0) for place in places.tolist()])
    k = int(np.argmax(lead))
    return float(places[k]), float(lead[k])
