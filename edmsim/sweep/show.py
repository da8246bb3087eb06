"""A sweep on the terminal and as a picture: means, sensitivities, and the Pareto front."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from edmsim.evaluation.compare import Figure
from edmsim.sweep.sensitivity import Effect
from edmsim.sweep.summary import KEYS, front_of, goals_of, groups, measured, sensitivities, varied

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
    from edmsim.screen import ScreenTable

    found = groups(table)
    names = measured(table)
    failed = sum(group.failed for group in found)
    settings = list(found[0].settings)
    title = f"{len(table)} runs, {failed} failed; means with 95 % intervals"
    shown = ScreenTable(title=title, keys=max(len(settings), 1))
    for name in settings:
        are_numbers = all(isinstance(group.settings[name], int | float | None) for group in found)
        shown.add_column(name, justify="right" if are_numbers else "left")
    for head in ("finished", *(KEYS[name] for name in names)):
        shown.add_column(head, justify="right")
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
    from edmsim.screen import ScreenTable

    found = sensitivities(table)
    settings = next(iter(found.values())).effects if found else {}
    shown = ScreenTable(
        "setting", numbers=[KEYS[name] for name in found],
        title="share of the variance alone / with interactions; below it the rank correlation",
    )  # fmt: skip

    def most(setting: str) -> float:
        effects = (of_figure.effects[setting] for of_figure in found.values())
        shares = (share for effect in effects for share in (effect.first_order, effect.total))
        return max((share for share in shares if not math.isnan(share)), default=0.0)

    for setting in sorted(settings, key=most, reverse=True)[:MOST_LINES]:
        shown.add_row(setting, *(_effect(of_figure.effects[setting]) for of_figure in found.values()))
    shown.add_section()
    for name in ("interactions", "unexplained"):
        shown.add_row(name, *(_percent(getattr(of_figure, name)) for of_figure in found.values()))
    return shown


def _effect(effect: Effect) -> str:
    first, total, rank = effect.first_order, effect.total, effect.rank_correlation
    shares = f"{_percent(first)} / {_percent(total)}" if not math.isnan(total) else _percent(first)
    return shares if math.isnan(rank) or not shares else f"{shares}\n{rank:+.2f}"


def _percent(share: float) -> str:
    return "" if math.isnan(share) else f"{100 * share:.0f} %"


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
