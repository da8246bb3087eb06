"""The lower part of ``profile.png``: what the machine did, over machine time."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.recording.figures.palette import BLUE, GRID, INK, LINE, MUTED, ORANGE, SHARE_COLOURS, VERMILION
from edmsim.recording.pauses import pause_rows, stretches
from edmsim.recording.windows import column, lag_along_um

if TYPE_CHECKING:
    import pyarrow as pa
    from matplotlib.axes import Axes

BINS = 800
"""Most points a series is drawn with."""


class Band(NamedTuple):
    """A series in bins: where each bin lies, and the mean, least and largest value in it."""

    x: NDArray[np.float64]
    mean: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def binned(x: NDArray[np.float64], values: NDArray[np.float64], bins: int = BINS) -> Band:
    """Put a series into at most `bins` bins of equally many rows.

    Parameters
    ----------
    x, values : float64 array (n,)
        NaN in `values` is left out; a bin with nothing else is NaN.
    bins : int
        At least 1.

    Returns
    -------
    Band
        Arrays of length ``min(n, bins)``.
    """
    edges = np.linspace(0, len(x), min(len(x), bins) + 1).astype(int)
    starts, known = edges[:-1], np.isfinite(values)
    if len(starts) == 0:
        return Band(*(np.zeros(0) for _ in range(4)))
    counts = np.add.reduceat(known.astype(float), starts)
    sums = np.add.reduceat(np.where(known, values, 0.0), starts)
    low = np.minimum.reduceat(np.where(known, values, np.inf), starts)
    high = np.maximum.reduceat(np.where(known, values, -np.inf), starts)
    empty = counts == 0
    mean = np.divide(sums, counts, out=np.full(len(starts), np.nan), where=~empty)
    place = np.add.reduceat(x, starts) / np.diff(edges)
    return Band(place, mean, np.where(empty, np.nan, low), np.where(empty, np.nan, high))


def bands(
    t: NDArray[np.float64], values: NDArray[np.float64], t_s: NDArray[np.float64], bins: int = BINS
) -> list[Band]:
    """Put a series into bins, stretch by stretch between the pauses in times `t_s`: nothing crosses one."""
    share = bins / max(len(t_s), 1)
    return [
        binned(t[part], values[part], max(1, round(share * (part.stop - part.start))))
        for part in stretches(len(t_s), pause_rows(t_s))
    ]


def mark_pauses(axes: Axes, t_s: NDArray[np.float64], seconds: float, label: str | None = None) -> None:
    """Hatch the pauses of an axis over machine time, `seconds` long units; the first has a label."""
    for number, row in enumerate(pause_rows(t_s)):
        axes.axvspan(
            t_s[row - 1] / seconds, t_s[row] / seconds, facecolor="none", edgecolor=LINE, hatch="////", linewidth=0,
            label=None if number else label,
        )  # fmt: skip


def quiet(axes: Axes) -> None:
    """Take from axes what does not speak of the data."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(LINE)
    axes.tick_params(labelsize=8, colors=MUTED, length=3, width=0.6)
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)


def draw_series(panels: list[Axes], windows: pa.Table) -> None:
    """Draw the main series of the windows over machine time, one of `PANELS` on each of the axes."""
    t_s = column(windows, "t_s")
    unit, seconds = time_unit(float(t_s[-1]) if len(t_s) else 0.0)
    for axes, draw in zip(panels, PANELS, strict=True):
        quiet(axes)
        mark_pauses(axes, t_s, seconds, "threading" if axes is panels[0] else None)
        draw(axes, t_s / seconds, windows)
        axes.margins(x=0.005)
        axes.yaxis.set_label_coords(-0.052, 0.5)
        axes.tick_params(labelbottom=axes is panels[-1])
        if axes is not panels[0]:
            axes.sharex(panels[0])
    panels[-1].set_xlabel(
        f"machine time, {unit}   (line: mean, band: least to largest of the windows in a bin)",
        color=MUTED,
        fontsize=9,
    )


def time_unit(longest_s: float) -> tuple[str, float]:
    """Return the unit a time axis of that length is drawn in, and its length in s."""
    if longest_s < 180:
        return "s", 1.0
    return ("min", 60.0) if longest_s < 3 * 3600 else ("h", 3600.0)


def _band(
    axes: Axes, t: NDArray[np.float64], values: NDArray[np.float64], windows: pa.Table, colour: str, label: str
) -> None:
    for number, band in enumerate(bands(t, values, column(windows, "t_s"))):
        axes.fill_between(band.x, band.low, band.high, color=colour, alpha=0.18, linewidth=0)
        axes.plot(band.x, band.mean, color=colour, linewidth=1.1, label=None if number else label)


def draw_shares(axes: Axes, t: NDArray[np.float64], windows: pa.Table, bins: int = BINS) -> None:
    """Draw what became of the pulses in percent, one class on the other."""
    counts = np.array([column(windows, kind) for kind in SHARE_COLOURS])
    shares = 100.0 * counts / np.maximum(counts.sum(axis=0), 1.0)
    of_kinds = [bands(t, share, column(windows, "t_s"), bins) for share in shares]
    for number, stretch in enumerate(zip(*of_kinds, strict=True)):
        axes.stackplot(
            stretch[0].x,
            [band.mean for band in stretch],
            colors=list(SHARE_COLOURS.values()),
            linewidth=0,
            labels=() if number else list(SHARE_COLOURS),
        )
    axes.set_ylim(0, 100)


def _finish(axes: Axes, label: str) -> None:
    axes.set_ylabel(label, color=MUTED, fontsize=8.5)
    if len(axes.get_legend_handles_labels()[0]) > 1:
        axes.legend(
            loc="upper left",
            bbox_to_anchor=(1.004, 1.03),
            frameon=False,
            fontsize=8,
            handlelength=1.0,
            labelcolor=INK,
            borderpad=0.0,
            handletextpad=0.4,
            labelspacing=0.3,
        )


def _panel_feed(axes: Axes, t: NDArray[np.float64], windows: pa.Table) -> None:
    _band(axes, t, column(windows, "feed_um_s"), windows, BLUE, "feed")
    _finish(axes, "feed\nµm/s")


def _panel_pulses(axes: Axes, t: NDArray[np.float64], windows: pa.Table) -> None:
    draw_shares(axes, t, windows)
    _finish(axes, "pulses\n%")


def _panel_gap(axes: Axes, t: NDArray[np.float64], windows: pa.Table) -> None:
    _band(axes, t, column(windows, "gap_um"), windows, BLUE, "gap")
    _band(axes, t, lag_along_um(windows), windows, ORANGE, "wire lag")
    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    _finish(axes, "gap, lag\nµm")


def _panel_error(axes: Axes, t: NDArray[np.float64], windows: pa.Table) -> None:
    _band(axes, t, column(windows, "error_um"), windows, VERMILION, "error")
    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    _finish(axes, "profile error\nµm")


def _panel_wire(axes: Axes, t: NDArray[np.float64], windows: pa.Table) -> None:
    _band(axes, t, column(windows, "wire_temperature_K"), windows, VERMILION, "wire")
    _finish(axes, "wire temp.\nK")


PANELS: tuple[Callable[[Axes, NDArray[np.float64], pa.Table], None], ...] = (
    _panel_feed,
    _panel_pulses,
    _panel_gap,
    _panel_error,
    _panel_wire,
)
