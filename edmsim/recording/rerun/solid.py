"""Solids as triangles: prisms over polygons, boxes, cylinders; and the workpiece with its kerf growing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import MultiLineString
from shapely.geometry.base import BaseGeometry

from edmsim.metrology.edges import filled
from edmsim.plant.constants import RAY_RANGE_UM
from edmsim.recording.pauses import jump_rows, stretches
from edmsim.recording.scene import Scene

KERF_FRAMES = 300
"""Most steps in which the kerf grows."""
KERF_STEP_UM = 50.0
"""It grows by no less than this at a time: less would not be seen."""
KERF_POINTS = 600
"""Most points of its edge; a longer one is drawn more coarsely."""
_FINEST_MM = 0.004
_SIDES = 24
"""Sides of a drawn cylinder."""


class Mesh(NamedTuple):
    """Triangles with a normal per vertex.

    Attributes
    ----------
    positions, normals : float32 arrays (n, 3)
        Positions in mm.
    triangles : uint32 array (m, 3)
    """

    positions: NDArray[np.float32]
    normals: NDArray[np.float32]
    triangles: NDArray[np.uint32]


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Return several meshes as one."""
    starts = np.cumsum([0, *(len(mesh.positions) for mesh in meshes[:-1])])
    return Mesh(
        np.concatenate([np.zeros((0, 3), np.float32), *(mesh.positions for mesh in meshes)]),
        np.concatenate([np.zeros((0, 3), np.float32), *(mesh.normals for mesh in meshes)]),
        np.concatenate(
            [np.zeros((0, 3), np.uint32),
             *(mesh.triangles + np.uint32(at) for mesh, at in zip(meshes, starts, strict=True))]
        ),
    )  # fmt: skip


def prism(area: BaseGeometry, low_mm: float, high_mm: float) -> Mesh:
    """Return the solid over an area (polygons, with holes or not) between two heights."""
    corners = shapely.get_coordinates(shapely.get_parts(shapely.constrained_delaunay_triangles(area)))
    flat = corners.reshape(-1, 4, 2)[:, :3].reshape(-1, 2)
    points, index = np.unique(flat, axis=0, return_inverse=True)
    faces = index.reshape(-1, 3)
    caps = [
        _placed(np.column_stack([points, np.full(len(points), z)]), (0.0, 0.0, up), faces)
        for z, up in ((low_mm, -1.0), (high_mm, 1.0))
    ]
    rings = shapely.get_rings(shapely.get_parts(shapely.orient_polygons(area)))
    return joined([*caps, *(_walls(shapely.get_coordinates(ring), low_mm, high_mm) for ring in rings)])


def _placed(positions: NDArray[np.float64], normal: Sequence[float], triangles: NDArray[np.int64]) -> Mesh:
    normals = np.broadcast_to(np.array(normal, np.float32), positions.shape)
    return Mesh(positions.astype(np.float32), normals, triangles.astype(np.uint32))


def _walls(ring: NDArray[np.float64], low_mm: float, high_mm: float) -> Mesh:
    """Return the upright walls over a closed line (n + 1, 2), a rectangle per side."""
    start, end = ring[:-1], ring[1:]
    along = end - start
    outward = np.column_stack([along[:, 1], -along[:, 0]])
    outward /= np.maximum(np.hypot(*outward.T)[:, None], 1e-12)
    n = len(start)
    positions = np.empty((n, 4, 3), np.float32)
    positions[:, 0, :2], positions[:, 1, :2], positions[:, 2, :2], positions[:, 3, :2] = start, end, end, start
    positions[:, :2, 2], positions[:, 2:, 2] = low_mm, high_mm
    normals = np.zeros((n, 4, 3), np.float32)
    normals[:, :, :2] = outward[:, None, :]
    pair = np.array([(0, 1, 2), (0, 2, 3)], np.uint32)
    triangles = (4 * np.arange(n, dtype=np.uint32))[:, None, None] + pair
    return Mesh(positions.reshape(-1, 3), normals.reshape(-1, 3), triangles.reshape(-1, 3))


def box(half_mm: NDArray[np.float64]) -> Mesh:
    """Return a box around the origin, of half sides (3,) in mm."""
    x, y, z = half_mm
    return prism(shapely.box(-x, -y, x, y), -z, z)


def cylinder(radius_mm: float, half_length_mm: float) -> Mesh:
    """Return a cylinder around the origin, its axis along z."""
    angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
    rim = radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    return prism(shapely.Polygon(rim), -half_length_mm, half_length_mm)


def moved(mesh: Mesh, rotation: NDArray[np.float64], to_mm: NDArray[np.float64]) -> Mesh:
    """Return a mesh turned by a matrix (3, 3) and shifted."""
    return Mesh(
        (mesh.positions @ rotation.T + to_mm).astype(np.float32),
        (mesh.normals @ rotation.T).astype(np.float32),
        mesh.triangles,
    )


class Growth(NamedTuple):
    """The workpiece while it is cut: its solid from each of some times on.

    Attributes
    ----------
    rows : int array (n,)
        Row of the table of windows from which on each solid holds.
    solids : tuple of Mesh
    tolerance_mm : float
        Within which the kerf's edge was drawn.
    """

    rows: NDArray[np.int64]
    solids: tuple[Mesh, ...]
    tolerance_mm: float


def growing_kerf(scene: Scene, places_um: NDArray[np.float64], path_um: NDArray[np.float64]) -> Growth:
    """Return the workpiece's solid at up to `KERF_FRAMES` times of a cut.

    The kerf is the finished cut's at mid height, uncovered as far as the wire's rays reach from where it has been.

    Parameters
    ----------
    scene : Scene
    places_um : array (windows, 2)
        Guides on the table, window by window.
    path_um : array (windows,)
        Place along the wire path.
    """
    kerf, tolerance = _kerf(scene)
    faces = _faces(scene)
    reach = scene.wire_diameter_um / 2000.0 + RAY_RANGE_UM / 1000.0
    rows, solids = [0], [_solid(faces)]
    swept: BaseGeometry = shapely.Polygon()
    ahead = np.maximum.accumulate(path_um) if len(path_um) else path_um
    for first, last in _steps(ahead):
        line = _way(places_um[max(first - 1, 0) : last + 1], path_um[max(first - 1, 0) : last + 1])
        swept = swept.union(line.simplify(0.002).buffer(reach, quad_segs=4)).simplify(0.001)
        cut = kerf.intersection(swept)  # again from the whole kerf: taken piece by piece it would leave slivers
        rows.append(last)
        solids.append(_solid([(face.difference(cut), height) for face, height in faces]))
    return Growth(np.array(rows), tuple(solids), tolerance)


def _way(places_um: NDArray[np.float64], path_um: NDArray[np.float64]) -> BaseGeometry:
    """Return where the wire has been in mm, without the ways between contours."""
    parts = [places_um[part] / 1000.0 for part in stretches(len(path_um), jump_rows(places_um, path_um))]
    return shapely.GeometryCollection([
        shapely.LineString(way) if len(way) > 1 else shapely.Point(way[0]) for way in parts
    ])  # fmt: skip


def _steps(ahead_um: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Return the first and last window of pieces of path that are about equally long."""
    if len(ahead_um) == 0 or ahead_um[-1] <= ahead_um[0]:
        return []
    steps = int(np.clip((ahead_um[-1] - ahead_um[0]) / KERF_STEP_UM, 1, KERF_FRAMES))
    marks = np.linspace(ahead_um[0], ahead_um[-1], steps + 1)[1:]
    ends = np.unique(np.minimum(np.searchsorted(ahead_um, marks), len(ahead_um) - 1))
    return list(zip([0, *(ends[:-1] + 1).tolist()], ends.tolist(), strict=True))


def _kerf(scene: Scene) -> tuple[BaseGeometry, float]:
    """Return what was cut at mid height, thinned to a number of points that can be drawn often."""
    if not scene.cut_edges_mm:
        return shapely.Polygon(), _FINEST_MM
    rings = [line for line in scene.cut_edges_mm[scene.middle_slice()] if len(line) > 3]
    kerf = shapely.make_valid(filled(MultiLineString(rings)))
    tolerance = _FINEST_MM
    thin = kerf.simplify(tolerance)
    while shapely.get_num_coordinates(thin) > KERF_POINTS and tolerance < scene.wire_diameter_um / 4000.0:
        tolerance *= 2
        thin = kerf.simplify(tolerance)
    return thin, tolerance


def _faces(scene: Scene) -> list[tuple[BaseGeometry, float]]:
    """Return the workpiece's upper faces before the cut, its start holes drilled, each with its height."""
    levels = [(filled(MultiLineString(list(t.outlines_mm))), t.height_mm) for t in scene.terraces]
    faces = levels or [(shapely.box(*scene.stock_mm), scene.height_mm)]
    holes = scene.bored()
    return [(shapely.make_valid(face).difference(holes), height) for face, height in faces]


def _solid(faces: Sequence[tuple[BaseGeometry, float]]) -> Mesh:
    solids = []
    for face, height in faces:
        polygons = [part for part in shapely.get_parts(face) if part.geom_type == "Polygon"]  # no stray lines
        if polygons:
            solids.append(prism(shapely.MultiPolygon(polygons), 0.0, height))
    return joined(solids)
