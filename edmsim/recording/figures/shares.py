"""Figure of what made the profile error: shares of path, planner, drive, wire and gap along the edge."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmsim.metrology.shares import SHARES
from edmsim.recording.figures.palette import BLUE, GREEN, INK, MUTED, ORANGE, PURPLE, SKY
from edmsim.recording.figures.style import LABEL_PT, TICK_PT, column_figure, dress, nothing_to_show
from edmsim.recording.scene import ErrorMap, Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_COLOURS = SKY, PURPLE, GREEN, BLUE, ORANGE
_SHOWN = 99.0
"""Percentile of all errors that the axes hold; single corners may leave them (ours)."""


def shares_figure(scene: Scene) -> Figure:
    """Draw the profile error and what made it, over the way along the nominal edges.

    Parameters
    ----------
    scene : Scene
        Of a cut: ``result.scene``.

    Returns
    -------
    matplotlib.figure.Figure
        One column wide, with an Agg canvas: a panel for the error and one for every share, all to one scale.
    """
    figure = column_figure(5.6, top_in=0.25, left_in=0.52)
    split = [edge for edge in scene.maps if edge.shares_um is not None and np.isfinite(edge.error_um).any()]
    if not split:
        return nothing_to_show(figure, "no shares: no error was measured, or the wire's centre ran on the edge")
    s_mm, error, shares = _joined(split)
    panels = figure.subplots(1 + len(SHARES), 1, sharex=True, sharey=True, gridspec_kw={"hspace": 0.22})
    names, colours = ("profile error", *SHARES), (INK, *_COLOURS)
    for axes, name, values, colour in zip(panels, names, (error, *shares), colours, strict=True):
        dress(axes, "", "")
        axes.axhline(0.0, color=MUTED, linewidth=0.6)
        axes.plot(s_mm, values, color=colour, linewidth=0.7)
        known = values[np.isfinite(values)]
        rms, mean = np.sqrt(np.mean(known**2)), f"{known.mean():+.1f}".replace("-", "−")
        axes.set_title(f"{name}: mean {mean}, {rms:.1f} µm rms", fontsize=TICK_PT, color=INK, loc="left", pad=2)
    limit = 1.2 * max(float(np.nanpercentile(np.abs([error, *shares]), _SHOWN)), 0.5)
    panels[0].set_ylim(-limit, limit)
    panels[0].margins(x=0)
    panels[-1].set_xlabel("along the nominal edge, mm", fontsize=LABEL_PT, color=MUTED)
    panels[len(SHARES) // 2].set_ylabel("µm, + metal left", fontsize=LABEL_PT, color=MUTED)
    return figure


def _joined(split: list[ErrorMap]) -> tuple[Array, Array, Array]:
    """Way along the edges, error and shares of several contours in a row, NaN between them."""
    ways, errors, shares, begin = [], [], [], 0.0
    for edge in split:
        assert edge.shares_um is not None
        way = begin + np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(edge.points_mm, axis=0).T))])
        begin = float(way[-1])
        ways.append(np.append(way, begin))
        errors.append(np.append(edge.error_um, np.nan))
        shares.append(np.column_stack([edge.shares_um, np.full(len(SHARES), np.nan)]))
    return np.concatenate(ways), np.concatenate(errors), np.concatenate(shares, axis=1)
