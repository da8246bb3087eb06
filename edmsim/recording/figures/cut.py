"""Figures of a cut: profile error map and its shares, corner, kerf over the height, pulses, wire, passes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.mlab import psd
from matplotlib.patches import Circle
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from edmsim.closed_loop.straight import KINDS, PulseSample
from edmsim.errors import InputError
from edmsim.geometry import Floats, arc_lengths, interpolated
from edmsim.machine.machine import Machine
from edmsim.metrology.error_budget import SHARES
from edmsim.metrology.profile import CornerError
from edmsim.plant.constants import modal_model
from edmsim.plant.resolution import resolution as named
from edmsim.recording.figures import palette, style
from edmsim.recording.figures.palette import BLUE, GREEN, GRID, INK, LINE, MUTED, ORANGE, PURPLE, SKY, VERMILION
from edmsim.recording.figures.profile import (
    bands,
    draw_errors,
    draw_shares,
    label_corners,
    mark_pauses,
    time_unit,
    write_not_measured,
)
from edmsim.recording.report import Report, mm_text
from edmsim.recording.scene import ErrorMap, Scene
from edmsim.recording.windows import column, columns, quantity

_COLOURS = palette.SKY, palette.PURPLE, palette.GREEN, palette.BLUE, palette.ORANGE
_SHOWN = 99.0  # percentile of the errors that sets the axes' limits; single corners may exceed them (ours)


@style.in_style
def shares_figure(scene: Scene) -> Figure:
    """Draw the profile error and its shares over the distance along the nominal edges, a panel each, on one scale."""
    split = [edge for edge in scene.maps if edge.shares_um is not None and np.isfinite(edge.error_um).any()]
    if not split:
        return style.EmptyFigure(
            "no shares: no error was measured, the wire is tilted, or its centre follows the contour"
        )
    figure = style.column_figure(5.6, top_in=0.25, left_in=0.52)
    s_mm, error, shares = _joined(split)
    panels = figure.subplots(1 + len(SHARES), 1, sharex=True, sharey=True, gridspec_kw={"hspace": 0.22})
    names, colours = ("profile error (mean over height)", *SHARES), (palette.INK, *_COLOURS)
    for axes, name, values, colour in zip(panels, names, (error, *shares), colours, strict=True):
        style.dress(axes, "", "")
        axes.axhline(0.0, color=palette.MUTED, linewidth=0.6)
        axes.plot(s_mm, values, color=colour, linewidth=0.7)
        known = values[np.isfinite(values)]
        rms, mean = np.sqrt(np.mean(known**2)), f"{known.mean():+.1f}".replace("-", "−")
        title = f"{name}: mean {mean}, {rms:.1f} µm rms"
        axes.set_title(title, fontsize=style.TICK_PT, color=palette.INK, loc="left", pad=2)
    limit = 1.2 * max(float(np.nanpercentile(np.abs([error, *shares]), _SHOWN)), 0.5)
    panels[0].set_ylim(-limit, limit)
    panels[0].margins(x=0)
    panels[-1].set_xlabel("along the nominal edge, mm", fontsize=style.LABEL_PT, color=palette.MUTED)
    panels[len(SHARES) // 2].set_ylabel("µm, + metal left", fontsize=style.LABEL_PT, color=palette.MUTED)
    return figure


def _joined(split: list[ErrorMap]) -> tuple[Floats, Floats, Floats]:
    """Return distance along the edges, error and shares of all contours in a row, with NaN between contours."""
    distances, errors, shares, begin = [], [], [], 0.0
    for edge in split:
        assert edge.shares_um is not None
        distance = begin + arc_lengths(edge.points_mm)
        begin = float(distance[-1])
        distances.append(np.append(distance, begin))
        errors.append(np.append(edge.error_um, np.nan))
        shares.append(np.column_stack([edge.shares_um, np.full(len(SHARES), np.nan)]))
    return np.concatenate(distances), np.concatenate(errors), np.concatenate(shares, axis=1)


CORNER_REACH_MM = 0.4  # half the width of a corner's detail (ours: shows the whole kerf and wire)
LABELLED = 6  # most corners labelled with their errors, the largest ones


@style.in_style
def error_figure(scene: Scene) -> Figure:
    """Draw the profile error along the nominal edge, exaggerated, with colours for sign and size."""
    if not len(scene.known_errors()):
        return style.EmptyFigure("no profile error: no edge of the part was measured")
    scene = scene.in_program()
    points = np.concatenate([edge.nominal_mm for edge in scene.maps])
    (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
    margin = 0.08 * max(x1 - x0, y1 - y0)
    across, high = x1 - x0 + 2 * margin, y1 - y0 + 2 * margin
    figure = style.column_figure(float(np.clip(2.9 * high / across, 1.0, 4.2)) + 0.85, top_in=0.49)
    axes = figure.add_subplot()
    style.dress(axes, *scene.axis_labels())
    axes.grid(visible=False)
    factor = scene.error_factor()
    lines = draw_errors(axes, scene, factor, (0.4, 1.2), 0.4, 3)
    assert lines is not None
    for edge in scene.maps:
        axes.plot(*edge.nominal_mm.T, color=palette.INK, linewidth=0.6, linestyle=(0, (5, 3)), zorder=2)
    axes.set_aspect("equal")
    axes.set_xlim(x0 - margin, x1 + margin)
    axes.set_ylim(y0 - margin, y1 + margin)
    axes.apply_aspect()  # sets the scale, which the labels' places depend on
    box = {"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
    label_corners(axes, scene, LABELLED, style.TICK_PT, box, 5)
    style.colour_bar(figure, lines, f"profile error, µm: − undercut, + metal left; drawn × {factor:g}")
    return figure


@style.in_style
def corner_figure(scene: Scene, windows: pa.Table, corner: int | None = None) -> Figure:
    """Draw one corner: above, metal and paths to scale; below, the deviations along the corner.

    The wire's path is drawn at the height of the metal, averaged over windows.

    Parameters
    ----------
    corner : int, optional
        Index in ``scene.corners``; by default that of the largest error.

    Raises
    ------
    InputError
        If there is no such corner.
    """
    chosen = _chosen_corner(scene, windows, corner)
    if chosen is None:
        return style.EmptyFigure("no corner: the edge as drawn has none, or the wire has come to none")
    figure = style.column_figure(5.2, top_in=0.55)
    detail, below = figure.subplots(2, 1, height_ratios=[2.6, 1.0], gridspec_kw={"hspace": 0.5})
    place = np.array([chosen.x_mm, chosen.y_mm])
    _draw_detail(detail, scene, windows, place)
    _draw_deviation(below, scene, windows, place)
    x, y = map(mm_text, (place - (scene.origin_mm or (0.0, 0.0))).tolist())
    error = "unknown" if np.isnan(chosen.error_um) else f"{chosen.error_um:+.1f} µm".replace("-", "−")
    detail.set_title(
        f"corner at X {x} Y {y} mm, {chosen.turn_deg:+.0f}°: {error}".replace("-", "−"),
        fontsize=style.LABEL_PT, color=palette.INK, loc="left", pad=28,
    )  # fmt: skip
    return figure


def _chosen_corner(scene: Scene, windows: pa.Table, corner: int | None) -> CornerError | None:
    if corner is None:
        at_mm = _axis_um(scene, windows) / 1000
        away_mm = [np.hypot(*(at_mm - (c.x_mm, c.y_mm)).T).min(initial=np.inf) for c in scene.corners]
        reached = [c for c, mm in zip(scene.corners, away_mm, strict=True) if mm < 2 * CORNER_REACH_MM]
        return max(reached, key=lambda c: -1.0 if np.isnan(c.error_um) else abs(c.error_um), default=None)
    if not 0 <= corner < len(scene.corners):
        raise InputError(f"there is no corner {corner}: the cut has corners 0 to {len(scene.corners) - 1}")
    return scene.corners[corner]


def _draw_detail(axes: Axes, scene: Scene, windows: pa.Table, place_mm: Floats) -> None:
    reach, height_mm = 1000 * CORNER_REACH_MM, scene.middle_mm()
    drawn_mm = scene.as_drawn_mm(height_mm)
    at_mid = np.concatenate([edge.nominal_mm for edge in scene.maps])  # the corner's place is known at mid height
    place_mm = np.concatenate(drawn_mm)[np.hypot(*(at_mid - place_mm).T).argmin()]
    style.dress(axes, "X from the corner, µm", "Y from the corner, µm")
    axes.grid(visible=False)
    axes.set_facecolor(palette.METAL)
    box = shapely.box(*(place_mm - CORNER_REACH_MM), *(place_mm + CORNER_REACH_MM))
    shown = shapely.intersection(shapely.make_valid(scene.kerf()), box)
    style.fill(axes, shapely.transform(shown, lambda mm: 1000 * (mm - place_mm)))
    for number, line in enumerate(scene.middle_edges_mm()):
        axes.plot(
            *(1000 * (line - place_mm)).T, color="#3d4852", linewidth=0.8, zorder=3,
            label=f"metal edge, {scene.middle_text()}" if number == 0 else None,
        )  # fmt: skip
    for number, line in enumerate(drawn_mm):
        axes.plot(
            *(1000 * (line - place_mm)).T, color=palette.INK, linewidth=0.8, linestyle=(0, (5, 3)),
            zorder=4, label="nominal edge" if number == 0 else None,
        )  # fmt: skip
    following = columns(windows, "following_x_um", "following_y_um")
    guides = _axis_um(scene, windows, height_mm) - following - 1000 * place_mm
    wire = guides - columns(windows, "lag_x_um", "lag_y_um")
    away = np.abs(guides).max(axis=1) > 2 * reach  # breaks the lines between two passages
    guides[away], wire[away] = np.nan, np.nan
    axes.plot(*guides.T, color=palette.ORANGE, linewidth=0.9, zorder=5, label="guides")
    axes.plot(*wire.T, color=palette.BLUE, linewidth=0.6, zorder=6, label="wire")
    nearest = np.nanargmin(np.hypot(*guides.T)) if np.isfinite(guides).any() else None
    if nearest is not None:
        radius = scene.wire_diameter_um / 2
        round_wire = {"fill": False, "color": palette.BLUE, "linewidth": 0.7, "linestyle": ":"}
        axes.add_patch(Circle(tuple(wire[nearest]), radius, **round_wire))
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    axes.set_aspect("equal")
    style.legend(axes, above=True, columns=2)


def _draw_deviation(axes: Axes, scene: Scene, windows: pa.Table, place_mm: Floats) -> None:
    """Draw the deviations of wire and metal edge over the distance from the corner along the nominal edge."""
    style.dress(axes, "along the nominal edge from the corner, µm", "off, µm")
    axes.axhline(0.0, color=palette.MUTED, linewidth=0.6)
    axes.axvline(0.0, color=palette.GRID, linewidth=0.8)
    reach = 1000 * CORNER_REACH_MM
    for edge in scene.maps:
        off = np.hypot(*(edge.points_mm - place_mm).T)
        if len(off) and off.min() < 1e-3:
            along_um = 1000 * arc_lengths(edge.points_mm)
            s, total = along_um - along_um[off.argmin()], along_um[-1]
            s = (s + total / 2) % total - total / 2 if np.allclose(edge.nominal_mm[0], edge.nominal_mm[-1]) else s
            order = np.argsort(s)
            error = edge.error_um[order]
            axes.plot(s[order], error, color="#3d4852", linewidth=1.0, label="profile error (+ metal left)")
            guides = _axis_um(scene, windows) / 1000
            _draw_lag(axes, windows, guides, edge.points_mm[order], s[order], place_mm, edge.outward()[order])
            break
    axes.set_xlim(-reach, reach)
    style.legend(axes, above=True)


def _axis_um(scene: Scene, windows: pa.Table, height_mm: float | None = None) -> Floats:
    return scene.axis_um(columns(windows, "x_um", "y_um"), column(windows, "path_um"), height_mm)


def _draw_lag(
    axes: Axes, windows: pa.Table, guides: Floats, edge_mm: Floats, s: Floats, place_mm: Floats, outward: Floats
) -> None:
    """Draw the wire's displacement from its guides, positive away from the part, at the nearest place of the edge."""
    from scipy.spatial import cKDTree

    near = np.hypot(*(guides - place_mm).T) < 2 * CORNER_REACH_MM
    if not near.any():
        return
    lag = columns(windows, "lag_x_um", "lag_y_um")[near]
    nearest = cKDTree(edge_mm).query(guides[near])[1]
    away = -(lag * outward[nearest]).sum(axis=1)
    places, group = np.unique(nearest, return_inverse=True)
    mean = np.bincount(group, away) / np.bincount(group)
    axes.plot(s[places], mean, color=palette.BLUE, linewidth=0.9, label="wire off its guides (+ away from the part)")


@style.in_style
def kerf_figure(report: Report) -> Figure:
    """Draw the kerf's cross-section over the workpiece's height, averaged along the cut.

    The band covers nine tenths of the measured places. The gap between wire and walls is enlarged, and the wire is
    omitted.
    """
    slices = report.kerf_section
    section = [row for row in slices if row.places]
    if not section:
        return style.EmptyFigure("no kerf: there was no place to measure its width")
    figure = style.column_figure(2.9, top_in=0.36)
    radius = report.settings["wire_diameter_um"] / 2
    z = np.array([row.height_mm for row in section])
    panels = figure.subplots(1, 2, sharey=True, gridspec_kw={"wspace": 0.24})
    for panel, side in zip(panels, ("rest", "part"), strict=True):
        mean, low, high = (
            np.array([row[side][key] for row in section]) - radius for key in ("mean_um", "p5_um", "p95_um")
        )
        panel.fill_betweenx(z, low, high, color=palette.BLUE, alpha=0.18, linewidth=0)
        panel.plot(mean, z, color=palette.BLUE, linewidth=1.3, marker="o", markersize=2.5)
        style.dress(panel, f"wire to wall of the {side}, µm", "")
    reach = max(np.ptp(panel.get_xlim()) for panel in panels) / 2  # common scale; trims leave the walls far apart
    for panel, outwards in zip(panels, (-1, 1), strict=True):
        middle = np.mean(panel.get_xlim())
        panel.set_xlim(middle - outwards * reach, middle + outwards * reach)  # the wire is between the panels
        panel.xaxis.set_major_locator(MaxNLocator(4))
    panels[0].set_ylabel("height over the lower face, mm", fontsize=style.LABEL_PT, color=palette.MUTED)
    panels[0].set_ylim(0, slices[-1].height_mm + slices[0].height_mm)
    panels[0].set_title(
        f"kerf {report.text('kerf_um.mean')} on average, wire {2 * radius:g} µm\n"
        "line: mean along the cut, band: nine tenths", fontsize=style.LABEL_PT, color=palette.INK, loc="left",
    )  # fmt: skip
    return figure


# Figures of the pulses: statistics over time, the plane of short and open, the distribution of ignition delays.

BINS = 250  # most points of a drawn series: two per pixel at one column's width
PATH_STEPS = 120  # points of the controller's path (ours: few enough to follow by eye)
TAIL_US = 10.0  # longer delays are all of the long branch of breakdowns (see `edmsim.validation.discharges`)
LEAST_TAIL = 20  # least breakdowns in the tail for a fitted line (ours: its slope is known to some 20 %)


@style.in_style
def pulses_figure(windows: pa.Table) -> Figure:
    """Draw the pulses over machine time: classes, voltage and current, ignition delay, gas, feed."""
    if windows.num_rows == 0:
        return style.EmptyFigure("no pulses: the cut has no window")
    figure = style.column_figure(5.1, top_in=0.25, right_in=0.55)
    t_s = column(windows, "t_s")
    unit, seconds = time_unit(float(t_s[-1]))
    t = t_s / seconds
    panels = figure.subplots(5, 1, sharex=True, height_ratios=[1.5, 1.0, 1.0, 1.0, 1.0], gridspec_kw={"hspace": 0.12})
    for axes in panels:
        mark_pauses(axes, t_s, seconds, "threading" if axes is panels[0] else None)
    style.dress(panels[0], "", "pulses, %")
    draw_shares(panels[0], t, windows, BINS)
    style.legend(panels[0], above=True, columns=5)
    _draw_band(panels[1], t, t_s, column(windows, "mean_voltage_V"), BLUE, "voltage, V")
    current = panels[1].twinx()
    if "net_voltage_V" in windows.column_names:
        _draw_band(panels[1], t, t_s, column(windows, "net_voltage_V"), SKY, "voltage, V", "with equalising pulses")
        panels[1].set_zorder(current.get_zorder() + 1)  # draws the legend over the current
        panels[1].patch.set_visible(False)
        style.legend(panels[1])
        panels[1].get_legend().set_frame_on(False)
    _draw_band(current, t, t_s, column(windows, "mean_current_A"), VERMILION, "current, A")
    current.spines["right"].set(visible=True, color=LINE)
    current.grid(visible=False)
    for axes, colour in ((panels[1], BLUE), (current, VERMILION)):
        axes.yaxis.label.set_color(colour)
    _draw_band(panels[2], t, t_s, column(windows, "mean_delay_us"), PURPLE, "delay, µs")
    _draw_band(panels[3], t, t_s, 100.0 * column(windows, "coverage"), SKY, "gas, %")
    _draw_band(panels[4], t, t_s, column(windows, "feed_um_s"), GREEN, "feed, µm/s")
    panels[4].set_xlabel(f"machine time, {unit}", fontsize=style.LABEL_PT, color=MUTED)
    panels[0].margins(x=0)
    figure.align_ylabels(panels)
    return figure


def _draw_band(
    axes: Axes, t: Floats, t_s: Floats, values: Floats, colour: str, label: str, name: str | None = None
) -> None:
    style.dress(axes, "", label)
    for number, band in enumerate(bands(t, values, t_s, BINS)):
        axes.fill_between(band.x, band.low, band.high, color=colour, alpha=0.15, linewidth=0)
        axes.plot(band.x, band.mean, color=colour, linewidth=0.9, label=None if number else name)
    if not np.isfinite(values).any():
        write_not_measured(axes)


@style.in_style
def plane_figure(windows: pa.Table) -> Figure:
    """Draw the windows' shares of short and open pulses, and their course over time.

    Dots are windows; the line is their mean over equal spans of time.
    """
    if windows.num_rows == 0:
        return style.EmptyFigure("no pulses: the cut has no window")
    figure = style.column_figure(3.3, top_in=0.49)
    short, open_ = (quantity(windows, kind) for kind in ("short", "open"))
    t_s = column(windows, "t_s")
    unit, seconds = time_unit(float(t_s[-1]))
    axes = figure.add_subplot()
    style.dress(axes, "open pulses, %", "short pulses, %")
    axes.plot(
        open_, short, ".", color=MUTED, markersize=2.0, alpha=0.12, markeredgewidth=0, rasterized=True, zorder=1
    )
    tracks = [
        np.column_stack([band.mean for band in stretch])
        for stretch in zip(*(bands(t_s, v, t_s, PATH_STEPS) for v in (t_s / seconds, open_, short)), strict=True)
    ]
    pieces = np.concatenate([np.stack([track[:-1], track[1:]], axis=1) for track in tracks])
    path = LineCollection(list(pieces[:, :, 1:]), array=pieces[:, 0, 0], cmap="viridis", linewidth=1.1, zorder=3)
    axes.add_collection(path, autolim=False)
    axes.plot(*tracks[0][0, 1:], "^", color=GREEN, markersize=6, markeredgecolor="white", zorder=4, label="start")
    axes.plot(*tracks[-1][-1, 1:], "s", color=VERMILION, markersize=5, markeredgecolor="white", zorder=4, label="end")
    axes.plot([0, 100], [100, 0], color=INK, linewidth=0.7, linestyle=":", zorder=2, label="no pulse ignites")
    axes.set_xlim(0, 100)
    axes.set_ylim(0, max(float(short.max()), 10.0) * 1.03)
    style.colour_bar(figure, path, f"path of the controller over machine time, {unit}")
    style.legend(axes, loc="upper right")
    return figure


@style.in_style
def delay_figure(sample: PulseSample, windows: pa.Table | None = None) -> Figure:
    """Draw the distribution of ignition delays: histogram above, survival on a logarithmic scale below.

    Survival is the share of pulses, without shorts, that have not ignited yet (Laue's plot); an exponential delay is
    a straight line. With a cut's windows, the histogram has their mean delays as well.
    """
    delay = sample.delay_us[np.isfinite(sample.delay_us)]
    if not len(delay):
        return style.EmptyFigure("no ignition delay: none of the pulses looked at ignited")
    figure = style.column_figure(3.9, top_in=0.25)
    above, below = figure.subplots(2, 1, sharex=True, gridspec_kw={"hspace": 0.08})
    edges = np.linspace(0.0, max(float(delay.max()), 1.0), 41)
    style.dress(above, "", "density, 1/µs")
    above.hist(delay, edges, density=True, color=BLUE, alpha=0.75, label=f"{len(delay)} single delays")
    if windows is not None:
        means = column(windows, "mean_delay_us")
        weights = column(windows, "spark") + column(windows, "arc")
        known = np.isfinite(means)
        above.hist(
            means[known], edges, weights=weights[known], density=True, histtype="step", color=ORANGE, linewidth=1.1,
            label="means of the cut's windows",
        )  # fmt: skip
    style.legend(above)
    _draw_survival(below, delay, int(np.sum(sample.kind == KINDS.index("open"))))
    below.set_xlim(0.0, edges[-1])
    below.set_xlabel("ignition delay, µs", fontsize=style.LABEL_PT, color=MUTED)
    above.set_title(
        f"straight cut at {sample.feed_um_s:.1f} µm/s: {100 * sample.share('open'):.0f} % open, "
        f"{100 * sample.share('short'):.0f} % short", fontsize=style.LABEL_PT, color=INK, loc="left",
    )  # fmt: skip
    return figure


def _draw_survival(axes: Axes, delay_us: Floats, open_: int) -> None:
    """Draw the share of pulses that have not ignited yet; open pulses never ignite."""
    ordered = np.sort(delay_us)
    pulses = len(ordered) + open_
    style.dress(axes, "", "not yet ignited, %")
    axes.set_yscale("log")
    axes.plot(ordered, 1.0 - np.arange(1, len(ordered) + 1) / (pulses + 1), color=BLUE, linewidth=1.2, label="pulses")
    few_ignite = open_ > 0.2 * pulses  # the axis is shorter than a decade, so ticks at 1, 2 and 5 may be too few
    axes.yaxis.set_major_locator(MaxNLocator(5) if few_ignite else LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda share, _: f"{100 * share:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    tail = ordered[ordered > TAIL_US]
    if len(tail) >= LEAST_TAIL:
        end = float(ordered[-1])
        # open pulses count as time without breakdown, to the longest delay (censored exponential)
        mean = float((tail - TAIL_US).sum() + open_ * (end - TAIL_US)) / len(tail)
        t = np.array([TAIL_US, end])
        left = (len(tail) + open_) / pulses
        axes.plot(
            t, left * np.exp(-(t - TAIL_US) / mean), color=ORANGE, linewidth=1.0, linestyle="--",
            label=f"exponential from {TAIL_US:g} µs, mean {mean:.1f} µs",
        )  # fmt: skip
    axes.set_ylim(top=1.0)
    style.legend(axes)


# The figure of the wire's vibration: modes over tension, and spectra of simulated cuts.

TENSIONS = 5  # tensions at which modes are computed, to be interpolated between
SEGMENTS = 8  # segments of a sample whose spectra are averaged (Welch): more give smoother, wider lines


def wire_frequencies_hz(machine: Machine, resolution: str) -> Floats:
    """Return the undamped frequencies of the wire's modes in Hz, lowest first, as the plant has them."""
    return np.asarray(modal_model(machine, named(resolution)).wire_omega / (2 * np.pi))


def folded_hz(frequency_hz: Floats, sampling_hz: float) -> Floats:
    """Return the aliases of frequencies sampled once per pulse: between 0 and half the pulse frequency."""
    return np.asarray(np.abs((frequency_hz + sampling_hz / 2) % sampling_hz - sampling_hz / 2))


def spectrum(sample: PulseSample) -> tuple[Floats, Floats, Floats]:
    """Return frequencies in Hz, and power spectra along and across the feed in um^2/Hz, averaged over the slices."""
    # Welch's method of matplotlib, because loading scipy.signal takes longer than drawing the whole figure
    length = max(len(sample.deflection_um) // SEGMENTS, 2)
    window = 0.5 - 0.5 * np.cos(2 * np.pi / length * np.arange(length))
    per_place = [
        psd(place_um, NFFT=length, Fs=1e6 / sample.period_us, detrend="linear", window=window, noverlap=length // 2)
        for place_um in sample.deflection_um.reshape(len(sample.deflection_um), -1).T
    ]
    power = np.array([power for power, _ in per_place]).reshape(-1, 2, length // 2 + 1)
    along, across = power.mean(axis=0)
    return np.asarray(per_place[0][1]), along, across


@style.in_style
def spectrum_figure(samples: Sequence[PulseSample], resolution: str = "default") -> Figure:
    """Draw spectra and the wire's modes over its tension (a Campbell diagram).

    Parameters
    ----------
    samples : sequence of PulseSample
        Cuts that differ only in tension. The figure has the spectrum of the first and, if there are several,
        the spectra of all over their tensions.
    resolution : {"fast", "default", "fine"}
        Determines the number of modes.

    Returns
    -------
    matplotlib.figure.Figure
        One column wide. The wire is sampled once per pulse: frequencies above half the pulse frequency appear
        folded below it, and motion in step with the pulses appears at 0.

    Raises
    ------
    InputError
        If there is no sample, or one is too short for a spectrum.
    """
    if not samples or min(len(s.kind) for s in samples) < 4 * SEGMENTS:
        raise InputError(f"a spectrum needs a sample of at least {4 * SEGMENTS} pulses")
    first = samples[0]
    figure = style.column_figure(3.5, top_in=0.48, right_in=0.17)
    modes, spectrum = figure.subplots(1, 2, sharey=True, width_ratios=[1.7, 1.0], gridspec_kw={"wspace": 0.14})
    sampling_hz = 1e6 / first.period_us
    if len(samples) > 1:
        _draw_waterfall(modes, samples)
    _draw_modes(modes, first, sampling_hz, resolution)
    _draw_spectrum(spectrum, first, sampling_hz, resolution)
    modes.set_ylim(0, sampling_hz / 2e3)
    style.legend(modes, above=True, columns=2)
    return figure


def _draw_modes(axes: Axes, sample: PulseSample, sampling_hz: float, resolution: str) -> None:
    machine = sample.machine
    tension, frequency = _modes_over_tension(machine, resolution)
    style.dress(axes, "wire tension, N", "frequency, kHz")
    for number, line in enumerate(frequency.T):
        below = np.where(line <= sampling_hz / 2, line, np.nan)
        folded = np.where(line > sampling_hz / 2, folded_hz(line, sampling_hz), np.nan)
        axes.plot(tension, below / 1e3, color=INK, linewidth=1.0, label="mode" if number == 0 else None)
        thin: dict[str, Any] = {"color": INK, "linewidth": 0.6, "linestyle": (0, (3, 3)), "alpha": 0.6}
        # only the first few, because the others are crowded and hardly depend on the tension
        if number < 4 and np.isfinite(folded).any():
            axes.plot(tension, folded / 1e3, **thin)
        if np.isfinite(below).sum() > 1:
            last = int(np.flatnonzero(np.isfinite(below))[-1])
            through_the_top = last < len(tension) - 1  # towards the legend
            axes.annotate(
                f"{number + 1}", (tension[last], below[last] / 1e3), xytext=(3, -6) if through_the_top else (2, 3),
                textcoords="offset points", fontsize=style.TICK_PT, color=INK, va="center",
            )  # fmt: skip
    axes.plot([], [], color=INK, linewidth=0.6, linestyle=(0, (3, 3)), alpha=0.6, label="mode, folded")
    axes.axvline(machine.tension, color=VERMILION, linewidth=0.8, label="set tension")
    axes.set_xlim(tension[0], tension[-1])


def _modes_over_tension(machine: Machine, resolution: str) -> tuple[Floats, Floats]:
    """Return tensions in N below the breaking force, and the modes' frequencies there, (tensions, modes) in Hz."""
    known = np.linspace(0.25, min(1.75, 0.99 * machine.breaking_force / machine.tension), TENSIONS) * machine.tension
    frequency = np.array([wire_frequencies_hz(machine.with_(tension=float(n)), resolution) for n in known])
    tension = np.linspace(known[0], known[-1], 200)
    # a string's frequency squared is proportional to its tension, so interpolating the squares is almost exact
    return tension, np.sqrt(interpolated(tension, known, frequency**2))


def _draw_waterfall(axes: Axes, samples: Sequence[PulseSample]) -> None:
    """Draw the spectra over tension, in decades of power along and across the feed together."""
    ordered = sorted(samples, key=lambda s: s.machine.tension)
    tension = np.array([s.machine.tension for s in ordered])
    spectra = [spectrum(s) for s in ordered]
    power = np.log10(np.maximum([along + across for _, along, across in spectra], 1e-12)).T
    axes.pcolormesh(
        tension, spectra[0][0] / 1e3, power, cmap="Blues", shading="nearest", rasterized=True, zorder=0,
        vmin=np.percentile(power, 20), vmax=power.max(),
    )  # fmt: skip


def _draw_spectrum(axes: Axes, sample: PulseSample, sampling_hz: float, resolution: str) -> None:
    frequency, along, across = spectrum(sample)
    style.dress(axes, "power, µm²/Hz", "")
    for hz in wire_frequencies_hz(sample.machine, resolution):
        if hz <= sampling_hz / 2:
            axes.axhline(hz / 1e3, color=GRID, linewidth=1.2, zorder=1)
    for power, colour, name in ((along, BLUE, "along feed"), (across, ORANGE, "across")):
        axes.semilogx(power[1:], frequency[1:] / 1e3, color=colour, linewidth=0.9, label=name, zorder=2)
    axes.xaxis.set_minor_formatter("")  # on a short axis they would have labels, wider than the column
    axes.grid(axis="y", visible=False)
    style.legend(axes, above=True, title=f"{sample.machine.tension:.3g} N, {sampling_hz / 1e3:.3g} kHz pulses")


# Figures of passes: the wall after each over the height, their time, stock and roughness, and the part's face.

@style.in_style
def passes_figure(report: Report) -> Figure:
    """Draw the result of each pass of a cut in passes: wall over the height, time, stock and roughness."""
    rows = [row for row in report.passes if row.piece == "profile" and row.left_um is not None]
    if not rows:
        return style.EmptyFigure("no passes: the cut was made in one, or no wall was measured after any")
    rows = [row for row in rows if row.contour == rows[0].contour]
    figure = style.column_figure(4.4, top_in=0.3)
    grid = figure.add_gridspec(2, 3, height_ratios=[1.5, 1.0], hspace=0.42, wspace=0.62)
    wall = figure.add_subplot(grid[0, :])
    heights = np.array([row.height_mm for row in report.heights])
    for row in rows:
        own = np.array(row.slices_um, float) - row.left_um
        wall.plot(own, heights, "o-", color=palette.pass_colour(row.number), markersize=2.5, linewidth=1.0,
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
        axes.bar(numbers, values, color=[palette.pass_colour(number) for number in numbers], width=0.7)
        style.dress(axes, "pass", "")
        axes.set_title(name, fontsize=style.TICK_PT, color=INK, loc="left", pad=2)
        axes.set_xticks(numbers)
    return figure


@style.in_style
def face_figure(scene: Scene) -> Figure:
    """Draw the cut face unrolled, at most four contours: profile error over distance along the edge and height."""
    faces = [(edge, um) for edge in scene.maps if (um := edge.face_um) is not None and np.isfinite(um).any()]
    if not faces:
        return style.EmptyFigure("no face: no edge of the part was measured")
    shown = faces[:4]
    figure = style.column_figure(0.95 + 1.05 * len(shown), top_in=0.55)
    known = np.concatenate([np.abs(error_um[np.isfinite(error_um)]) for _, error_um in shown])
    limit = max(float(np.percentile(known, 97)), 0.1)
    panels = np.atleast_1d(figure.subplots(len(shown), 1, gridspec_kw={"hspace": 0.35}))
    for axes, (edge, error_um) in zip(panels, shown, strict=True):
        s = arc_lengths(edge.points_mm)
        ends = np.append(s, s[-1] + max(s[-1] - s[-2], 1e-3)) if len(s) > 1 else np.array([0.0, 1.0])
        axes.pcolormesh(
            ends, np.linspace(0.0, scene.height_mm, len(error_um) + 1), error_um, cmap=style.ERROR_COLOURS,
            norm=Normalize(-limit, limit), rasterized=True, shading="flat",
        )
        style.dress(axes, "", "height, mm")
        axes.grid(visible=False)
    panels[-1].set_xlabel("along the nominal edge, mm", fontsize=style.LABEL_PT, color=MUTED)
    style.colour_bar(figure, panels[0].collections[0], "profile error, µm: − undercut, + metal left")
    return figure
