"""Figures of the pulses: statistics over time, the plane of short and open, the distribution of ignition delays."""

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from edmsim.cosim.straight import KINDS, PulseSample
from edmsim.geometry import Floats
from edmsim.recording.figures.palette import BLUE, GREEN, INK, LINE, MUTED, ORANGE, PURPLE, SKY, VERMILION
from edmsim.recording.figures.profile import bands, draw_shares, mark_pauses, time_unit
from edmsim.recording.figures.style import LABEL_PT, colour_bar, column_figure, dress, legend, nothing_to_show
from edmsim.recording.windows import column

BINS = 250  # most points a series is drawn with: two a pixel at one column's width
PATH_STEPS = 120  # points of the controller's path (ours: few enough to be followed by eye)
TAIL_US = 10.0  # from this delay on only the long branch of breakdowns is left (see `edmsim.validation.ignition`)
LEAST_TAIL = 20  # breakdowns needed in the tail for a line through it (ours: its slope is known to some 20 %)


def pulses_figure(windows: pa.Table) -> Figure:
    """Draw the pulses over machine time: classes, voltage and current, ignition delay, gas, feed."""
    figure = column_figure(5.1, top_in=0.25, right_in=0.42)
    if windows.num_rows == 0:
        return nothing_to_show(figure, "no pulses: the cut has no window")
    t_s = column(windows, "t_s")
    unit, seconds = time_unit(float(t_s[-1]))
    t = t_s / seconds
    panels = figure.subplots(5, 1, sharex=True, height_ratios=[1.5, 1.0, 1.0, 1.0, 1.0], gridspec_kw={"hspace": 0.12})
    for axes in panels:
        mark_pauses(axes, t_s, seconds, "threading" if axes is panels[0] else None)
    dress(panels[0], "", "pulses, %")
    draw_shares(panels[0], t, windows, BINS)
    legend(panels[0], above=True, columns=5)
    _draw_band(panels[1], t, t_s, column(windows, "mean_voltage_V"), BLUE, "voltage, V")
    current = panels[1].twinx()
    if "net_voltage_V" in windows.column_names:
        _draw_band(panels[1], t, t_s, column(windows, "net_voltage_V"), SKY, "voltage, V", "with equalising pulses")
        panels[1].set_zorder(current.get_zorder() + 1)  # the legend before the current
        panels[1].patch.set_visible(False)
        legend(panels[1])
    _draw_band(current, t, t_s, column(windows, "mean_current_A"), VERMILION, "current, A")
    current.spines["right"].set(visible=True, color=LINE)
    current.grid(visible=False)
    for axes, colour in ((panels[1], BLUE), (current, VERMILION)):
        axes.yaxis.label.set_color(colour)
    _draw_band(panels[2], t, t_s, column(windows, "mean_delay_us"), PURPLE, "delay, µs")
    _draw_band(panels[3], t, t_s, 100.0 * column(windows, "coverage"), SKY, "gas, %")
    _draw_band(panels[4], t, t_s, column(windows, "feed_um_s"), GREEN, "feed, µm/s")
    panels[4].set_xlabel(f"machine time, {unit}", fontsize=LABEL_PT, color=MUTED)
    panels[0].margins(x=0)
    figure.align_ylabels(panels)
    return figure


def _draw_band(
    axes: Axes, t: Floats, t_s: Floats, values: Floats, colour: str, label: str, name: str | None = None
) -> None:
    dress(axes, "", label)
    for number, band in enumerate(bands(t, values, t_s, BINS)):
        axes.fill_between(band.x, band.low, band.high, color=colour, alpha=0.15, linewidth=0)
        axes.plot(band.x, band.mean, color=colour, linewidth=0.9, label=None if number else name)


def plane_figure(windows: pa.Table) -> Figure:
    """Draw the windows' shares of short and open pulses, and their course over time.

    Dots are windows; the line is their mean over equal spans of time.
    """
    figure = column_figure(3.3, top_in=0.49)
    if windows.num_rows == 0:
        return nothing_to_show(figure, "no pulses: the cut has no window")
    pulses = np.sum([column(windows, kind) for kind in KINDS], axis=0)
    short, open_ = (100.0 * column(windows, kind) / np.maximum(pulses, 1.0) for kind in ("short", "open"))
    t_s = column(windows, "t_s")
    unit, seconds = time_unit(float(t_s[-1]))
    axes = figure.add_subplot()
    dress(axes, "open pulses, %", "short pulses, %")
    axes.plot(
        open_, short, ".", color=MUTED, markersize=2.0, alpha=0.12, markeredgewidth=0, rasterized=True, zorder=1
    )
    ways = [
        np.column_stack([band.mean for band in stretch])
        for stretch in zip(*(bands(t_s, v, t_s, PATH_STEPS) for v in (t_s / seconds, open_, short)), strict=True)
    ]
    pieces = np.concatenate([np.stack([way[:-1], way[1:]], axis=1) for way in ways])
    path = LineCollection(list(pieces[:, :, 1:]), array=pieces[:, 0, 0], cmap="viridis", linewidth=1.1, zorder=3)
    axes.add_collection(path, autolim=False)
    axes.plot(*ways[0][0, 1:], "^", color=GREEN, markersize=6, markeredgecolor="white", zorder=4, label="start")
    axes.plot(*ways[-1][-1, 1:], "s", color=VERMILION, markersize=5, markeredgecolor="white", zorder=4, label="end")
    axes.plot([0, 100], [100, 0], color=INK, linewidth=0.7, linestyle=":", zorder=2, label="no pulse ignites")
    axes.set_xlim(0, 100)
    axes.set_ylim(0, max(float(short.max()), 10.0) * 1.03)
    colour_bar(figure, path, f"path of the controller over machine time, {unit}")
    legend(axes, loc="upper right")
    return figure


def delay_figure(sample: PulseSample, windows: pa.Table | None = None) -> Figure:
    """Draw the distribution of ignition delays: histogram above, survival on a logarithmic scale below.

    Survival is the share of pulses, without shorts, that have not ignited yet (Laue's plot); an exponential delay is
    a straight line. With a cut's windows, the histogram has their mean delays as well.
    """
    figure = column_figure(3.9, top_in=0.25)
    delay = sample.delay_us[np.isfinite(sample.delay_us)]
    if not len(delay):
        return nothing_to_show(figure, "no ignition delay: none of the pulses looked at ignited")
    above, below = figure.subplots(2, 1, sharex=True, gridspec_kw={"hspace": 0.08})
    edges = np.linspace(0.0, max(float(delay.max()), 1.0), 41)
    dress(above, "", "density, 1/µs")
    above.hist(delay, edges, density=True, color=BLUE, alpha=0.75, label=f"{len(delay)} single delays")
    if windows is not None:
        means = column(windows, "mean_delay_us")
        weights = column(windows, "spark") + column(windows, "arc")
        known = np.isfinite(means)
        above.hist(
            means[known], edges, weights=weights[known], density=True, histtype="step", color=ORANGE, linewidth=1.1,
            label="means of the cut's windows",
        )  # fmt: skip
    legend(above)
    _draw_survival(below, delay, int(np.sum(sample.kind == KINDS.index("open"))))
    below.set_xlim(0.0, edges[-1])
    below.set_xlabel("ignition delay, µs", fontsize=LABEL_PT, color=MUTED)
    above.set_title(
        f"straight cut at {sample.feed_um_s:.1f} µm/s: {100 * sample.share('open'):.0f} % open, "
        f"{100 * sample.share('short'):.0f} % short", fontsize=LABEL_PT, color=INK, loc="left",
    )  # fmt: skip
    return figure


def _draw_survival(axes: Axes, delay_us: Floats, open_: int) -> None:
    """Share of pulses not yet ignited; open ones never do."""
    ordered = np.sort(delay_us)
    pulses = len(ordered) + open_
    dress(axes, "", "not yet ignited, %")
    axes.set_yscale("log")
    axes.plot(ordered, 1.0 - np.arange(1, len(ordered) + 1) / (pulses + 1), color=BLUE, linewidth=1.2, label="pulses")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda share, _: f"{100 * share:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    tail = ordered[ordered > TAIL_US]
    if len(tail) >= LEAST_TAIL:
        end = float(ordered[-1])
        # open pulses have waited to the end: they count as time without breakdown (censored exponential)
        mean = float((tail - TAIL_US).sum() + open_ * (end - TAIL_US)) / len(tail)
        t = np.array([TAIL_US, end])
        left = (len(tail) + open_) / pulses
        axes.plot(
            t, left * np.exp(-(t - TAIL_US) / mean), color=ORANGE, linewidth=1.0, linestyle="--",
            label=f"exponential from {TAIL_US:g} µs, mean {mean:.1f} µs",
        )  # fmt: skip
    legend(axes)
