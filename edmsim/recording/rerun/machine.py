"""The machine in the recording: its bodies, the workpiece with the growing kerf, wire, drawing and errors.

The world is the machine: wire and guides stand still, the table with the workpiece moves.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmsim.recording.figures import palette
from edmsim.recording.frames import Frames
from edmsim.recording.pauses import jump_rows
from edmsim.recording.rerun.bodies import BASE, CROSS, TABLE, Bodies
from edmsim.recording.rerun.solid import Growth
from edmsim.recording.rerun.stream import at_height, indexes, log_lines, log_points, on_screen
from edmsim.recording.scene import Scene

if TYPE_CHECKING:
    import rerun as rr

STEEL = (142, 152, 172, 140)
"""Colour of the workpiece; a little of what is in the kerf shines through."""
_PLACES = {BASE: "world/base", CROSS: "world/cross/carriage", TABLE: "world/table/carriage"}


class Shapes:
    """The wire and the gas on it over the cut: frames and close-ups together, in order of time.

    Attributes
    ----------
    t_s, path_um : float64 arrays (n,)
    guides_um : float64 array (n, 2)
    deflection_um : float64 array (n, slices, 2)
    coverage : float32 array (n, slices)
    """

    def __init__(self, frames: Frames, closeups: NDArray[np.void]) -> None:
        times = np.concatenate([frames.t_s, closeups["t_s"]])
        self.t_s, first = np.unique(times, return_index=True)
        self.path_um = np.concatenate([frames.path_um, closeups["path_um"]])[first]
        self.guides_um = np.concatenate([frames.guides_um, closeups["guides_um"]])[first]
        self.deflection_um = np.concatenate([frames.deflection_um, closeups["deflection_um"]])[first]
        self.coverage = np.concatenate([frames.coverage, closeups["coverage"]])[first]

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.t_s)


def log_bodies(recording: rr.RecordingStream, bodies: Bodies) -> None:
    """Log the machine's bodies, and the edges of the plate its drawing has for a workpiece."""
    import rerun as rr

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


def log_workpiece(
    recording: rr.RecordingStream, growth: Growth, t_s: NDArray[np.float64], path_um: NDArray[np.float64]
) -> None:
    """Log the workpiece as a solid while the kerf grows; `t_s` and `path_um` are the windows'."""
    import rerun as rr

    recording.log("world/table/workpiece", rr.Mesh3D.from_fields(albedo_factor=STEEL), static=True)
    t_s, path_um = (values[growth.rows] if len(values) else np.zeros(1) for values in (t_s, path_um))
    t_s = np.where(np.arange(len(t_s)) == 0, 0.0, t_s)
    solids = growth.solids
    per_vertex = rr.Mesh3D.columns(
        vertex_positions=np.concatenate([s.positions for s in solids]),
        vertex_normals=np.concatenate([s.normals for s in solids]),
    ).partition([len(s.positions) for s in solids])
    faces = rr.Mesh3D.columns(triangle_indices=np.concatenate([s.triangles for s in solids])).partition(
        [len(s.triangles) for s in solids]
    )
    recording.send_columns("world/table/workpiece", indexes(t_s, path_um), [*per_vertex, *faces])


def log_drawing(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log the drawing on the workpiece, and the edges that were cut."""
    height = scene.height_mm
    steps = [strip for t in scene.terraces for strip in at_height(t.outlines_mm, t.height_mm)]
    log_lines(recording, "world/table/steps", steps, palette.LINE)
    nominal = [m.nominal_mm for m in scene.maps]
    for name, z_mm in (("bottom", 0.0), ("top", height)):
        log_lines(recording, f"world/table/nominal/{name}", at_height(nominal, z_mm), palette.GREEN)
    last, middle = len(scene.cut_edges_mm) - 1, scene.middle_slice()
    # The outer slices are drawn on the faces, to lie in one plane with the drawing.
    for name, index, z_mm in (("bottom", 0, 0.0), ("middle", middle, scene.middle_mm()), ("top", last, height)):
        if last >= 0:
            edges = at_height(scene.cut_edges_mm[index], z_mm)
            log_lines(recording, f"world/table/cut/{name}", edges, palette.SKY)


def log_errors(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log the profile error along the edge, exaggerated and coloured."""
    import rerun as rr

    factor, limit = scene.error_factor(), scene.error_limit_um()
    for index, edge in enumerate(scene.maps):
        shown = np.column_stack([edge.exaggerated_mm(factor), np.full(len(edge.points_mm), scene.height_mm)])
        good = edge.smooth() & np.isfinite(edge.error_um[:-1]) & np.isfinite(edge.error_um[1:])
        if good.any():
            pieces = np.stack([shown[:-1], shown[1:]], axis=1)[good]
            colours = palette.error_rgb(edge.error_um[:-1][good], limit)
            lines = rr.LineStrips3D(pieces, colors=colours, radii=on_screen(1.5))
            recording.log(f"world/table/error/{index}", lines, static=True)


def log_marks(recording: rr.RecordingStream, scene: Scene, factor: float) -> None:
    """Log corners with their errors, start holes, where the machine stopped, and the guides."""
    import rerun as rr

    known = [c for c in scene.corners if np.isfinite(c.error_um)]
    log_points(
        recording,
        "world/table/corners",
        [(c.x_mm, c.y_mm, scene.height_mm) for c in known],
        [f"{c.error_um:+.1f}" for c in known],  # short: the viewer lets labels cover each other
        palette.ORANGE,
    )
    starts = [(float(x), float(y), scene.height_mm) for x, y in scene.starts_mm]
    log_points(recording, "world/table/starts", starts, ["start"] * len(starts), palette.GREEN)
    if scene.stop_mm is not None:
        log_points(
            recording,
            "world/table/stop",
            [(*scene.stop_mm, scene.height_mm)],
            ["stopped here"],
            palette.VERMILION,
        )
    guides = [(0.0, 0.0, z_mm) for z_mm in scene.guides_z_mm]
    recording.log(
        "world/guides",
        rr.Points3D(
            guides, colors=[palette.rgb(palette.PURPLE)], radii=on_screen(4.0), show_labels=True,
            labels=["lower guide", f"upper guide, wire deflection × {factor:g}"],
        ),
        static=True,
    )  # fmt: skip


def log_motion(recording: rr.RecordingStream, scene: Scene, shapes: Shapes, factor: float) -> None:
    """Log table, wire and the path cut so far; the wire's deflection is drawn `factor` times as large."""
    import rerun as rr

    if len(shapes) == 0:
        return
    at = np.column_stack([shapes.guides_um / 1000.0, np.zeros(len(shapes))])
    when = indexes(shapes.t_s, shapes.path_um)
    recording.send_columns("world/cross", when, rr.Transform3D.columns(translation=-at * (1.0, 0.0, 0.0)))
    recording.send_columns("world/table", when, rr.Transform3D.columns(translation=-at))
    recording.log(
        "world/wire",
        rr.LineStrips3D.from_fields(colors=[palette.rgb(palette.ORANGE)], radii=[scene.wire_diameter_um / 2000.0]),
        static=True,
    )
    recording.send_columns("world/wire", when, rr.LineStrips3D.columns(strips=wire_strips(scene, shapes, factor)))
    _log_deflection(recording, scene, shapes, factor)
    recording.log(
        "world/table/done",
        rr.LineStrips3D.from_fields(colors=[palette.rgb(palette.VERMILION)], radii=on_screen(1.2)),
        static=True,
    )
    top = at + np.array([0.0, 0.0, scene.height_mm])
    steps = np.stack([np.vstack([top[:1], top[:-1]]), top], axis=1)
    threaded = jump_rows(shapes.guides_um, shapes.path_um)  # nothing is cut on the way to the next contour
    steps[threaded, 0] = top[threaded]
    recording.send_columns("world/table/done", when, rr.LineStrips3D.columns(strips=steps))


def _log_deflection(recording: rr.RecordingStream, scene: Scene, shapes: Shapes, factor: float) -> None:
    """Log the deflection at mid height as an arrow from the guides' axis, drawn on the workpiece's top."""
    import rerun as rr

    middle = shapes.deflection_um[:, shapes.deflection_um.shape[1] // 2] * (factor / 1000.0)
    vectors = np.column_stack([middle, np.zeros(len(shapes))])
    origin = [(0.0, 0.0, scene.height_mm)]
    recording.log(
        "world/deflection",
        rr.Arrows3D.from_fields(origins=origin, colors=[palette.rgb(palette.ORANGE)], radii=on_screen(2.0)),
        static=True,
    )
    recording.send_columns(
        "world/deflection", indexes(shapes.t_s, shapes.path_um), rr.Arrows3D.columns(vectors=vectors)
    )
    recording.log(
        "world/axis",
        rr.Points3D(origin, colors=[palette.rgb(palette.PURPLE)], radii=on_screen(4.0)),
        static=True,
    )


def wire_strips(scene: Scene, shapes: Shapes, factor: float) -> NDArray[np.float32]:
    """Return the wire of every shape in machine coordinates, (n, slices + 2, 3) in mm.

    From the lower guide through the middle of every slice to the upper guide; deflection times `factor`.
    """
    n = shapes.deflection_um.shape[1]
    z_mm = np.concatenate(
        [[scene.guides_z_mm[0]], scene.height_mm * (np.arange(n) + 0.5) / n, [scene.guides_z_mm[1]]]
    )
    strips = np.zeros((len(shapes), n + 2, 3), np.float32)
    strips[:, 1:-1, :2] = shapes.deflection_um * (factor / 1000.0)
    strips[:, :, 2] = z_mm
    return strips
