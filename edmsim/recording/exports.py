"""A cut as files for other programs: its face as STL or glTF, its contour as DXF, CSV or SVG."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError, refuses_wrong_types
from edmsim.files import check_suffix, make_writable, replacing
from edmsim.geometry import Floats, arc_lengths, interpolated, left_of
from edmsim.metrology.profile import FARTHEST_WALL_MM, PROFILE_STEP_MM
from edmsim.program.outline import signed_area
from edmsim.recording.figures import palette
from edmsim.recording.scene import ErrorMap, Scene, grid_triangles

# The part's cut face as a mesh (STL or glTF). Its points are found slice by slice.


class Face(NamedTuple):
    """The cut face along one contour, from the workpiece's lower face to the upper one."""

    # (rows, n, 3): rows from below: the lower face, the middle of every slice, the upper face. NaN if no wall was
    # measured there.
    points_mm: Floats
    error_um: Floats  # (rows, n): distance from the wall as drawn, in the plane of the row: positive is metal left
    part_side: str  # side of the part, looking along the edge: left or right

    def at(self, height_mm: float) -> list[Floats]:
        """Return the lines (n, 2) of the face at a height, without the places that were not measured."""
        heights = np.nanmean(self.points_mm[:, :, 2], axis=1)
        k = min(max(int(np.searchsorted(heights, height_mm)) - 1, 0), len(heights) - 2)
        share = (height_mm - heights[k]) / (heights[k + 1] - heights[k])
        line = (1 - share) * self.points_mm[k, :, :2] + share * self.points_mm[k + 1, :, :2]
        known = np.isfinite(line).all(axis=1)
        runs = np.split(np.arange(len(line)), np.flatnonzero(np.diff(known)) + 1)
        return [line[run] for run in runs if len(run) > 1 and known[run[0]]]


def cut_faces(scene: Scene) -> list[Face]:
    """Return the cut face of every contour whose profile error is known."""
    from scipy.spatial import cKDTree

    count = len(scene.cut_edges_mm)
    if count == 0:
        return []
    heights = (np.arange(count) + 0.5) / count * scene.height_mm
    trees = []
    for lines in scene.cut_edges_mm:
        dense = [np.zeros((0, 2))]
        for line in lines:
            if is_whole(line, scene):  # resampled every 2 um
                passed = arc_lengths(line)
                at = np.linspace(0.0, passed[-1], max(int(passed[-1] / 0.002), 1) + 1)
                dense.append(interpolated(at, passed, line))
        points = np.concatenate(dense)
        trees.append((points, cKDTree(points) if len(points) else None))
    found = []
    for number, edge in enumerate(scene.maps):
        if not np.isfinite(edge.error_um).any():  # not an edge of the part, or not cut
            continue
        walls = scene.walls_mm[number] if scene.walls_mm else (edge.nominal_mm, edge.nominal_mm)
        shares = _stations(walls)
        measured = _measured(edge, _on(walls, shares, 0.5), count)
        rows, errors = [], []
        for height, known, (points, tree) in zip(heights, measured, trees, strict=True):
            nominal = _on(walls, shares, height / scene.height_mm)
            wall = np.full((len(nominal), 3), np.nan)
            if tree is not None:
                away, nearest = (np.asarray(of) for of in tree.query(nominal))
                near = known & (away <= FARTHEST_WALL_MM)
                wall[near, :2] = points[nearest[near]]
            wall[:, 2] = height
            rows.append(wall)
            errors.append(_signed_um(wall[:, :2], nominal, edge.part_side))
        half = 0.5 / count  # from the outermost slices' middles to the faces, as share of the height
        low = _continued(rows[0], walls, shares, (half, 0.0))
        high = _continued(rows[-1], walls, shares, (1 - half, 1.0))
        rows = [low * (1, 1, 0), *rows, high * (1, 1, 0) + (0, 0, scene.height_mm)]
        found.append(Face(np.stack(rows), np.stack([errors[0], *errors, errors[-1]]), edge.part_side))
    return found


def is_whole(line: Floats, scene: Scene) -> bool:
    """Return whether a closed edge is larger than a speck."""
    return abs(signed_area(line)) >= scene.speck_mm2


def _measured(edge: ErrorMap, places_mm: Floats, slices: int) -> NDArray[np.bool_]:
    """Return whether the profile error is known (slices, n) at places (n, 2) of an edge at mid height."""
    # elsewhere the nearest edge of the kerf may be its front, or its end at a step of the workpiece
    from scipy.spatial import cKDTree

    error_um = edge.error_um if edge.face_um is None else edge.face_um
    nearest = cKDTree(edge.points_mm).query(places_mm)[1]
    return np.broadcast_to(np.isfinite(error_um[..., nearest]), (slices, len(places_mm)))


def _stations(walls: tuple[Floats, ...]) -> Floats:
    """Return places along two lines with equal numbers of points, as fractional indices of points."""
    steps = np.max([np.hypot(*np.diff(line, axis=0).T) for line in walls], axis=0)
    counts = np.maximum(np.ceil(steps / PROFILE_STEP_MM), 1).astype(int)
    places = [k + np.arange(n) / n for k, n in enumerate(counts)]
    return np.concatenate([*places, [len(steps)]])


def _on(walls: tuple[Floats, ...], shares: Floats, height_share: float) -> Floats:
    """Return the points (n, 2) at places of `_stations` and at a share of the height."""
    line = (1 - height_share) * walls[0] + height_share * walls[1]
    return interpolated(shares, np.arange(len(line)), line)


def _continued(row: Floats, walls: tuple[Floats, ...], shares: Floats, between: tuple[float, float]) -> Floats:
    """Return a slice's points moved from one share of the height to another along the walls as drawn."""
    begin, end = between
    moved = np.zeros_like(row)
    moved[:, :2] = _on(walls, shares, end) - _on(walls, shares, begin)
    return np.asarray(row + moved)


def _signed_um(wall: Floats, nominal: Floats, part_side: str) -> Floats:
    outward, off = left_of(np.gradient(nominal, axis=0)) * (1.0 if part_side == "right" else -1.0), wall - nominal
    return np.asarray(1e3 * np.hypot(*off.T) * np.sign((off * outward).sum(axis=1)))


def write_faces(scene: Scene, file: str | Path) -> None:
    """Write the cut faces of the part: ``.stl``, or ``.glb`` coloured by the profile error."""
    # STL in mm of the program, z from the lower face; glTF in metres, y upwards, as its specification requires
    target = Path(file)
    suffix = check_suffix(target, "a cut face", ".stl", ".glb")
    try:
        from trimesh import Trimesh
    except ImportError:
        raise InputError('meshes are written with trimesh: pip install "edmsim[mesh]"', target) from None
    scene = scene.in_program()
    points, triangles, errors = _triangles(cut_faces(scene))
    if not len(triangles):
        raise InputError("there is no cut face in this cut", target)
    is_gltf = suffix == ".glb"
    if is_gltf:
        points = points[:, [0, 2, 1]] * (1e-3, 1e-3, -1e-3)
    colours = palette.error_rgb(errors, scene.error_limit_um()) if is_gltf else None
    mesh = Trimesh(points, triangles, vertex_colors=colours, process=False)
    make_writable(target.parent)
    with replacing(target) as partial:
        mesh.export(str(partial), file_type=suffix.removeprefix("."))


def _triangles(faces: list[Face]) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Return points (k, 3), triangles (m, 3) and errors (k,) of faces; normals point away from the part."""
    points, triangles, errors, count = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], [np.zeros(0)], 0
    for face in faces:
        rows, n = face.error_um.shape
        made = grid_triangles(rows, n)
        flat = face.points_mm.reshape(-1, 3)
        known = np.asarray(np.isfinite(flat).all(axis=1))  # no triangles at places that were not measured
        if face.part_side == "right":
            made = made[:, ::-1]
        triangles.append(count + made[known[made].all(axis=1)])
        points.append(np.where(known[:, None], flat, 0.0))
        errors.append(np.where(known, face.error_um.reshape(-1), 0.0))
        count += rows * n
    return np.concatenate(points), np.concatenate(triangles), np.concatenate(errors)


# The contour of a cut as DXF, CSV or SVG, in the program's coordinates.

_COLOURS = {"CUT": (1, "#d55e00"), "NOMINAL": (7, "#1f2933")}
"""Colours of the layers: AutoCAD's index, and SVG's colour."""


@refuses_wrong_types
def write_contour(scene: Scene, file: str | Path, height_mm: float | None = None) -> None:
    """Write the cut edges as ``.dxf``, ``.csv`` or ``.svg``, and the edges as drawn, in mm of the program."""
    # by default all edges of the kerf at mid height; at a height over the workpiece's lower face only the part's
    # wall, interpolated between the adjacent slices
    writers = {".dxf": _write_dxf, ".csv": _write_csv, ".svg": _write_svg}
    target = Path(file)
    write = writers[check_suffix(target, "a contour", *writers)]
    scene = scene.in_program()
    if height_mm is None:
        layers = {
            "CUT": [line for line in scene.middle_edges_mm() if is_whole(line, scene)],
            "NOMINAL": scene.as_drawn_mm(scene.middle_mm()),
        }
    else:
        layers = _at_height(scene, height_mm, target)
    make_writable(target.parent)
    with replacing(target) as partial:
        write(layers, partial)


def _at_height(scene: Scene, height_mm: float, target: Path) -> dict[str, list[Floats]]:
    if not 0 <= height_mm <= scene.height_mm:
        raise InputError(
            f"there is no contour {height_mm:g} mm high: the workpiece has 0 to {scene.height_mm:g} mm", target
        )
    return {
        "CUT": [line for face in cut_faces(scene) for line in face.at(height_mm)],
        "NOMINAL": scene.as_drawn_mm(height_mm),
    }


def _is_closed(line: Floats) -> bool:
    return len(line) > 2 and bool(np.allclose(line[0], line[-1], atol=1e-6))


def _write_dxf(layers: Mapping[str, Sequence[Floats]], file: Path) -> None:
    from ezdxf.filemanagement import new

    document = new("R2010", units=4)
    for layer, lines in layers.items():
        document.layers.add(layer, color=_COLOURS[layer][0])
        for line in lines:
            closed = _is_closed(line)
            points = (line[:-1] if closed else line).tolist()
            document.modelspace().add_lwpolyline(points, close=closed, dxfattribs={"layer": layer})
    document.saveas(file)


def _write_csv(layers: Mapping[str, Sequence[Floats]], file: Path) -> None:
    with file.open("w", newline="", encoding="utf-8") as opened:
        rows = csv.writer(opened)
        rows.writerow(["layer", "line", "x_mm", "y_mm"])
        for layer, lines in layers.items():
            for number, line in enumerate(lines, 1):
                rows.writerows([layer, number, f"{x:.5f}", f"{y:.5f}"] for x, y in line)


def _write_svg(layers: Mapping[str, Sequence[Floats]], file: Path) -> None:
    points = np.concatenate([line for lines in layers.values() for line in lines])
    (x0, y0), (x1, y1) = points.min(axis=0) - 0.5, points.max(axis=0) + 0.5
    width, height = x1 - x0, y1 - y0
    text = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.3f}mm" height="{height:.3f}mm" '
        f'viewBox="{x0:.5f} {-y1:.5f} {width:.5f} {height:.5f}">'
    ]
    for layer, lines in layers.items():
        style = f'class="{layer.lower()}" fill="none" stroke="{_COLOURS[layer][1]}" stroke-width="0.01"'
        for line in lines:
            pairs = " L".join(f"{x:.5f},{-y:.5f}" for x, y in line)  # Y points down in SVG
            text.append(f'<path {style} d="M{pairs}{" Z" if _is_closed(line) else ""}"/>')
    file.write_text("\n".join([*text, "</svg>\n"]), encoding="utf-8")
