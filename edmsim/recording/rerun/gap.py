"""The gap in the recording: the wall round the wire in um, discharges in their places, voltage and current, gas.

The model knows a share of gas per slice and no bubbles: those drawn, one for a slice, only show it.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from edmsim.geometry import Floats
from edmsim.plant.constants import RAY_RANGE_UM
from edmsim.plant.kernel.state import ARC, SPARK
from edmsim.recording.figures import palette
from edmsim.recording.rerun.machine import wire_strips
from edmsim.recording.rerun.stream import class_rgb, faded, indexes, log_changing, on_screen, turned
from edmsim.recording.scene import Scene
from edmsim.recording.stores import traces
from edmsim.recording.windows import column, travel_direction

Closeups = NDArray[np.void]  # rows of `edmsim.recording.stores.row_type`

AGES = 6  # a discharge is still to be seen in this many close-ups, ever fainter
SCOPE_PULSES = 12  # pulses on the oscilloscope
SCOPE_WIDTH, VOLTAGE_HEIGHT, CURRENT_HEIGHT, SCOPE_SPACE = 420.0, 50.0, 32.0, 10.0
"""The oscilloscope's screen, in units of its view: width, heights of both traces, what lies between them."""
WALL_UM = 6.0  # half the width in um of the line that stands for the metal; its inner side is the metal's edge
_WIRE = (124, 92, 30)
_NARROW_UM = 10.0  # a ray with a gap up to this is drawn in the colour of shorts; near the critical gap a spark finds


# --- discharges ---------------------------------------------------------------------------------------------


def discharges(closeups: Closeups, radius_um: float) -> tuple[NDArray[np.bool_], Floats]:
    """Return which pulses have a place (n, pulses), and where on the metal it is: (n, pulses, 2) in um."""
    pulses = closeups["pulses"]
    known = (np.arange(pulses.shape[1]) < closeups["count"][:, None]) & (pulses["slice"] >= 0)
    angle = 2 * np.pi * pulses["ray"] / max(closeups["walls_um"].shape[1], 1)
    out = radius_um + pulses["gap_um"].astype(np.float64)
    place = np.stack([pulses["x_um"] + out * np.cos(angle), pulses["y_um"] + out * np.sin(angle)], axis=-1)
    return known, place


def log_discharges(recording: rr.RecordingStream, scene: Scene, closeups: Closeups) -> None:
    """Log discharges and contacts where they were on the workpiece, in mm; the last `AGES` close-ups of them."""
    if len(closeups) == 0:
        return
    known, place = discharges(closeups, scene.wire_diameter_um / 2)
    n_slices = closeups["deflection_um"].shape[1]
    z_mm = scene.height_mm * (closeups["pulses"]["slice"] + 0.5) / n_slices
    if scene.lead is not None:  # places are those at mid height
        led = scene.lead_mm(closeups["path_um"], scene.height_mm * (np.arange(n_slices) + 0.5) / n_slices)
        led -= scene.lead_mm(closeups["path_um"], np.array([0.5 * scene.height_mm]))
        at_slice = np.clip(closeups["pulses"]["slice"], 0, n_slices - 1).astype(np.int64)[..., None]
        place = place + 1e3 * np.take_along_axis(led, at_slice, axis=1)
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
    """Log the middle slice's wall round the wire in um; the origin is the guides' axis."""
    _log_gap_marks(recording, scene)
    if len(closeups) == 0:
        return
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


def _log_gap_marks(recording: rr.RecordingStream, scene: Scene) -> None:
    """Log what stands still in the top view: a cross, circles of 50 um, and on the part its drawn edge."""
    angle = np.linspace(0.0, 2 * np.pi, 73)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    rings = [radius * circle for radius in (50.0, 100.0, 150.0, 200.0, 250.0)]
    recording.log(
        "top/scale",
        rr.LineStrips2D([[(-8, 0), (8, 0)], [(0, -8), (0, 8)], *rings], colors=[(58, 68, 80)], radii=on_screen(0.5)),
        static=True,
    )
    recording.log(
        "top/scale/um",
        rr.Points2D(
            [(0.0, -radius) for radius in (100.0, 150.0, 200.0)], labels=["100 µm", "150", "200"], show_labels=True,
            colors=[palette.rgb(palette.MUTED)], radii=on_screen(0.5),
        ),
        static=True,
    )  # fmt: skip
    nominal = [turned(edge.nominal_mm * 1000.0) for edge in scene.maps]
    if nominal:
        lines = rr.LineStrips2D(nominal, colors=[palette.rgb(palette.GREEN)], radii=on_screen(0.8))
        recording.log("top/part/nominal", lines, static=True)


def _log_walls(recording: rr.RecordingStream, scene: Scene, closeups: Closeups, wire: Floats) -> None:
    """Log every ray that meets metal, and the metal's edge as a line through their ends."""
    gaps = closeups["walls_um"].astype(np.float64)
    angle = 2 * np.pi * np.arange(gaps.shape[1]) / max(gaps.shape[1], 1)
    way = np.column_stack([np.cos(angle), -np.sin(angle)])
    radius = scene.wire_diameter_um / 2
    meets = gaps < RAY_RANGE_UM
    ends = wire[:, None, :] + (radius + gaps)[..., None] * way
    starts = np.broadcast_to(wire[:, None, :] + radius * way, ends.shape)
    when = indexes(closeups["t_s"], closeups["path_um"])
    near = np.clip((gaps[meets] - _NARROW_UM) / (RAY_RANGE_UM - _NARROW_UM), 0.0, 1.0)[:, None]
    colours = palette.rgb(palette.VERMILION) * (1 - near) + np.array((70, 82, 96)) * near
    lines = np.stack([starts[meets], ends[meets]], axis=1)
    rays = rr.LineStrips2D.columns(strips=lines, colors=colours.astype(np.uint8))
    recording.send_columns("top/rays", when, rays.partition(meets.sum(axis=1)))
    # a piece of wall between two neighbouring rays that both meet metal; the jump to another wall is left out
    after = np.roll(np.arange(gaps.shape[1]), -1)
    wall = meets & meets[:, after] & (np.abs(gaps - gaps[:, after]) < radius)
    behind = wire[:, None, :] + (radius + gaps + WALL_UM)[..., None] * way
    pieces = np.stack([behind[wall], behind[:, after][wall]], axis=1)
    look = rr.LineStrips2D.from_fields(colors=[palette.rgb(palette.MUTED)], radii=[WALL_UM])
    columns = rr.LineStrips2D.columns(strips=pieces).partition(wall.sum(axis=1))
    log_changing(recording, "top/metal", look, when, columns)


# --- the oscilloscope ---------------------------------------------------------------------------------------


def log_scope(recording: rr.RecordingStream, closeups: Closeups) -> None:
    """Log gap voltage and current of the last pulses, coloured by class, and the oscilloscope's scales."""
    if len(closeups) == 0:
        return
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
    """Yield where the 0 of each trace lies on the screen, and its scale, from its least and greatest value."""
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
    recording.log("scope/grid", rr.LineStrips2D(lines, colors=[(52, 60, 70)], radii=on_screen(0.5)), static=True)
    places, labels = [(x, y) for x, y, _ in marks], [text for *_, text in marks]
    numbers = rr.Points2D(
        places, labels=labels, show_labels=True, colors=[palette.rgb(palette.MUTED)], radii=on_screen(0.5)
    )
    recording.log("scope/scale", numbers, static=True)


def _ticks(most: float, count: int, least: float = 0.0) -> list[float]:
    """Return round values from `least`, 0 or below, up to `most`, some `count` of them above 0."""
    if not most > 0.0:
        return [0.0]
    decade = 10.0 ** math.floor(math.log10(most / count))
    step = next(s * decade for s in (1.0, 2.0, 5.0, 10.0) if most / (s * decade) <= count + 0.5)
    return [step * k for k in range(int(least / step * (1 + 1e-9)), int(most / step * (1 + 1e-9)) + 1)]


SMALLEST = 0.05  # slices of which gas covers less than this have no bubble: it would not be seen (ours)
_OPACITY = 150  # of 255


def travel_at(windows: pa.Table, t_s: Floats) -> Floats:
    """Return the direction of travel (n, 2) at the ends (n,) of some of the windows."""
    row = np.searchsorted(column(windows, "t_s"), t_s)
    return travel_direction(windows)[np.minimum(row, len(windows) - 1)]


def log_coverage(recording: rr.RecordingStream, scene: Scene, shapes: NDArray[np.void]) -> None:
    """Log the share of the front that gas covers, a curve per slice."""
    n, slices = shapes["coverage"].shape
    if n == 0:
        return
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
    # in a slice covered wholly it is as wide as the slice is high; the area of others is that share of its
    n, slices = shapes["coverage"].shape
    if n == 0:
        return
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
    """Log a bubble for every slice, at the last discharge that burned there, in um in the top view."""
    # as wide as the share of the wire's front half that gas covers in its slice, from the wire to the metal at
    # mid height
    if len(closeups) == 0:
        return
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
    half = np.maximum(long - width, 0.1) / 2 / middle  # its round ends add the width
    arc = angle[:, None] + half[:, None] * np.linspace(-1.0, 1.0, 9)
    wire = np.repeat(closeups["wire_um"] - closeups["guides_um"], shown.sum(axis=1), axis=0)
    strips = wire[:, None] + middle[:, None, None] * np.stack([np.cos(arc), np.sin(arc)], axis=-1)
    # sunk into the ground and below the rays: lines of this view are never translucent
    pale = faded(np.array([palette.rgb(palette.GAS)], np.uint8), np.array([0.65]))
    look = rr.LineStrips2D.from_fields(colors=pale, draw_order=15.0)
    columns = rr.LineStrips2D.columns(strips=turned(strips).astype(np.float32), radii=width / 2)
    when = indexes(closeups["t_s"], closeups["path_um"])
    log_changing(recording, "top/gas", look, when, columns.partition(shown.sum(axis=1)))
