"""Offset of an edge to the wire's path: the same distance everywhere, with arcs round the part's outer corners.

At an outer corner the wire moves on an arc about the corner, so its distance from the edge never exceeds the offset
(the rounding joint of wire-EDM controls; at a mitred corner it would). Planned trims go straight past the corner
instead, as CAM plans them if a corner is to stay sharp: on the arc, the wire remains next to one point of the part,
where almost no metal is left, and rounds it. In an inner corner the wire goes to the point at the offset from both
sides, and leaves the fillet of a round wire. Places that a wire of some radius and gap cannot cut are found, too:
inner corners, small radii, grooves.
"""

import math
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError, located
from edmsim.geometry import Floats, arc_lengths
from edmsim.program.outline import Outline, Side, chords_of, signed_area
from edmsim.program.taper import GuideHeights, Ruled, left_normals, turned_walls, wall_and_wire

QUAD_SEGMENTS = 32  # chords per quarter circle about corners: 0.05 um of chord error at an offset of 0.155 mm
SIMPLIFY_MM = 0.00025  # points are dropped if this moves the path by less (ours: below the later rounding to um)
REACH_TOLERANCE_MM = 0.002  # an edge counts as cut if the path is no further from it than offset and this (ours)
_ON_RING_MM = 1e-6
_MOST_MITRE = 1e3
"""Greatest length of a mitred tip, in offsets, before it is cut off (ours: no corner is sharper)."""


def offset_edge(edge: Floats, side: Side, distance_mm: float, closed: bool, past_mm: float | None = None) -> Floats:
    """Return the path along an edge (n, 2) in mm, in its direction; a closed path begins next to the edge's start."""
    # at outer corners it goes straight past, at most `past_mm` away; by default round the corner on an arc
    if distance_mm == 0:
        return edge.copy()
    path = (_ring if closed else _line)(edge, side, distance_mm, past_mm)
    if past_mm is not None:
        blunt = _blunted(path, edge, past_mm, closed=closed)
        if blunt is None or not _keeps(shapely.LineString(blunt), shapely.LineString(edge), distance_mm):
            return offset_edge(edge, side, distance_mm, closed)
        path = blunt
    if closed:
        path = _turned_to(path, edge[0] + distance_mm * normal(edge[:2], side), edge[0])
    return np.asarray(shapely.get_coordinates(shapely.LineString(path).simplify(SIMPLIFY_MM)), np.float64)


def _ring(edge: Floats, side: Side, distance_mm: float, past_mm: float | None) -> Floats:
    """Return the path along a closed edge; the path may begin anywhere."""
    counter_clockwise = signed_area(edge) > 0
    inward = counter_clockwise == (side == "left")
    grown = shapely.Polygon(edge).buffer(
        -distance_mm if inward else distance_mm, quad_segs=QUAD_SEGMENTS, **_join(past_mm)
    )
    if grown.is_empty:
        raise InputError(too_narrow(distance_mm, "no path is left"))
    # the separate polygons, or the holes; empty if it is a single ring
    pieces = getattr(grown, "geoms", None) or [shapely.Polygon(ring) for ring in grown.interiors]
    if pieces:
        spot = min(pieces, key=lambda piece: piece.area).representative_point()
        what = f"the path falls into pieces, one about X{spot.x:.3f} Y{spot.y:.3f}"
        raise InputError(too_narrow(distance_mm, what))
    ring = shapely.get_coordinates(grown)
    return np.asarray(ring if (signed_area(ring) > 0) == counter_clockwise else ring[::-1], np.float64)


def _line(edge: Floats, side: Side, distance_mm: float, past_mm: float | None) -> Floats:
    """Return the path along an open edge."""
    signed = distance_mm if side == "left" else -distance_mm
    curve = shapely.LineString(edge).offset_curve(signed, quad_segs=QUAD_SEGMENTS, **_join(past_mm))
    if curve.is_empty or not isinstance(curve, shapely.LineString):
        raise InputError(too_narrow(distance_mm, "the path vanishes or falls into pieces"))
    return np.asarray(shapely.get_coordinates(curve), np.float64)


def _join(past_mm: float | None) -> dict[str, Any]:
    return {"join_style": "round"} if past_mm is None else {"join_style": "mitre", "mitre_limit": _MOST_MITRE}


def _keeps(path: shapely.LineString, edge: shapely.LineString, distance_mm: float) -> bool:
    """Return whether a path keeps its distance from an edge and does not cross itself."""
    shapely.prepare(edge)
    return bool(path.is_simple and not shapely.dwithin(edge, path, distance_mm - SIMPLIFY_MM))


def _blunted(path: Floats, edge: Floats, past_mm: float, *, closed: bool) -> Floats | None:
    """Return a mitred path whose tips are cut off by arcs at `past_mm` from the edge's corners."""
    # None if a tip has more than two sides within this distance, because the edge has more corners there
    line = shapely.LineString(edge)
    if closed:  # begin in the middle of a side, so that every corner has two sides
        sides = np.hypot(*np.diff(path, axis=0).T)
        k = int(sides.argmax())
        middle = (path[k] + path[k + 1]) / 2
        path = np.concatenate([[middle], path[k + 1 : -1], path[: k + 1], [middle]])
    away_mm = distances(path, chords_of(edge))
    found = [path[:1]]
    for i in range(1, len(path) - 1):
        tip = path[i]
        if away_mm[i] <= past_mm + SIMPLIFY_MM:
            found.append(path[i : i + 1])
            continue
        corner = shapely.get_coordinates(line.interpolate(line.project(shapely.Point(tip))))[0]
        ends = []
        for neighbour in (path[i - 1], path[i + 1]):
            side = neighbour - tip
            length = float(np.hypot(*side))
            foot = float((corner - tip) @ side) / length
            back = foot - math.sqrt(max(past_mm**2 - (away_mm[i] ** 2 - foot**2), 0.0))
            if back > length:
                return None
            ends.append(tip + side / length * back)
        first, last = (math.atan2(*(end - corner)[::-1]) for end in ends)
        swept = (last - first + math.pi) % (2 * math.pi) - math.pi
        count = max(2, math.ceil(abs(swept) / (math.pi / 2) * QUAD_SEGMENTS))
        angles = first + swept * np.linspace(0.0, 1.0, count + 1)
        found.append(corner + past_mm * np.column_stack([np.cos(angles), np.sin(angles)]))
    return np.concatenate([*found, path[-1:]])


def distances(points: Floats, chords: NDArray[np.object_]) -> Floats:
    """Return the distance of every point (n, 2) from the nearest chord; NaN without chords."""
    if not len(chords):
        return np.full(len(points), np.nan)
    _, found = shapely.STRtree(chords).query_nearest(shapely.points(points), return_distance=True, all_matches=False)
    return np.asarray(found, np.float64)


def nearest_chords(edge: Floats, points: Floats) -> NDArray[np.intp]:
    """Return for each point (k, 2) the index of the nearest chord of `edge` (n, 2), the last if several are."""
    of_point, chord = shapely.STRtree(chords_of(edge)).query_nearest(shapely.points(points))
    nearest = np.zeros(len(points), np.intp)
    np.maximum.at(nearest, of_point, chord)
    return nearest


def normal(chord: Floats, side: Side) -> Floats:
    """Return the unit vector (2,) to one side of a chord (2, 2)."""
    left: Floats = left_normals(chord)[0]
    return left if side == "left" else -left


def too_narrow(distance_mm: float, what: str) -> str:
    """Return the message that a contour is too narrow for the wire, with the remedy."""
    remedy = "take a thinner wire or a smaller offset"
    return f"the contour is too narrow for an offset of {distance_mm:.4f} mm: {what}; {remedy}"


def _turned_to(ring: Floats, target: Floats, corner: Floats) -> Floats:
    """Rotate a ring to begin at `target` if it passes there, otherwise (inner corner) nearest to the corner."""
    line = shapely.LineString(ring)
    on_ring = line.distance(shapely.Point(target)) < _ON_RING_MM
    at = line.project(shapely.Point(target if on_ring else corner))
    start = shapely.get_coordinates(line.interpolate(at))
    passed = arc_lengths(ring)
    after = ring[:-1][passed[:-1] > at]
    before = ring[:-1][passed[:-1] < at]
    return np.concatenate([start, after, before, start])


_MOST_NAMED = 5
_SHARP_DEG = 15.0  # lines that meet at a smaller angle count as tangent (ours)


@dataclass(frozen=True)
class Unreachable:
    """A place of the edge where the wire leaves metal."""

    place_mm: tuple[float, float]  # where most metal is left
    left_mm: float  # its thickness, from the edge to the wire's envelope
    # inner radius as drawn, 0 for a sharp corner; None for a groove or a step narrower than the wire
    radius_mm: float | None
    line: int  # the line of the program, 0 if there is none


def check_reach(
    edge: Floats, path: Floats, distance_mm: float, line_numbers: Sequence[int], elements: Sequence[int],
) -> list[str]:
    """Return notices of what the wire cannot cut: radii and grooves, the worst first, and sharp inner corners."""
    # within one element, line or arc, there are no corners
    found = unreachable(edge, path, distance_mm, line_numbers, elements)
    corners = [place for place in found if place.radius_mm == 0]
    others = [place for place in found if place.radius_mm != 0]
    if others and others[0].left_mm > distance_mm:
        x, y = others[0].place_mm
        reason = f"{others[0].left_mm:.3f} mm of metal would stay at X{x:.3f} Y{y:.3f}"
        raise InputError(too_narrow(distance_mm, reason), line=others[0].line or None)
    notices = [_notice(place, distance_mm) for place in others[:_MOST_NAMED]]
    if len(others) > _MOST_NAMED:
        notices.append(f"{len(others) - _MOST_NAMED} more inner radii or grooves are too small for the wire")
    return notices + _corner_notices(corners, distance_mm)


def _corner_notices(corners: list[Unreachable], distance_mm: float) -> list[str]:
    if not corners:
        return []
    what = "1 sharp inner corner becomes" if len(corners) == 1 else f"{len(corners)} sharp inner corners become"
    return [
        f"{what} an inner radius of {distance_mm:.3f} mm, wire and gap: {'' if len(corners) == 1 else 'up to '}"
        f"{corners[0].left_mm:.3f} mm of metal stays, {_at(corners[0])}"
    ]


def _corners_of_wall(wall: Ruled, wire: Ruled, distance_mm: float) -> list[str]:
    """Return notices of the sharp inner corners of a tapered wall in the program's plane."""
    edge = wall.lower_mm
    moves = np.hypot(*np.diff(edge, axis=0).T) > _ON_RING_MM  # False if the wire turns about a point of the edge
    lines, elements = (np.array(of)[moves].tolist() for of in (wall.line_numbers, wall.elements))
    # the plane cuts a leaning wire in an ellipse
    wide_mm = distance_mm * math.sqrt(1.0 + float(np.square(wall.slope).sum(axis=1).max()))
    found = unreachable(edge[np.append(True, moves)], wire.lower_mm, wide_mm, lines, elements)
    return _corner_notices([place for place in found if place.radius_mm == 0], distance_mm)


def unreachable(
    edge: Floats, path: Floats, distance_mm: float, line_numbers: Sequence[int], elements: Sequence[int],
) -> list[Unreachable]:
    """Return the places of an edge where metal is left, the worst first; parameters as in `check_reach`."""
    if distance_mm == 0:
        return []
    left = distances(edge, chords_of(path)) - distance_mm
    sharp = _sharp(edge, elements)
    found, in_run = [], np.zeros(len(edge), np.bool_)
    for chords in _runs(~_touched(edge, path, distance_mm), edge):
        vertices = np.append(chords, chords[-1] + 1)
        in_run[vertices] = True
        radius_mm = _radius_mm(edge, vertices, sharp)
        # a corner is at its vertex, other places are at the middle of a chord
        spots = edge[vertices[sharp[vertices]]] if radius_mm == 0 else (edge[chords] + edge[chords + 1]) / 2
        stays = np.atleast_1d(shapely.distance(shapely.LineString(path), shapely.points(spots))) - distance_mm
        worst = int(stays.argmax())
        x, y = spots[worst].tolist()
        most = max(float(stays[worst]), float(left[vertices].max()))
        found.append(Unreachable((x, y), most, radius_mm, line_numbers[int(chords[min(worst, len(chords) - 1)])]))
    for vertex in np.flatnonzero(sharp & ~in_run & (left > REACH_TOLERANCE_MM)).tolist():
        x, y = edge[vertex].tolist()
        found.append(Unreachable((x, y), float(left[vertex]), 0.0, line_numbers[vertex]))
    return sorted(found, key=lambda place: -place.left_mm)


def _sharp(edge: Floats, elements: Sequence[int]) -> NDArray[np.bool_]:
    """Return for every point of an edge whether two elements meet there at an angle; False for the last point."""
    steps, marks = np.diff(edge, axis=0) @ (1, 1j), np.asarray(elements)
    turn, meet = np.angle(steps / np.roll(steps, 1)), marks != np.roll(marks, 1)
    half = np.where(meet, 0.0, turn / 2)  # from an arc's chord to its tangent: large if the chords are few
    sharp = meet & (np.abs(turn - np.roll(half, 1) - np.roll(half, -1)) > np.radians(_SHARP_DEG))
    sharp[0] &= bool((edge[0] == edge[-1]).all())
    return np.append(sharp, False)


def _runs(missed: NDArray[np.bool_], edge: Floats) -> list[NDArray[np.intp]]:
    """Return the runs of successive chords that the wire does not touch; they continue past a closed edge's end."""
    numbers = np.flatnonzero(missed)
    if not len(numbers):
        return []
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)
    goes_on = bool((edge[0] == edge[-1]).all()) and len(runs) > 1 and missed[0] and missed[-1]
    return [*runs[1:-1], np.concatenate([runs[-1], runs[0]])] if goes_on else runs


def _radius_mm(edge: Floats, vertices: NDArray[np.intp], sharp: NDArray[np.bool_]) -> float | None:
    """Return a run's inner radius: 0 with one sharp corner, None with several; else of a circle through 3 points."""
    corners = int(sharp[vertices].sum())
    if corners or len(vertices) < 3:
        return 0.0 if corners == 1 else None
    a, b, c = edge[vertices[[0, len(vertices) // 2, -1]]] @ (1, 1j)
    twice_area = abs(((b - a).conjugate() * (c - a)).imag)
    return float(abs(b - a) * abs(c - b) * abs(a - c) / (2 * twice_area)) if twice_area > 0 else None


def _notice(place: Unreachable, distance_mm: float) -> str:
    stays = f"{place.left_mm:.3f} mm of metal stays"
    if place.radius_mm is None:
        return f"the contour is narrower than wire and gap, {2 * distance_mm:.3f} mm, {_at(place)}: {stays}"
    return (f"the inner radius of {place.radius_mm:.3f} mm {_at(place)} is smaller than wire and gap make it, "
            f"{distance_mm:.3f} mm: {stays}")


def _at(place: Unreachable) -> str:
    x, y = place.place_mm
    return f"at X{x:.3f} Y{y:.3f}" + (f" (line {place.line})" if place.line else "")


def _touched(edge: Floats, path: Floats, distance_mm: float) -> NDArray[np.bool_]:
    """Return for each chord whether the wire touches its middle four fifths."""
    steps = np.diff(edge, axis=0)
    middles = shapely.linestrings(np.stack([edge[:-1] + 0.1 * steps, edge[1:] - 0.1 * steps], axis=1))
    line = shapely.LineString(path)
    shapely.prepare(line)
    return np.asarray(shapely.dwithin(line, middles, distance_mm + REACH_TOLERANCE_MM), np.bool_)


_SEPARATION_MM = 0.002


@dataclass(frozen=True)
class OffsetOutline:
    """An outline and the wire's path along it, both in mm in the program's coordinates."""

    # if the outline is tapered, `path` and `nominal` are in the program's plane, `surfaces` are the wall and the
    # wire's surface, and `guides` has the heights at which the wire bends

    outline: Outline
    path: Floats
    nominal: Floats
    offset_mm: float
    surfaces: tuple[Ruled, Ruled] | None = None
    guides: GuideHeights | None = None

    @property
    def edge(self) -> shapely.LineString:
        """The part's edge."""
        return shapely.LineString(self.nominal)

    def at_height(self, height_mm: float) -> Self:
        """Return path and edge at a height above the workpiece's lower face."""
        if self.surfaces is None:
            return self
        wall, wire = self.surfaces
        return replace(self, path=wire.at(height_mm), nominal=wall.at(height_mm), surfaces=None)

    def at_mid_height(self) -> Self:
        """Return path and edge at half the workpiece's height."""
        return self if self.guides is None else self.at_height(0.5 * self.guides.height_mm)


def offset_outline(
    outline: Outline, offset_mm: float, notices: list[str], past_mm: float | None = None
) -> OffsetOutline:
    """Return an outline with its path at an offset; adds notices of places that the wire cannot reach."""
    points = outline.points_mm
    if outline.wire_side is None:
        try:
            edge = offset_edge(points, outline.part_side, offset_mm, outline.closed)
            return OffsetOutline(outline, points, edge, offset_mm)
        except InputError:  # there is no such edge, but the wire can follow the program
            notices.append(f"{outline.name} is cut as written; no edge lies at the offset beside it, so its profile "
                           "is measured from the wire's centre")
            return OffsetOutline(outline, points, points, 0.0)
    with of_outline(outline):
        path = offset_edge(points, outline.wire_side, offset_mm, outline.closed, past_mm)
        notices += check_reach(points, path, offset_mm, outline.line_numbers, outline.elements)
    return OffsetOutline(outline, path, points, offset_mm)


def leaning_outline(
    outline: Outline, offset_mm: float, guides: GuideHeights | None, notices: list[str]
) -> OffsetOutline:
    """Return a tapered outline with the wire's path at an offset; adds notices of its sharp inner corners."""
    with of_outline(outline):
        if guides is None:
            raise InputError("it is tapered, and no movable upper guide is known: edmsim cut takes it from a machine "
                             "whose file has guides.upper_travel_mm")
        wall, wire = wall_and_wire(outline, offset_mm, guides)
    notices += turned_walls(outline)
    if outline.wire_side is not None:
        notices += _corners_of_wall(wall, wire, offset_mm)
    return OffsetOutline(outline, wire.lower_mm, wall.lower_mm, offset_mm, (wall, wire), guides)


def dwells_along(leg: OffsetOutline) -> list[tuple[float, float]]:
    """Return the dwells along an edge: lengths of the path in mm, at mid height if the wire leans, and seconds."""
    own, dwells = len(leg.outline.approach_mm), leg.outline.dwells
    if not any(i >= own for i, _ in dwells):
        return []
    path = leg.at_mid_height().path
    line, passed = shapely.LineString(path), arc_lengths(path)
    return [
        (
            _dwell_mm(leg, line, i - own) if leg.surfaces is None
            else float(passed[leg.surfaces[1].vertices[i - own]]),
            seconds,
        )
        for i, seconds in dwells if i >= own
    ]  # fmt: skip


def _dwell_mm(leg: OffsetOutline, line: shapely.LineString, i: int) -> float:
    """Return the length of path in mm at which the wire passes vertex `i` of the outline."""
    points = leg.outline.points_mm
    if i == 0 or i == len(points) - 1:
        return 0.0 if i == 0 else float(line.length)
    across = np.zeros(2)
    if leg.outline.wire_side is not None:
        across = leg.offset_mm * normal(points[i - 1 : i + 1], leg.outline.wire_side)
    return float(line.project(shapely.Point(points[i] + across)))


def of_outline(outline: Outline) -> AbstractContextManager[None]:
    """Add the outline's name to input errors raised inside and, if they have none, its line."""
    return located(line=outline.line, name=outline.name)


def keep_apart(legs: Sequence[OffsetOutline]) -> None:
    """Refuse compensated contours so near each other that cutting one would cut into the other."""
    shut = [leg for leg in legs if leg.outline.closed and leg.outline.wire_side]
    edges = [leg.edge for leg in shut]
    tree = shapely.STRtree(edges)
    for leg in shut:
        line = shapely.LineString(leg.path)
        for number in sorted(tree.query(line, "dwithin", leg.offset_mm).tolist()):
            other = shut[number]
            if other is leg and leg.guides is not None:  # `wall_and_wire` checks all heights
                continue
            distance = line.distance(edges[number])
            if distance < leg.offset_mm - _SEPARATION_MM:
                pair = f"{leg.outline.name} is too near {other.outline.name.removeprefix('the ')}"
                reason = f"the wire's centre would pass {distance:.3f} mm from it, not {leg.offset_mm:.4f} mm"
                raise InputError(f"{pair}: {reason}; move them apart", line=leg.outline.line)


def away(leg: OffsetOutline) -> Floats:
    """Return the unit vector from the part to the start of the wire path."""
    waste: Side = "right" if leg.outline.part_side == "left" else "left"
    compensated = leg.outline.wire_side is not None
    foot = leg.nominal[0] if compensated else shapely.get_coordinates(
        leg.edge.interpolate(leg.edge.project(shapely.Point(leg.path[0]))))[0]
    across = leg.path[0] - foot
    distance = float(np.hypot(*across))
    return np.asarray(across / distance) if distance > 0 else normal(leg.path[:2], waste)
