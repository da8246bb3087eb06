"""Figures of passes: the wall after each over the height, what each took, and the face of the part."""

from typing import Any

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from edmsim.geometry import arc_lengths
from edmsim.recording.figures import style
from edmsim.recording.figures.palette import BLUE, GREEN, INK, MUTED, ORANGE, PURPLE, SKY, VERMILION
from edmsim.recording.report import Report
from edmsim.recording.scene import Scene

PASS_COLOURS = (INK, BLUE, SKY, GREEN, ORANGE, VERMILION, PURPLE)  # colours of the passes, from rough on


def pass_colour(number: int) -> str:
    """Return the colour of a pass."""
    return PASS_COLOURS[(number - 1) % len(PASS_COLOURS)]


def passes_figure(report: Report) -> Figure:
    """Draw the result of each pass of a cut in passes: wall over the height, time, stock and roughness."""
    rows = [row for row in report.passes if row.piece == "profile" and row.left_um is not None]
    if not rows:
        none = "no passes: the cut was made in one, or none was finished"
        return style.nothing_to_show(style.column_figure(2.0), none)
    rows = [row for row in rows if row.contour == rows[0].contour]
    figure = style.column_figure(4.4, top_in=0.3)
    grid = figure.add_gridspec(2, 3, height_ratios=[1.5, 1.0], hspace=0.42, wspace=0.62)
    wall = figure.add_subplot(grid[0, :])
    heights = np.array([row.height_mm for row in report.heights])
    for row in rows:
        own = np.array(row.slices_um, float) - row.left_um
        wall.plot(own, heights, "o-", color=pass_colour(row.number), markersize=2.5, linewidth=1.0,
                  label=f"{row.number}")  # fmt: skip
    style.dress(wall, "wall over its mean, µm (+ metal left)", "height, mm")
    style.legend(wall, above=True, columns=len(rows), title="wall after pass")
    numbers = [row.number for row in rows]
    panels: tuple[tuple[str, list[Any]], ...] = (
        ("time, min", [(row.end_s - row.begin_s) / 60 for row in rows]),
        ("metal left, µm", [row.left_um for row in rows]),
        ("Ra, µm", [row.ra_um or np.nan for row in rows]),
    )
    for k, (name, values) in enumerate(panels):
        axes = figure.add_subplot(grid[1, k])
        axes.bar(numbers, values, color=[pass_colour(number) for number in numbers], width=0.7)
        style.dress(axes, "pass", "")
        axes.set_title(name, fontsize=style.TICK_PT, color=INK, loc="left", pad=2)
        axes.set_xticks(numbers)
    return figure


def face_figure(scene: Scene) -> Figure:
    """Draw the cut face unrolled, at most four contours: profile error over distance along the edge and height."""
    faces = [edge for edge in scene.maps if edge.face_um is not None and np.isfinite(edge.face_um).any()]
    if not faces:
        return style.nothing_to_show(style.column_figure(2.0), "no face: no edge of the part was measured")
    shown = faces[:4]
    figure = style.column_figure(0.95 + 1.05 * len(shown), top_in=0.55)
    known = np.concatenate(
        [np.abs(edge.face_um[np.isfinite(edge.face_um)]) for edge in shown if edge.face_um is not None]
    )
    limit = max(float(np.percentile(known, 97)), 0.1)
    panels = np.atleast_1d(figure.subplots(len(shown), 1, gridspec_kw={"hspace": 0.35}))
    for axes, edge in zip(panels, shown, strict=True):
        assert edge.face_um is not None
        way = arc_lengths(edge.points_mm)
        heights = np.linspace(0.0, scene.height_mm, len(edge.face_um) + 1)
        ends = (
            np.concatenate([way, way[-1:] + max(way[-1] - way[-2], 1e-3)]) if len(way) > 1 else np.array([0.0, 1.0])
        )
        axes.pcolormesh(
            ends, heights, edge.face_um, cmap=style.ERROR_COLOURS, norm=Normalize(-limit, limit), rasterized=True,
            shading="flat",
        )
        style.dress(axes, "", "height, mm")
        axes.grid(visible=False)
    panels[-1].set_xlabel("along the nominal edge, mm", fontsize=style.LABEL_PT, color=MUTED)
    style.colour_bar(figure, panels[0].collections[0], "profile error, µm: − undercut, + metal left")
    return figure
