"""What both ways of taking a variance apart work on, and what they find."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Factor(NamedTuple):
    """A setting: the place of every run's value among all in order, how many these are, and if they are numbers."""

    levels: NDArray[np.intp]
    size: int
    is_number: bool


class Shares(NamedTuple):
    """Shares of a variance: of every factor alone and in all, of factors together, and of none; NaN if unknown."""

    first_order: list[float]
    total: list[float]
    interactions: float
    unexplained: float

    @classmethod
    def unknown(cls, factors: int) -> Shares:
        """Return the shares of which nothing is known."""
        return cls([math.nan] * factors, [math.nan] * factors, math.nan, math.nan)


class Cells(NamedTuple):
    """Runs with the same settings taken together.

    Attributes
    ----------
    levels : int array (cells, factors)
    means : float64 array (cells,)
    counts : int array (cells,)
    chance : float
        Variance between runs of a cell; NaN where no cell has two.
    """

    levels: NDArray[np.intp]
    means: NDArray[np.float64]
    counts: NDArray[np.intp]
    chance: float


def cells_of(factors: list[Factor], values: NDArray[np.float64]) -> Cells:
    """Take the runs with the same settings together."""
    levels, cell = np.unique(np.column_stack([f.levels for f in factors]), axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    counts = np.bincount(cell)
    means = np.bincount(cell, values) / counts
    more = len(values) - len(means)
    chance = float(((values - means[cell]) ** 2).sum()) / more if more else math.nan
    return Cells(levels, means, counts, chance)
