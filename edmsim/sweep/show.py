"""A sweep on the terminal and as a picture: means, sensitivities, and the Pareto front."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from edmsim.evaluation.compare import Figure
from edmsim.sweep.summary import KEYS, effects, front_of, goals_of, groups, measured, varied

if TYPE_CHECKING:
    import pyarrow as pa
    from matplotlib.figure import Figure as Drawing
    from rich.console import RenderableType

MOST_LINES = 40
"""Groups and settings listed on a terminal (ours); all are in the dataset."""
_LABELS = {"cutting_rate_mm2_min": "cutting rate [mm²/min]", "ra_um": "Ra [µm]", "error_rms_um": "profile error [µm]"}


def render(table: pa.Table) -> RenderableType:
    """Return the summary of a sweep for the terminal."""
    from rich.console import Group

    return Group(_means(table), *([_sensitivities(table)] if varied(table) else []), *_errors(table))


def _means(table: pa.Table) -> RenderableType:
    from rich.table import Table

    found = groups(table)
    names = measured(table)
    failed = sum(group.failed for group in found)
    shown = Table(title=f"{len(table)} runs, {failed} failed; means with 95 % intervals")
    settings = list(found[0].settings)
    for name in settings:
        shown.add_column(name, overflow="fold")
    shown.add_column("finished", justify="right")
    for name in names:
        shown.add_column(KEYS[name], justify="right")
    for group in found[:MOST_LINES]:
        failures = f", {group.failed} failed" if group.failed else ""
        shown.add_row(
            *(_said(group.settings[name]) for name in settings), f"{group.finished} of {group.runs}{failures}",
            *(_figure(group.figures[name]) for name in names),
        )
    if len(found) > MOST_LINES:
        shown.caption = f"the first {MOST_LINES} of {len(found)} combinations"
    return shown


def _sensitivities(table: pa.Table) -> RenderableType:
    from rich.table import Table

    names = measured(table)
    shown = Table(title="share of the variance that goes with a setting by itself (rank correlation)")
    shown.add_column("setting")
    for name in names:
        shown.add_column(KEYS[name], justify="right")
    for setting, found in list(effects(table).items())[:MOST_LINES]:
        cells = []
        for name in names:
            rank = found[name].rank_correlation
            share = "" if math.isnan(found[name].share) else f"{100 * found[name].share:.0f} %"
            cells.append(share if math.isnan(rank) or not share else f"{share} ({rank:+.2f})")
        shown.add_row(setting, *cells)
    return shown


def _errors(table: pa.Table) -> list[RenderableType]:
    """Return the errors, the most frequent first."""
    counts: dict[str, int] = {}
    for error in table["error"].to_pylist():
        if error is not None:
            counts[error] = counts.get(error, 0) + 1
    ordered = sorted(counts.items(), key=lambda item: -item[1])[:MOST_LINES]
    return [f"{count} failed: {error}" for error, count in ordered]


def pareto_figure(table: pa.Table) -> Drawing:
    """Draw the groups of a sweep by rate, roughness and error, and mark those that no other surpasses."""
    from edmsim.recording.figures.palette import BLUE, LINE, VERMILION
    from edmsim.recording.figures.style import colour_bar, column_figure, dress, legend, nothing_to_show

    goals = goals_of(table)
    found, front = front_of(table)
    figure = column_figure(2.9, top_in=0.5 if len(goals) > 2 else 0.12)
    if len(goals) < 2 or not found:
        return nothing_to_show(figure, "No two of rate, roughness and error were measured in a run.")
    values = {name: np.array([group.figures[name].value for group in found]) for name in goals}
    x, y = goals[0], goals[1]
    axes = figure.subplots()
    order = np.argsort(values[x][front])
    axes.plot(values[x][front][order], values[y][front][order], color=LINE, lw=1.0, zorder=1)
    colour: dict[str, Any] = {"c": values[goals[2]], "cmap": "viridis_r"} if len(goals) > 2 else {"c": BLUE}
    dots = axes.scatter(values[x], values[y], s=14, lw=0, zorder=2, **colour)
    axes.scatter(
        values[x][front], values[y][front], s=34, facecolors="none", edgecolors=VERMILION, lw=1.0, zorder=3,
        label="surpassed by none",
    )
    dress(axes, _LABELS[x], _LABELS[y])
    legend(axes)
    if len(goals) > 2:
        colour_bar(figure, dots, _LABELS[goals[2]])
    return figure


def _figure(figure: Figure) -> str:
    if math.isnan(figure.value):
        return ""
    between = f"\n{figure.low:.3g}–{figure.high:.3g}" if figure.low < figure.high else ""
    return f"{figure.value:.3g}{between}"


def _said(value: Any) -> str:
    if value is None:
        return "default"
    return f"{value:g}" if isinstance(value, float) else str(value)
