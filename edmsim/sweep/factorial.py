"""Grids, whole or with gaps, and lists of one setting at a time: the variance of their cells taken apart.

In a whole grid the means over its cells give the decomposition exactly (Hoeffding; Sobol' 1993). Where cells are
missing, the effects of the single settings are fitted to the cells that are there, side by side, which is the same as
filling the gaps with what makes the interactions least (Yates 1933). What chance alone puts into a share, known
from runs with the same settings, is taken off.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from edmsim.sweep.variance import Cells, Factor, Shares, cells_of

MOST_CELLS = 4_000_000
"""Of a grid that is filled for its interactions (ours: 32 MB)."""
MOST_TERMS = 1000
"""Levels of all factors together (ours: a sample of more is fitted)."""
Array = NDArray[np.float64]


def decompose(factors: list[Factor], values: Array) -> Shares | None:
    """Return the shares of every factor; None where the effects of single factors cannot be parted level by level.

    Interactions are looked at where more than half of all combinations are there (ours); elsewhere they count as
    unexplained, as far as they show at all.
    """
    counts = [factor.size for factor in factors]
    cells = cells_of(factors, values)
    there, size, terms = len(cells.means), math.prod(counts), 1 + sum(count - 1 for count in counts)
    if terms > min(there, MOST_TERMS):
        return None
    fitted = _Additive(cells, counts)
    if fitted.rank < terms:
        return None
    by_chance = np.nan_to_num(cells.chance) / cells.counts  # variance of each mean
    left = there - terms
    per_term = float((fitted.residuals**2).sum()) / left if left else math.nan
    excess = max(per_term - float(by_chance.mean()), 0.0) if left else 0.0 if size == terms else math.nan
    if 2 * there > size and size <= MOST_CELLS:
        grown = (size - terms) / left if left else 0.0
        by_noise = [float(by_chance.mean()) * (1 - 1 / count - (count - 1) / size) for count in counts]
        shared = [
            max(raw * grown - noise, 0.0) if math.isfinite(excess) else math.nan
            for raw, noise in zip(_shared(cells, counts, fitted.residuals), by_noise, strict=True)
        ]  # fmt: skip
        return _shares(fitted.variances(by_chance), shared, excess * (size - terms) / size, cells.chance)
    rest = [part for part in (cells.chance, excess) if math.isfinite(part)]
    noise = np.full(there, per_term) if left else by_chance
    unknown = [math.nan] * len(factors)
    return _shares(fitted.variances(noise), unknown, math.nan, sum(rest) if rest else math.nan)


def _shares(single: list[float], shared: list[float], together: float, rest: float) -> Shares:
    whole = sum(single) + sum(part for part in (together, rest) if not math.isnan(part))
    if whole == 0:
        return Shares.unknown(len(single))
    return Shares(
        [part / whole for part in single], [(a + b) / whole for a, b in zip(single, shared, strict=True)],
        together / whole, rest / whole,
    )  # fmt: skip


class _Additive:
    """The sum of an effect for each level of each factor, fitted to the means of cells, each of the same weight."""

    def __init__(self, cells: Cells, counts: list[int]) -> None:
        from scipy.sparse import csr_array

        first = 1 + np.concatenate([[0], np.cumsum(counts)])
        self._spans = [slice(a, b) for a, b in pairwise(first.tolist())]
        columns = np.column_stack([np.zeros(len(cells.means), int), cells.levels + first[:-1]])
        rows = np.repeat(np.arange(len(columns)), columns.shape[1])
        self._design = csr_array((np.ones(columns.size), (rows, columns.reshape(-1))), (len(columns), int(first[-1])))
        gram = (self._design.T @ self._design).toarray()
        self.rank = int(np.linalg.matrix_rank(gram, hermitian=True))
        self._inverse = np.linalg.pinv(gram, hermitian=True)
        self._effects: Array = np.asarray(self._inverse @ (self._design.T @ cells.means))
        self.residuals: Array = cells.means - self._design @ self._effects

    def variances(self, noise: Array) -> list[float]:
        """Return the variance over the levels of each factor, less what noise of these variances puts into it."""
        from scipy.sparse import diags_array

        scattered = (self._design.T @ diags_array(noise) @ self._design).toarray()
        errors: Array = np.asarray(self._inverse @ scattered @ self._inverse)
        found = []
        for span in self._spans:
            count = span.stop - span.start
            centred = np.eye(count) - 1 / count
            effect = centred @ self._effects[span]
            by_noise = float(np.trace(centred @ errors[span, span] @ centred)) / count
            found.append(max(float(np.mean(effect**2)) - by_noise, 0.0))
        return found


def _shared(cells: Cells, counts: list[int], residuals: Array) -> list[float]:
    """Return the variance of all interactions that a factor takes part in, for each; gaps have none."""
    grid = np.zeros(counts)
    grid[tuple(cells.levels.T)] = residuals
    whole = float(np.mean(grid**2))
    return [whole - float(np.mean(grid.mean(axis=axis) ** 2)) for axis in range(len(counts))]
