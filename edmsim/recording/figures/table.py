"""Figures of a machine's table: positioning along its axes, before and after compensation, and the circular test."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from edmsim.recording.figures.palette import BLUE, GRID, MUTED, ORANGE

if TYPE_CHECKING:
    from matplotlib.projections.polar import PolarAxes

    from edmsim.metrology.circular_test import CircularTest
    from edmsim.metrology.positioning import Positioning
    from edmsim.metrology.table_run import TableMeasurement

_COLOURS = BLUE, ORANGE


def table_figure(measured: Mapping[str, TableMeasurement]) -> Figure:
    """Draw what was measured of a table, once or before and after compensation.

    Parameters
    ----------
    measured : mapping of str to TableMeasurement
        By the name of the legend, two at most.

    Returns
    -------
    Figure
        Deviation of x and of y along their own ways, both ways as thin lines and their mean; of y along x; and the
        circular test.
    """
    figure = Figure(figsize=(9.0, 5.6), layout="constrained")
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
