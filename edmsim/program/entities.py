"""Conversion of a drawing's entities to lines and arcs, and of curves to chords within the tolerance.

Polylines are LWPOLYLINE, and POLYLINE in two dimensions or at one height. Splines may be closed, or periodic with
knots beyond their ends.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any, Self

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.geometry import Floats, arc_lengths
from edmsim.program.arcs import CHORD_TOLERANCE_UM, arc_points, by_element
from edmsim.program.limits import FARTHEST_MM, check_count, check_points
from edmsim.program.outline import JOIN_TOLERANCE_MM

# Chains: successive lines and arcs of a drawing, joined into closed contours; duplicates.

SAME_MM = 1e-6  # points closer than this many mm are one (ours: rounding errors)


@dataclass(frozen=True)
class Chain:
    """Points of one entity, or of several joined."""

    points: Floats  # (n, 2): in mm, none within `SAME_MM` of the one before
    elements: NDArray[np.int64]  # (n - 1,): which line or arc each of the chords belongs to; neighbours differ
    place: int  # index of its first entity in the drawing

    @classmethod
    def of(cls, pieces: Sequence[Floats], place: int) -> Self:
        """Join lines and arcs that follow each other."""
        points = np.concatenate([pieces[0], *(piece[1:] for piece in pieces[1:])])
        elements = np.repeat(np.arange(len(pieces)), [len(piece) - 1 for piece in pieces])
        return cls(points, elements, place)._without_repeats()

    @classmethod
    def joined(cls, chains: Sequence[Self]) -> Self:
        """Join chains, each of which begins where the previous one ends."""
        counts = np.cumsum([0, *(int(chain.elements.max()) + 1 for chain in chains[:-1])])
        points = np.concatenate([chains[0].points, *(chain.points[1:] for chain in chains[1:])])
        elements = np.concatenate([chain.elements + count for chain, count in zip(chains, counts, strict=True)])
        return cls(points, elements, min(chain.place for chain in chains))._without_repeats()

    def reversed(self) -> Self:
        """Return the chain in the opposite direction."""
        return type(self)(self.points[::-1], self.elements[::-1], self.place)

    def ring(self) -> Self:
        """Return a closed chain with its last point equal to its first."""
        points = np.concatenate([self.points[:-1], self.points[:1]])
        return type(self)(points, self.elements, self.place)._without_repeats()

    @property
    def closed(self) -> bool:
        """Whether its ends are joined."""
        return float(np.hypot(*(self.points[0] - self.points[-1]))) <= JOIN_TOLERANCE_MM

    @property
    def is_short(self) -> bool:
        """Whether the whole chain is within the tolerance that joins ends."""
        return is_short(self.points)

    def parts(self) -> list[tuple[Floats, bool]]:
        """Return the points of its lines and arcs, the ends of each included, and whether each is short."""
        parts = by_element(self.points, self.elements)
        return [(part, math.dist(part[0], part[-1]) <= JOIN_TOLERANCE_MM and is_short(part)) for part in parts]

    def without_short_elements(self) -> Self:
        """Return a ring without lines and arcs within the tolerance, because their ends are one point."""
        # of several in a row, those whose end is further from the last remaining point remain, as straight lines
        parts = self.parts()
        if not any(short for _, short in parts):
            return self
        pieces = [self.points[:1]]
        for part, short in parts:
            if not short or np.hypot(*(part[-1] - pieces[-1][-1])) > JOIN_TOLERANCE_MM:
                pieces.append(np.concatenate([pieces[-1][-1:], part[-1:] if short else part[1:]]))
        return type(self).of(pieces[1:], self.place).ring() if len(pieces) > 1 else self

    def _without_repeats(self) -> Self:
        moves = np.hypot(*np.diff(self.points, axis=0).T) > SAME_MM
        if moves.all():
            return self
        return type(self)(self.points[np.concatenate([[True], moves])], self.elements[moves], self.place)


def is_short(points: Floats) -> bool:
    """Return whether points (n, 2) in mm are within the tolerance of the first or, if closed, of their middle."""
    closes = np.hypot(*(points[0] - points[-1])) <= JOIN_TOLERANCE_MM
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return any(
        np.hypot(*(points - centre).T).max() <= JOIN_TOLERANCE_MM
        for centre in ((points[0], middle) if closes else points[:1])
    )


_NEIGHBOURS = 8
_WIDEST_MM = 3 * JOIN_TOLERANCE_MM  # two ends with something short between them, and the tolerance at either end
_End = tuple[int, int]  # an end of a chain: index of the chain, and 0 or -1


def joined_contours(chains: Sequence[Chain]) -> list[Chain]:
    """Join chains into closed contours, in the order of their first entities."""
    # a chain within the tolerance is removed, because the ends that it meets are one point. Several of these in a
    # row that extend further than the tolerance are a chain like any other
    runs = _runs([chain for chain in chains if chain.is_short])
    whole = [*(chain for chain in chains if not chain.is_short), *(run for run in runs if not run.is_short)]
    loose = sorted((chain for chain in whole if not chain.closed), key=lambda chain: chain.place)
    partner = _partners(loose, [run for run in runs if run.is_short])
    contours = [*(chain for chain in whole if chain.closed), *_followed(loose, partner)]
    return [chain.ring().without_short_elements() for chain in sorted(contours, key=lambda chain: chain.place)]


def _runs(short: list[Chain]) -> list[Chain]:
    """Join short chains with each other, the nearest first."""
    count = 0
    while len(short) not in (0, count):
        count = len(short)
        short = _followed(short, _nearest_partners(short))
    return short


def _nearest_partners(short: Sequence[Chain]) -> dict[_End, _End]:
    """Return pairs of ends that are nearest to each other, except the two ends of one short chain."""
    ends, places = _ends(short)
    still_short = [chain.is_short for chain in short]
    nearest: dict[int, int] = {}
    for k, other in _near(places):
        if ends[k][0] != ends[other][0] or not still_short[ends[k][0]]:
            nearest.setdefault(k, other)
    return {ends[k]: ends[other] for k, other in nearest.items() if nearest.get(other) == k}


def _partners(loose: Sequence[Chain], short: Sequence[Chain]) -> dict[_End, _End]:
    """Return for every end of the loose chains the end that meets it, directly or through short chains."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not loose:
        return {}
    ends, places = _ends([*loose, *short])
    links = [*_near(places), *((k, k + 1) for k in range(2 * len(loose), len(ends), 2))]
    rows, columns = np.array(links, np.intp).reshape(-1, 2).T
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), (len(ends), len(ends)))
    _, labels = connected_components(graph, directed=False)
    meeting: dict[int, list[int]] = {}
    for k, label in enumerate(labels[: 2 * len(loose)].tolist()):
        meeting.setdefault(label, []).append(k)
    for group in meeting.values():
        if len(group) > 2:
            raise InputError(f"{len(group)} ends meet at {spot(places[group[0]])}: a contour must not branch")
    partner: dict[_End, _End] = {}
    open_ends = []
    for group in meeting.values():
        if len(group) == 1 or np.hypot(*(places[group[0]] - places[group[1]])) > _WIDEST_MM:
            open_ends += group
        else:
            first, second = (ends[k] for k in group)
            partner |= {first: second, second: first}
    if open_ends:
        raise InputError(_open_reason(places[open_ends]))
    return partner


def _ends(chains: Sequence[Chain]) -> tuple[list[_End], Floats]:
    ends = [(i, end) for i in range(len(chains)) for end in (0, -1)]
    return ends, np.concatenate([chain.points[[0, -1]] for chain in chains])


def _near(places: Floats) -> list[tuple[int, int]]:
    """Return pairs of points within the tolerance, the nearest first for each; if very many are near, only some."""
    from scipy.spatial import KDTree

    reach_mm = np.nextafter(JOIN_TOLERANCE_MM, 1)
    found = KDTree(places).query(places, k=_NEIGHBOURS, distance_upper_bound=reach_mm)
    distances, others = (np.atleast_2d(values) for values in found)
    own = np.broadcast_to(np.arange(len(places))[:, None], others.shape)
    within = np.isfinite(distances) & (others != own)
    return list(zip(own[within].tolist(), others[within].tolist(), strict=True))


def _open_reason(ends: Floats) -> str:
    from scipy.spatial import KDTree

    distances, nearest = (np.atleast_2d(values) for values in KDTree(ends).query(ends, k=2))
    k = int(np.argmin(distances[:, 1]))
    first, second = sorted(nearest[k].tolist())
    return (f"a contour is open: a gap of {distances[k, 1]:.3f} mm between {spot(ends[first])} and "
            f"{spot(ends[second])}; close it within {JOIN_TOLERANCE_MM} mm")


def _followed(chains: Sequence[Chain], partner: dict[_End, _End]) -> list[Chain]:
    """Join chains whose ends are partners; each result begins with its first chain, or at an open end."""
    left = dict(enumerate(chains))
    found = []
    for first in range(len(chains)):
        if first in left:
            ahead = _walk(left, partner, (first, -1))
            behind = _walk(left, partner, (first, 0))
            pieces = [*(chain.reversed() for chain in reversed(behind)), left.pop(first), *ahead]
            found.append(Chain.joined(pieces))
    return found


def _walk(left: dict[int, Chain], partner: dict[_End, _End], end: _End) -> list[Chain]:
    """Remove from `left` the chains that follow an end, up to an open end or a full turn; return them oriented."""
    first, pieces = end[0], []
    while end in partner:
        number, begin = partner[end]
        if number == first or number not in left:
            break
        chain = left.pop(number)
        pieces.append(chain if begin == 0 else chain.reversed())
        end = (number, -1 - begin)
    return pieces


def spot(point: Floats) -> str:
    """Return a point as text for messages."""
    return f"X{point[0]:.3f} Y{point[1]:.3f} mm"


_CELL_MM = 16 * JOIN_TOLERANCE_MM
_Box = tuple[float, float, float, float]
_LEAST_SHARE = 0.25  # lines apart by a greater share of their extent are two, however short they are (ours)


def without_duplicates(chains: Sequence[Chain]) -> list[Chain]:
    """Return the chains without those that coincide with an earlier one, in either direction."""
    # duplicates have equal bounding boxes, which are looked up in a grid, with adjacent cells
    cells: dict[tuple[int, ...], list[tuple[_Box, Chain]]] = {}
    distinct = []
    for chain in chains:
        box = (*chain.points.min(axis=0).tolist(), *chain.points.max(axis=0).tolist())
        low, high = (
            [math.floor((c + step) / _CELL_MM) for c in box] for step in (-JOIN_TOLERANCE_MM, JOIN_TOLERANCE_MM)
        )
        near = product(*({a, b} for a, b in zip(low, high, strict=True)))
        if not any(_are_same(chain, box, *other) for cell in near for other in cells.get(cell, ())):
            distinct.append(chain)
            cells.setdefault(tuple(math.floor(c / _CELL_MM) for c in box), []).append((box, chain))
    return distinct


def _are_same(one: Chain, box: _Box, other_box: _Box, other: Chain) -> bool:
    """Return whether every point and chord's middle of each chain is on the other, within the tolerance."""
    extent = min(max(x1 - x0, y1 - y0) for x0, y0, x1, y1 in (box, other_box))
    reach = min(JOIN_TOLERANCE_MM, _LEAST_SHARE * extent)
    if any(abs(a - b) > reach for a, b in zip(box, other_box, strict=True)) or one.closed != other.closed:
        return False
    if not one.closed:
        ends = one.points[[0, -1]]
        if min(np.hypot(*(ends - other.points[[a, -1 - a]]).T).max() for a in (0, -1)) > reach:
            return False
    return _lies_on(one.points, other.points, reach) and _lies_on(other.points, one.points, reach)


def _lies_on(points: Floats, line: Floats, reach: float) -> bool:
    spots = np.concatenate([points, (points[1:] + points[:-1]) / 2])
    drawn = shapely.LineString(line)
    shapely.prepare(drawn)
    return bool(shapely.dwithin(drawn, shapely.points(spots), reach).all())


_MOST_HALVINGS = 16
_FEWEST_CHORDS = 16


def spline_points(entity: Any, tolerance: float) -> Floats:
    """Return the points (n, 2) of a SPLINE, in drawing units, as chords within a tolerance."""
    # A periodic spline is drawn between knots[degree] and knots[-degree - 1]. If it has knots for repeated control
    # points but lists them once, the first of them are appended. A spline that is flagged as closed and has only
    # fit points is a periodic cubic through these.
    from scipy.interpolate import BSpline

    if entity.closed and len(entity.fit_points) > 2:
        entity = with_control_points(entity)
    control = np.array([tuple(p)[:2] for p in entity.control_points], np.float64).reshape(-1, 2)
    knots, degree = np.array(entity.knots, np.float64), int(entity.dxf.degree)
    clamped = not len(knots) or (knots[0] == knots[degree] and knots[-1] == knots[-degree - 1])
    usual = clamped and len(knots) in (0, len(control) + degree + 1)
    if len(control) == 0 or usual:
        points = [tuple(p)[:2] for p in entity.flattening(tolerance, segments=_FEWEST_CHORDS)]
        return np.array(points, np.float64).reshape(-1, 2)
    weights = np.array(entity.weights, np.float64) if len(entity.weights) else np.ones(len(control))
    if len(knots) == len(control) + 2 * degree + 1:
        control, weights = np.concatenate([control, control[:degree]]), np.concatenate([weights, weights[:degree]])
    if len(knots) != len(control) + degree + 1 or (np.diff(knots) < 0).any():
        raise InputError(f"a SPLINE has {len(control)} control points and {len(knots)} knots at degree {degree}: "
                         "these make no curve, export it again")
    curve = BSpline(knots, np.column_stack([control * weights[:, None], weights]), degree)
    breaks = np.unique(knots[degree : len(control) + 1])
    return _chords(lambda t: curve(t)[:, :2] / curve(t)[:, 2:], breaks, tolerance)


def with_control_points(entity: Any) -> Any:
    """Return a SPLINE with control points in place of fit points, so that stretching it stretches the curve."""
    from scipy.interpolate import make_interp_spline

    if len(entity.control_points) or not len(entity.fit_points):
        return entity
    found = entity.copy()
    if entity.closed and len(entity.fit_points) > 2:
        points = np.array([tuple(p)[:2] for p in entity.fit_points], np.float64)
        ring = points if np.array_equal(points[0], points[-1]) else np.concatenate([points, points[:1]])
        curve = make_interp_spline(arc_lengths(ring), ring, bc_type="periodic")
        degree, knots, control = 3, curve.t, np.column_stack([curve.c, np.zeros(len(curve.c))])
    else:
        tool = entity.construction_tool()
        degree, knots, control = tool.degree, tool.knots(), tool.control_points
    found.dxf.degree, found.knots, found.control_points, found.fit_points = degree, knots, control, []
    return found


def _chords(curve: Any, breaks: Floats, tolerance: float) -> Floats:
    """Halve the chords between breaks until their middles lie within the tolerance of the curve."""
    t = np.unique(np.linspace(breaks[:-1], breaks[1:], _FEWEST_CHORDS // 4 + 1))
    for _ in range(_MOST_HALVINGS):
        points, middle = curve(t), (t[1:] + t[:-1]) / 2
        far = np.hypot(*(curve(middle) - (points[1:] + points[:-1]) / 2).T) > tolerance
        if not far.any():
            break
        t = np.sort(np.concatenate([t, middle[far]]))
    return np.asarray(curve(t))


_FRAME = 16  # flag of a vertex that controls a spline and is not on it (DXF reference, VERTEX, code 70)
_MESHES = {"AcDbPolygonMesh": "polygon mesh", "AcDbPolyFaceMesh": "polyface mesh"}


def polyline_pieces(entity: Any, unit_mm: float) -> list[Floats]:
    """Return the lines and arcs of a polyline, points (n, 2) in mm each, without those of no length."""
    corners, bulges, closed, height = _vertices(entity, unit_mm)
    check_points(np.column_stack([corners.real, corners.imag]), f"a {entity.dxftype()}",
                 f"; a drawing unit is {unit_mm:g} mm here; or give --unit")
    if closed:
        corners, bulges = np.append(corners, corners[:1]), np.append(bulges, 0.0)
    pieces, count = [], 0
    for (start, end), bulge in zip(pairwise(corners.tolist()), bulges.tolist(), strict=False):
        if abs(end - start) > SAME_MM:
            points = _segment(start, end, bulge)
            count += len(points)
            check_count(count)
            pieces.append(_flat(entity, points, height, unit_mm))
    return pieces


def _vertices(entity: Any, unit_mm: float) -> tuple[NDArray[np.complex128], Floats, bool, float]:
    """Return corners in mm, bulges, whether it is closed, and its height in drawing units."""
    if entity.dxftype() == "LWPOLYLINE":
        values = np.array(entity.get_points("xyb"), np.float64).reshape(-1, 3)
        return _corners(values, unit_mm), values[:, 2], bool(entity.closed), float(entity.dxf.elevation)
    mode = entity.get_mode()
    if mode in _MESHES:
        raise InputError(f"a {_MESHES[mode]} cannot be cut: draw its edge as a polyline")
    drawn = [vertex for vertex in entity.vertices if not vertex.dxf.flags & _FRAME]
    if entity.vertices and not drawn:
        raise InputError("a POLYLINE holds only what controls its spline, no points on it: export it as SPLINE")
    values = np.array([tuple(vertex.dxf.location) for vertex in drawn], np.float64).reshape(-1, 3)
    closed, height = bool(entity.is_closed), float(entity.dxf.elevation[2])
    if mode == "AcDb2dPolyline":
        bulges = np.array([vertex.dxf.get("bulge", 0.0) for vertex in drawn], np.float64)
        return _corners(values, unit_mm), bulges, closed, height
    low, high = (values[:, 2].min(), values[:, 2].max()) if len(values) else (0.0, 0.0)
    if not (high - low) * unit_mm <= JOIN_TOLERANCE_MM:
        raise InputError(f"a 3D polyline climbs from Z{low * unit_mm:.3f} to Z{high * unit_mm:.3f} mm: "
                         "project the drawing to XY")
    return _corners(values, unit_mm), np.zeros(len(values)), closed, height


def _corners(values: Floats, unit_mm: float) -> NDArray[np.complex128]:
    return np.asarray(values[:, :2] @ (1, 1j) * unit_mm, np.complex128)


def _segment(start: complex, end: complex, bulge: float) -> Floats:
    """Return the points of a line or arc; the bulge is the tangent of its quarter angle, counter-clockwise."""
    step = end - start
    if not np.isfinite(bulge):
        raise InputError("a polyline has a bulge that is not a number: export it again")
    points = [start, end]
    if abs(bulge * step) / 2 > CHORD_TOLERANCE_UM / 1000:
        centre = (start + end) / 2 + 1j * step * (1 - bulge * bulge) / (4 * bulge)
        points = [start, *arc_points(start, end, centre, 1 if bulge > 0 else -1, full=False)]
    return np.array([(point.real, point.imag) for point in points])


def _flat(entity: Any, points: Floats, height: float, unit_mm: float) -> Floats:
    """Transform points (n, 2) from the entity's own plane to the drawing's."""
    if entity.dxftype() == "POLYLINE" and not entity.is_2d_polyline:
        return points
    plane = entity.ocs()
    if not plane.transform:
        return points
    placed = plane.points_to_wcs([(x, y, height * unit_mm) for x, y in points.tolist()])
    return np.array([(point.x, point.y) for point in placed], np.float64)


SHAPES = "lines, arcs, circles, polylines, splines or ellipses"  # kinds that can be cut, for messages
POLYLINES = frozenset({"LWPOLYLINE", "POLYLINE"})  # kinds of several lines and arcs

_OUTERMOST: dict[str, Callable[[Any], Iterable[Any]]] = {
    "LINE": lambda entity: (entity.dxf.start, entity.dxf.end),
    "CIRCLE": lambda entity: _box(entity.dxf.center, entity.dxf.radius),
    "ARC": lambda entity: (entity.start_point, entity.end_point),
    "ELLIPSE": lambda entity: _box(entity.dxf.center, entity.dxf.major_axis.magnitude),
    "SPLINE": lambda entity: (*entity.control_points, *entity.fit_points),
}
"""Points between which an entity is, or from which its length follows."""
CUT = POLYLINES | _OUTERMOST.keys()  # kinds of entities that can be cut
UNDRAWN = frozenset({
    "TEXT", "MTEXT", "ATTDEF", "ATTRIB", "RTEXT", "ARCALIGNEDTEXT", "ACAD_TABLE", "DIMENSION", "ARC_DIMENSION",
    "LARGE_RADIAL_DIMENSION", "LEADER", "MLEADER", "MULTILEADER", "TOLERANCE", "POINT", "HATCH", "MPOLYGON", "IMAGE",
    "WIPEOUT", "VIEWPORT", "XLINE", "RAY", "LIGHT", "SUN", "PDFUNDERLAY", "DWFUNDERLAY", "DGNUNDERLAY", "OLEFRAME",
    "OLE2FRAME",
})  # fmt: skip
"""Kinds that are left out: annotations, and drawing aids."""
_FLAT = 0.9999


def pieces_of(entity: Any, unit_mm: float) -> list[Floats]:
    """Return the lines and arcs of an entity, points (n, 2) in mm each."""
    kind = entity.dxftype()
    if kind not in CUT:
        raise InputError(f"{named(kind)} cannot be cut: draw {SHAPES}")
    if kind in POLYLINES:
        if entity.dxftype() == "LWPOLYLINE" or entity.is_2d_polyline:
            _refuse_tilted(entity, kind)
        return polyline_pieces(entity, unit_mm)
    _refuse_tilted(entity, kind)
    outermost = np.array([(p[0], p[1]) for p in _OUTERMOST[kind](entity)], np.float64).reshape(-1, 2)
    check_points(outermost * unit_mm, named(kind), f"; a drawing unit is {unit_mm:g} mm here; or give --unit")
    points = [(p[0], p[1]) for p in _points(entity, kind, unit_mm)]
    return [np.array(points, np.float64).reshape(-1, 2) * unit_mm]


def named(kind: str) -> str:
    """Return a kind of entity with its article."""
    return f"{'an' if kind[0] in 'AEIO' else 'a'} {kind}"


def _refuse_tilted(entity: Any, kind: str) -> None:
    extrusion = np.array(tuple(entity.dxf.get("extrusion", (0, 0, 1))), np.float64)
    if abs(extrusion[2]) < _FLAT * np.linalg.norm(extrusion):
        raise InputError(f"{named(kind)} is drawn out of the XY plane: project the drawing to XY")


def _points(entity: Any, kind: str, unit_mm: float) -> Iterable[Any]:
    """Return points in drawing units; a single one if the entity has no length."""
    tolerance = CHORD_TOLERANCE_UM / 1000 / unit_mm
    if kind == "LINE":
        return [entity.dxf.start, entity.dxf.end]
    if kind == "SPLINE":
        return spline_points(entity, tolerance / 2)
    if kind == "ELLIPSE":
        length = entity.dxf.major_axis.magnitude
        return entity.flattening(tolerance, segments=16) if length * unit_mm > SAME_MM else [entity.dxf.center]
    radius = entity.dxf.radius
    if not 0 <= radius * unit_mm <= FARTHEST_MM:
        what = f"{named(kind)} has a radius of {radius * unit_mm:g} mm, not one from 0 to {FARTHEST_MM:g} mm"
        raise InputError(f"{what}: draw it again, or a line")
    return entity.flattening(min(tolerance, radius / 4)) if radius * unit_mm > SAME_MM else [entity.dxf.center]


def _box(centre: Any, reach: float) -> list[tuple[float, float]]:
    return [(centre[0] - reach, centre[1] - reach), (centre[0] + reach, centre[1] + reach)]
