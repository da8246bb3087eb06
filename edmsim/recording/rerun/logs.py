"""Machine and gap in the recording: bodies, the workpiece with the growing kerf, wire, drawing, errors, discharges.

The frame of reference is the machine's base: wire and guides are fixed, the table with the workpiece moves.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr
import shapely
from numpy.typing import NDArray

from edmsim.geometry import Floats, arc_lengths, interpolated, left_of
from edmsim.metrology.edges import filled
from edmsim.plant.constants import RAY_RANGE_UM
from edmsim.plant.kernel.state import ARC, OPEN, SHORT, SPARK
from edmsim.plant.mechanics.engine import mujoco
from edmsim.recording.figures import palette
from edmsim.recording.rerun.playback import PATH, TIME
from edmsim.recording.scene import PassFace, Scene, grid_triangles
from edmsim.recording.windows import Frames, column, jump_rows, stretches, traces, travel_direction


def indexes(t_s: Floats, path_um: Floats) -> list[rr.TimeColumn]:
    """Return rows' times on both timelines."""
    return [rr.TimeColumn(TIME, duration=t_s), rr.TimeColumn(PATH, sequence=np.round(path_um).astype(np.int64))]


def log_changing(
    recording: rr.RecordingStream, entity: str, look: rr.AsComponents, when: list[rr.TimeColumn],
    columns: rr.ComponentColumnList,
) -> None:
    """Log an entity's look as static data, and its other data over time."""
    recording.log(entity, look, static=True)
    recording.send_columns(entity, when, columns)


def class_rgb(kind: NDArray[np.int16]) -> NDArray[np.uint8]:
    """Return the colours (..., 3) of pulses' classes."""
    table = np.zeros((4, 3), np.uint8)
    for code, name in ((OPEN, "open"), (SPARK, "spark"), (ARC, "arc"), (SHORT, "short")):
        table[code] = palette.rgb(palette.CLASS_COLOURS[name])
    return np.asarray(table[kind], np.uint8)


def faded(colours: NDArray[np.uint8], left: Floats) -> NDArray[np.uint8]:
    """Return colours (n, 3) blended into the background, with their opacities `left` (n,) from 0 to 1."""
    ground = np.array(palette.rgb(palette.INK), float)
    return np.asarray(np.round(ground + (colours - ground) * left[:, None]), np.uint8)


def turned(points: Floats) -> Floats:
    """Return points (..., 2) with y reversed, because y points down in rerun's 2D views."""
    return np.asarray(points * np.array([1.0, -1.0]), np.float64)


def on_screen(points: float) -> list[float]:
    """Return a radius in points of the screen, which rerun distinguishes from a length by its negative sign."""
    return [-points]


def at_height(lines: Iterable[Floats], z_mm: float) -> list[Floats]:
    """Return lines (n, 2) as lines (n, 3) at a height."""
    return [np.column_stack([line, np.full(len(line), z_mm)]) for line in lines]


def log_lines(recording: rr.RecordingStream, entity: str, strips: list[Floats], colour: str) -> None:
    """Log static lines in space."""
    if strips:
        lines = rr.LineStrips3D(strips, colors=[palette.rgb(colour)], radii=on_screen(0.8))
        recording.log(entity, lines, static=True)


def log_points(
    recording: rr.RecordingStream, entity: str, places: list[tuple[float, float, float]], labels: list[str],
    colour: str,
) -> None:
    """Log static points with labels."""
    if places:
        points = rr.Points3D(places, labels=labels, colors=[palette.rgb(colour)], radii=on_screen(4.0))
        recording.log(entity, points, static=True)


KERF_FRAMES = 300  # most steps in which the kerf grows
KERF_STEP_UM = 50.0  # least growth per step; less would be invisible
KERF_POINTS = 600  # most points of the kerf's edge; a longer edge is simplified more
_FINEST_MM = 0.004
_SIDES = 24  # sides of a drawn cylinder


class Mesh(NamedTuple):
    """Triangles with a normal per vertex."""

    positions: NDArray[np.float32]  # positions, normals: positions in mm
    normals: NDArray[np.float32]
    triangles: NDArray[np.uint32]


_NOTHING = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Return several meshes as one."""
    meshes = [_NOTHING, *meshes]
    starts = np.cumsum([0, *(len(mesh.positions) for mesh in meshes[:-1])])
    return Mesh(
        np.concatenate([mesh.positions for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.triangles + np.uint32(at) for mesh, at in zip(meshes, starts, strict=True)]),
    )


def prism(area: shapely.Geometry, low_mm: float, high_mm: float) -> Mesh:
    """Return the solid over an area (polygons, with holes or not) between two heights."""
    corners = shapely.get_coordinates(shapely.get_parts(shapely.constrained_delaunay_triangles(area)))
    flat = corners.reshape(-1, 4, 2)[:, :3].reshape(-1, 2)
    points, index = np.unique(flat, axis=0, return_inverse=True)
    faces = index.reshape(-1, 3)
    caps = [
        Mesh(
            np.column_stack([points, np.full(len(points), z)]).astype(np.float32),
            np.broadcast_to(np.array((0.0, 0.0, up), np.float32), (len(points), 3)), faces.astype(np.uint32),
        )
        for z, up in ((low_mm, -1.0), (high_mm, 1.0))
    ]
    rings = shapely.get_rings(shapely.get_parts(shapely.orient_polygons(area)))
    return joined([*caps, *(_walls(shapely.get_coordinates(ring), low_mm, high_mm) for ring in rings)])


def _walls(ring: Floats, low_mm: float, high_mm: float) -> Mesh:
    """Return the upright walls over a closed line (n + 1, 2), a rectangle per side."""
    start, end = ring[:-1], ring[1:]
    outward = -left_of(end - start)
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


def box(half_mm: Floats) -> Mesh:
    """Return a box around the origin with half sides (3,) in mm."""
    x, y, z = half_mm
    return prism(shapely.box(-x, -y, x, y), -z, z)


def cylinder(radius_mm: float, half_length_mm: float) -> Mesh:
    """Return a cylinder around the origin with its axis along z."""
    angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
    rim = radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    return prism(shapely.Polygon(rim), -half_length_mm, half_length_mm)


def moved(mesh: Mesh, rotation: Floats, to_mm: Floats) -> Mesh:
    """Return a mesh rotated by a matrix (3, 3) and then shifted."""
    return Mesh(
        (mesh.positions @ rotation.T + to_mm).astype(np.float32),
        (mesh.normals @ rotation.T).astype(np.float32),
        mesh.triangles,
    )


class Growth(NamedTuple):
    """The workpiece during the cut: a sequence of solids."""

    rows: NDArray[np.int64]  # (n,): first row of the table of windows for which each solid is valid
    solids: tuple[Mesh, ...]
    tolerance_mm: float  # of the simplified edge of the kerf


def growing_kerf(scene: Scene, places_um: Floats, path_um: Floats) -> Growth:
    """Return the workpiece's solid at up to `KERF_FRAMES` times of a cut."""
    # the finished cut's kerf at mid height, as far as it was within reach of the wire's rays so far; if the wire
    # leans, the kerf of every slice
    faces, reach = _faces(scene), scene.wire_diameter_um / 2000.0 + RAY_RANGE_UM / 1000.0
    layers = _layers(scene)
    known = [_kerf(scene, layer.number, KERF_POINTS // len(layers)) for layer in layers]
    rows, solids = [0], [_solid(faces)]
    swept: list[shapely.Geometry] = [shapely.Polygon()] * len(layers)
    ahead = np.maximum.accumulate(path_um) if len(path_um) else path_um
    for first, last in _steps(ahead, KERF_FRAMES // len(layers)):
        part, parts = slice(max(first - 1, 0), last + 1), []
        for k, (layer, (kerf, _)) in enumerate(zip(layers, known, strict=True)):
            led_um = 1e3 * scene.lead_mm(path_um[part], np.array([layer.middle_mm]))[:, 0]
            line = _wire_path(places_um[part] + led_um, path_um[part])
            swept[k] = swept[k].union(line.simplify(0.002).buffer(reach, quad_segs=4)).simplify(0.001)
            # cut from the whole kerf every time, because taking it piece by piece would leave slivers
            cut = kerf.intersection(swept[k])
            uncut = [(face.difference(cut), height) for face, height in faces]
            parts.append(_solid(uncut, layer.low_mm, layer.high_mm))
        rows.append(last)
        solids.append(joined(parts))
    return Growth(np.array(rows), tuple(solids), max(tolerance for _, tolerance in known))


class _Layer(NamedTuple):
    """A layer of the workpiece, drawn with the kerf of one slice."""

    number: int
    low_mm: float
    high_mm: float

    @property
    def middle_mm(self) -> float:
        return 0.5 * (self.low_mm + self.high_mm)


def _layers(scene: Scene) -> list[_Layer]:
    """Return the layers: one if the wire is vertical, or else one per slice."""
    if scene.lead is None:
        return [_Layer(scene.middle_slice() if scene.cut_edges_mm else 0, 0.0, scene.height_mm)]
    edges = np.linspace(0.0, scene.height_mm, len(scene.cut_edges_mm) + 1).tolist()
    return [_Layer(number, *ends) for number, ends in enumerate(pairwise(edges))]


def _wire_path(places_um: Floats, path_um: Floats) -> shapely.Geometry:
    """Return the wire's path in mm, without the moves between contours."""
    parts = [places_um[part] / 1000.0 for part in stretches(len(path_um), jump_rows(places_um, path_um))]
    return shapely.GeometryCollection([
        shapely.LineString(part) if len(part) > 1 else shapely.Point(part[0]) for part in parts
    ])  # fmt: skip


def _steps(ahead_um: Floats, most: int) -> list[tuple[int, int]]:
    """Return the first and last window of each piece of path: at most `most` pieces of about equal length."""
    if len(ahead_um) == 0 or ahead_um[-1] <= ahead_um[0]:
        return []
    steps = int(np.clip((ahead_um[-1] - ahead_um[0]) / KERF_STEP_UM, 1, most))
    marks = np.linspace(ahead_um[0], ahead_um[-1], steps + 1)[1:]
    ends = np.unique(np.minimum(np.searchsorted(ahead_um, marks), len(ahead_um) - 1))
    return list(zip([0, *(ends[:-1] + 1).tolist()], ends.tolist(), strict=True))


def _kerf(scene: Scene, number: int, most_points: int) -> tuple[shapely.Geometry, float]:
    """Return the kerf of a slice, simplified to about `most_points` points, and the tolerance in mm."""
    if not scene.cut_edges_mm:
        return shapely.Polygon(), _FINEST_MM
    rings = [line for line in scene.cut_edges_mm[number] if len(line) > 3]
    kerf = shapely.make_valid(filled(shapely.MultiLineString(rings)))
    tolerance = _FINEST_MM
    thin = kerf.simplify(tolerance)
    while shapely.get_num_coordinates(thin) > most_points and tolerance < scene.wire_diameter_um / 4000.0:
        tolerance *= 2
        thin = kerf.simplify(tolerance)
    return thin, tolerance


def _faces(scene: Scene) -> list[tuple[shapely.Geometry, float]]:
    """Return the workpiece's upper faces before the cut, with start holes, and their heights."""
    levels = [(filled(shapely.MultiLineString(list(t.outlines_mm))), t.height_mm) for t in scene.terraces]
    faces = levels or [(shapely.box(*scene.stock_mm), scene.height_mm)]
    holes = scene.bored()
    return [(shapely.make_valid(face).difference(holes), height) for face, height in faces]


def _solid(faces: Sequence[tuple[shapely.Geometry, float]], low_mm: float = 0.0, high_mm: float = np.inf) -> Mesh:
    """Return the solid below faces with their heights, between two heights."""
    solids = []
    for face, height in faces:
        if height <= low_mm:
            continue
        polygons = [part for part in shapely.get_parts(face) if part.geom_type == "Polygon"]  # no stray lines
        if polygons:
            solids.append(prism(shapely.MultiPolygon(polygons), low_mm, min(height, high_mm)))
    return joined(solids)


BASE, CROSS, TABLE = "base", "cross", "table"
"""Groups of the machine's bodies: fixed, on the x carriage, on the y carriage with the workpiece."""
_CARRIED = {"x_carriage": CROSS, "y_rotor": CROSS, "y_carriage": TABLE}
_PLATE = "workpiece"  # the MJCF's workpiece; the recording draws the cut workpiece instead


class Bodies(NamedTuple):
    """Bodies of a machine to draw, in mm from the lower guide's axis and the workpiece's lower face, at X0 Y0."""

    solids: dict[str, Mesh]  # by `BASE`, `CROSS` and `TABLE`
    colours: dict[str, NDArray[np.uint8]]  # (n, 3): colours of the vertices
    # opposite corners of the MJCF's workpiece
    plate_mm: tuple[tuple[float, float, float], tuple[float, float, float]]


def bodies_of(model: mujoco.MjModel, lower_guide_mm: float) -> Bodies:
    """Return the bodies of a machine; `lower_guide_mm` is negative, below the workpiece's lower face."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    shift = np.array([0.0, 0.0, lower_guide_mm])
    parts: dict[str, list[Mesh]] = {BASE: [], CROSS: [], TABLE: []}
    colours: dict[str, list[NDArray[np.uint8]]] = {BASE: [], CROSS: [], TABLE: []}
    plate = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for g in range(model.ngeom):
        geom = model.geom(g)
        at = data.geom_xpos[g] * 1000.0 + shift
        size = geom.size * 1000.0
        if geom.name == _PLATE:
            plate = (tuple((at - size).tolist()), tuple((at + size).tolist()))
            continue
        carrier = _CARRIED.get(model.body(int(geom.bodyid[0])).name, BASE)
        shape = box(size) if geom.type[0] == mujoco.mjtGeom.mjGEOM_BOX else cylinder(size[0], size[1])
        parts[carrier].append(moved(shape, data.geom_xmat[g].reshape(3, 3), at))
        material = int(geom.matid[0])
        rgba = geom.rgba if material < 0 else model.mat_rgba[material]
        colour = np.round(255 * np.asarray(rgba[:3])).astype(np.uint8)
        colours[carrier].append(np.tile(colour, (len(shape.positions), 1)))
    return Bodies(
        {carrier: joined(shapes) for carrier, shapes in parts.items()},
        {carrier: np.concatenate([np.zeros((0, 3), np.uint8), *rows]) for carrier, rows in colours.items()},
        plate,
    )


STEEL = (142, 152, 172, 140)  # of the workpiece; translucent, to show what is in the kerf
_PLACES = {BASE: "world/base", CROSS: "world/cross/carriage", TABLE: "world/table/carriage"}


def shapes_of(frames: Frames, closeups: NDArray[np.void]) -> NDArray[np.void]:
    """Return the wire's shape and gas over the cut: rows of frames and close-ups, in order of time."""
    rows = np.concatenate([frames.rows, closeups[list(frames.rows.dtype.names or ())]])
    return np.asarray(rows[np.unique(rows["t_s"], return_index=True)[1]])


def log_bodies(recording: rr.RecordingStream, bodies: Bodies) -> None:
    """Log the machine's bodies, and the edges of the MJCF's workpiece."""
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for carrier, solid in bodies.solids.items():
        mesh = rr.Mesh3D(
            vertex_positions=solid.positions, vertex_normals=solid.normals, triangle_indices=solid.triangles,
            vertex_colors=bodies.colours[carrier],
        )  # fmt: skip
        recording.log(_PLACES[carrier], mesh, static=True)
    low, high = (np.array(corner) for corner in bodies.plate_mm)
    plate = rr.Boxes3D(
        mins=[low], sizes=[high - low], colors=[palette.rgb(palette.MUTED)], radii=on_screen(0.6),
        fill_mode=rr.components.FillMode.MajorWireframe,
    )  # fmt: skip
    recording.log("world/table/plate", plate, static=True)


def log_workpiece(recording: rr.RecordingStream, growth: Growth, t_s: Floats, path_um: Floats) -> None:
    """Log the workpiece as a solid with the growing kerf; `t_s` and `path_um` are the windows'."""
    recording.log("world/table/workpiece", rr.Mesh3D.from_fields(albedo_factor=STEEL), static=True)
    t_s, path_um = (values[growth.rows] if len(values) else np.zeros(1) for values in (t_s, path_um))
    t_s = np.where(np.arange(len(t_s)) == 0, 0.0, t_s)
    _send_meshes(recording, "world/table/workpiece", indexes(t_s, path_um), growth.solids)


def _send_meshes(
    recording: rr.RecordingStream, entity: str, when: list[rr.TimeColumn], meshes: Sequence[Mesh],
    colours: Sequence[NDArray[np.uint8]] | None = None,
) -> None:
    """Log meshes over time, with colours of the vertices if they are not None."""
    per_vertex = rr.Mesh3D.columns(
        vertex_positions=np.concatenate([mesh.positions for mesh in meshes]),
        vertex_normals=np.concatenate([mesh.normals for mesh in meshes]),
        vertex_colors=None if colours is None else np.concatenate(colours),
    ).partition([len(mesh.positions) for mesh in meshes])
    faces = rr.Mesh3D.columns(triangle_indices=np.concatenate([mesh.triangles for mesh in meshes])).partition(
        [len(mesh.triangles) for mesh in meshes]
    )
    recording.send_columns(entity, when, [*per_vertex, *faces])


def log_drawing(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log the drawing on the workpiece, and the edges that were cut."""
    height = scene.height_mm
    steps = [strip for t in scene.terraces for strip in at_height(t.outlines_mm, t.height_mm)]
    log_lines(recording, "world/table/steps", steps, palette.LINE)
    nominal = [m.nominal_mm for m in scene.maps]
    for face, (name, z_mm) in enumerate((("bottom", 0.0), ("top", height))):
        drawn = [wall[face] for wall in scene.walls_mm] or nominal
        log_lines(recording, f"world/table/nominal/{name}", at_height(drawn, z_mm), palette.GREEN)
    last, middle = len(scene.cut_edges_mm) - 1, scene.middle_slice()
    # the outer slices are drawn on the faces, in one plane with the drawing
    for name, index, z_mm in (("bottom", 0, 0.0), ("middle", middle, scene.middle_mm()), ("top", last, height)):
        if last >= 0:
            edges = at_height(scene.cut_edges_mm[index], z_mm)
            log_lines(recording, f"world/table/cut/{name}", edges, palette.SKY)


def log_errors(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log the profile error along the edge, exaggerated and coloured."""
    factor, limit = scene.error_factor(), scene.error_limit_um()
    for index, edge in enumerate(scene.maps):
        pieces, error_um = edge.pieces(factor)
        if len(pieces):
            on_top = at_height(pieces, scene.height_mm)
            lines = rr.LineStrips3D(on_top, colors=palette.error_rgb(error_um, limit), radii=on_screen(1.5))
            recording.log(f"world/table/error/{index}", lines, static=True)


FACE_OFF_MM = 0.02
"""Distance of a pass's drawn face from the metal (ours: the workpiece's wall would cover it otherwise)."""


def log_faces(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log the cut face after every pass, coloured by its deviation from its own mean."""
    for contour in sorted({face.contour for face in scene.pass_faces}):
        faces = [face for face in scene.pass_faces if face.contour == contour]
        meshes = [face_mesh(scene, face) for face in faces]
        colours = [palette.error_rgb(off_um, scene.error_limit_um()) for _, off_um in meshes]
        when = indexes(np.array([face.time_s for face in faces]), np.array([face.path_um for face in faces]))
        _send_meshes(recording, f"world/table/face/{contour}", when, [mesh for mesh, _ in meshes], colours)


def face_mesh(scene: Scene, face: PassFace) -> tuple[Mesh, Floats]:
    """Return the mesh of a face, just off its metal, and every vertex's deviation from the mean in um."""
    edge, count = scene.maps[face.contour], len(face.error_um)
    error = np.concatenate([face.error_um[:1], face.error_um, face.error_um[-1:]])
    heights = np.concatenate([[0.0], (np.arange(count) + 0.5) / count, [1.0]]) * scene.height_mm
    outward = replace(edge, points_mm=face.points_mm).outward()
    walls = scene.walls_mm[face.contour] if scene.walls_mm else (edge.nominal_mm, edge.nominal_mm)
    middle = (walls[0] + walls[1]) / 2
    passed, at = arc_lengths(middle), shapely.line_locate_point(
        shapely.LineString(middle), shapely.points(face.points_mm)
    )
    known = np.isfinite(error)
    filled_um = np.where(known, error, 0.0)
    rows = []
    for z_mm, off_um in zip(heights, filled_um, strict=True):
        share = z_mm / scene.height_mm
        wall = (1 - share) * walls[0] + share * walls[1]
        places = interpolated(at, passed, wall)
        off_mm = outward * (off_um * 1e-3 + FACE_OFF_MM)[:, None]
        rows.append(np.column_stack([places + off_mm, np.full(len(places), z_mm)]))
    triangles = grid_triangles(*error.shape)
    triangles = triangles[known.reshape(-1)[triangles].all(axis=1)]
    normals = np.tile(np.column_stack([outward, np.zeros(len(outward))]), (len(heights), 1))
    mean_um = float(error[known].mean()) if known.any() else 0.0
    mesh = Mesh(np.concatenate(rows).astype(np.float32), normals.astype(np.float32), triangles.astype(np.uint32))
    return mesh, filled_um.reshape(-1) - mean_um


def log_marks(recording: rr.RecordingStream, scene: Scene, factor: float) -> None:
    """Log corners with their errors, start holes, the place where the machine stopped, and the guides."""
    known = [c for c in scene.corners if np.isfinite(c.error_um)]
    corners = [(c.x_mm, c.y_mm, scene.height_mm) for c in known]
    errors = [f"{c.error_um:+.1f}" for c in known]  # short, because labels may cover each other in the viewer
    log_points(recording, "world/table/corners", corners, errors, palette.ORANGE)
    starts = [(float(x), float(y), scene.height_mm) for x, y in scene.starts_mm]
    log_points(recording, "world/table/starts", starts, ["start"] * len(starts), palette.GREEN)
    if scene.stop_mm is not None:
        stop = [(*scene.stop_mm, scene.height_mm)]
        log_points(recording, "world/table/stop", stop, ["stopped here"], palette.VERMILION)
    guides = rr.Points3D(
        [(0.0, 0.0, z_mm) for z_mm in scene.guides_z_mm], colors=[palette.rgb(palette.PURPLE)], radii=on_screen(4.0),
        show_labels=True, labels=["lower guide", f"upper guide, wire deflection × {factor:g}"],
    )  # fmt: skip
    recording.log("world/guides", guides, static=True)


def log_motion(recording: rr.RecordingStream, scene: Scene, shapes: NDArray[np.void], factor: float) -> None:
    """Log table, wire and the path cut so far; the wire's deflection is drawn `factor` times as large."""
    slices = shapes["deflection_um"].shape[1]
    at = np.column_stack([shapes["guides_um"] / 1000.0, np.zeros(len(shapes))])
    when = indexes(shapes["t_s"], shapes["path_um"])
    recording.send_columns("world/cross", when, rr.Transform3D.columns(translation=-at * (1.0, 0.0, 0.0)))
    recording.send_columns("world/table", when, rr.Transform3D.columns(translation=-at))
    look = rr.LineStrips3D.from_fields(colors=[palette.rgb(palette.ORANGE)], radii=[scene.wire_diameter_um / 2000.0])
    wire = rr.LineStrips3D.columns(strips=wire_strips(scene, shapes, factor))
    log_changing(recording, "world/wire", look, when, wire)
    _log_deflection(recording, scene, shapes, factor)
    look = rr.LineStrips3D.from_fields(colors=[palette.rgb(palette.VERMILION)], radii=on_screen(1.2))
    top = at + np.array([0.0, 0.0, scene.height_mm])
    top[:, :2] += scene.lead_mm(shapes["path_um"], np.array([scene.height_mm * (1 - 0.5 / slices)]))[:, 0]
    steps = np.stack([np.vstack([top[:1], top[:-1]]), top], axis=1)
    threaded = jump_rows(shapes["guides_um"], shapes["path_um"])  # no cut on moves between contours
    steps[threaded, 0] = top[threaded]
    log_changing(recording, "world/table/done", look, when, rr.LineStrips3D.columns(strips=steps))


def _log_deflection(recording: rr.RecordingStream, scene: Scene, shapes: NDArray[np.void], factor: float) -> None:
    """Log the deflection at mid height as an arrow from the guides' axis, drawn on the workpiece's top."""
    middle = shapes["deflection_um"][:, shapes["deflection_um"].shape[1] // 2] * (factor / 1000.0)
    vectors = np.column_stack([middle, np.zeros(len(shapes))])
    origin = [(0.0, 0.0, scene.height_mm)]
    look = rr.Arrows3D.from_fields(origins=origin, colors=[palette.rgb(palette.ORANGE)], radii=on_screen(2.0))
    when = indexes(shapes["t_s"], shapes["path_um"])
    log_changing(recording, "world/deflection", look, when, rr.Arrows3D.columns(vectors=vectors))
    axis = rr.Points3D(origin, colors=[palette.rgb(palette.PURPLE)], radii=on_screen(4.0))
    recording.log("world/axis", axis, static=True)


def wire_strips(scene: Scene, shapes: NDArray[np.void], factor: float) -> NDArray[np.float32]:
    """Return the wire's lines from guide to guide, (n, slices + 2, 3) in mm, with `factor` times the deflection."""
    n = shapes["deflection_um"].shape[1]
    z_mm = np.concatenate(
        [[scene.guides_z_mm[0]], scene.height_mm * (np.arange(n) + 0.5) / n, [scene.guides_z_mm[1]]]
    )
    strips = np.zeros((len(shapes), n + 2, 3), np.float32)
    strips[:, 1:-1, :2] = shapes["deflection_um"] * (factor / 1000.0)
    strips[:, :, :2] += scene.lead_mm(shapes["path_um"], z_mm)
    strips[:, :, 2] = z_mm
    return strips


# The gap in the recording: the wall around the wire in um, places of discharges, voltage and current, gas.
#
# The model has a share of gas per slice and no bubbles; one bubble per slice is drawn to show this share.

Closeups = NDArray[np.void]  # rows of `edmsim.recording.windows.row_type`
AGES = 6  # close-ups for which a discharge stays visible, while it fades
SCOPE_PULSES = 12  # pulses on the oscilloscope
SCOPE_WIDTH, VOLTAGE_HEIGHT, CURRENT_HEIGHT, SCOPE_SPACE = 420.0, 50.0, 32.0, 10.0
"""The oscilloscope's screen, in units of its view: width, heights of both traces, space between them."""
_THIN = on_screen(0.5)  # radius of the lines of scales
WALL_UM = 6.0  # half the width in um of the line drawn for metal; its inner side is the metal's edge
_WIRE = (124, 92, 30)
_NARROW_UM = 10.0  # rays with smaller gaps have the colour of shorts; near a spark's critical gap


# --- discharges ---------------------------------------------------------------------------------------------


def discharges(closeups: Closeups, radius_um: float) -> tuple[NDArray[np.bool_], Floats]:
    """Return whether pulses have a place (n, pulses), and their places on the metal, (n, pulses, 2) in um."""
    pulses = closeups["pulses"]
    known = (np.arange(pulses.shape[1]) < closeups["count"][:, None]) & (pulses["slice"] >= 0)
    angle = 2 * np.pi * pulses["ray"] / max(closeups["walls_um"].shape[1], 1)
    out = radius_um + pulses["gap_um"].astype(np.float64)
    place = np.stack([pulses["x_um"] + out * np.cos(angle), pulses["y_um"] + out * np.sin(angle)], axis=-1)
    return known, place


def log_discharges(recording: rr.RecordingStream, scene: Scene, closeups: Closeups) -> None:
    """Log discharges and contacts of the last `AGES` close-ups at their places on the workpiece, in mm."""
    known, place = discharges(closeups, scene.wire_diameter_um / 2)
    n_slices = closeups["deflection_um"].shape[1]
    z_mm = scene.height_mm * (closeups["pulses"]["slice"] + 0.5) / n_slices
    points, colours, radii = [], [], []
    lengths = np.zeros(len(closeups), np.int64)
    for i in range(len(closeups)):
        for age in range(min(AGES, i + 1)):
            j = i - age
            these = np.flatnonzero(known[j])[:: 1 if age == 0 else 2]
            points.append(np.column_stack([place[j, these] / 1000.0, z_mm[j, these]]).astype(np.float32))
            left = np.full(len(these), (1.0 - age / AGES) ** 1.5)
            colours.append(faded(class_rgb(closeups["pulses"]["kind"][j, these]), left))
            radii.append(np.full(len(these), -3.2 + 1.8 * age / AGES, np.float32))
            lengths[i] += len(these)
    columns = rr.Points3D.columns(
        positions=np.concatenate(points), colors=np.concatenate(colours), radii=np.concatenate(radii)
    )
    recording.send_columns(
        "world/table/discharges", indexes(closeups["t_s"], closeups["path_um"]), columns.partition(lengths)
    )


# --- the top view at the wire -------------------------------------------------------------------------------


def log_gap(recording: rr.RecordingStream, scene: Scene, closeups: Closeups) -> None:
    """Log the middle slice's wall around the wire in um; the origin is the guides' axis."""
    when = indexes(closeups["t_s"], closeups["path_um"])
    wire = turned(closeups["wire_um"] - closeups["guides_um"])
    look = rr.Points2D.from_fields(colors=[_WIRE], radii=[scene.wire_diameter_um / 2], draw_order=10.0)
    log_changing(recording, "top/wire", look, when, rr.Points2D.columns(positions=wire))
    _log_walls(recording, scene, closeups, wire)
    known, place = discharges(closeups, scene.wire_diameter_um / 2)
    shift = turned(place - closeups["guides_um"][:, None, :])
    left = np.linspace(0.25, 1.0, known.shape[1])
    colours = faded(class_rgb(closeups["pulses"]["kind"][known]), np.broadcast_to(left, known.shape)[known])
    columns = rr.Points2D.columns(positions=shift[known], colors=colours, radii=np.full(known.sum(), 4.0))
    look = rr.Points2D.from_fields(draw_order=60.0)
    log_changing(recording, "top/discharges", look, when, columns.partition(known.sum(axis=1)))
    away = np.column_stack([-turned(closeups["guides_um"]), np.zeros(len(closeups))])
    recording.send_columns("top/part", when, rr.Transform3D.columns(translation=away))


def log_gap_marks(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log static lines of the top view: a cross, circles every 50 um, and the part's edge as drawn."""
    angle = np.linspace(0.0, 2 * np.pi, 73)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    rings = [radius * circle for radius in (50.0, 100.0, 150.0, 200.0, 250.0)]
    cross = [[(-8, 0), (8, 0)], [(0, -8), (0, 8)]]
    recording.log("top/scale", rr.LineStrips2D([*cross, *rings], colors=[(58, 68, 80)], radii=_THIN), static=True)
    _log_labels(recording, "top/scale/um", [(0.0, -100.0, "100 µm"), (0.0, -150.0, "150"), (0.0, -200.0, "200")])
    nominal = [turned(edge * 1000.0) for edge in scene.as_drawn_mm(scene.middle_mm())]
    if nominal:
        lines = rr.LineStrips2D(nominal, colors=[palette.rgb(palette.GREEN)], radii=on_screen(0.8))
        recording.log("top/part/nominal", lines, static=True)


def _log_walls(recording: rr.RecordingStream, scene: Scene, closeups: Closeups, wire: Floats) -> None:
    """Log every ray that meets metal, and the metal's edge as lines between their ends."""
    gaps = closeups["walls_um"].astype(np.float64)
    angle = 2 * np.pi * np.arange(gaps.shape[1]) / max(gaps.shape[1], 1)
    direction = np.column_stack([np.cos(angle), -np.sin(angle)])
    radius = scene.wire_diameter_um / 2
    meets = gaps < RAY_RANGE_UM
    ends = wire[:, None, :] + (radius + gaps)[..., None] * direction
    starts = np.broadcast_to(wire[:, None, :] + radius * direction, ends.shape)
    when = indexes(closeups["t_s"], closeups["path_um"])
    near = np.clip((gaps[meets] - _NARROW_UM) / (RAY_RANGE_UM - _NARROW_UM), 0.0, 1.0)[:, None]
    colours = palette.rgb(palette.VERMILION) * (1 - near) + np.array((70, 82, 96)) * near
    lines = np.stack([starts[meets], ends[meets]], axis=1)
    rays = rr.LineStrips2D.columns(strips=lines, colors=colours.astype(np.uint8))
    recording.send_columns("top/rays", when, rays.partition(meets.sum(axis=1)))
    # a piece of wall for two neighbouring rays that both meet metal, unless one meets another wall
    after = np.roll(np.arange(gaps.shape[1]), -1)
    wall = meets & meets[:, after] & (np.abs(gaps - gaps[:, after]) < radius)
    behind = wire[:, None, :] + (radius + gaps + WALL_UM)[..., None] * direction
    pieces = np.stack([behind[wall], behind[:, after][wall]], axis=1)
    look = rr.LineStrips2D.from_fields(colors=[palette.rgb(palette.MUTED)], radii=[WALL_UM])
    columns = rr.LineStrips2D.columns(strips=pieces).partition(wall.sum(axis=1))
    log_changing(recording, "top/metal", look, when, columns)


# --- the oscilloscope ---------------------------------------------------------------------------------------


def log_scope(recording: rr.RecordingStream, closeups: Closeups) -> None:
    """Log gap voltage and current of the last pulses, coloured by class, and the oscilloscope's scales."""
    time, voltage, current = traces(closeups, SCOPE_PULSES)
    span_us = float(time.max())
    spans = tuple((float(values.min()), float(values.max())) for values in (voltage, current))
    last = np.maximum(closeups["count"][:, None] - SCOPE_PULSES + np.arange(SCOPE_PULSES), 0)
    kinds = np.take_along_axis(closeups["pulses"], last, axis=1)["kind"]
    colours = class_rgb(kinds).reshape(-1, 3)
    when = indexes(closeups["t_s"], closeups["path_um"])
    for name, values, (foot, scale) in zip(("voltage", "current"), (voltage, current), _feet(spans), strict=True):
        across = time * (SCOPE_WIDTH / max(span_us, 1e-9))
        strips = np.stack([across, foot - values * scale], axis=-1).astype(np.float32)
        look = rr.LineStrips2D.from_fields(radii=on_screen(1.3))
        columns = rr.LineStrips2D.columns(strips=strips.reshape(-1, time.shape[-1], 2), colors=colours)
        log_changing(recording, f"scope/{name}", look, when, columns.partition([SCOPE_PULSES] * len(closeups)))
    _log_scales(recording, span_us, spans)


def _feet(spans: Sequence[tuple[float, float]]) -> Iterator[tuple[float, float]]:
    """Yield the place of each trace's zero on the screen, and its scale, from its least and greatest value."""
    lowest = VOLTAGE_HEIGHT, VOLTAGE_HEIGHT + SCOPE_SPACE + CURRENT_HEIGHT
    for (least, most), height, low in zip(spans, (VOLTAGE_HEIGHT, CURRENT_HEIGHT), lowest, strict=True):
        scale = height / max(most - least, 1e-9)
        yield low + least * scale, scale


def _log_scales(recording: rr.RecordingStream, span_us: float, spans: Sequence[tuple[float, float]]) -> None:
    low = VOLTAGE_HEIGHT + SCOPE_SPACE + CURRENT_HEIGHT
    marks: list[tuple[float, float, str]] = []
    lines: list[list[tuple[float, float]]] = []
    for (least, most), unit, (foot, scale) in zip(spans, "VA", _feet(spans), strict=True):
        for value in _ticks(most, 3, least):
            y = foot - value * scale
            marks.append((-6.0, y, f"{value:g} {unit}"))
            lines.append([(0.0, y), (SCOPE_WIDTH, y)])
    for value in _ticks(span_us, 6):
        x = value * SCOPE_WIDTH / max(span_us, 1e-9)
        marks.append((x, low + 6.0, f"{value:g} µs"))
        lines.append([(x, 0.0), (x, low)])
    recording.log("scope/grid", rr.LineStrips2D(lines, colors=[(52, 60, 70)], radii=_THIN), static=True)
    _log_labels(recording, "scope/scale", marks)


def _log_labels(recording: rr.RecordingStream, entity: str, labels: Sequence[tuple[float, float, str]]) -> None:
    """Log the static labels of a scale, each with its place."""
    places, texts = [(x, y) for x, y, _ in labels], [text for *_, text in labels]
    grey = [palette.rgb(palette.MUTED)]
    recording.log(entity, rr.Points2D(places, labels=texts, show_labels=True, colors=grey, radii=_THIN), static=True)


def _ticks(most: float, count: int, least: float = 0.0) -> list[float]:
    """Return round values from `least`, which is 0 or below, to `most`; about `count` of them are above 0."""
    if not most > 0.0:
        return [0.0]
    decade = 10.0 ** math.floor(math.log10(most / count))
    step = next(s * decade for s in (1.0, 2.0, 5.0, 10.0) if most / (s * decade) <= count + 0.5)
    return [step * k for k in range(int(least / step * (1 + 1e-9)), int(most / step * (1 + 1e-9)) + 1)]


SMALLEST = 0.05  # least share of gas for which a bubble is drawn; less would be invisible (ours)
_OPACITY = 150  # of 255


def travel_at(windows: pa.Table, t_s: Floats) -> Floats:
    """Return the direction of travel (n, 2) at the ends (n,) of some of the windows."""
    row = np.searchsorted(column(windows, "t_s"), t_s)
    return travel_direction(windows)[np.minimum(row, len(windows) - 1)]


def log_coverage(recording: rr.RecordingStream, scene: Scene, shapes: NDArray[np.void]) -> None:
    """Log the share of the front that gas covers, a curve per slice."""
    n, slices = shapes["coverage"].shape
    high = np.linspace(0.0, 1.0, slices)[:, None]
    colours = palette.rgb(palette.PURPLE) * (1 - high) + np.array(palette.rgb(palette.GREEN)) * high
    names = [f"{scene.height_mm * (s + 0.5) / slices:.1f} mm" for s in range(slices)]
    look = rr.SeriesLines(names=names, colors=colours.astype(np.uint8), widths=[0.8] * slices)
    curves = rr.Scalars.columns(scalars=shapes["coverage"].ravel()).partition([slices] * n)
    log_changing(recording, "slices/coverage", look, indexes(shapes["t_s"], shapes["path_um"]), curves)


def log_bubbles(
    recording: rr.RecordingStream, scene: Scene, shapes: NDArray[np.void], travel: Floats, factor: float
) -> None:
    """Log a bubble for every slice on the front of the drawn wire, in mm."""
    # in a fully covered slice it is as wide as the slice is high; otherwise its area is smaller by the share
    slices = shapes["coverage"].shape[1]
    centre = wire_strips(scene, shapes, factor)[:, 1:-1]
    centre[..., :2] += travel[:, None] * (scene.wire_diameter_um / 2000.0)
    shown = shapes["coverage"] >= SMALLEST
    radius_mm = np.sqrt(shapes["coverage"][shown]) * (scene.height_mm / slices / 2)
    look = rr.Ellipsoids3D.from_fields(
        colors=[(*palette.rgb(palette.GAS), _OPACITY)], fill_mode=rr.components.FillMode.Solid
    )  # fmt: skip
    columns = rr.Ellipsoids3D.columns(half_sizes=np.repeat(radius_mm[:, None], 3, axis=1), centers=centre[shown])
    when = indexes(shapes["t_s"], shapes["path_um"])
    log_changing(recording, "world/gas", look, when, columns.partition(shown.sum(axis=1)))


def log_top_bubbles(recording: rr.RecordingStream, scene: Scene, closeups: NDArray[np.void]) -> None:
    """Log a bubble for every slice, at its last discharge, in um in the top view."""
    # along the wire as long as the covered share of its front half in the slice; across, from the wire to the
    # metal at mid height
    radius, covered, pulses = scene.wire_diameter_um / 2, closeups["coverage"], closeups["pulses"]
    burned = discharges(closeups, radius)[0] & np.isin(pulses["kind"], (SPARK, ARC))
    here = burned[..., None] & (pulses["slice"][..., None] == np.arange(covered.shape[1]))
    last = burned.shape[1] - 1 - np.argmax(here[:, ::-1], axis=1)
    ray = np.take_along_axis(pulses["ray"], last, axis=1).astype(np.int64)
    gap = np.take_along_axis(closeups["walls_um"], ray, axis=1).astype(np.float64)
    shown = here.any(axis=1) & (covered >= SMALLEST) & (gap < RAY_RANGE_UM)
    angle, gap = 2 * np.pi * ray[shown] / closeups["walls_um"].shape[1], gap[shown]
    long = covered[shown] * (np.pi * radius)
    width, middle = np.minimum(gap, long), radius + gap / 2
    half = np.maximum(long - width, 0.1) / 2 / middle  # without the round ends
    arc = angle[:, None] + half[:, None] * np.linspace(-1.0, 1.0, 9)
    wire = np.repeat(closeups["wire_um"] - closeups["guides_um"], shown.sum(axis=1), axis=0)
    strips = wire[:, None] + middle[:, None, None] * np.stack([np.cos(arc), np.sin(arc)], axis=-1)
    # blended and drawn below the rays, because lines of this view cannot be translucent
    pale = faded(np.array([palette.rgb(palette.GAS)], np.uint8), np.array([0.65]))
    look = rr.LineStrips2D.from_fields(colors=pale, draw_order=15.0)
    columns = rr.LineStrips2D.columns(strips=turned(strips).astype(np.float32), radii=width / 2)
    when = indexes(closeups["t_s"], closeups["path_um"])
    log_changing(recording, "top/gas", look, when, columns.partition(shown.sum(axis=1)))
