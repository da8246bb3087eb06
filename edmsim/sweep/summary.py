"""The summary of a sweep as text and picture: means with intervals, sensitivities, the Pareto front."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import rich.console
from matplotlib.figure import Figure as Drawing
from numpy.typing import NDArray

from edmsim.errors import refuse_unknown, refuses_wrong_types
from edmsim.evaluation.compare import Figure, ratio
from edmsim.recording.figures.palette import BLUE, LINE, VERMILION
from edmsim.recording.figures.style import EmptyFigure, colour_bar, column_figure, dress, in_style, legend
from edmsim.screen import ScreenTable
from edmsim.sweep.run import FIGURES
from edmsim.sweep.sensitivity import MOST_VALUES, Effect, Sensitivity, sensitivity
from edmsim.sweep.specification import number_or_text

TIME = "machining_time_s"
KEYS = {
    "cutting_rate_mm2_min": "rate mm2/min", TIME: "time s", "ra_um": "Ra um", "error_rms_um": "error um rms",
    "short_share": "shorts", "total_return": "return",
}
"""Figures of the summary with their heads, if the sweep has them; the time is that of finished cuts."""
GOALS = {"cutting_rate_mm2_min": 1, "ra_um": -1, "error_rms_um": -1}
"""Figures of the Pareto front: more rate, less roughness and error are better."""
MACHINE = "machine_sample"
ORIGINS = "files", "edmsim_version"  # they differ if a program or controller was changed between runs
_NO_SETTINGS = {"id", "seed", "error", "outcome", *FIGURES, "report", *ORIGINS, "wall_time_s", "host"}


@dataclass(frozen=True)
class Group:
    """Runs with the same settings, averaged over seeds and drawn machines."""

    settings: dict[str, Any]  # those that differ within the sweep
    runs: int
    failed: int  # with an error
    finished: int  # that finished the cut
    # means over the runs without error, by the names of `KEYS`; their 95 % intervals are over machines if several
    # were drawn, else over runs
    figures: dict[str, Figure]


def varied(table: pa.Table) -> list[str]:
    """Return the columns that differ: settings, constants, and those of `ORIGINS` that differ with equal settings."""
    # of all columns, because constants that the first runs did not set come last
    names = (name for name in table.column_names if name not in _NO_SETTINGS)
    found = [name for name in names if len(table[name].unique()) > 1]
    for name in (name for name in ORIGINS if name in table.column_names):
        if table.group_by([*found, name]).aggregate([]).num_rows > table.group_by(found).aggregate([]).num_rows:
            found.append(name)
    return found


def measured(table: pa.Table) -> list[str]:
    """Return the figures of `KEYS` that the sweep has."""
    return [name for name in KEYS if np.isfinite(_values(table, name)).any()]


@refuses_wrong_types
def groups(table: pa.Table, by: Iterable[str] | None = None) -> list[Group]:
    """Return runs grouped by settings and sorted by these; by default the settings with 2 to `MOST_VALUES` values."""
    few = [name for name in _chosen(table) if len(table[name].unique()) <= MOST_VALUES]
    chosen = few if by is None else [*by]
    for name in chosen:
        refuse_unknown("setting", name, table.column_names)
    keys = list(zip(*(_settings(table, name) for name in chosen), strict=True)) or [()] * len(table)
    members: dict[tuple[Any, ...], list[int]] = {}
    for row, key in enumerate(keys):
        members.setdefault(key, []).append(row)
    columns = {name: _values(table, name) for name in measured(table)}
    errors, outcomes, machines = (table[name].to_pylist() for name in ("error", "outcome", MACHINE))
    ordered = sorted(members, key=lambda key: tuple((value is not None, str(type(value)), value) for value in key))
    return [
        Group(
            dict(zip(chosen, key, strict=True)), len(rows), sum(errors[row] is not None for row in rows),
            sum(outcomes[row] == "finished" for row in rows),
            {name: _mean(values[rows], [machines[row] for row in rows]) for name, values in columns.items()},
        )
        for key in ordered for rows in [members[key]]
    ]  # fmt: skip


@refuses_wrong_types
def sensitivities(table: pa.Table) -> dict[str, Sensitivity]:
    """Return each figure's sensitivity to the settings that differ; see `edmsim.sweep.sensitivity.sensitivity`.

    Constants of drawn machines count as settings if the sweep drew more machines than there are constants.
    Otherwise their effects cannot be separated, and the machine counts as one setting.
    """
    constants, machines = _drawn(table), len(table[MACHINE].unique())
    left_out = constants if machines <= len(constants) + 1 else [MACHINE]
    settings = {name: _settings(table, name) for name in varied(table) if name not in left_out}
    return {name: sensitivity(settings, _values(table, name), [MACHINE]) for name in measured(table)}


def pareto_front(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return for each point whether no other is as good in every column and better in one; more is better."""
    front = np.ones(len(points), bool)
    for k, point in enumerate(points):
        front[k] = not np.any((points >= point).all(axis=1) & (points > point).any(axis=1))
    return front


@refuses_wrong_types
def front_of(table: pa.Table) -> tuple[list[Group], NDArray[np.bool_]]:
    """Group by all settings; return the groups that have every goal, and which are on the Pareto front."""
    goals = goals_of(table)
    found = [
        group for group in groups(table, _chosen(table))
        if all(math.isfinite(group.figures[name].value) for name in goals)
    ]  # fmt: skip
    points = np.array([[GOALS[name] * group.figures[name].value for name in goals] for group in found])
    return found, pareto_front(points) if found else np.zeros(0, bool)


def goals_of(table: pa.Table) -> list[str]:
    """Return the goals that the sweep has."""
    return [name for name in GOALS if name in measured(table)]


def _chosen(table: pa.Table) -> list[str]:
    """Return the settings of the specification that differ, without constants of drawn machines."""
    drawn = _drawn(table)
    return [name for name in varied(table) if name != MACHINE and name not in drawn]


def _drawn(table: pa.Table) -> list[str]:
    """Return the constants that were drawn; a constant of the specification is equal on several machines."""
    made = table.filter(table["error"].is_null())
    machines = made[MACHINE].to_pylist()
    if len(set(machines)) < 2:
        return []
    found = []
    for name in (name for name in varied(table) if "." in name):
        pairs = set(zip(made[name].to_pylist(), machines, strict=True))
        if len({value for value, _ in pairs}) == len(pairs):
            found.append(name)
    return found


def _settings(table: pa.Table, name: str) -> list[Any]:
    """Return the values of a setting, as numbers if all its texts are numbers: an offset's unless one is auto."""
    values: list[Any] = table[name].to_pylist()
    numbers: list[Any] = [number_or_text(value) if isinstance(value, str) else None for value in values]
    return [float(number) for number in numbers] if all(type(n) in (int, float) for n in numbers) else values


def _values(table: pa.Table, name: str) -> NDArray[np.float64]:
    values = np.array([math.nan if value is None else value for value in table[name].to_pylist()], np.float64)
    if name == TIME:
        values[[outcome != "finished" for outcome in table["outcome"].to_pylist()]] = math.nan
    return values


def _mean(values: NDArray[np.float64], machines: Sequence[Any]) -> Figure:
    """Return the mean of the known values, with its interval over machines if there are several."""
    # the runs of a machine are alike; if they counted as independent, the interval would be too narrow
    units = machines if len(set(machines)) > 1 else range(len(values))
    numbers: dict[Any, int] = {}
    known = np.isfinite(values)
    unit = np.array([numbers.setdefault(units[int(row)], len(numbers)) for row in np.flatnonzero(known)], int)
    return ratio(np.bincount(unit, values[known]).astype(np.float64), np.bincount(unit).astype(np.float64))


HELD_BACK = 0.5  # above this share of the cut at the greatest feed, the machine limits the rate (ours)
MOST_LINES = 40  # groups and settings listed on a terminal (ours); all are in the dataset


def render(table: pa.Table) -> rich.console.Group:
    """Return the summary of a sweep for the terminal."""
    effects = [_sensitivities(table)] if varied(table) else []
    return rich.console.Group(_means(table), *effects, *_held_back(table), *_errors(table))


def _means(table: pa.Table) -> ScreenTable:
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


def _sensitivities(table: pa.Table) -> ScreenTable:
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


def _held_back(table: pa.Table) -> list[str]:
    """Return a line with the number of cuts mostly at the greatest feed, at which no setting can raise the rate."""
    shares = table["share_at_limit"].to_pylist() if "share_at_limit" in table.column_names else []
    held = sum(share is not None and share > HELD_BACK for share in shares)
    mostly = f"{held} of {len(table)} runs cut mostly at the greatest feed of machine and planner"
    return [f"{mostly}, which limits their rate"] if held else []


def _errors(table: pa.Table) -> list[str]:
    """Return the errors, the most frequent first."""
    counts = Counter(table["error"].drop_null().to_pylist())
    return [f"{count} failed: {error}" for error, count in counts.most_common(MOST_LINES)]


@in_style
def pareto_figure(table: pa.Table) -> Drawing:
    """Draw the groups of a sweep by rate, roughness and error, and mark the Pareto front."""
    goals = goals_of(table)
    found, front = front_of(table)
    if len(goals) < 2 or not found:
        return EmptyFigure("No two of rate, roughness and error were measured in a run.")
    figure = column_figure(2.9, top_in=0.5 if len(goals) > 2 else 0.12)
    values = {name: np.array([group.figures[name].value for group in found]) for name in goals}
    x, y = goals[0], goals[1]
    axes = figure.subplots()
    order = np.argsort(values[x][front])
    axes.plot(values[x][front][order], values[y][front][order], color=LINE, lw=1.0, zorder=1)
    colour: dict[str, Any] = {"c": values[goals[2]], "cmap": "viridis_r"} if len(goals) > 2 else {"c": BLUE}
    dots = axes.scatter(values[x], values[y], s=14, lw=0, zorder=2, **colour)
    axes.scatter(
        values[x][front], values[y][front], s=34, facecolors="none", edgecolors=VERMILION, lw=1.0, zorder=3,
        label="Pareto-optimal",
    )
    axes.ticklabel_format(useOffset=False)  # full values on the axis, even if they hardly differ
    dress(axes, _label(x), _label(y))
    legend(axes)
    if len(goals) > 2:
        colour_bar(figure, dots, _label(goals[2]))
    return figure


def _label(name: str) -> str:
    return f"{FIGURES[name].meaning} [{FIGURES[name].unit}]"


def _figure(figure: Figure) -> str:
    if math.isnan(figure.value):
        return ""
    between = f"\n{figure.low:.3g}–{figure.high:.3g}" if figure.low < figure.high else ""
    return f"{figure.value:.3g}{between}"


def _said(value: Any) -> str:
    if value is None:
        return "default"
    return f"{value:g}" if isinstance(value, float) else str(value)
