"""Gas in the recording: the share of the wire's front that it covers over time, and bubbles that show it.

The model knows a share per slice and no bubbles. So many are drawn that together they cover that share, in random
places.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmsim.plant.constants import RAY_RANGE_UM
from edmsim.recording.figures import palette
from edmsim.recording.rerun.machine import Shapes, wire_strips
from edmsim.recording.rerun.stream import indexes, turned
from edmsim.recording.scene import Scene
from edmsim.recording.windows import column, travel_direction

if TYPE_CHECKING:
    import pyarrow as pa
    import rerun as rr

IN_A_SLICE = 4
"""Bubbles one above the other that are together as long as a slice is high (ours)."""
ROUND_THE_FRONT = 20
"""Bubbles side by side round the wire's front half: each as wide as a usual gap on a wire of 0.25 mm (ours)."""
WIDEST = 2.0
"""Most width of a bubble in wire diameters; at mid height in widths of its place on the front (ours)."""
SMALLEST = 0.1
"""Bubbles smaller than this share of a whole one are left out: they would not be seen (ours)."""
_OPACITY = 110
"""Of 255."""


def bubbles(covered: NDArray[np.floating], places: int) -> NDArray[np.float64]:
    """Return the size of the bubble in every place, as a share of a whole one.

    Of 20 places, a share of 0.13 fills two with a whole bubble and a third with one of 0.6 of the size. Which places
    these are is random for every share; equal arrays give equal bubbles.

    Parameters
    ----------
    covered : float array (...)
        Shares of 0 to 1.
    places : int
        How many places there are for each.

    Returns
    -------
    float64 array (..., places)
        Their mean over the places is the share.
    """
    order = np.broadcast_to(np.arange(places), (*covered.shape, places))
    rank = np.random.default_rng(0).permuted(order, axis=-1)
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

    Those of a slice are together as long as gas covers it; across, they are as wide as long, up to `WIDEST`.

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
    size = bubbles(shapes.coverage, IN_A_SLICE).reshape(n, -1)
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


def log_top_bubbles(
    recording: rr.RecordingStream, scene: Scene, closeups: NDArray[np.void], travel: NDArray[np.float64]
) -> None:
    """Log bubbles between the front of the wire and the metal at mid height, in um in the top view.

    A whole one is as wide as the gap there, up to `WIDEST`; where no metal is near there is none.

    Parameters
    ----------
    recording : rr.RecordingStream
    scene : Scene
    closeups : array (n,)
        Rows of `edmsim.recording.closeups.row_type`.
    travel : float64 array (n, 2)
        Direction of travel at every close-up.
    """
    import rerun as rr

    if len(closeups) == 0:
        return
    radius, gaps = scene.wire_diameter_um / 2, closeups["walls_um"]
    place = np.pi / ROUND_THE_FRONT
    aside = place * (np.arange(ROUND_THE_FRONT) + 0.5) - np.pi / 2
    angle = np.arctan2(travel[:, 1], travel[:, 0])[:, None] + aside
    ray = np.round(angle / (2 * np.pi) * gaps.shape[1]).astype(np.int64) % gaps.shape[1]
    gap = np.take_along_axis(gaps, ray, axis=1).astype(np.float64)
    size = bubbles(closeups["coverage"][:, scene.middle_slice()], ROUND_THE_FRONT)
    width = size * np.minimum(gap, WIDEST * radius * place)
    way = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    wire = closeups["wire_um"] - closeups["guides_um"]
    centre = turned(wire[:, None] + (radius + width / 2)[..., None] * way)
    shown = (gap < RAY_RANGE_UM) & (size >= SMALLEST)
    # below the rays, which shine through that way: points of this view are never translucent
    look = rr.Points2D.from_fields(colors=[palette.rgb(palette.GAS_DARK)], draw_order=15.0)
    recording.log("top/gas", look, static=True)
    columns = rr.Points2D.columns(positions=centre[shown], radii=width[shown] / 2)
    recording.send_columns(
        "top/gas", indexes(closeups["t_s"], closeups["path_um"]), columns.partition(shown.sum(axis=1))
    )  # fmt: skip
