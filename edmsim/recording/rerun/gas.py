"""Gas in the recording: the share of the wire's front that it covers over time, and bubbles that show it.

The model knows a share per slice and no bubbles. So many are drawn that together they cover that share.
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
from edmsim.recording.rerun.stream import indexes, turned
from edmsim.recording.scene import Scene
from edmsim.recording.windows import column, travel_direction

if TYPE_CHECKING:
    import pyarrow as pa
    import rerun as rr

IN_A_SLICE = 2
"""Bubbles one above the other that are together as long as a slice is high (ours)."""
ROUND_THE_FRONT = 8
"""Bubbles side by side that fill the wire's front half (ours)."""
WIDEST = 3.0
"""Most width of a bubble in the machine, in wire diameters (ours)."""
SMALLEST = 0.1
"""Bubbles smaller than this share of a whole one are left out: they would not be seen (ours)."""
_OPACITY = 190
"""Of 255."""


def bubbles(covered: NDArray[np.floating], rank: NDArray[np.int64], places: int) -> NDArray[np.float64]:
    """Return the size of the bubble in every place, as a share of a whole one.

    Of 8 places, a share of 0.2 fills the two of the lowest ranks: one with a whole bubble, one with a bubble of 0.6 of
    its size.

    Parameters
    ----------
    covered : float array (...)
        Shares of 0 to 1.
    rank : int array (..., n)
        In which order places are filled, from 0.
    places : int
        How many whole bubbles a share of 1 fills.

    Returns
    -------
    float64 array (..., n)
        Their sum is the share times the places, if every rank up to the number of places occurs once.
    """
    return np.clip(covered[..., None].astype(np.float64) * places - rank, 0.0, 1.0)


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
    """Log bubbles on the front of the drawn wire in the machine, in mm.

    Those of a slice are together as long as gas covers it, in random order; across, they are as wide as long, up to
    `WIDEST`.

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
    from scipy.interpolate import make_interp_spline

    n, slices = shapes.coverage.shape
    if n == 0:
        return
    wire, diameter_mm = wire_strips(scene, shapes, factor), scene.wire_diameter_um / 1000.0
    long_mm = scene.height_mm / (slices * IN_A_SLICE)
    z_mm = long_mm * (np.arange(slices * IN_A_SLICE) + 0.5)
    centre = make_interp_spline(wire[0, :, 2], wire, k=1, axis=1)(z_mm)
    centre[..., :2] += travel[:, None] * diameter_mm / 2
    order = np.broadcast_to(np.arange(IN_A_SLICE), (n, slices, IN_A_SLICE))
    rank = np.random.default_rng(0).permuted(order, axis=-1)  # alike for equal cuts
    size = bubbles(shapes.coverage, rank, IN_A_SLICE).reshape(n, -1)
    across_mm = size * min(long_mm, WIDEST * diameter_mm)
    shown = size >= SMALLEST
    halves = np.stack([across_mm, across_mm, size * long_mm], axis=-1) / 2
    look = rr.Ellipsoids3D.from_fields(
        colors=[(*palette.rgb(palette.GAS), _OPACITY)], fill_mode=rr.components.FillMode.Solid
    )  # fmt: skip
    recording.log("world/gas", look, static=True)
    columns = rr.Ellipsoids3D.columns(half_sizes=halves[shown], centers=centre[shown])
    recording.send_columns(
        "world/gas", indexes(shapes.t_s, shapes.path_um), columns.partition(shown.sum(axis=1))
    )  # fmt: skip


def log_top_bubbles(recording: rr.RecordingStream, scene: Scene, closeups: NDArray[np.void]) -> None:
    """Log bubbles where the last discharges burned, in um in the top view.

    Together they are as wide as gas covers the front in the mean over the height, the latest first; they reach from
    the wire to the metal at mid height.

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
    radius, gaps, pulses = scene.wire_diameter_um / 2, closeups["walls_um"], closeups["pulses"]
    burned = discharges(closeups, radius)[0] & np.isin(pulses["kind"], (SPARK, ARC))
    latest = np.cumsum(burned[:, ::-1], axis=1)[:, ::-1] - 1
    size = bubbles(closeups["coverage"].mean(axis=1), latest, ROUND_THE_FRONT)
    gap = np.take_along_axis(gaps, pulses["ray"].astype(np.int64), axis=1)
    shown = burned & (size >= SMALLEST) & (gap < RAY_RANGE_UM)
    angle, gap = 2 * np.pi * pulses["ray"][shown] / gaps.shape[1], gap[shown].astype(np.float64)
    long = size[shown] * (np.pi * radius / ROUND_THE_FRONT)
    width = np.minimum(gap, long)
    middle = radius + gap / 2
    half = np.maximum(long - width, 0.1) / 2 / middle  # rounded ends add the width
    arc = angle[:, None] + half[:, None] * np.linspace(-1.0, 1.0, 5)
    wire = np.repeat(closeups["wire_um"] - closeups["guides_um"], shown.sum(axis=1), axis=0)
    strips = wire[:, None] + middle[:, None, None] * np.stack([np.cos(arc), np.sin(arc)], axis=-1)
    # below the rays, which shine through that way: lines of this view are never translucent
    look = rr.LineStrips2D.from_fields(colors=[palette.rgb(palette.GAS_DARK)], draw_order=15.0)
    recording.log("top/gas", look, static=True)
    columns = rr.LineStrips2D.columns(strips=turned(strips), radii=width / 2)
    recording.send_columns(
        "top/gas", indexes(closeups["t_s"], closeups["path_um"]), columns.partition(shown.sum(axis=1))
    )  # fmt: skip
