"""What a sweep says: means with intervals, which setting matters how much, and what nothing else surpasses."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from edmsim.evaluation.compare import Figure, mean
from edmsim.sweep.figures import NAMES

if TYPE_CHECKING:
    import pyarrow as pa

KEYS = {
    "cutting_rate_mm2_min": "rate mm2/min", "ra_um": "Ra um", "error_rms_um": "error um rms", "short_share": "shorts",
    "total_return": "return",
}
"""Figures that are looked at, as far as the sweep has them."""
GOALS = {"cutting_rate_mm2_min": 1, "ra_um": -1, "error_rms_um": -1}
"""Figures of the Pareto front: more rate, less roughness and error are better."""
MOST_VALUES = 12
"""Values of a setting up to which runs are grouped by it (ours); a Sobol sample has as many as points."""
BINS = 8
"""Groups of equally many runs that a setting of more values is divided into for its effect (ours)."""
_NO_SETTINGS = {"id", "seed"}


@dataclass(frozen=True)
class Group:
    """Runs with the same settings.

    Attributes
    ----------
    settings : dict
        Of the settings that differ within the sweep.
    runs, failed, finished : int
        All; those that ended in an error; and those cut to the end.
    figures : dict
        Means over the runs without error, with 95 % intervals, by the names of `KEYS`.
    """

    settings: dict[str, Any]
    runs: int
    failed: int
    finished: int
    figures: dict[str, Figure]


@dataclass(frozen=True)
class Effect:
    """What a setting does to a figure, by itself.

    Attributes
    ----------
    share : float
        Share (0..1) of the figure's variance over all runs that goes with the setting, what chance alone would give
        taken off (Kelley's epsilon squared); the first-order index of sensitivity, where the sample is balanced.
    rank_correlation : float
        Spearman's: 1 if the figure only rises with the setting, -1 if it only falls; NaN of a setting that is no
        number.
    """

    share: float
    rank_correlation: float


def varied(table: pa.Table) -> list[str]:
    """Return the settings, constants among them, that differ between the runs."""
    names = table.column_names[: table.column_names.index("error")]
    return [name for name in names if name not in _NO_SETTINGS and len(table[name].unique()) > 1]


def measured(table: pa.Table) -> list[str]:
    """Return the figures looked at that the sweep has."""
    return [name for name in KEYS if table[name].null_count < len(table)]


def groups(table: pa.Table, by: list[str] | None = None) -> list[Group]:
    """Return the runs in groups of the same settings, in the order of these; seeds and machines drawn are averaged.

    Parameters
    ----------
    table : pyarrow.Table
        See `edmsim.sweep.table.read`.
    by : list of str, optional
        Settings; if not given, those that differ and have `MOST_VALUES` or fewer values.
    """
    few = [name for name in _chosen(table) if len(table[name].unique()) <= MOST_VALUES]
    chosen = few if by is None else by
    keys = list(zip(*(table[name].to_pylist() for name in chosen), strict=True)) or [()] * len(table)
    members: dict[tuple[Any, ...], list[int]] = {}
    for row, key in enumerate(keys):
        members.setdefault(key, []).append(row)
    columns = {name: _values(table, name) for name in measured(table)}
    errors, outcomes = table["error"].to_pylist(), table["outcome"].to_pylist()
    ordered = sorted(members, key=lambda key: tuple((value is not None, str(type(value)), value) for value in key))
    return [
        Group(
            dict(zip(chosen, key, strict=True)), len(rows), sum(errors[row] is not None for row in rows),
            sum(outcomes[row] == "finished" for row in rows),
            {name: _mean(values[rows]) for name, values in columns.items()},
        )
        for key in ordered for rows in [members[key]]
    ]  # fmt: skip


def effects(table: pa.Table) -> dict[str, dict[str, Effect]]:
    """Return what each setting that differs does to each figure, the strongest on the first figure first."""
    found = {
        setting: {name: effect(table[setting].to_pylist(), _values(table, name)) for name in measured(table)}
        for setting in varied(table)
    }  # fmt: skip
    return dict(sorted(found.items(), key=lambda item: -max((e.share for e in item[1].values()), default=0.0)))


def effect(setting: list[Any], figure: NDArray[np.float64]) -> Effect:
    """Return what a setting does to a figure, from their values run by run."""
    from scipy.stats import rankdata

    known = np.isfinite(figure)
    values, given = figure[known], [value for value, is_known in zip(setting, known, strict=True) if is_known]
    number = all(isinstance(value, int | float) for value in given)
    told = np.array(given, float) if number else np.array([str(value) for value in given])
    levels = np.unique(told, return_inverse=True)[1]
    ranks = rankdata(given) if number and given else np.zeros(0)
    kinds = len(set(levels))
    if number and kinds > MOST_VALUES:
        levels = np.minimum((ranks - 0.5) * BINS // len(ranks), BINS - 1).astype(int)
        kinds = len(set(levels))
    if len(values) <= kinds or np.ptp(values) == 0:
        return Effect(math.nan, math.nan)
    total = float(((values - values.mean()) ** 2).sum())
    within = sum(float(((part - part.mean()) ** 2).sum()) for k in set(levels) for part in [values[levels == k]])
    share = 1.0 - within / (len(values) - kinds) * (len(values) - 1) / total
    ordered = number and kinds > 1
    return Effect(max(share, 0.0), float(np.corrcoef(ranks, rankdata(values))[0, 1]) if ordered else math.nan)


def pareto_front(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Say which points no other one surpasses: as good in every column and better in one, where more is better."""
    front = np.ones(len(points), bool)
    for k, point in enumerate(points):
        front[k] = not np.any((points >= point).all(axis=1) & (points > point).any(axis=1))
    return front


def front_of(table: pa.Table) -> tuple[list[Group], NDArray[np.bool_]]:
    """Return the groups by all settings, as far as every goal is known of them, and which are on the front."""
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
    """Return the settings that were chosen and differ; what a drawn machine has was not chosen."""
    drawn = table["machine_sample"].null_count < len(table)
    return [name for name in varied(table) if name != "machine_sample" and not (drawn and "." in name)]


def _values(table: pa.Table, name: str) -> NDArray[np.float64]:
    assert name in NAMES
    return np.array([math.nan if value is None else value for value in table[name].to_pylist()], np.float64)


def _mean(values: NDArray[np.float64]) -> Figure:
    return mean(values[np.isfinite(values)])
