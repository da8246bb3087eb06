"""The way from a start hole to a contour: one of our choice, and whether a program's own spares the part."""

import math
from collections.abc import Sequence

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from edmsim.errors import InputError
from edmsim.geometry import Floats

HOLE_CLEARANCE_MM = 0.05  # least distance in mm between a hole of our choice and any edge (ours)

_TOLERANCE_MM = 0.001
_SHARES = (1.0, 0.75, 0.5, 0.35, 0.25, 0.15)
_TURNS_DEG = (0, 15, -15, 30, -30, 45, -45, 60, -60, 75, -75)


def own_lead_in(
    starts: Sequence[Floats], away: Floats, faces: Sequence[BaseGeometry], offset_mm: float, length_mm: float,
    hole_radius_mm: float,
) -> tuple[Floats, list[str]]:
    """Choose a thread point off the contour, on the waste side.

    The contour begins at one of `starts` on each face of the workpiece, on the first away from the part.
    """
    # straight away from the edge at the full length if there is room, else turned by up to 75 degrees, else
    # shorter; the wire keeps the offset from every edge of each face, the hole its radius and a clearance
    start = starts[0]
    for share in _SHARES:
        for turn in _TURNS_DEG:
            cos, sin = math.cos(math.radians(turn)), math.sin(math.radians(turn))
            direction = np.array([cos * away[0] - sin * away[1], sin * away[0] + cos * away[1]])
            thread = start + share * length_mm * direction
            ways = [np.array([thread, begin]) for begin in starts]
            nearest_mm = min(edges.distance(shapely.Point(thread)) for edges in faces)
            if nearest_mm >= hole_radius_mm + HOLE_CLEARANCE_MM and all(
                clears(way, edges, offset_mm) for way, edges in zip(ways, faces, strict=True)
            ):
                short = share * length_mm
                return thread, [] if share == 1 else [f"a lead-in is {short:.3f} mm long, as there is no more room"]
    x, y = start
    raise InputError(f"no room for a start hole of {hole_radius_mm:g} mm radius within {length_mm:g} mm of "
                     f"X{x:.3f} Y{y:.3f}: draw the contour with more waste beside its first point, or cut a G-code "
                     "program with its own way from a start hole to the contour")


def check_approach(approach: Floats, edge: BaseGeometry, offset_mm: float, hole_radius_mm: float) -> None:
    """Check that on the program's own approach (n, 2) in mm neither wire nor start hole cuts into the part."""
    x, y = approach[0]
    if not clears(approach, edge, offset_mm):
        raise InputError(f"the approach from X{x:.3f} Y{y:.3f} cuts into the part: thread the wire on the "
                         "waste side, or exchange G41 and G42")
    distance = edge.distance(shapely.Point(approach[0]))
    if distance < hole_radius_mm - _TOLERANCE_MM:
        raise InputError(f"the thread point X{x:.3f} Y{y:.3f} is {distance:.3f} mm from the part, the hole's "
                         f"radius {hole_radius_mm:g} mm: move the point or take a smaller hole")


def clears(path: Floats, edges: BaseGeometry, offset_mm: float) -> bool:
    """Say whether a path (n, 2) to a contour keeps the offset from the edges; at offset 0, meets none."""
    if offset_mm == 0:
        before = path[-1] + (path[-2] - path[-1]) * 0.01
        return bool(shapely.LineString([*path[:-1], before]).distance(edges) > 0)
    return bool(shapely.LineString(path).distance(edges) >= offset_mm - _TOLERANCE_MM)
