"""The wire's path beside an edge: at one distance everywhere, round about the part's outer corners.

About an outer corner the wire swings on an arc round the corner's point, so that it never leaves the edge by
more than the offset (the rounding joint of wire-EDM controls; an extended, mitred corner would not). In an
inner corner it goes to the point that is the offset away from both sides, and leaves the fillet every round
wire leaves.
"""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.program.crossing import chords_of
from edmsim.program.outline import Side, signed_area

QUAD_SEGMENTS = 32
"""Chords per quarter circle about corners: 0.05 um of chord error at an offset of 0.155 mm."""

SIMPLIFY_MM = 0.00025
"""Points are dropped where the path moves by less than this many mm (ours: below the whole um to follow)."""

REACH_TOLERANCE_MM = 0.002
"""An edge counts as cut where the wire path comes this close (mm) to the offset from it (ours)."""

_ON_RING_MM = 1e-6


def offset_closed(
    edge: NDArray[np.float64], side: Side, distance_mm: float
) -> NDArray[np.float64]:
    """Return the closed path beside a closed edge.

    Parameters
    ----------
    edge : float64 array (n, 2)
        In mm, first and last point equal, without self-crossings.
    side : {"left", "right"}
        Side of the edge, looking along it.
    distance_mm : float
        Offset, 0 or more.

    Returns
    -------
    float64 array (m, 2)
        In the edge's direction, from beside the edge's start, first and last point equal.

    Raises
    ------
    InputError
        The path vanishes or falls apart.
    """
    if distance_mm == 0:
        return edge.copy()
    counter_clockwise = signed_area(edge) > 0
    inward = counter_clockwise == (side == "left")
    grown = shapely.Polygon(edge).buffer(-distance_mm if inward else distance_mm, quad_segs=QUAD_SEGMENTS)
    if grown.is_empty:
        raise InputError(too_narrow(distance_mm, "no path is left"))
    pieces = _pieces(grown)
    if pieces:
        spot = min(pieces, key=lambda piece: piece.area).representative_point()
        what = f"the path falls into pieces, one about X{spot.x:.3f} Y{spot.y:.3f}"
        raise InputError(too_narrow(distance_mm, what))
    ring = shapely.get_coordinates(grown)
    if (signed_area(ring) > 0) != counter_clockwise:
        ring = ring[::-1]
    return _simplified(_turned_to(ring, _beside_start(edge, side, distance_mm), edge[0]))


def offset_open(edge: NDArray[np.float64], side: Side, distance_mm: float) -> NDArray[np.float64]:
    """Return the path beside an open edge (n, 2) in mm, in its direction; errors as in `offset_closed`."""
    if distance_mm == 0:
        return edge.copy()
    signed = distance_mm if side == "left" else -distance_mm
    curve = shapely.LineString(edge).offset_curve(signed, quad_segs=QUAD_SEGMENTS, join_style="round")
    if curve.is_empty or not isinstance(curve, shapely.LineString):
        raise InputError(too_narrow(distance_mm, "the path vanishes or falls into pieces"))
    return _simplified(shapely.get_coordinates(curve))


def nearest_chords(edge: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return for each point (k, 2) the index of the nearest chord of `edge` (n, 2), the last of equals."""
    of_point, chord = shapely.STRtree(chords_of(edge)).query_nearest(shapely.points(points))
    nearest = np.zeros(len(points), np.intp)
    np.maximum.at(nearest, of_point, chord)
    return nearest


def normal(chord: NDArray[np.float64], side: Side) -> NDArray[np.float64]:
    """Return the unit vector (2,) to the given side of a chord (2, 2)."""
    dx, dy = chord[1] - chord[0]
    left: NDArray[np.float64] = np.array([-dy, dx]) / np.hypot(dx, dy)
    return left if side == "left" else -left


def too_narrow(distance_mm: float, what: str) -> str:
    """Say of a contour that the wire does not fit it, and what to do."""
    remedy = "take a thinner wire or a smaller offset"
    return f"the contour is too narrow for an offset of {distance_mm:.4f} mm: {what}; {remedy}"


def _pieces(grown: shapely.Polygon | shapely.MultiPolygon) -> list[shapely.Polygon]:
    """Return the polygons an offset contour has fallen into, or its pockets; none if it is one ring."""
    if isinstance(grown, shapely.MultiPolygon):
        return list(grown.geoms)
    return [shapely.Polygon(ring) for ring in grown.interiors]


def _beside_start(edge: NDArray[np.float64], side: Side, distance_mm: float) -> NDArray[np.float64]:
    return np.asarray(edge[0] + distance_mm * normal(edge[:2], side))


def _turned_to(
    ring: NDArray[np.float64], wanted: NDArray[np.float64], corner: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Let a ring begin at the wanted point if it passes there, else (inner corner) nearest to the corner."""
    line = shapely.LineString(ring)
    on_ring = line.distance(shapely.Point(wanted)) < _ON_RING_MM
    at = line.project(shapely.Point(wanted if on_ring else corner))
    start = shapely.get_coordinates(line.interpolate(at))
    passed = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(ring, axis=0).T))])
    after = ring[:-1][passed[:-1] > at]
    before = ring[:-1][passed[:-1] < at]
    return np.concatenate([start, after, before, start])


def _simplified(path: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(shapely.get_coordinates(shapely.LineString(path).simplify(SIMPLIFY_MM)), np.float64)
