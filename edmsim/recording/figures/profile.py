"""A cut from above: ``profile.png``, with the error along it and the process over time, and its path beforehand."""

import textwrap
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from edmsim.geometry import Floats, arc_lengths, interpolated
from edmsim.metrology.profile import CornerError
from edmsim.numeric import above_zero
from edmsim.program.path import CutPath, WireContour
from edmsim.recording.figures import palette
from edmsim.recording.figures.style import ERROR_COLOURS, NotebookFigure, fill, in_style, quiet, shrink_to
from edmsim.recording.report import Report, duration_text, rate_text
from edmsim.recording.scene import Scene, round_number
from edmsim.recording.windows import column, group_means, pause_rows, quantity, stretches

BINS = 800  # most points of a drawn series


class Band(NamedTuple):
    """A series in bins: the place of each bin, and its mean, least and largest value."""

    x: Floats
    mean: Floats
    low: Floats
    high: Floats


def binned(x: Floats, values: Floats, bins: int = BINS) -> Band:
    """Return a series in at most `bins` bins of equal numbers of rows. NaN is ignored unless a bin has only NaN."""
    edges = np.linspace(0, len(x), min(len(x), bins) + 1).astype(int)
    starts, known = edges[:-1], np.isfinite(values)
    if len(starts) == 0:
        return Band(*(np.zeros(0) for _ in range(4)))
    low = np.minimum.reduceat(np.where(known, values, np.inf), starts)
    high = np.maximum.reduceat(np.where(known, values, -np.inf), starts)
    mean = group_means(values, starts)
    empty = np.isnan(mean)
    place = np.add.reduceat(x, starts) / np.diff(edges)
    return Band(place, mean, np.where(empty, np.nan, low), np.where(empty, np.nan, high))


def bands(t: Floats, values: Floats, t_s: Floats, bins: int = BINS) -> list[Band]:
    """Return a series in bins, separately for each stretch between two pauses in the times `t_s`."""
    share = bins / max(len(t_s), 1)
    return [
        binned(t[part], values[part], max(1, round(share * (part.stop - part.start))))
        for part in stretches(len(t_s), pause_rows(t_s))
    ]


def mark_pauses(axes: Axes, t_s: Floats, seconds: float, label: str | None = None) -> None:
    """Hatch the pauses on an axis of machine time, whose unit is `seconds` long; the first has the label."""
    for number, row in enumerate(pause_rows(t_s)):
        axes.axvspan(
            t_s[row - 1] / seconds, t_s[row] / seconds, facecolor="none", edgecolor=palette.LINE, hatch="////",
            linewidth=0, label=None if number else label,
        )  # fmt: skip


def draw_series(panels: list[Axes], windows: pa.Table) -> None:
    """Draw the main series of the windows over machine time: one of `PANELS` on each of the axes."""
    t_s = column(windows, "t_s")
    unit, seconds = time_unit(float(t_s[-1]) if len(t_s) else 0.0)
    for axes, (label, lines) in zip(panels, PANELS.items(), strict=True):
        quiet(axes)
        mark_pauses(axes, t_s, seconds, "threading" if axes is panels[0] else None)
        if lines:
            _draw_bands(axes, t_s / seconds, windows, lines)
        else:
            draw_shares(axes, t_s / seconds, windows)
        if lines and not any(np.isfinite(quantity(windows, series)).any() for series, _, _ in lines):
            write_not_measured(axes)
        elif label.endswith("\nµm"):
            axes.axhline(0.0, color=palette.MUTED, linewidth=0.6)
        _label(axes, label)
        axes.margins(x=0.005)
        axes.yaxis.set_label_coords(-0.052, 0.5)
        axes.tick_params(labelbottom=axes is panels[-1])
        if axes is not panels[0]:
            axes.sharex(panels[0])
    meaning = "(line: mean, band: least to largest of the windows in a bin)"
    panels[-1].set_xlabel(f"machine time, {unit}   {meaning}", color=palette.MUTED, fontsize=9)


def write_not_measured(axes: Axes) -> None:
    """Write "not measured" on the axes of a series without values, instead of a scale."""
    axes.set_yticks([])
    centred: dict[str, Any] = {"transform": axes.transAxes, "ha": "center", "va": "center"}
    axes.text(0.5, 0.5, "not measured", fontsize=8, color=palette.MUTED, **centred)


def time_unit(longest_s: float) -> tuple[str, float]:
    """Return the unit for a time axis of this length: its name, and its length in s."""
    if longest_s < 180:
        return "s", 1.0
    return ("min", 60.0) if longest_s < 3 * 3600 else ("h", 3600.0)


def _draw_bands(axes: Axes, t: Floats, windows: pa.Table, lines: Sequence[tuple[str, str, str]]) -> None:
    for series, colour, name in lines:
        for number, band in enumerate(bands(t, quantity(windows, series), column(windows, "t_s"))):
            axes.fill_between(band.x, band.low, band.high, color=colour, alpha=0.18, linewidth=0)
            axes.plot(band.x, band.mean, color=colour, linewidth=1.1, label=None if number else name)


def draw_shares(axes: Axes, t: Floats, windows: pa.Table, bins: int = BINS) -> None:
    """Draw the percentages of the classes of pulses, stacked."""
    t_s = column(windows, "t_s")
    of_kinds = [bands(t, quantity(windows, kind), t_s, bins) for kind in palette.SHARE_COLOURS]
    for number, stretch in enumerate(zip(*of_kinds, strict=True)):
        axes.stackplot(
            stretch[0].x, [band.mean for band in stretch], colors=list(palette.SHARE_COLOURS.values()), linewidth=0,
            labels=() if number else list(palette.SHARE_COLOURS),
        )
    axes.set_ylim(0, 100)


def _label(axes: Axes, label: str) -> None:
    axes.set_ylabel(label, color=palette.MUTED, fontsize=8.5)
    if len(axes.get_legend_handles_labels()[0]) > 1:
        axes.legend(
            loc="upper left", bbox_to_anchor=(1.004, 1.03), frameon=False, fontsize=8, handlelength=1.0,
            labelcolor=palette.INK, borderpad=0.0, handletextpad=0.4, labelspacing=0.3,
        )


PANELS = {
    "feed\nµm/s": [("feed_um_s", palette.BLUE, "feed")], "pulses\n%": [],
    "gap, lag\nµm": [("gap_um", palette.BLUE, "gap"), ("lag_um", palette.ORANGE, "wire lag")],
    "profile error\nµm": [("error_um", palette.VERMILION, "error")],
    "wire temp.\nK": [("wire_temperature_K", palette.VERMILION, "wire")],
}  # fmt: skip
"""Panels over machine time by label, from above: quantity, colour and name of each line; without lines, shares."""


Box = tuple[float, float, float, float]
_BLANK: dict[str, Any] = {"facecolor": palette.METAL, "edgecolor": palette.MUTED, "linewidth": 0.8, "zorder": 0}
_LABEL_FONT_PT = 8.5
_LABEL = (4.2, 1.75)  # width and height of a label with some room around it, in heights of its font
_LABEL_AWAY = (2.6, 3.8, 5.2)  # distances of a label from its corner to try, in heights of its font
NAMED_LEVELS = 4  # up to this number of levels of a stepped workpiece, the legend names each
LABELLED_CORNERS = 12  # most corners labelled with their errors, the largest ones


def draw_map(axes: Axes, scene: Scene, within_mm: Box | None = None) -> None:
    """Draw part, kerf and profile error in the program's coordinates; `within_mm` is a box on the table."""
    box, (dx, dy) = within_mm or scene.extent_mm(), scene.origin_mm or (0.0, 0.0)
    scene = scene.in_program().at_middle()
    factor = scene.error_factor()
    _frame_map(axes, scene, (box[0] - dx, box[1] - dy, box[2] - dx, box[3] - dy))
    _draw_metal(axes, scene)
    lines = draw_errors(axes, scene, factor) if len(scene.known_errors()) else None
    if lines is not None:
        axes.plot([], [], color=lines.cmap(0.85), linewidth=1.7, label=f"profile error drawn × {factor:g}")
        _colour_bar(axes, lines)
    # drawn instead of an error: there the round wire leaves metal even on its exact path
    if runs := [run for edge in scene.maps for run in edge.out_of_reach_mm()]:
        label = "out of the wire's reach"
        _draw_lines(axes, runs, color=palette.PURPLE, linewidth=2.2, capstyle="round", zorder=5, label=label)
    _mark_corners(axes, scene)
    _mark_places(axes, scene)
    _scale_bars(axes, factor if len(scene.known_errors()) else None)
    for columns in (6, 5, 4, 3):
        legend = axes.legend(
            loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False, fontsize=8.5, handlelength=1.6,
            columnspacing=1.2, borderpad=0.0, borderaxespad=0.3, labelcolor=palette.INK, ncols=columns,
        )
        if legend.get_window_extent().width <= axes.bbox.width:
            break


def _frame_map(axes: Axes, scene: Scene, shown_mm: Box) -> None:
    x0, y0, x1, y1 = shown_mm
    margin = max(0.12 * max(x1 - x0, y1 - y0, 1.0), 2e-3 * scene.wire_diameter_um)  # shows the whole kerf
    box = axes.get_window_extent()
    # half the width shown: the larger of what both sides need, because a millimetre is equally long on both axes
    half = max((x1 - x0) / 2 + margin, ((y1 - y0) / 2 + margin) * box.width / box.height)
    axes.set_xlim((x0 + x1) / 2 - half, (x0 + x1) / 2 + half)
    axes.set_ylim((y0 + y1) / 2 - half * box.height / box.width, (y0 + y1) / 2 + half * box.height / box.width)
    axes.set_aspect("equal", adjustable="box")
    axes.autoscale(enable=False)
    x, y = scene.axis_labels()
    axes.set_xlabel(x, color=palette.MUTED, fontsize=9)
    axes.set_ylabel(y, color=palette.MUTED, fontsize=9)
    quiet(axes)
    axes.set_axisbelow(False)
    axes.grid(visible=False)


def _draw_metal(axes: Axes, scene: Scene) -> None:
    x0, y0, x1, y1 = scene.stock_mm
    axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, **_BLANK))
    bored = scene.bored()
    fill(axes, scene.kerf())
    fill(axes, bored)
    rims = [shapely.get_coordinates(ring) for ring in shapely.get_rings(shapely.get_parts(bored))]
    _draw_lines(axes, rims, color=palette.MUTED, linewidth=0.6, zorder=2)
    label = f"cut edge, {scene.middle_text()}"
    _draw_lines(axes, scene.middle_edges_mm(), color="#3d4852", linewidth=0.7, zorder=3, label=label)
    nominal, dashes = [edge.nominal_mm for edge in scene.maps], (0, (5, 3))
    _draw_lines(axes, nominal, color=palette.INK, linewidth=0.7, linestyle=dashes, zorder=4, label="nominal edge")
    for face, (colour, name) in enumerate(((palette.BLUE, "edge below"), (palette.VERMILION, "edge above"))):
        if scene.walls_mm:
            walls = [wall[face] for wall in scene.walls_mm]
            _draw_lines(axes, walls, color=colour, linewidth=0.7, zorder=4, label=name)
    _draw_steps(axes, scene)


def _draw_steps(axes: Axes, scene: Scene) -> None:
    """Outline the levels of a stepped workpiece, with their heights."""
    outlines = [line for terrace in scene.terraces for line in terrace.outlines_mm]
    if outlines:
        levels = [f"{terrace.height_mm:.3g}" for terrace in scene.terraces]
        heights = ", ".join(levels) if len(levels) <= NAMED_LEVELS else f"{levels[0]} to {levels[-1]}"
        label = f"steps, {heights} mm high"
        _draw_lines(axes, outlines, color=palette.MUTED, linewidth=0.6, linestyle=":", zorder=2, label=label)


def _draw_lines(axes: Axes, lines: Any, **style: Any) -> LineCollection:
    drawn = LineCollection([np.asarray(line) for line in lines], **style)
    axes.add_collection(drawn, autolim=False)
    return drawn


def draw_errors(
    axes: Axes, scene: Scene, factor: float, widths: tuple[float, float] = (0.5, 1.7), alpha: float = 0.35,
    zorder: int = 5,
) -> LineCollection | None:
    """Draw the profile error from the edge outwards, enlarged and in colours; return the last lines, if any."""
    limit = scene.error_limit_um()
    style: dict[str, Any] = {"cmap": ERROR_COLOURS, "norm": Normalize(-limit, limit)}
    lines = None
    for edge in scene.maps:
        fans = np.stack([edge.points_mm, edge.exaggerated_mm(factor)], axis=1)
        _draw_lines(axes, fans, array=edge.reached_um(), linewidth=widths[0], alpha=alpha, zorder=zorder, **style)
        pieces, mean = edge.pieces(factor)
        lines = _draw_lines(
            axes, pieces, array=mean, linewidth=widths[1], capstyle="round", zorder=zorder + 1, **style
        )
    return lines


def _colour_bar(axes: Axes, lines: LineCollection) -> None:
    inset = axes.inset_axes((1.015, 0.0, 0.016, 1.0))
    bar = axes.figure.colorbar(lines, cax=inset, extend="both", extendfrac=0.03)
    bar.outline.set_visible(False)
    bar.set_label("profile error, µm   (too much removed  −  |  +  metal left)", color=palette.MUTED, fontsize=9)
    bar.ax.tick_params(labelsize=8, colors=palette.MUTED, length=2)


def _mark_corners(axes: Axes, scene: Scene) -> None:
    known = [c for c in scene.corners if np.isfinite(c.error_um)]
    if known:
        axes.plot(
            [c.x_mm for c in known], [c.y_mm for c in known], "o", markersize=5.5, markerfacecolor="none",
            markeredgecolor=palette.INK, markeredgewidth=0.8, zorder=7, label="corner, its error in µm",
        )
        box = {"boxstyle": "round,pad=0.18", "facecolor": "white", "edgecolor": palette.GRID, "linewidth": 0.6}
        label_corners(axes, scene, LABELLED_CORNERS, _LABEL_FONT_PT, box, 8)


def label_corners(axes: Axes, scene: Scene, most: int, font_pt: float, box: dict[str, Any], zorder: int) -> None:
    """Write the errors of corners next to them, the `most` largest ones, if there is room."""
    known = [c for c in scene.corners if np.isfinite(c.error_um)]
    worst = sorted(known, key=lambda c: -abs(c.error_um))[:most]
    if not worst:
        return
    x0, y0, x1, y1 = scene.extent_mm()
    middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2])
    for corner, offset_pt in label_places(axes, worst, middle, font_pt):
        axes.annotate(
            f"{corner.error_um:+.1f}".replace("-", "−"), (corner.x_mm, corner.y_mm), xytext=offset_pt,
            textcoords="offset points", ha="center", va="center", fontsize=font_pt, color=palette.INK, zorder=zorder,
            bbox=box,
        )  # fmt: skip


def label_places(
    axes: Axes, corners: Sequence[CornerError], middle: Floats, font_pt: float
) -> Iterator[tuple[CornerError, tuple[float, float]]]:
    """Yield places of labels, in points from their corners, so that they cover neither each other nor a corner."""
    # best towards the part's middle, because the exaggerated error is drawn outside; no label if there is no room
    point = axes.figure.dpi / 72.0
    at = axes.transData.transform([(c.x_mm, c.y_mm) for c in corners]) / point
    centre = axes.transData.transform(middle) / point
    size = font_pt * np.array(_LABEL)
    low, high = (corner / point for corner in axes.get_window_extent().get_points())
    taken = np.empty((0, 2))
    for corner, place in zip(corners, at, strict=True):
        inward = centre - place
        angle = np.arctan2(inward[1], inward[0])
        tries = [
            radius * font_pt * np.array([np.cos(angle + turn), np.sin(angle + turn)])
            for turns in ((0, 40, -40, 80, -80), (120, -120, 180)) for radius in _LABEL_AWAY
            for turn in np.radians(turns)
        ]  # fmt: skip
        for offset in tries:
            label = place + offset
            shown = (label - size / 2 > low).all() and (label + size / 2 < high).all()
            covers = (np.abs(at - label) < size / 2).all(axis=1).any()
            if shown and not covers and not (np.abs(taken - label) < size).all(axis=1).any():
                taken = np.vstack([taken, label])
                yield corner, (float(offset[0]), float(offset[1]))
                break


def _mark_places(axes: Axes, scene: Scene) -> None:
    if len(scene.starts_mm):
        axes.plot(
            scene.starts_mm[:, 0], scene.starts_mm[:, 1], "^", markersize=7, color=palette.GREEN,
            markeredgecolor="white", markeredgewidth=0.7, linestyle="none", zorder=8, label="start",
        )
    if scene.stop_mm is not None:
        axes.plot(
            *scene.stop_mm, "X", markersize=10, color=palette.VERMILION, markeredgecolor="white", markeredgewidth=0.8,
            linestyle="none", zorder=9, label="stopped here",
        )


def _scale_bars(axes: Axes, factor: float | None) -> None:
    low, high = axes.get_xlim()
    length = round_number((high - low) * 0.12)
    bars = [(0.034, f"{length:g} mm")]
    if factor is not None:
        apart = max(0.044, 16.0 / axes.get_window_extent().height)  # room for a line of text on small pictures, too
        bars = [(0.034 + apart, f"{length:g} mm"), (0.034, f"{length * 1000.0 / factor:g} µm of error")]
    for bottom, text in bars:
        span = length / (high - low)
        axes.plot(
            [0.965 - span, 0.965], [bottom, bottom], transform=axes.transAxes, color=palette.INK, linewidth=2.2,
            solid_capstyle="butt", zorder=10,
        )
        axes.text(
            0.965, bottom + 0.007, text, transform=axes.transAxes, ha="right", va="bottom", fontsize=8,
            color=palette.INK, zorder=10,
        )


PROFILE_DPI = 160
PROFILE_DOTS = 1600, 1920  # width and height of `profile.png` (ours)
REASON_LETTERS = 130  # most letters in a line of the stop reason


@in_style
def profile_figure(scene: Scene, windows: pa.Table, report: Report, title: str) -> Figure:
    """Draw a cut: part, kerf and error from above, and the process over machine time, under a title."""
    inches = (PROFILE_DOTS[0] / PROFILE_DPI, PROFILE_DOTS[1] / PROFILE_DPI)
    figure = NotebookFigure(figsize=inches, dpi=PROFILE_DPI, facecolor="white")
    outer = figure.add_gridspec(
        2, 1, height_ratios=[1.32, 1.0], hspace=0.13, left=0.085, right=0.915, top=0.89, bottom=0.05
    )
    _heading(figure, report, title)
    draw_map(figure.add_subplot(outer[0]), scene)
    series = outer[1].subgridspec(len(PANELS), 1, hspace=0.16)
    axes = [figure.add_subplot(series[row]) for row in range(len(PANELS))]
    draw_series(axes, windows)
    mark_passes(axes, windows, report)
    return figure


def mark_passes(panels: list[Axes], windows: pa.Table, report: Report) -> None:
    """Draw where passes begin in panels over machine time, with their numbers over the uppermost panel."""
    t_s = column(windows, "t_s")
    _, seconds = time_unit(float(t_s[-1]) if len(t_s) else 0.0)
    for row in report.passes:
        for axes in panels:
            axes.axvline(row.begin_s / seconds, color=palette.MUTED, linewidth=0.7, linestyle=(0, (4, 3)))
        name = f"{row.number}" + ("t" if row.piece == "tab" else "")
        middle = (row.begin_s + row.end_s) / 2 / seconds
        panels[0].annotate(
            name, (middle, 1.0), xycoords=("data", "axes fraction"), xytext=(0, 2), textcoords="offset points",
            ha="center", fontsize=7.5, color=palette.MUTED, annotation_clip=True,
        )  # fmt: skip


def _heading(figure: Figure, report: Report, title: str) -> None:
    facts = [
        duration_text(report.machining_time_s), report.text("path_length_mm"), rate_text(report),
        f"kerf {report.text('kerf_um.mean', 0)}", f"profile error {report.profile_error_um.worst_and_rms}",
    ]
    stopped = report.reason is not None
    name = figure.text(0.085, 0.972, title, fontsize=16, fontweight="bold", color=palette.INK, va="baseline")
    outcome = figure.text(
        0.915, 0.972, report.outcome, fontsize=12, ha="right", va="baseline", fontweight="bold",
        color=palette.VERMILION if stopped else palette.GREEN,
    )
    shrink_to(name, outcome.get_window_extent().x0)
    figure.text(0.085, 0.950, "   ·   ".join(facts), fontsize=9.5, color=palette.MUTED, va="baseline")
    if stopped:
        lines = textwrap.wrap(f"stopped: {report.reason}", REASON_LETTERS, max_lines=2, placeholder=" ...")
        figure.text(0.085, 0.9455, "\n".join(lines), fontsize=8.5, color=palette.VERMILION, va="top", linespacing=1.1)


# The wire's path before the cut: edges as drawn, the planned kerf, start holes and blank.

_ARROWS = 4  # arrows on a contour: enough to see its direction
_WIRES = 150  # places at which a leaning wire is drawn


@in_style
def path_figure(path: CutPath, title: str, kerf_um: float) -> Figure:
    """Draw a path in the program's coordinates; the kerf is wire and twice the gap."""
    above_zero("kerf_um", kerf_um)
    figure = NotebookFigure(figsize=(9.0, 8.0), dpi=130, facecolor="white", layout="none")
    two_rows = path.leans or any(contour.passes for contour in path.contours)  # the legend has two rows
    axes = figure.add_axes((0.09, 0.08, 0.88, 0.80 if two_rows else 0.82))
    quiet(axes)
    axes.grid(visible=False)
    axes.set_aspect("equal", adjustable="datalim")
    _draw_blank(axes, path, kerf_um)
    for number, contour in enumerate(path.contours):
        faces = _faces(contour)
        for name, (edge_colour, path_colour), face in faces:
            edge = face.nominal_mm - path.origin_mm
            label = f"edge as drawn{name}" if number == 0 else None
            axes.plot(*edge.T, color=edge_colour, linewidth=0.9, zorder=4, label=label)
            _draw_wire_paths(axes, path, face, (name, path_colour), number == 0)
            _draw_arrows(axes, face.points_um / 1e3 - path.origin_mm)
        if len(faces) == 2:
            _draw_wires(axes, *(face.points_um / 1e3 - path.origin_mm for _, _, face in faces))
        points = contour.points_um / 1e3 - path.origin_mm
        axes.annotate(
            str(number + 1), points[0], xytext=(8, 8), textcoords="offset points", fontsize=9, color=palette.GREEN,
            zorder=6,
        )
    starts = path.start_holes_um / 1e3 - path.origin_mm
    axes.plot(*starts.T, "^", color=palette.GREEN, markeredgecolor="white", zorder=6, label="start hole")
    axes.set_xlabel("X of the program, mm", fontsize=9, color=palette.MUTED)
    axes.set_ylabel("Y of the program, mm", fontsize=9, color=palette.MUTED)
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4 if path.leans else 5, frameon=False, fontsize=8.5,
        labelcolor=palette.INK,
    )
    shrink_to(figure.text(0.09, 0.955, title, fontsize=14, fontweight="bold", color=palette.INK), figure.bbox.x1)
    return figure


def _faces(contour: WireContour) -> list[tuple[str, tuple[str, str], WireContour]]:
    """Return the faces on which a contour is drawn: name, colours of edge and wire's path, and contour."""
    if contour.lean is None:
        return [("", (palette.INK, palette.BLUE), contour)]
    return [
        (", below", (palette.INK, palette.BLUE), contour.at_height(0.0)),
        (", above", (palette.MUTED, palette.VERMILION), contour.at_height(contour.lean.height_mm)),
    ]


def _draw_wires(axes: Axes, below: Floats, above: Floats) -> None:
    """Draw the wire at `_WIRES` places, from the lower face to the upper one."""
    passed = arc_lengths((below + above) / 2)
    at = np.linspace(0.0, passed[-1], _WIRES)
    ends = [interpolated(at, passed, points) for points in (below, above)]
    wires = LineCollection(list(np.stack(ends, axis=1)), color=palette.GREEN, linewidth=0.4, zorder=3, label="wire")
    axes.add_collection(wires)


def _draw_wire_paths(axes: Axes, path: CutPath, contour: WireContour, face: tuple[str, str], labelled: bool) -> None:
    """Draw the path of the wire's centre on a face, each pass in its colour; a tab's passes are dashed."""
    where, colour = face
    if not contour.passes:
        points, label = contour.points_um / 1e3 - path.origin_mm, f"wire's centre{where}" if labelled else None
        axes.plot(*points.T, color=colour, linewidth=0.9, zorder=3, label=label)
        return
    for one in contour.passes:
        said = one.piece == "profile" and where in ("", ", below")
        name = f"pass {one.number}, {one.offset_um / 1e3:.3f} mm" if said else None
        style = "-" if one.piece == "profile" else (0, (3, 1.5))
        points = one.points_um / 1e3 - path.origin_mm
        axes.plot(
            *points.T, color=palette.pass_colour(one.number), linewidth=0.8, linestyle=style, zorder=3,
            label=name if labelled else None,
        )  # fmt: skip


def _draw_blank(axes: Axes, path: CutPath, kerf_um: float) -> None:
    (x0, y0, x1, y1), (dx, dy) = path.stock_mm, path.origin_mm
    axes.add_patch(Rectangle((x0 - dx, y0 - dy), x1 - x0, y1 - y0, **_BLANK))
    lines = [
        shapely.LineString(points / 1e3 - path.origin_mm)
        for contour in path.contours for _, _, face in _faces(contour) for points in face.guide_paths_um
    ]
    kerf = shapely.union_all([line.buffer(kerf_um / 2e3) for line in lines])
    fill(axes, kerf, "#cfe3f1", "kerf")
    for place_um in path.start_holes_um:
        look: dict[str, Any] = {"facecolor": "white", "edgecolor": palette.MUTED, "zorder": 2}
        axes.add_patch(Circle(place_um / 1e3 - path.origin_mm, path.start_hole_radius_mm, **look))


def _draw_arrows(axes: Axes, points: Floats) -> None:
    """Draw arrows in the direction of the cut."""
    line = shapely.LineString(points)
    for share in (np.arange(_ARROWS) + 0.5) / _ARROWS:
        at = share * line.length
        tail, head = (shapely.get_coordinates(line.interpolate(s))[0] for s in (at, at + 1e-3 * line.length))
        look = {"arrowstyle": "-|>", "color": palette.BLUE, "linewidth": 0.9}
        axes.annotate("", head, tail, arrowprops=look, zorder=5)
