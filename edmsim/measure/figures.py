"""Figures of a machine's table: positioning and circular test, before and after compensation, and of a part."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from edmsim.geometry import arc_lengths
from edmsim.recording.figures.palette import BLUE, GRID, MUTED, VERMILION

if TYPE_CHECKING:
    from matplotlib.projections.polar import PolarAxes

    from edmsim.measure.iso_230 import CircularTest, Positioning
    from edmsim.measure.table import TableMeasurement
    from edmsim.recording.scene import ErrorMap

_COLOURS = VERMILION, BLUE
_SMOOTHED_MM = 1.0  # length along the edge over which the wall is averaged: its roughness is several um (ours)
_STEP_MM = 0.02


def table_figure(measured: Mapping[str, TableMeasurement]) -> Figure:
    """Draw measurements of a table, once or before and after compensation.

    Parameters
    ----------
    measured : mapping of str to TableMeasurement
        By name in the legend, at most two.

    Returns
    -------
    Figure
        Deviations of x and of y along their own axes, in both directions (thin lines) and their mean; of y along x;
        and the circular test.
    """
    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    for place, (pair, title) in enumerate(
        {("x", "x"): "x along x", ("y", "y"): "y along y", ("y", "x"): "y along x"}.items(), 1
    ):
        axes = figure.add_subplot(2, 2, place)
        for colour, (name, found) in zip(_COLOURS, measured.items(), strict=False):
            _draw(axes, found.along[pair], name, colour)
        axes.set(title=title, xlabel="target, mm", ylabel="deviation, um")
        axes.grid(color=GRID)
    polar: PolarAxes = figure.add_subplot(2, 2, 4, projection="polar")  # type: ignore[assignment]
    _draw_circles(polar, {name: found.circle for name, found in measured.items()})
    return figure


def _draw(axes: object, found: Positioning, name: str, colour: str) -> None:
    plot = axes.plot  # type: ignore[attr-defined]
    for mean in (found.mean_up_um, found.mean_down_um):
        plot(found.targets_mm, mean, color=colour, lw=0.5, alpha=0.6)
    plot(found.targets_mm, found.mean_um, color=colour, lw=1.3, label=name)
    axes.legend(fontsize=8)  # type: ignore[attr-defined]


def _draw_circles(axes: PolarAxes, circles: Mapping[str, CircularTest]) -> None:
    most = max(float(np.abs(c.deviation_um(way)).max()) for c in circles.values() for way in (False, True))
    for colour, circle in zip(_COLOURS, circles.values(), strict=False):
        angle = np.append(circle.angle_rad, 2 * np.pi)
        for clockwise, style in ((False, "-"), (True, ":")):
            deviation = circle.deviation_um(clockwise)
            axes.plot(angle, np.append(deviation, deviation[0]), style, color=colour, lw=1.1)
    axes.plot(np.linspace(0, 2 * np.pi, 181), np.zeros(181), color=MUTED, lw=0.8)
    axes.set_ylim(-3 * most, 1.5 * most)
    radius = next(iter(circles.values())).radius_mm
    axes.set_title(f"radius on a circle of {radius:g} mm, um (clockwise dotted)", fontsize=9)


def part_figure(measured: Mapping[str, TableMeasurement], cuts: Mapping[str, ErrorMap]) -> Figure:
    """Draw a table's pitch error before and after compensation, and its effect on the wall of a part.

    Parameters
    ----------
    measured : mapping of str to TableMeasurement
        By name, at most two.
    cuts : mapping of str to ErrorMap
        The same contour, cut with both and with a perfect table (``"perfect table"``), which is subtracted from
        the others: wire and process are the same.
    """
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    drawn = figure.subplot_mosaic([["x", "y"], ["part", "part"]])
    for pair in (("x", "x"), ("y", "x")):
        axes = drawn[pair[0]]
        for colour, (name, found) in zip(_COLOURS, measured.items(), strict=False):
            _draw(axes, found.along[pair], name, colour)
        axes.set(title=f"{pair[0]} along {pair[1]}", xlabel="target, mm", ylabel="deviation, um")
        axes.grid(color=GRID)
    axes = drawn["part"]
    perfect = cuts["perfect table"].error_um
    names = [name for name in cuts if name != "perfect table"]
    for colour, name in zip(_COLOURS, names, strict=False):
        cut = cuts[name]
        along_mm = arc_lengths(cut.points_mm)
        axes.plot(along_mm, _smoothed(cut.error_um - perfect), color=colour, lw=1.3, label=name)
    axes.set(title="the part's wall, less that of a perfect table", xlabel="along the edge, mm", ylabel="error, um")
    axes.grid(color=GRID)
    axes.legend(fontsize=8)
    return figure


def _smoothed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return running means of what is finite."""
    window = np.ones(round(_SMOOTHED_MM / _STEP_MM))
    known = np.isfinite(values)
    count = np.convolve(known, window, "same")
    total = np.convolve(np.where(known, values, 0.0), window, "same")
    return np.asarray(np.divide(total, count, out=np.full(len(values), np.nan), where=count > 0))
