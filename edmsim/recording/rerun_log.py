"""``cut.rrd``: the cut as a rerun recording, table and wire in 3D beside the series of the windows.

The world is the machine: wire and guides stand still, the table with the workpiece moves. The top view is
seen from the table, so that there the wire moves along the drawing.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from edmsim.recording import palette
from edmsim.recording.blueprint import ELECTRICAL, PATH, PROCESS, TIME, blueprint
from edmsim.recording.frames import Frames
from edmsim.recording.report import duration_text, figure_text
from edmsim.recording.scene import Scene, round_factor
from edmsim.recording.windows import column, lag_along_um

if TYPE_CHECKING:
    import pyarrow as pa
    import rerun as rr

MAX_ROWS = 20_000
"""Most rows of a series; a longer table is averaged in groups."""


def write_recording(
    file: str | Path, scene: Scene, windows: pa.Table, frames: Frames, report: Mapping[str, Any], title: str
) -> None:
    """Write the recording; equal cuts give equal recordings, whatever the computer took for them.

    Parameters
    ----------
    file : path
        Replaced whole or not at all.
    scene : Scene
        Drawing, cut edges, error, corners.
    windows : pyarrow.Table
        The table of windows.
    frames : Frames
        The wire's shape.
    report : mapping
        Of `edmsim.recording.report.build_report`.
    title : str
        What was cut, usually the program's name.
    """
    import rerun as rr

    target = Path(file)
    partial = target.with_name(target.name + ".part")
    factor = round_factor(np.hypot(*np.moveaxis(frames.deflection_um, -1, 0)).ravel(), 0.05 * scene.size_mm())
    recording = rr.RecordingStream("edmsim", recording_id=recording_id(report), send_properties=False)
    recording.save(partial, default_blueprint=blueprint(scene, frames, factor))
    recording.send_recording_name(title)
    _log_workpiece(recording, scene)
    _log_errors(recording, scene)
    _log_marks(recording, scene)
    _log_motion(recording, scene, frames, factor)
    group = _log_series(recording, windows)
    recording.log(
        "about",
        rr.TextDocument(about(scene, frames, report, title, factor, group), media_type=rr.MediaType.MARKDOWN),
        static=True,
    )
    recording.flush()
    recording.disconnect()
    partial.replace(target)


def recording_id(report: Mapping[str, Any]) -> str:
    """Return the recording's identity: a digest of version, seed and settings."""
    made_with = {key: report[key] for key in ("edmsim_version", "seed", "settings")}
    return hashlib.sha256(json.dumps(made_with, sort_keys=True).encode()).hexdigest()[:32]


def about(
    scene: Scene, frames: Frames, report: Mapping[str, Any], title: str, factor: float, group: int
) -> str:
    """Return what a viewer of the recording needs to know, as Markdown."""
    profile = report["profile_error_um"]
    lines = [
        f"# {title}",
        f"**{report['outcome']}**" + (f": {report['reason']}" if report["reason"] else ""),
        f"{duration_text(report['machining_time_s'])}, {figure_text(report['path_length_mm'], 'mm', 2)}, "
        f"{figure_text(report['cutting_rate_mm2_min'], 'mm²/min')}, profile error "
        f"{figure_text(profile['max'], 'µm')} max, {figure_text(profile['rms'], 'µm')} rms",
        "## How it is drawn",
        "- In the machine view the wire stands and the table moves; the top view moves with the table.",
        f"- Wire deflection is drawn **× {factor:g}**, the profile error **× {scene.error_factor():g}** "
        "(blue: too much removed, orange: metal left). All else is to scale, in mm.",
        f"- One frame of the wire for every {frames.stride} windows; a point of a series is "
        + ("one window." if group == 1 else f"the mean of {group} windows."),
        "## Settings",
        f"- seed: {report['seed']}",
        *(f"- {key}: {value}" for key, value in report["settings"].items()),
    ]
    return "\n\n".join(lines[:3]) + "\n\n" + "\n".join(lines[3:])


# --- what stands and what moves ----------------------------------------------------------------------------


def _on_screen(points: float) -> list[float]:
    """Return a radius in points of the screen, which rerun tells from a length by its sign."""
    return [-points]


def _at_height(lines: Iterable[NDArray[np.float64]], z_mm: float) -> list[NDArray[np.float64]]:
    return [np.column_stack([line, np.full(len(line), z_mm)]) for line in lines]


def _log_workpiece(recording: rr.RecordingStream, scene: Scene) -> None:
    import rerun as rr

    x0, y0, x1, y1 = scene.stock_mm
    plate, height = 0.08 * scene.height_mm, scene.height_mm
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for name, low, high, colour in (
        ("plate", -plate, 0.0, palette.MUTED),
        ("blank", 0.0, height, palette.LINE),
    ):
        box = rr.Boxes3D(
            mins=[(x0, y0, low)],
            sizes=[(x1 - x0, y1 - y0, high - low)],
            colors=[palette.rgb(colour)],
            fill_mode=rr.components.FillMode.MajorWireframe,
        )
        recording.log(f"world/table/{name}", box, static=True)
    steps = [strip for t in scene.terraces for strip in _at_height(t.outlines_mm, t.height_mm)]
    _log_lines(recording, "world/table/steps", steps, palette.LINE)
    nominal = [m.nominal_mm for m in scene.maps]
    for name, z_mm in (("bottom", 0.0), ("top", height)):
        _log_lines(recording, f"world/table/nominal/{name}", _at_height(nominal, z_mm), palette.GREEN)
    last, middle = len(scene.cut_edges_mm) - 1, scene.middle_slice()
    # The outer slices are drawn on the faces, to lie in one plane with the drawing.
    for name, index, z_mm in (("bottom", 0, 0.0), ("middle", middle, scene.middle_mm()), ("top", last, height)):
        if last >= 0:
            edges = _at_height(scene.cut_edges_mm[index], z_mm)
            _log_lines(recording, f"world/table/cut/{name}", edges, palette.SKY)


def _log_lines(
    recording: rr.RecordingStream, entity: str, strips: list[NDArray[np.float64]], colour: str
) -> None:
    import rerun as rr

    if strips:
        lines = rr.LineStrips3D(strips, colors=[palette.rgb(colour)], radii=_on_screen(0.8))
        recording.log(entity, lines, static=True)


def _log_errors(recording: rr.RecordingStream, scene: Scene) -> None:
    import rerun as rr

    factor, limit = scene.error_factor(), scene.error_limit_um()
    for index, edge in enumerate(scene.maps):
        shown = np.column_stack([edge.exaggerated_mm(factor), np.full(len(edge.points_mm), scene.height_mm)])
        good = edge.smooth() & np.isfinite(edge.error_um[:-1]) & np.isfinite(edge.error_um[1:])
        if good.any():
            pieces = np.stack([shown[:-1], shown[1:]], axis=1)[good]
            colours = palette.error_rgb(edge.error_um[:-1][good], limit)
            lines = rr.LineStrips3D(pieces, colors=colours, radii=_on_screen(1.5))
            recording.log(f"world/table/error/{index}", lines, static=True)


def _log_marks(recording: rr.RecordingStream, scene: Scene) -> None:
    import rerun as rr

    known = [c for c in scene.corners if np.isfinite(c.error_um)]
    _log_points(
        recording,
        "world/table/corners",
        [(c.x_mm, c.y_mm, scene.height_mm) for c in known],
        [f"{c.error_um:+.1f} µm" for c in known],
        palette.ORANGE,
    )
    starts = [(float(x), float(y), scene.height_mm) for x, y in scene.starts_mm]
    _log_points(recording, "world/table/starts", starts, ["start"] * len(starts), palette.GREEN)
    if scene.stop_mm is not None:
        _log_points(
            recording,
            "world/table/stop",
            [(*scene.stop_mm, scene.height_mm)],
            ["stopped here"],
            palette.VERMILION,
        )
    guides = [(0.0, 0.0, z_mm) for z_mm in scene.guides_z_mm]
    recording.log(
        "world/guides",
        rr.Points3D(guides, colors=[palette.rgb(palette.PURPLE)], radii=_on_screen(5.0)),
        static=True,
    )


def _log_points(
    recording: rr.RecordingStream,
    entity: str,
    places: list[tuple[float, float, float]],
    labels: list[str],
    colour: str,
) -> None:
    import rerun as rr

    if places:
        points = rr.Points3D(places, labels=labels, colors=[palette.rgb(colour)], radii=_on_screen(4.0))
        recording.log(entity, points, static=True)


def _log_motion(recording: rr.RecordingStream, scene: Scene, frames: Frames, factor: float) -> None:
    import rerun as rr

    if len(frames) == 0:
        return
    at = np.column_stack([frames.guides_um / 1000.0, np.zeros(len(frames))])
    indexes = _indexes(frames.t_s, frames.path_um)
    recording.send_columns("world/table", indexes, rr.Transform3D.columns(translation=-at))
    recording.log(
        "world/wire",
        rr.LineStrips3D.from_fields(colors=[palette.rgb(palette.ORANGE)], radii=_on_screen(2.0)),
        static=True,
    )
    recording.send_columns(
        "world/wire", indexes, rr.LineStrips3D.columns(strips=wire_strips(scene, frames, factor))
    )
    _log_deflection(recording, scene, frames, factor)
    recording.log(
        "world/table/done",
        rr.LineStrips3D.from_fields(colors=[palette.rgb(palette.VERMILION)], radii=_on_screen(1.2)),
        static=True,
    )
    top = at + np.array([0.0, 0.0, scene.height_mm])
    steps = np.stack([np.vstack([top[:1], top[:-1]]), top], axis=1)
    recording.send_columns("world/table/done", indexes, rr.LineStrips3D.columns(strips=steps))


def _log_deflection(recording: rr.RecordingStream, scene: Scene, frames: Frames, factor: float) -> None:
    """Log the deflection at mid height as an arrow from the guides' axis, drawn on the workpiece's top."""
    import rerun as rr

    middle = frames.deflection_um[:, frames.n_slices // 2] * (factor / 1000.0)
    vectors = np.column_stack([middle, np.zeros(len(frames))])
    recording.log(
        "world/deflection",
        rr.Arrows3D.from_fields(
            origins=[(0.0, 0.0, scene.height_mm)],
            colors=[palette.rgb(palette.ORANGE)],
            radii=_on_screen(2.0),
        ),
        static=True,
    )
    recording.send_columns(
        "world/deflection", _indexes(frames.t_s, frames.path_um), rr.Arrows3D.columns(vectors=vectors)
    )
    recording.log(
        "world/axis",
        rr.Points3D(
            [(0.0, 0.0, scene.height_mm)],
            colors=[palette.rgb(palette.PURPLE)],
            radii=_on_screen(4.0),
        ),
        static=True,
    )


def wire_strips(scene: Scene, frames: Frames, factor: float) -> NDArray[np.float32]:
    """Return the wire of every frame in machine coordinates, shape (n, n_slices + 2, 3) in mm.

    From the lower guide through the middle of every slice to the upper guide; deflection times `factor`.
    """
    n = frames.n_slices
    z_mm = np.concatenate(
        [[scene.guides_z_mm[0]], scene.height_mm * (np.arange(n) + 0.5) / n, [scene.guides_z_mm[1]]]
    )
    strips = np.zeros((len(frames), n + 2, 3), np.float32)
    strips[:, 1:-1, :2] = frames.deflection_um * (factor / 1000.0)
    strips[:, :, 2] = z_mm
    return strips


# --- the series --------------------------------------------------------------------------------------------


def _indexes(t_s: NDArray[np.float64], path_um: NDArray[np.float64]) -> list[rr.TimeColumn]:
    import rerun as rr

    return [
        rr.TimeColumn(TIME, duration=t_s),
        rr.TimeColumn(PATH, sequence=np.round(path_um).astype(np.int64)),
    ]


def _log_series(recording: rr.RecordingStream, windows: pa.Table) -> int:
    """Log every series; return how many windows each of its points is the mean of."""
    import rerun as rr

    rows = len(windows)
    group = max(1, -(-rows // MAX_ROWS))
    if rows == 0:
        return group
    t_s, path_um = (grouped(column(windows, name), group) for name in ("t_s", "path_um"))
    for plot in PROCESS + ELECTRICAL:
        for series in plot.series:
            entity = f"{plot.origin}/{series.entity}"
            line = rr.SeriesLines(names=[series.name], colors=[palette.rgb(series.colour)], widths=[1.3])
            recording.log(entity, line, static=True)
            values = grouped(_values(windows, series.entity), group)
            known = np.isfinite(values)
            recording.send_columns(
                entity, _indexes(t_s[known], path_um[known]), rr.Scalars.columns(scalars=values[known])
            )
    return group


def _values(windows: pa.Table, name: str) -> NDArray[np.float64]:
    """Return a column of the table; wire lag along the feed, pulse counts as a share in percent."""
    if name == "lag_um":
        return lag_along_um(windows)
    if name in ("short", "open", "spark", "arc"):
        total = sum(column(windows, kind) for kind in ("short", "open", "spark", "arc"))
        return np.asarray(100.0 * column(windows, name) / np.maximum(total, 1.0))
    return column(windows, name)


def grouped(values: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Return the mean of every `size` neighbours, the last group may be shorter; NaN is left out."""
    starts = np.arange(0, len(values), size)
    known = np.isfinite(values)
    counts = np.add.reduceat(known.astype(float), starts)
    sums = np.add.reduceat(np.where(known, values, 0.0), starts)
    return np.asarray(np.divide(sums, counts, out=np.full(len(starts), np.nan), where=counts > 0))
