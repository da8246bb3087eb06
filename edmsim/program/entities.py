"""Entities of a drawing as lines and arcs, curves as chords within the tolerance."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.program.arcs import CHORD_TOLERANCE_UM
from edmsim.program.chains import SAME_MM
from edmsim.program.limits import FARTHEST_MM, check_points
from edmsim.program.polylines import polyline_pieces
from edmsim.program.splines import spline_points

SHAPES = "lines, arcs, circles, polylines, splines or ellipses"
"""What can be cut, in the words of a message."""

POLYLINES = frozenset({"LWPOLYLINE", "POLYLINE"})
"""Kinds of several lines and arcs."""

_OUTERMOST: dict[str, Callable[[Any], Iterable[Any]]] = {
    "LINE": lambda entity: (entity.dxf.start, entity.dxf.end),
    "CIRCLE": lambda entity: _box(entity.dxf.center, entity.dxf.radius),
    "ARC": lambda entity: (entity.start_point, entity.end_point),
    "ELLIPSE": lambda entity: _box(entity.dxf.center, entity.dxf.major_axis.magnitude),
    "SPLINE": lambda entity: (*entity.control_points, *entity.fit_points),
}
"""Points between which an entity lies, or that its length follows from."""
CUT = POLYLINES | _OUTERMOST.keys()
"""Kinds of entities that can be cut."""
UNDRAWN = frozenset({
    "TEXT", "MTEXT", "ATTDEF", "ATTRIB", "RTEXT", "ARCALIGNEDTEXT", "ACAD_TABLE", "DIMENSION", "ARC_DIMENSION",
    "LARGE_RADIAL_DIMENSION", "LEADER", "MLEADER", "MULTILEADER", "TOLERANCE", "POINT", "HATCH", "MPOLYGON", "IMAGE",
    "WIPEOUT", "VIEWPORT", "XLINE", "RAY", "LIGHT", "SUN", "PDFUNDERLAY", "DWFUNDERLAY", "DGNUNDERLAY", "OLEFRAME",
    "OLE2FRAME",
})  # fmt: skip
"""Kinds that are left out: annotations, and what helps in drawing."""
_FLAT = 0.9999


def pieces_of(entity: Any, unit_mm: float) -> list[NDArray[np.float64]]:
    """Return the lines and arcs of an entity, points (n, 2) in mm each.

    Raises
    ------
    InputError
        An entity that cannot be cut, lies out of the XY plane, or is too large.
    """
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
        told = f"{named(kind)} has a radius of {radius * unit_mm:g} mm, not one from 0 to {FARTHEST_MM:g} mm"
        raise InputError(f"{told}: draw it again, or a line")
    return entity.flattening(min(tolerance, radius / 4)) if radius * unit_mm > SAME_MM else [entity.dxf.center]


def _box(centre: Any, reach: float) -> list[tuple[float, float]]:
    return [(centre[0] - reach, centre[1] - reach), (centre[0] + reach, centre[1] + reach)]
