"""What surrounds a cut: the wire's path, the blank's own edges and its steps, near which no wall can be measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edmsim.geometry import Polyline
from edmsim.plant.workpiece.kerf_field import KerfField, Stock
from edmsim.program.path import WireContour

Floats = NDArray[np.float64]

BLANK_EDGE_MM = 0.15
"""Nearer than this to the blank's own side or start hole, that edge could be taken for the cut's."""
GRAIN_UM = 12.0
"""Metal (or a hole in it) thinner than this is a loose grain or sliver in the kerf, no wall."""


def wire_line(contour: WireContour) -> Polyline:
    """The wire's path in mm without the lead-in."""
    points = contour.points_um[contour.lead_in_moves :]
    return Polyline(points / 1000, closed=bool((points[0] == points[-1]).all()))


def depth_in_blank(stock: Stock, points_mm: Floats) -> Floats:
    """Distance in mm to the blank's nearest own edge, side or start hole; negative outside the metal."""
    x, y = points_mm.T
    x0, y0, x1, y1 = (side / 1000 for side in stock.rectangle_um)
    depth = np.minimum(np.minimum(x - x0, x1 - x), np.minimum(y - y0, y1 - y))
    for hole_x, hole_y, radius in stock.holes_um:
        depth = np.minimum(depth, np.hypot(x - hole_x / 1000, y - hole_y / 1000) - radius / 1000)
    return np.asarray(depth)


def clear_of_steps(field: KerfField, points_mm: Floats) -> Floats:
    """Distance in mm to where each slice has no metal from the beginning, (n_slices, n); 0 inside it."""
    if field.relief is None:
        return np.full((field.n_slices, len(points_mm)), np.inf)
    return field.relief.clearance_um(points_mm * 1000) / 1000
