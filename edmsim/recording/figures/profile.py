"""``profile.png``: the cut from above, the error along it, and the process over time."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edmsim.files import replacing
from edmsim.recording.figures.map import draw_map
from edmsim.recording.figures.palette import GREEN, INK, MUTED, VERMILION
from edmsim.recording.figures.series import PANELS, draw_series
from edmsim.recording.report import duration_text, figure_text, rate_text
from edmsim.recording.scene import Scene

if TYPE_CHECKING:
    import pyarrow as pa
    from matplotlib.figure import Figure

REASON_LETTERS = 130
"""Letters of a line in which it is said why a cut stopped."""


def profile_figure(scene: Scene, windows: pa.Table, report: Mapping[str, Any], title: str) -> Figure:
    """Draw the cut.

    Parameters
    ----------
    scene : Scene
        Drawing, cut edges, error, corners.
    windows : pyarrow.Table
        The table of windows.
    report : mapping
        Of `edmsim.recording.report.build_report`, for the heading.
    title : str
        What was cut, usually the program's name.

    Returns
    -------
    matplotlib.figure.Figure
        With an Agg canvas; no global state of matplotlib is touched.
    """
    from edmsim.recording.figures.canvas import NotebookFigure

    figure = NotebookFigure(figsize=(10.0, 12.0), dpi=160, facecolor="white")
    outer = figure.add_gridspec(
        2, 1, height_ratios=[1.32, 1.0], hspace=0.13, left=0.085, right=0.915, top=0.908, bottom=0.05
    )
    _heading(figure, report, title)
    draw_map(figure.add_subplot(outer[0]), scene)
    series = outer[1].subgridspec(len(PANELS), 1, hspace=0.16)
    axes = [figure.add_subplot(series[row]) for row in range(len(PANELS))]
    draw_series(axes, windows)
    return figure


def write_figure(figure: Figure, file: str | Path) -> None:
    """Write a figure as PNG; a file of that name is replaced whole or not at all."""
    with replacing(file) as partial:
        figure.savefig(partial, format="png", metadata={"Software": "edmsim"})


def _heading(figure: Figure, report: Mapping[str, Any], title: str) -> None:
    kerf, profile = report["kerf_um"], report["profile_error_um"]
    facts = [
        duration_text(report["machining_time_s"]),
        figure_text(report["path_length_mm"], "mm", 2),
        rate_text(report),
        f"kerf {figure_text(kerf['mean'], 'µm', 0)}",
        f"profile error {figure_text(profile['max'], 'µm')} max, {figure_text(profile['rms'], 'µm')} rms",
    ]
    stopped = report["reason"] is not None
    figure.text(0.085, 0.972, title, fontsize=16, fontweight="bold", color=INK, va="baseline")
    figure.text(
        0.915,
        0.972,
        report["outcome"],
        fontsize=12,
        ha="right",
        va="baseline",
        fontweight="bold",
        color=VERMILION if stopped else GREEN,
    )
    figure.text(0.085, 0.950, "   ·   ".join(facts), fontsize=9.5, color=MUTED, va="baseline")
    if stopped:
        lines = textwrap.wrap(f"stopped: {report['reason']}", REASON_LETTERS, max_lines=2, placeholder=" ...")
        figure.text(0.085, 0.9455, "\n".join(lines), fontsize=8.5, color=VERMILION, va="top", linespacing=1.1)
