"""Entities of a drawing as lines and arcs, curves as chords within the tolerance.

LWPOLYLINE, and POLYLINE in two dimensions or at one height; splines also closed and periodic, whose knots do not stop
at the ends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.geometry import arc_lengths
from edmsim.program.arcs import CHORD_TOLERANCE_UM, arc_points
from edmsim.program.chains import SAME_MM
from edmsim.program.limits import FARTHEST_MM, check_count, check_points
from edmsim.program.outline import JOIN_TOLERANCE_MM

_MOST_HALVINGS = 16
_FEWEST_CHORDS = 16


def spline_points(entity: Any, tolerance: float) -> NDArray[np.float64]:
    """Return the points (n, 2) of a SPLINE, in drawing units, as chords within a tolerance."""
    # a periodic spline is drawn between the first and last knot that all its control points bear on; one whose
    # control points are written once, for as many knots as if they were repeated, is closed with the first of
    # them; one that is said to be closed and has only fit points is a periodic cubic through them
    control = np.array([tuple(p)[:2] for p in entity.control_points], np.float64).reshape(-1, 2)
    if len(control) == 0 and entity.closed and len(entity.fit_points) > 2:
        return _through(np.array([tuple(p)[:2] for p in entity.fit_points], np.float64), tolerance)
    knots, degree = np.array(entity.knots, np.float64), int(entity.dxf.degree)
    usual = _is_clamped(knots, degree) and len(knots) == len(control) + degree + 1 if len(knots) else True
    if len(control) == 0 or usual:
        points = [tuple(p)[:2] for p in entity.flattening(tolerance, segments=_FEWEST_CHORDS)]
        return np.array(points, np.float64).reshape(-1, 2)
    weights = np.array(entity.weights, np.float64) if len(entity.weights) else np.ones(len(control))
    if len(knots) == len(control) + 2 * degree + 1:
        control, weights = np.concatenate([control, control[:degree]]), np.concatenate([weights, weights[:degree]])
    if len(knots) != len(control) + degree + 1 or (np.diff(knots) < 0).any():
        raise InputError(f"a SPLINE has {len(control)} control points and {len(knots)} knots at degree {degree}: "
                         "these make no curve, export it again")
    return _along(knots, control, weights, degree, tolerance)


def _is_clamped(knots: NDArray[np.float64], degree: int) -> bool:
    return bool(knots[0] == knots[degree] and knots[-1] == knots[-degree - 1])


def _along(
    knots: NDArray[np.float64], control: NDArray[np.float64], weights: NDArray[np.float64], degree: int,
    tolerance: float,
) -> NDArray[np.float64]:
    from scipy.interpolate import BSpline

    curve = BSpline(knots, np.column_stack([control * weights[:, None], weights]), degree)
    breaks = np.unique(knots[degree : len(control) + 1])
    return _chords(lambda t: curve(t)[:, :2] / curve(t)[:, 2:], breaks, tolerance)


def _through(points: NDArray[np.float64], tolerance: float) -> NDArray[np.float64]:
    from scipy.interpolate import CubicSpline

    ring = points if np.array_equal(points[0], points[-1]) else np.concatenate([points, points[:1]])
    ring[-1] = ring[0]
    length = arc_lengths(ring)
    return _chords(CubicSpline(length, ring, bc_type="periodic"), length, tolerance)


def _chords(curve: Any, breaks: NDArray[np.float64], tolerance: float) -> NDArray[np.float64]:
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


def polyline_pieces(entity: Any, unit_mm: float) -> list[NDArray[np.float64]]:
    """Return the lines and arcs of a polyline, points (n, 2) in mm each; those of no length are left out."""
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


def _vertices(entity: Any, unit_mm: float) -> tuple[NDArray[np.complex128], NDArray[np.float64], bool, float]:
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


def _corners(values: NDArray[np.float64], unit_mm: float) -> NDArray[np.complex128]:
    return np.asarray(values[:, :2] @ (1, 1j) * unit_mm, np.complex128)


def _segment(start: complex, end: complex, bulge: float) -> NDArray[np.float64]:
    """Return the points of a line or arc; the bulge is the tangent of its quarter angle, counter-clockwise."""
    step = end - start
    if not np.isfinite(bulge):
        raise InputError("a polyline has a bulge that is not a number: export it again")
    points = [start, end]
    if abs(bulge * step) / 2 > CHORD_TOLERANCE_UM / 1000:
        centre = (start + end) / 2 + 1j * step * (1 - bulge * bulge) / (4 * bulge)
        points = [start, *arc_points(start, end, centre, 1 if bulge > 0 else -1, full=False)]
    return np.array([(point.real, point.imag) for point in points])


def _flat(entity: Any, points: NDArray[np.float64], height: float, unit_mm: float) -> NDArray[np.float64]:
    """Return points (n, 2) of an entity's own plane as they lie in the drawing's."""
    if entity.dxftype() == "POLYLINE" and not entity.is_2d_polyline:
        return points
    plane = entity.ocs()
    if not plane.transform:
        return points
    placed = plane.points_to_wcs([(x, y, height * unit_mm) for x, y in points.tolist()])
    return np.array([(point.x, point.y) for point in placed], np.float64)


SHAPES = "lines, arcs, circles, polylines, splines or ellipses"  # what can be cut, in the words of a message

POLYLINES = frozenset({"LWPOLYLINE", "POLYLINE"})  # kinds of several lines and arcs

_OUTERMOST: dict[str, Callable[[Any], Iterable[Any]]] = {
    "LINE": lambda entity: (entity.dxf.start, entity.dxf.end),
    "CIRCLE": lambda entity: _box(entity.dxf.center, entity.dxf.radius),
    "ARC": lambda entity: (entity.start_point, entity.end_point),
    "ELLIPSE": lambda entity: _box(entity.dxf.center, entity.dxf.major_axis.magnitude),
    "SPLINE": lambda entity: (*entity.control_points, *entity.fit_points),
}
"""Points between which an entity lies, or that its length follows from."""
CUT = POLYLINES | _OUTERMOST.keys()  # kinds of entities that can be cut
UNDRAWN = frozenset({
    "TEXT", "MTEXT", "ATTDEF", "ATTRIB", "RTEXT", "ARCALIGNEDTEXT", "ACAD_TABLE", "DIMENSION", "ARC_DIMENSION",
    "LARGE_RADIAL_DIMENSION", "LEADER", "MLEADER", "MULTILEADER", "TOLERANCE", "POINT", "HATCH", "MPOLYGON", "IMAGE",
    "WIPEOUT", "VIEWPORT", "XLINE", "RAY", "LIGHT", "SUN", "PDFUNDERLAY", "DWFUNDERLAY", "DGNUNDERLAY", "OLEFRAME",
    "OLE2FRAME",
})  # fmt: skip
"""Kinds that are left out: annotations, and what helps in drawing."""
_FLAT = 0.9999


def pieces_of(entity: Any, unit_mm: float) -> list[NDArray[np.float64]]:
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
    """Return points in drawing units; where an entity has no length, one of them."""
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
