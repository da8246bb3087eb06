"""Which setting matters how much: indices of Sobol' from the runs that are there, whatever their design.

All shares are of the variance that a figure would have if every combination of the values that were run were equally
likely. Runs of a grid, and of lists in which one setting at a time was changed, are taken apart by the analysis of
variance (`factorial`); a sample, in which hardly a value occurs twice, by a polynomial fitted to it (`surrogate`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.sweep.factorial import decompose
from edmsim.sweep.surrogate import fit
from edmsim.sweep.variance import Factor, Shares

MOST_VALUES = 12
"""Values of a number up to which each is a level of its own (ours); above, a figure is taken to change smoothly."""


@dataclass(frozen=True)
class Effect:
    """What a setting does to a figure.

    Attributes
    ----------
    first_order : float
        Share (0..1) of the variance that goes with the setting by itself, whatever the others are. NaN where the runs
        do not tell.
    total : float
        The same with what it does together with others.
    rank_correlation : float
        Spearman's, over all runs: 1 if the figure only rises with the setting, -1 if it only falls; NaN of a setting
        that is no number.
    """

    first_order: float
    total: float
    rank_correlation: float


@dataclass(frozen=True)
class Sensitivity:
    """What the settings do to a figure; first orders, interactions and the unexplained share add up to 1.

    Attributes
    ----------
    effects : dict
        Of each setting its `Effect`.
    interactions : float
        Share of the variance that goes with settings together only; NaN where the runs do not tell.
    unexplained : float
        Share that goes with no setting: chance and, of a sample, what the polynomial misses. NaN where every
        combination was run once, as chance then counts as an effect.
    """

    effects: dict[str, Effect]
    interactions: float
    unexplained: float


class Varied(NamedTuple):
    """A setting run by run: its name, its values, and whether numbers among these are only names, as of machines."""

    name: str
    values: Sequence[Any]
    is_name: bool = False


def sensitivity(settings: Sequence[Varied], figure: NDArray[np.float64]) -> Sensitivity:
    """Return what settings do to a figure, from their values run by run; runs without the figure are left out."""
    known = np.isfinite(figure)
    values = figure[known]
    factors = {s.name: _factor(s, known) for s in settings}
    differ = {name: factor for name, factor in factors.items() if factor.size > 1}
    shares = _shares(list(differ.values()), values)
    unknown = math.nan, math.nan
    pairs = dict(zip(differ, zip(shares.first_order, shares.total, strict=True), strict=True))
    effects = {
        s.name: Effect(*pairs.get(s.name, unknown), _rank_correlation(factors[s.name], values)) for s in settings
    }
    return Sensitivity(effects, shares.interactions, shares.unexplained)


def _shares(factors: list[Factor], values: NDArray[np.float64]) -> Shares:
    if len(values) < 2 or np.ptp(values) == 0 or not factors:
        return Shares.unknown(len(factors))
    places = np.column_stack([factor.levels for factor in factors])
    has_repeats = len(np.unique(places, axis=0)) < len(places)
    is_smooth = any(factor.is_number and factor.size > MOST_VALUES for factor in factors)
    found = None if is_smooth and not has_repeats else decompose(factors, values)
    return fit(factors, values, MOST_VALUES) if found is None else found


def _factor(setting: Varied, known: NDArray[np.bool_]) -> Factor:
    """Return the levels of a setting in the runs whose figure is known."""
    given = [value for value, is_known in zip(setting.values, known, strict=True) if is_known]
    is_number = not setting.is_name and all(isinstance(value, int | float) for value in given)
    told = np.array(given, float) if is_number else np.array([str(value) for value in given])
    kinds, levels = np.unique(told, return_inverse=True)
    return Factor(levels, len(kinds), is_number)


def _rank_correlation(factor: Factor, values: NDArray[np.float64]) -> float:
    from scipy.stats import rankdata

    if not factor.is_number or factor.size < 2 or np.ptp(values) == 0:
        return math.nan
    return float(np.corrcoef(rankdata(factor.levels), rankdata(values))[0, 1])
