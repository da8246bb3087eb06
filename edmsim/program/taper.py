"""Tapered walls: shape of an outline at every height, and paths of a leaning wire and its two guides.

>>> outline = Outline(square, (0,) * 4, True, "right", "left", np.empty((0, 2)), taper=Taper((3.0,) * 4))
>>> wall, wire = wall_and_wire(outline, 0.164, GuideHeights(-10.0, 30.0, 20.0, 60.0))
>>> lower, upper = wire.at(-10.0), wire.at(30.0)   # at the guides

A wall is a ruled surface: every point of its lower line is joined to one point of its upper line by a straight line,
along which the wire lies. Between two of these lines both ends move linearly, as four axes do.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.geometry import Floats, arc_lengths, left_of
from edmsim.program.arcs import CHORD_TOLERANCE_UM, ROUND_MM
from edmsim.program.outline import Corners, Outline, Taper

Stop = tuple[int, float]  # index of the point at which the wire waits, and seconds
MOST_DEG = 45.0  # limit of angles (ours: wire guides of taper machines end at 30 to 45 degrees)
SHARP_DEG = 1.0  # lines and arcs that meet at less are tangent (ours: rounding of drawings)
_MOST_TURN_DEG = 165.0  # a corner that turns by more has a mitre longer than seven offsets (ours)
GOUGE_MM = 0.01  # the wire may be this much nearer to a wall than its offset (ours: half the error of a rough cut)
_NOTHING_MM = 1e-9
_NEAR_MM = 1e-3  # planes at heights that differ by less are equal (ours)
_STRAIGHT_MM = 1e-4  # tolerance of points on a straight line (ours)
_HEIGHTS = 5  # number of heights, with both faces, at which the wire's path is checked for crossings (ours)


class GuideHeights(NamedTuple):
    """Heights of the guides in mm above the workpiece's lower face, and how the wire bends at them."""

    # lower_mm, upper_mm: heights of the lower guide, below 0, and of the upper one, above `height_mm`, as the
    # control knows them
    lower_mm: float
    upper_mm: float
    height_mm: float  # of the workpiece
    travel_mm: float  # travel of u and v in either direction
    # stiff_mm, radius_mm: distance inside the guides at which a leaning wire bends, and radius of the guides'
    # edges, which moves the bend further inside: see `edmsim.machine.setting.GuideBends`
    stiff_mm: float = 0.0
    radius_mm: float = 0.0

    @property
    def distance_mm(self) -> float:
        """Height of the upper guide over the lower one."""
        return self.upper_mm - self.lower_mm

    def bends_mm(self, slope: Floats) -> Floats:
        """Return the heights (n, 2) at which wires of these slopes (n, 2) bend."""
        rise = np.hypot(*slope.T)
        inwards = self.stiff_mm + self.radius_mm * rise / (1.0 + np.sqrt(1.0 + rise**2))
        return np.stack([self.lower_mm + inwards, self.upper_mm - inwards], axis=1)


@dataclass(frozen=True)
class Ruled:
    """A ruled surface between two lines with equal numbers of points."""

    lower_mm: Floats  # lower_mm, upper_mm: points in the program plane and in the second plane
    upper_mm: Floats
    low_mm: float  # low_mm, high_mm: heights of these planes over the workpiece's lower face; unequal
    high_mm: float
    # elements, line_numbers: for each of the ``n - 1`` chords the line or arc and the program's line it belongs to
    elements: tuple[int, ...]
    line_numbers: tuple[int, ...]
    vertices: tuple[int, ...]  # for each point of the outline, index of its first point here

    @property
    def slope(self) -> Floats:
        """Horizontal travel per height of every ruling, (n, 2)."""
        return np.asarray((self.upper_mm - self.lower_mm) / (self.high_mm - self.low_mm))

    def at(self, height_mm: float) -> Floats:
        """Return the points (n, 2) at a height."""
        return np.asarray(self.lower_mm + self.slope * (height_mm - self.low_mm))

    def moved(self, by_mm: Floats) -> "Ruled":
        """Return the same surface, displaced."""
        return replace(self, lower_mm=self.lower_mm + by_mm, upper_mm=self.upper_mm + by_mm)


def leaning(outlines: tuple[Outline, ...], angle_deg: float, corners: Corners) -> tuple[Outline, ...]:
    """Set angle (positive if the part is smaller above) and corners of outlines that have none."""
    if not (math.isfinite(angle_deg) and abs(angle_deg) < MOST_DEG):
        raise InputError(f"the wall cannot lean by {angle_deg:g} degrees: give less than {MOST_DEG:g} either way")
    found = []
    for outline in outlines:
        taper, towards_left = outline.taper, angle_deg if outline.part_side == "left" else -angle_deg
        if taper is None and angle_deg != 0:
            taper = Taper((towards_left,) * (len(outline.points_mm) - 1), corners=corners)
        elif taper is not None and taper.corners is None:
            taper = replace(taper, corners=corners)
        found.append(replace(outline, taper=taper))
    return tuple(found)


def _of_two_lines(outline: Outline, upper_mm: Floats, low: float, high: float) -> Ruled:
    upper, lower = np.asarray(upper_mm, np.float64), outline.points_mm
    if upper.shape != lower.shape:
        raise InputError(f"the contour below has {len(lower) - 1} elements and the one above {len(upper) - 1}: give "
                         "both equal numbers, in the same order")
    if outline.closed and not np.allclose(upper[0], upper[-1], atol=1e-6):
        raise InputError("the contour below is closed, and the one above is not: close it")
    count = len(lower)
    return Ruled(lower, upper, low, high, _elements(outline), outline.line_numbers, tuple(range(count)))


def _elements(outline: Outline) -> tuple[int, ...]:
    return outline.elements or tuple(range(1, len(outline.points_mm)))


class _Chords(NamedTuple):
    """Chords of an outline: left normals, and distances to their left of the line in the second plane."""

    normals: Floats
    shift_mm: Floats
    elements: NDArray[np.int64]
    offset_mm: float  # offset to their left between wall and wire


def _of_angle(outline: Outline, low: float, high: float, offset_mm: float) -> Ruled:
    """Return the surface of an outline, chord by chord, if its arcs have the same radius at every height."""
    points = outline.points_mm
    shift_mm = (high - low) * _tangents(outline)
    chords = _Chords(left_normals(points), shift_mm, np.array(_elements(outline)), offset_mm)
    cylindrical = _cylinders(outline, chords)
    lower: list[Floats] = []
    upper: list[Floats] = []
    owners: list[int] = []
    vertices: list[int] = []
    count = len(points) - 1
    for i in range(count + 1):
        before, after = _chords_at(i, count, outline.closed)
        above = [points[i] + shift for shift in _shifts(outline, chords, before, after, cylindrical)]
        if outline.closed and i == 0:
            above = above[-1:]  # the first corner is cut at the end
        vertices.append(len(lower))
        owners += [before] * (len(above) - 1) + [after]
        lower += [points[i]] * len(above)
        upper += above
    of_chord = np.array(owners[:-1])
    lines = np.array(outline.line_numbers)
    return Ruled(
        np.array(lower), np.array(upper), low, high, tuple(chords.elements[of_chord].tolist()),
        tuple(lines[of_chord].tolist()), tuple(vertices),
    )


def _tangents(outline: Outline) -> Floats:
    """Return the tangents of the taper angles of an outline's chords; raises `InputError` for invalid angles."""
    assert outline.taper is not None
    assert outline.taper.angle_deg is not None
    angles, count = np.array(outline.taper.angle_deg, np.float64), len(outline.points_mm) - 1
    if len(angles) != count:
        raise InputError(f"there are {len(angles)} angles for {count} elements: give one for each")
    if not (np.isfinite(angles).all() and np.abs(angles).max() < MOST_DEG):
        worst = float(angles[np.abs(angles).argmax()])
        raise InputError(f"the wall cannot lean by {worst:g} degrees: give angles below {MOST_DEG:g} either way")
    return np.asarray(np.tan(np.radians(angles)), np.float64)


def left_normals(points: Floats) -> Floats:
    """Return the unit vectors (n - 1, 2) to the left of the chords of a line; zero for a chord of no length."""
    across = left_of(np.diff(points, axis=0))
    length = np.hypot(*across.T)[:, None]
    return np.asarray(np.divide(across, length, out=np.zeros_like(across), where=length > _NOTHING_MM))


def _chords_at(i: int, count: int, closed: bool) -> tuple[int, int]:
    """Return the chords before and after a point; they are the same at the ends of an open line."""
    return ((i - 1) % count, i % count) if closed else (max(i - 1, 0), min(i, count - 1))


def _shifts(
    outline: Outline, chords: _Chords, before: int, after: int, cylindrical: dict[int, Floats]
) -> list[Floats]:
    """Return the vectors from a vertex to its points in the second plane: one, or several if it becomes an arc."""
    taper, same = outline.taper, chords.elements[before] == chords.elements[after]
    assert taper is not None
    known = [cylindrical[k] for k in chords.elements[[before, after]].tolist() if k in cylindrical]
    if known:
        return known[:1] if same else known
    n1, n2, d1, d2 = (*chords.normals[[before, after]], *chords.shift_mm[[before, after]])
    turn = _turn(n1, n2)
    if abs(turn) < math.radians(SHARP_DEG) and abs(d1 - d2) > _NOTHING_MM:
        return [d1 * n1, d2 * n2]  # the angle changes at a tangent: only the upper end moves
    rounds = taper.corners == "rounded" and not same and abs(turn) >= math.radians(SHARP_DEG)
    if rounds and d1 == d2 and _opens(turn, d1) and _opens(turn, chords.offset_mm or d1):
        return list(d1 * _turned(n1, turn, _chords_of_arc(turn, float(d1))))
    return [mitre(n1, n2, float(d1), float(d2))]


def _turn(n1: Floats, n2: Floats) -> float:
    """Return the angle from one direction to another, left positive."""
    return math.atan2(n1[0] * n2[1] - n1[1] * n2[0], float(n1 @ n2))


def _opens(turn: float, left: float) -> bool:
    """Return whether a parallel line, to the left if `left` is positive, passes a corner on the outside."""
    return turn * left < 0


def _to_left(outline: Outline, offset_mm: float) -> float:
    """Return the offset, positive to the left, from the drawn one of wall and wire to the other."""
    side = outline.part_side if outline.wire_side is None else outline.wire_side
    return offset_mm if side == "left" else -offset_mm


def _chords_of_arc(turn: float, radius_mm: float) -> int:
    """Return how many chords an arc needs."""
    sagitta = min(CHORD_TOLERANCE_UM * 1e-3 / max(abs(radius_mm), 1e-6), 0.5)
    return max(2, math.ceil(abs(turn) / (2 * math.acos(1 - sagitta))))


def _turned(normal: Floats, turn: float, count: int) -> Floats:
    """Return `count` + 1 directions (count + 1, 2), from `normal` on in equal steps through an angle."""
    angles = np.linspace(0.0, turn, count + 1)
    cos, sin = np.cos(angles), np.sin(angles)
    x, y = normal
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=1)


def mitre(n1: Floats, n2: Floats, d1: float, d2: float) -> Floats:
    """Return the vector from a corner to the intersection of lines at two distances to the left of its chords."""
    both, apart = n1 + n2, n1 - n2
    if math.degrees(abs(_turn(n1, n2))) > _MOST_TURN_DEG:
        raise InputError(f"a corner turns by more than {_MOST_TURN_DEG:g} degrees: round it, or cut it without taper")
    found = both * (d1 + d2) / (both @ both)
    gap = math.hypot(*apart)
    if gap > 2 * math.sin(math.radians(SHARP_DEG) / 2):
        found = found + apart * (d1 - d2) / gap**2
    return np.asarray(found)


def _cylinders(outline: Outline, chords: _Chords) -> dict[int, Floats]:
    """Return the displacement of each arc, by element, in the second plane; all arcs keep their radius."""
    found, count = {}, len(chords.elements)
    for element in np.unique(chords.elements).tolist():
        own = np.flatnonzero(chords.elements == element)
        if len(own) < 2 or own[-1] - own[0] != len(own) - 1:
            continue
        ends = []
        for k, neighbour in ((own[0], own[0] - 1), (own[-1], own[-1] + 1)):
            if not outline.closed and not 0 <= neighbour < count:
                ends.append(chords.normals[k])
                continue
            near = chords.normals[neighbour % count]
            if abs(_turn(chords.normals[k], near)) > math.radians(15.0):
                x, y = outline.points_mm[own[0]]
                raise InputError(f"the arc at X{x:.3f} Y{y:.3f} meets its neighbour at a corner and cannot keep its "
                                 "radius: draw it tangent, or let arcs become conical",
                                 line=outline.line_numbers[k] or None)
            ends.append(near)
        swept = sum(_turn(a, b) for a, b in zip(chords.normals[own[:-1]], chords.normals[own[1:]], strict=True))
        if abs(swept) > math.radians(_MOST_TURN_DEG):
            x, y = outline.points_mm[own[0]]
            raise InputError(f"the arc at X{x:.3f} Y{y:.3f} spans {math.degrees(abs(swept)):.0f} degrees and cannot "
                             "keep its radius: let arcs become conical", line=outline.line_numbers[own[0]] or None)
        shift = float(chords.shift_mm[own[0]])
        found[element] = mitre(ends[0], ends[1], shift, shift)
    return found


def offset_surface(wall: Ruled, offset_mm: float) -> Ruled:
    """Return the surface of a wire's centre at an offset to the left of a wall, perpendicular to the wire."""
    # in a horizontal plane a leaning wire is an ellipse, so its centre is offset / cos(angle) away from the wall,
    # with the angle between wall and vertical, across the path
    if offset_mm == 0:
        return wall
    closed = all(np.allclose(line[0], line[-1], atol=1e-6) for line in (wall.lower_mm, wall.upper_mm))
    lines = []
    for points, other in ((wall.lower_mm, wall.upper_mm), (wall.upper_mm, wall.lower_mm)):
        normals = left_normals(points)
        still = ~normals.any(axis=1)
        normals[still] = left_normals(other)[still]
        lines.append(points + _offsets(normals, wall.slope, offset_mm, closed))
    return replace(wall, lower_mm=lines[0], upper_mm=lines[1])


def _offsets(normals: Floats, slope: Floats, offset_mm: float, closed: bool) -> Floats:
    """Return the vectors (n, 2) from the points of a line to a wire's centre at an offset to the left."""
    count = len(normals)
    found = np.empty((count + 1, 2))
    for i in range(count + 1):
        n1, n2 = normals[[*_chords_at(i, count, closed)]]
        d1, d2 = (offset_mm * math.hypot(1.0, float(slope[i] @ n)) for n in (n1, n2))
        found[i] = mitre(n1, n2, d1, d2)
    return found


def refuse_vanished(wall: Ruled, height_mm: float, what: str) -> None:
    """Refuse a surface if one of its chords vanishes, and reverses, at some height of the workpiece."""
    # chords of almost no length in the program's plane, where the wire only turns, are excepted
    low, rise = np.diff(wall.lower_mm, axis=0), np.diff(wall.slope, axis=0)
    at_faces = np.stack([((low + rise * (z - wall.low_mm)) * low).sum(axis=1) for z in (0.0, height_mm)])
    size = np.hypot(*low.T)
    gone = np.flatnonzero((at_faces < -size * 1e-6).any(axis=0) & (size > _STRAIGHT_MM))
    if not len(gone):
        return
    slope = (rise * low).sum(axis=1)
    place = wall.low_mm - size**2 / np.where(slope == 0, 1.0, slope)
    place = np.clip(place, 0.0, height_mm)
    near = np.abs(place[gone] - wall.low_mm)
    k = int(gone[np.flatnonzero(near < near.min() + _NOTHING_MM)[0]])  # all chords of an arc vanish at one height
    x, y = wall.lower_mm[k]
    same = np.flatnonzero(np.array(wall.elements) == wall.elements[k])
    kind = "the arc" if len(same) > 2 else "the line"
    line = wall.line_numbers[k]
    raise InputError(f"{kind} of {what} at X{x:.3f} Y{y:.3f} vanishes at a height of {place[k]:.3f} mm: take a "
                     f"smaller angle, a {'greater radius' if kind == 'the arc' else 'longer line'}, or a lower "
                     "workpiece", line=line or None)


def refuse_crossings(wire: Ruled, height_mm: float) -> None:
    """Refuse a wire whose path crosses itself at some height of the workpiece; the message has the height."""
    for z in np.linspace(0.0, height_mm, _HEIGHTS).tolist():
        points = wire.at(z)
        steps = np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 1e-7])
        if not shapely.LineString(points[steps]).is_simple:
            raise InputError(f"the wire's way crosses itself at a height of {z:.3f} mm: take a smaller angle or "
                             "offset, or draw the contour wider")


def refuse_gouges(wall: Ruled, wire: Ruled, offset_mm: float, height_mm: float) -> None:
    """Refuse a wire that comes too near to the wall at some height of the workpiece."""
    for z in np.linspace(0.0, height_mm, _HEIGHTS).tolist():
        edge, path = shapely.LineString(wall.at(z)), shapely.LineString(wire.at(z))
        shapely.prepare(edge)
        if offset_mm > GOUGE_MM and shapely.dwithin(edge, path, offset_mm - GOUGE_MM):
            into_mm = offset_mm - edge.distance(path)
            raise InputError(f"the wire would cut {into_mm:.3f} mm into the wall at a height of {z:.3f} mm: take a "
                             "smaller angle or offset, or draw the contour wider")


def refuse_out_of_reach(wire: Ruled, guides: GuideHeights) -> None:
    """Refuse a wire that leans further than the travel of the upper guide."""
    bends = guides.bends_mm(wire.slope)
    lead = wire.slope * (bends[:, 1:] - bends[:, :1])
    k, axis = np.unravel_index(int(np.abs(lead).argmax()), lead.shape)
    most = abs(float(lead[k, axis]))
    if most > guides.travel_mm:
        angle = math.degrees(math.atan(math.hypot(*wire.slope[k])))
        least = math.degrees(math.atan(guides.travel_mm / guides.distance_mm))
        raise InputError(f"the wire would lean by {angle:.2f} degrees, and the upper guide go {most:.3f} mm along "
                         f"{'uv'[int(axis)]}: with guides {guides.distance_mm:.2f} mm apart it goes "
                         f"{guides.travel_mm:g} mm, which is {least:.2f} degrees",
                         line=wire.line_numbers[min(int(k), len(wire.line_numbers) - 1)] or None)


@dataclass(frozen=True, eq=False)
class _Piece:
    """A line, an arc or a curve of an outline."""

    points: Floats
    element: int
    line: int
    first: int  # number of its first point along the outline
    tangent: float  # tangent of the angle between wall and vertical, positive to the left
    centre: Floats | None = None  # of an arc
    # radius_mm, swept: of an arc: positive, and the angle from its first point to its last, left positive
    radius_mm: float = 0.0
    swept: float = 0.0

    @cached_property
    def normals(self) -> Floats:
        """Left normals of the chords."""
        return left_normals(self.points)

    @cached_property
    def ends(self) -> tuple[Floats, Floats]:
        """Left normals at the first and the last point."""
        if self.centre is None:
            return self.normals[0], self.normals[-1]
        inward = -math.copysign(1.0 / self.radius_mm, self.swept)
        return inward * (self.points[0] - self.centre), inward * (self.points[-1] - self.centre)

    def radius_at(self, left_mm: float) -> float:
        """Return the radius of the parallel arc at a distance to the left; negative if it has vanished."""
        return self.radius_mm - (left_mm if self.swept > 0 else -left_mm)


def _pieces(outline: Outline) -> list[_Piece]:
    marks, tangents = np.array(_elements(outline)), _tangents(outline)
    firsts = np.concatenate([[0], np.flatnonzero((np.diff(marks) != 0) | (np.diff(tangents) != 0)) + 1, [len(marks)]])
    found = []
    for a, b in pairwise(firsts.tolist()):
        piece = _Piece(outline.points_mm[a : b + 1], int(marks[a]), outline.line_numbers[a], a, float(tangents[a]))
        circle = _circle(piece.points) if b - a > 1 else None
        if circle is not None:
            piece = replace(piece, centre=circle[0], radius_mm=circle[1], swept=circle[2])
        elif b - a > 1 and is_straight(piece.points, _STRAIGHT_MM):
            piece = replace(piece, points=piece.points[[0, -1]])
        found.append(piece)
    return found


def _refuse_steps(outline: Outline, reach_mm: float) -> None:
    """Refuse a change of angle where two lines or arcs are tangent, because it makes a step between their walls."""
    for one, other, turns in _changes(outline, GOUGE_MM / reach_mm):
        if not turns and abs(_turn(one.ends[1], other.ends[0])) < math.radians(SHARP_DEG):
            reason = f"the taper changes {_from_to(one, other)}, where two lines or arcs are tangent"
            raise InputError(f"{reason}, and the wire cannot cut the step between their walls: change it at a corner",
                             line=other.line or None)


def _changes(outline: Outline, least: float) -> list[tuple[_Piece, _Piece, bool]]:
    """Return neighbours whose walls have different angles, and whether an arc turns the wall next to it."""
    # tangents of the angles differ by more than `least`; an arc that keeps its radius displaces the end of the line
    # next to it by as much as its own
    if np.ptp(_tangents(outline)) <= least:
        return []
    assert outline.taper is not None
    pieces, keeps = _pieces(outline), outline.taper.corners in ("cylindrical", "rounded")
    return [
        (one, other, keeps and (one.centre is None) != (other.centre is None))
        for one, other in pairwise([pieces[-1], *pieces] if outline.closed else pieces)
        if abs(other.tangent - one.tangent) > least
    ]


def _from_to(one: _Piece, other: _Piece) -> str:
    x, y = other.points[0]
    first, second = (math.degrees(math.atan(piece.tangent)) for piece in (one, other))
    return f"from {first:g} to {second:g} degrees at X{x:.3f} Y{y:.3f}"


def turned_walls(outline: Outline) -> list[str]:
    """Return notices of arcs that keep their radius and turn the wall next to them from one angle to another."""
    if outline.taper is None or outline.taper.upper_mm is not None:
        return []
    return [
        f"line {other.line}: the taper changes {_from_to(one, other)}, beside an arc that keeps its radius: the wall "
        "there turns from the one angle to the other"
        for one, other, turns in _changes(outline, 0.0) if turns
    ]  # fmt: skip


def _circle(points: Floats) -> tuple[Floats, float, float] | None:
    """Return centre, radius and swept angle of an arc's points; None if they are not on an arc."""
    system = np.column_stack([points, np.ones(len(points))])
    middle = points.mean(axis=0)
    solved, *_ = np.linalg.lstsq(system - [*middle, 0.0], ((points - middle) ** 2).sum(axis=1), rcond=None)
    centre = solved[:2] / 2
    radius = math.sqrt(max(float(solved[2] + centre @ centre), 0.0))
    off = points - (centre + middle)
    is_round = 0 < radius < 1e5 and np.abs(np.hypot(*off.T) - radius).max() <= ROUND_MM
    if not is_round or is_straight(points, _STRAIGHT_MM):
        return None
    angles = np.unwrap(np.arctan2(off[:, 1], off[:, 0]))
    steps = np.diff(angles)
    far = radius * (1 - math.cos(np.abs(steps).max() / 2)) > ROUND_MM  # chords of a corner, not of an arc
    if far or not ((steps > 0).all() or (steps < 0).all()):
        return None
    return centre + middle, radius, float(angles[-1] - angles[0])


def is_straight(points: Floats, within_mm: float) -> bool:
    """Return whether points (n, 2) are on the line from the first to the last."""
    along = points - points[0]
    x, y = along[-1]
    return bool(np.abs(along @ (-y, x)).max() < within_mm * math.hypot(x, y))


class _Joint(NamedTuple):
    """Junction of two pieces: change of direction, and number of chords of a rounded corner, 0 if it is not round."""

    turn: float
    chords: int


def _meeting(one: _Piece, other: _Piece, left: tuple[float, float]) -> Floats:
    """Return the intersection of the lines parallel to two pieces at a corner, at distances `left` to their left."""
    vertex, n1, n2 = other.points[0], one.ends[1], other.ends[0]
    corner = vertex + mitre(n1, n2, *left)
    circles = [(p.centre, p.radius_at(d)) for p, d in zip((one, other), left, strict=True) if p.centre is not None]
    if not circles or min(radius for _, radius in circles) <= 0:
        return np.asarray(corner)
    if len(circles) == 2:
        found = _circles_meet(*circles[0], *circles[1])
    else:
        normal, shift = (n2, left[1]) if one.centre is not None else (n1, left[0])
        found = _line_meets(vertex + shift * normal, np.array([normal[1], -normal[0]]), *circles[0])
    return min(found, key=lambda place: math.hypot(*(place - vertex))) if found else np.asarray(corner)


def _line_meets(point: Floats, along: Floats, centre: Floats, radius_mm: float) -> list[Floats]:
    foot = point + ((centre - point) @ along) * along
    half2 = radius_mm**2 - float((foot - centre) @ (foot - centre))
    return [foot + sign * math.sqrt(half2) * along for sign in (-1.0, 1.0)] if half2 >= 0 else []


def _circles_meet(c1: Floats, r1: float, c2: Floats, r2: float) -> list[Floats]:
    apart = c2 - c1
    distance = math.hypot(*apart)
    if distance < _NOTHING_MM:
        return []
    along = apart / distance
    foot = (distance**2 + r1**2 - r2**2) / (2 * distance)
    return _line_meets(c1 + foot * along, np.array([-along[1], along[0]]), c1, r1)


def _offset_line(
    pieces: list[_Piece], joints: list[_Joint], chords: list[int], left: list[float], closed: bool
) -> Floats:
    """Return the points of the line parallel to all pieces, with a distance to the left for each."""
    count = len(pieces)
    begins, ends, rounded = [], [], []
    for k in range(count + 1):
        open_end = not closed and k in (0, count)
        one, other = pieces[k - 1], pieces[k % count]
        d1, d2 = left[k - 1], left[k % count]
        vertex, n1, n2 = other.points[0], one.ends[1], other.ends[0]
        joint = _Joint(0.0, 0) if open_end else joints[k % count]
        meets = abs(joint.turn) >= math.radians(SHARP_DEG)
        if open_end or joint.chords or not (meets or abs(d1 - d2) < _NOTHING_MM):
            first, last = (one.points[-1] if open_end else vertex) + d1 * n1, vertex + d2 * n2
        else:
            first = last = _meeting(one, other, (d1, d2)) if meets else vertex + mitre(n1, n2, d1, d2)
        begins.append(last)
        ends.append(first)
        rounded.append(
            vertex + d1 * _turned(n1, joint.turn, joint.chords)[1:-1] if joint.chords else np.empty((0, 2))
        )
    line = []
    for k, piece in enumerate(pieces):
        line += [_inside(piece, left[k], begins[k], ends[k + 1], chords[k]), rounded[k + 1]]
    if len(rounded[-1]):  # the first corner is a cone, so the line is closed here
        line.append(line[0][:1])
    return np.concatenate(line)


def _inside(piece: _Piece, left_mm: float, begin: Floats, end: Floats, chords: int) -> Floats:
    """Return the points of the line parallel to a piece, from `begin` to `end`."""
    if piece.centre is None:
        inner = [
            vertex + mitre(n1, n2, left_mm, left_mm)
            for vertex, (n1, n2) in zip(piece.points[1:-1], pairwise(piece.normals), strict=True)
        ]
        return np.array([begin, *inner, end])
    radius, off = piece.radius_at(left_mm), piece.points[[0, -1]] - piece.centre
    drawn = np.arctan2(off[:, 1], off[:, 0])
    swept = piece.swept
    if radius > 0:
        found = np.array([begin, end]) - piece.centre
        more = (np.arctan2(found[:, 1], found[:, 0]) - drawn + math.pi) % (2 * math.pi) - math.pi
        drawn, swept = drawn + more, swept + float(more[1] - more[0])
    angles = drawn[0] + np.linspace(0.0, swept, chords + 1)
    line = piece.centre + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    if radius > 0:
        line[0], line[-1] = begin, end
    return np.asarray(line)


def _joints(pieces: list[_Piece], left: Floats, conical: bool) -> list[_Joint]:
    """Return the joint before every piece; `left` (lines, pieces) has the distances of all parallel lines."""
    found = []
    for k, piece in enumerate(pieces):
        turn, d = _turn(pieces[k - 1].ends[1], piece.ends[0]), left[:, k]
        rounds = (
            conical and abs(turn) >= math.radians(SHARP_DEG)
            and (d == left[:, k - 1]).all() and d.any() and (turn * d <= 0).all()
        )  # fmt: skip
        found.append(_Joint(turn, _chords_of_arc(turn, float(np.abs(d).max())) if rounds else 0))
    return found


def _of_pieces(outline: Outline, low: float, high: float, offset_mm: float) -> tuple[Ruled, Ruled]:
    """Return wall and wire of an outline whose arcs become cones."""
    pieces = _pieces(outline)
    tangents = np.array([piece.tangent for piece in pieces])
    lean, off = (high - low) * tangents, _to_left(outline, offset_mm) * np.hypot(1.0, tangents)
    left = np.stack([0.0 * lean, lean, off, lean + off])
    joints = _joints(pieces, left, outline.taper is not None and outline.taper.corners == "conical")
    chords = [
        len(piece.points) - 1 if piece.centre is None
        else max(len(piece.points) - 1, _chords_of_arc(piece.swept, max(map(piece.radius_at, left[:, k].tolist()))))
        for k, piece in enumerate(pieces)
    ]
    lines = [_offset_line(pieces, joints, chords, row, outline.closed) for row in left.tolist()]
    elements: list[int] = []
    numbers: list[int] = []
    vertices: list[int] = []
    most = max(piece.element for piece in pieces)  # corners that become cones are elements of their own
    for k, piece in enumerate(pieces):
        at = len(elements)
        following = joints[(k + 1) % len(pieces)] if outline.closed or k + 1 < len(pieces) else _Joint(0.0, 0)
        after = max(following.chords, 1)  # chords that join this piece to the next
        drawn = (pieces[k + 1].first if k + 1 < len(pieces) else len(outline.points_mm) - 1) - piece.first
        vertices += [at + round(i * chords[k] / drawn) for i in range(drawn)]
        corner = most + k + 1 if following.chords else piece.element
        elements += [piece.element] * chords[k] + [corner] * after
        numbers += [piece.line] * (chords[k] + after)
    last = len(lines[0]) - 1
    ruled = [
        Ruled(a, b, low, high, tuple(elements[:last]), tuple(numbers[:last]), (*vertices, last))
        for a, b in (lines[:2], lines[2:])
    ]
    wall, wire = ruled if outline.wire_side is not None else ruled[::-1]
    return wall, wire


def wall_and_wire(outline: Outline, offset_mm: float, guides: GuideHeights) -> tuple[Ruled, Ruled]:
    """Return wall and wire of a tapered outline; raises `InputError` if the wire cannot cut it."""
    taper = outline.taper
    assert taper is not None
    assert taper.corners is not None
    low, high = taper.program_plane_mm, taper.second_plane_mm
    if high is None:  # with an angle, any plane but the program's can be used
        is_upper_face = taper.upper_mm is None and abs(guides.height_mm - low) <= _NEAR_MM
        high = 0.0 if is_upper_face else guides.height_mm
    if 0 < low < guides.height_mm:  # a corner that opens above closes below: the tip of a cone would be in the wall
        stays: dict[Corners, Corners] = {"conical": "sharp", "rounded": "cylindrical"}
        taper = replace(taper, corners=stays.get(taper.corners, taper.corners))
        outline = replace(outline, taper=taper)
    if not (math.isfinite(low) and math.isfinite(high) and abs(high - low) > _NEAR_MM):
        raise InputError(f"program plane and second plane lie at {low:g} and {high:g} mm: give two different heights")
    if taper.upper_mm is None and offset_mm > 0:
        _refuse_steps(outline, max(abs(low), abs(guides.height_mm - low)))
    if taper.upper_mm is None and taper.corners in ("sharp", "conical"):
        wall, wire = _of_pieces(outline, low, high, offset_mm)
    else:
        upper_mm = taper.upper_mm
        left_mm = _to_left(outline, offset_mm)
        drawn = (
            _of_angle(outline, low, high, left_mm) if upper_mm is None
            else _of_two_lines(outline, upper_mm, low, high)
        )  # fmt: skip
        wall, wire = drawn, offset_surface(drawn, left_mm)
        if outline.wire_side is None:
            wall, wire = wire, wall
    refuse_vanished(wall, guides.height_mm, "the wall")
    refuse_vanished(wire, guides.height_mm, "the wire's way")
    refuse_crossings(wire, guides.height_mm)
    refuse_gouges(wall, wire, offset_mm, guides.height_mm)
    refuse_out_of_reach(wire, guides)
    return _without_standstill(wall, wire)


def _without_standstill(wall: Ruled, wire: Ruled) -> tuple[Ruled, Ruled]:
    """Remove points at which nothing moves; the surfaces correspond point by point."""
    steps = [np.hypot(*np.diff(line, axis=0).T) for of in (wall, wire) for line in (of.lower_mm, of.upper_mm)]
    chosen = np.concatenate([[True], np.max(steps, axis=0) > _NOTHING_MM])
    place, chords = np.cumsum(chosen) - 1, chosen[1:]
    wall, wire = (
        replace(
            of, lower_mm=of.lower_mm[chosen], upper_mm=of.upper_mm[chosen],
            elements=tuple(np.array(of.elements)[chords].tolist()),
            line_numbers=tuple(np.array(of.line_numbers)[chords].tolist()),
            vertices=tuple(place[list(of.vertices)].tolist()),
        )
        for of in (wall, wire)
    )
    return wall, wire


# The path of a wire that may lean: positions of its guides, its position at every height, and its length.


@dataclass(frozen=True, eq=False)
class Lean:
    """Inclination of the wire along a path."""

    # (n, 2): for each point of the path the upper guide's position relative to the lower one: axes u and v
    upper_um: NDArray[np.int64]
    # (n, 2): for each point the heights over the workpiece's lower face at which the wire bends, at lower and
    # upper guide
    bends_mm: Floats
    wall: Ruled  # the part's wall as drawn, in mm on the table
    height_mm: float  # of the workpiece

    def shares(self, height_mm: float) -> Floats:
        """Return the wire's displacement at a height as a share (n, 1) of the upper guide's."""
        lower, upper = self.bends_mm.T
        return np.asarray(((height_mm - lower) / (upper - lower))[:, None])

    def moved(self, by_mm: Floats) -> "Lean":
        """Return the same, displaced on the table."""
        return replace(self, wall=self.wall.moved(by_mm))


class WirePath(NamedTuple):
    """The lower guide's path, (n, 2) in whole um, and the wire's inclination; None if it is vertical."""

    points_um: NDArray[np.int64]
    lean: Lean | None = None

    def at_height(self, height_mm: float) -> NDArray[np.int64]:
        """Return the wire's path at a height, in whole um."""
        if self.lean is None:
            return self.points_um
        led = np.round(self.lean.upper_um * self.lean.shares(height_mm)).astype(np.int64)
        return np.asarray(self.points_um + led)

    def at_mid_height(self) -> NDArray[np.int64]:
        """Return the wire's path at half the workpiece's height."""
        return self.points_um if self.lean is None else self.at_height(0.5 * self.lean.height_mm)

    def moving(self, stops: Sequence[Stop]) -> "tuple[WirePath, NDArray[np.bool_], tuple[Stop, ...]]":
        """Return the path without points at which nothing moves, the mask of remaining moves, and the stops."""
        lean = self.lean
        every = self.points_um if lean is None else np.hstack([self.points_um, lean.upper_um])
        moves = (np.diff(every, axis=0) != 0).any(axis=1)
        moving = np.append(True, moves)
        place = np.cumsum(moving) - 1
        lean = lean and replace(lean, upper_um=lean.upper_um[moving], bends_mm=lean.bends_mm[moving])
        return WirePath(self.points_um[moving], lean), moves, tuple((int(place[i]), seconds) for i, seconds in stops)

    @property
    def along_um(self) -> Floats:
        """Length of path (n,) up to every point; for a leaning wire, that of the longer face in each move."""
        if self.lean is None:
            return arc_lengths(self.points_um)
        moves_um = [np.hypot(*np.diff(self.at_height(z), axis=0).T) for z in (0.0, self.lean.height_mm)]
        # a move of the guides alone takes time as well
        moves_um.append(1e-3 * np.hypot(*np.diff(self.lean.upper_um, axis=0).T))
        return np.concatenate([[0.0], np.cumsum(np.max(moves_um, axis=0))])

    @property
    def slant(self) -> Floats:
        """Length of the wall across the path per height of the workpiece, for every move: 1 / cos of its angle."""
        if self.lean is None:
            return np.ones(len(self.points_um) - 1)
        steps = np.diff(self.at_mid_height(), axis=0)
        lower, upper = self.lean.bends_mm.T
        slope = self.lean.upper_um * 1e-3 / (upper - lower)[:, None]
        middle, length = (slope[1:] + slope[:-1]) / 2, np.maximum(np.hypot(*steps.T), 1e-9)
        return np.asarray(np.hypot(1.0, (middle[:, 1] * steps[:, 0] - middle[:, 0] * steps[:, 1]) / length))


def guides_for(
    points_mm: Floats, at_mm: float, slope: Floats, guides: GuideHeights, grid_um: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """Return the guides' positions in whole um, and the bends, for wires through points with these slopes."""
    # points of the lower guide, whole multiples of `grid_um`, and of the upper one relative to it
    bends = guides.bends_mm(slope)
    lower, upper = (points_mm + slope * (z - at_mm)[:, None] for z in bends.T)
    points = np.round(lower * 1000 / grid_um).astype(np.int64) * grid_um
    return points, np.round((upper - lower) * 1000).astype(np.int64), bends
