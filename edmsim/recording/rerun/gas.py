"""Gas in the recording: the share of the wire's front that it covers over time, and bubbles that show it.

The model knows a share per slice and no bubbles: those drawn, one for a slice, only show it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmsim.plant.constants import RAY_RANGE_UM
from edmsim.plant.kernel.state import ARC, SPARK
from edmsim.recording.figures import palette
from edmsim.recording.rerun.gap import discharges
from edmsim.recording.rerun.machine import Shapes, wire_strips
from edmsim.recording.rerun.stream import faded, indexes, turned
from edmsim.recording.scene import Scene
from edmsim.recording.windows import column, travel_direction

if TYPE_CHECKING:
    import pyarrow as pa
    import rerun as rr

SMALLEST = 0.05
"""Slices of which gas covers less than this have no bubble: it would not be seen (ours)."""
_OPACITY = 150
"""Of 255."""


def travel_at(windows: pa.Table, t_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the direction of travel (n, 2) at the ends (n,) of some of the windows."""
    row = np.searchsorted(column(windows, "t_s"), t_s)
    return travel_direction(windows)[np.minimum(row, len(windows) - 1)]


def log_coverage(recording: rr.RecordingStream, scene: Scene, shapes: Shapes) -> None:
    """Log the share of the front that gas covers, a curve per slice."""
    import rerun as rr

    n, slices = shapes.coverage.shape
    if n == 0:
        return
    high = np.linspace(0.0, 1.0, slices)[:, None]
    colours = palette.rgb(palette.PURPLE) * (1 - high) + np.array(palette.rgb(palette.GREEN)) * high
    names = [f"{scene.height_mm * (s + 0.5) / slices:.1f} mm" for s in range(slices)]
    lines = rr.SeriesLines(names=names, colors=colours.astype(np.uint8), widths=[0.8] * slices)
    recording.log("slices/coverage", lines, static=True)
    curves = rr.Scalars.columns(scalars=shapes.coverage.ravel()).partition([slices] * n)
    recording.send_columns("slices/coverage", indexes(shapes.t_s, shapes.path_um), curves)


def log_bubbles(
    recording: rr.RecordingStream, scene: Scene, shapes: Shapes, travel: NDArray[np.float64], factor: float
) -> None:
    """Log a bubble for every slice on the front of the drawn wire, in mm.

    One of a slice that gas covers wholly is as wide as the slice is high; the area of others is that share of its.

    Parameters
    ----------
    recording : rr.RecordingStream
    scene : Scene
    shapes : Shapes
    travel : float64 array (n, 2)
        Direction of travel at every shape.
    factor : float
        How many times larger the wire's deflection is drawn.
    """
    import rerun as rr

    n, slices = shapes.coverage.shape
    if n == 0:
        return
    centre = wire_strips(scene, shapes, factor)[:, 1:-1]
    centre[..., :2] += travel[:, None] * (scene.wire_diameter_um / 2000.0)
    shown = shapes.coverage >= SMALLEST
    radius_mm = np.sqrt(shapes.coverage[shown]) * (scene.height_mm / slices / 2)
    look = rr.Ellipsoids3D.from_fields(
        colors=[(*palette.rgb(palette.GAS), _OPACITY)], fill_mode=rr.components.FillMode.Solid
    )  # fmt: skip
    recording.log("world/gas", look, static=True)
    columns = rr.Ellipsoids3D.columns(half_sizes=np.repeat(radius_mm[:, None], 3, axis=1), centers=centre[shown])
    recording.send_columns(
        "world/gas", indexes(shapes.t_s, shapes.path_um), columns.partition(shown.sum(axis=1))
    )  # fmt: skip


def log_top_bubbles(recording: rr.RecordingStream, scene: Scene, closeups: NDArray[np.void]) -> None:
    """Log a bubble for every slice, at the last discharge that burned there, in um in the top view.

    It is as wide as the share of the wire's front half that gas covers in its slice, and reaches from the wire to the
    metal at mid height.

    Parameters
    ----------
    recording : rr.RecordingStream
    scene : Scene
    closeups : array (n,)
        Rows of `edmsim.recording.closeups.row_type`.
    """
    import rerun as rr

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
    recording.log("top/gas", look, static=True)
    columns = rr.LineStrips2D.columns(strips=turned(strips).astype(np.float32), radii=width / 2)
    recording.send_columns(
        "top/gas", indexes(closeups["t_s"], closeups["path_um"]), columns.partition(shown.sum(axis=1))
    )  # fmt: skip
