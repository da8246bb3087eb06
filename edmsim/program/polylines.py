"""Polylines of drawings as lines and arcs: LWPOLYLINE, and POLYLINE in two dimensions or at one height."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.program.arcs import CHORD_TOLERANCE_UM, arc_points
from edmsim.program.chains import SAME_MM
from edmsim.program.limits import check_count, check_points
from edmsim.program.outline import JOIN_TOLERANCE_MM

_FRAME = 16
"""Flag of a vertex that controls a spline and is not on it (DXF reference, VERTEX, code 70)."""

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
        raise InputError("a polyline has a bulge that is no number: export it again")
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
