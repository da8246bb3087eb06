"""Sensitivity of a figure to the settings: Sobol' indices from the existing runs, for any design.

All shares are of the variance that a figure would have if every combination of the values that were run were equally
likely. Analysis of variance (`decompose`) handles grids, and lists that change one setting at a time; a fitted
polynomial (`fit`) handles samples, in which hardly a value occurs twice.

In a complete grid the means over its cells give the decomposition exactly (Hoeffding; Sobol' 1993). If cells are
missing, the effects of single settings are fitted to the others simultaneously. This is the same as filling the gaps
with values that minimise the interactions (Yates 1933). Runs with the same settings measure chance, and its
contribution is subtracted from each share.

The polynomial's terms are products of polynomials that are orthonormal over the values of each setting, so each
term's squared coefficient is its share of the variance (polynomial chaos; Sudret 2008). They are selected one by one,
the most explanatory first (orthogonal least squares; Chen et al. 1989), until the next would be as good by chance
(F test, times the number of terms). The polynomial's error on runs outside the fit is the unexplained share.
"""

import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.sparse import csr_array, diags_array

Array = NDArray[np.float64]


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
    def unknown(cls, factors: int) -> "Shares":
        """Return unknown shares."""
        return cls([math.nan] * factors, [math.nan] * factors, math.nan, math.nan)


class Cells(NamedTuple):
    """Runs with the same settings taken together."""

    levels: NDArray[np.intp]
    means: NDArray[np.float64]
    counts: NDArray[np.intp]
    chance: float  # variance between runs of a cell; NaN where no cell has two


def cells_of(factors: list[Factor], values: NDArray[np.float64]) -> Cells:
    """Take the runs with the same settings together."""
    levels, cell = np.unique(np.column_stack([f.levels for f in factors]), axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    counts = np.bincount(cell)
    means = np.bincount(cell, values) / counts
    more = len(values) - len(means)
    chance = float(((values - means[cell]) ** 2).sum()) / more if more else math.nan
    return Cells(levels, means, counts, chance)


MOST_CELLS = 4_000_000  # of a grid that is filled for its interactions (ours: 32 MB)
MOST_LEVELS = 1000  # levels of all factors together (ours: a sample of more is fitted)


def decompose(factors: list[Factor], values: Array) -> Shares | None:
    """Return the shares of every factor; None where the effects of single factors cannot be parted level by level."""
    # interactions are looked at where more than half of all combinations are there (ours); elsewhere they count
    # as unexplained, as far as they show at all
    counts = [factor.size for factor in factors]
    cells = cells_of(factors, values)
    there, size, terms = len(cells.means), math.prod(counts), 1 + sum(count - 1 for count in counts)
    if terms > min(there, MOST_LEVELS):
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
        return _shares_of_cells(fitted.variances(by_chance), shared, excess * (size - terms) / size, cells.chance)
    rest = [part for part in (cells.chance, excess) if math.isfinite(part)]
    noise = np.full(there, per_term) if left else by_chance
    unknown = [math.nan] * len(factors)
    return _shares_of_cells(fitted.variances(noise), unknown, math.nan, sum(rest) if rest else math.nan)


def _shares_of_cells(single: list[float], shared: list[float], together: float, rest: float) -> Shares:
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


MOST_DEGREE = 10  # of the polynomial (ours: it follows two waves)
NORMS = 1.0, 0.75, 0.5
"""Norms of a term's degrees, tried until there are few enough terms: below 1, high degrees of several factors are
left out (Blatman and Sudret 2011)."""
MOST_TERMS = 1000
"""Terms to choose from (ours), fewer where the table of all runs would take more than `MOST_NUMBERS`."""
MOST_NUMBERS = 30_000_000
MOST_CHOSEN = 60  # terms chosen at most (ours)
BY_CHANCE = 0.05  # probability at most that the best of all terms is as good as the next one chosen, by chance (ours)
Term = tuple[tuple[int, int], ...]  # pairs of a factor and the number of its function, from 1 on


def fit(factors: list[Factor], values: Array) -> Shares:
    """Return the shares of every factor; unknown of factors that only ever change together."""
    cells = cells_of(factors, values)
    functions = [_functions(factor) for factor in factors]
    parted = _parted(cells, factors, functions)
    if not any(parted):
        return Shares.unknown(len(factors))
    terms = _terms(factors, parted, min(MOST_TERMS, MOST_NUMBERS // len(cells.means)))
    order = _chosen(_columns(cells, functions, terms), cells.means)
    design = np.column_stack([np.ones(len(cells.means)), _columns(cells, functions, [terms[k] for k in order])])
    inverse = np.linalg.pinv(design)
    coefficients = inverse @ cells.means
    left = cells.means - design @ coefficients
    free = 1.0 - np.einsum("ij,ji->i", design, inverse)
    others = free > 1e-9  # not a cell that alone determines a coefficient: nothing is known of its error
    left_out = left[others] / free[others]  # error of each cell without it in the fit
    by_noise = float(left @ left) / max(len(design) - design.shape[1], 1) * (inverse**2).sum(axis=1)
    within = 0.0 if math.isnan(cells.chance) else cells.chance * (1 - float(np.mean(1 / cells.counts)))
    rest = float(np.mean(left_out**2)) + within  # of one run, not of the mean of a cell's
    parts = np.maximum(coefficients**2 - by_noise, 0.0)[1:]
    whole = float(parts.sum()) + rest
    shares = [({k for k, _ in terms[place]}, float(part) / whole) for place, part in zip(order, parts, strict=True)]

    def summed(k: int, alone: bool) -> float:
        return sum(s for those, s in shares if (those == {k} if alone else k in those)) if parted[k] else math.nan

    return Shares(
        [summed(k, True) for k in range(len(factors))], [summed(k, False) for k in range(len(factors))],
        sum(s for those, s in shares if len(those) > 1), rest / whole,
    )  # fmt: skip


def _chosen(columns: Array, values: Array) -> list[int]:
    """Return terms one by one, each that which explains most of the rest, as long as that is more than chance."""
    columns, rest = columns - columns.mean(axis=0), values - values.mean()
    first = np.maximum((columns**2).sum(axis=0), 1e-300)
    left = first.copy()  # of each term's square what those chosen do not make up
    units, order, all_of_it = np.zeros((len(values), 0)), list[int](), float(rest @ rest)
    for number in range(min(MOST_CHOSEN, columns.shape[1], (len(values) - 1) // 2)):
        gains = np.where(left > 1e-9 * first, (rest @ columns) ** 2 / np.maximum(left, 1e-300), 0.0)
        best, whole, freedom = int(gains.argmax()), float(rest @ rest), len(values) - 2 - number
        if gains[best] <= 1e-20 * all_of_it:
            break
        ratio = freedom * gains[best] / max(whole - gains[best], 1e-300)
        if stats.f.sf(ratio, 1, freedom) * int((left > 1e-9 * first).sum()) > BY_CHANCE:
            break
        order.append(best)
        unit = columns[:, best] - units @ (units.T @ columns[:, best])
        unit /= float(np.linalg.norm(unit))
        rest = rest - float(unit @ rest) * unit
        left -= (unit @ columns) ** 2
        units = np.column_stack([units, unit])
    return order


def _functions(factor: Factor) -> Array:
    """Return functions of a factor's values, orthonormal over them: (values, functions), the constant one first."""
    # a number counts by its place among all its values, so that a sample in the logarithm needs nothing else
    count = factor.size
    if not factor.is_number:
        return _orthonormal(np.column_stack([np.ones(count), np.eye(count)[:, 1:]]))
    places = (2 * np.arange(count) + 1) / count - 1
    return _orthonormal(np.asarray(np.polynomial.legendre.legvander(places, min(MOST_DEGREE, count - 1)), np.float64))


def _orthonormal(columns: Array) -> Array:
    q, r = np.linalg.qr(columns)
    return np.asarray(q * np.sign(np.diag(r)) * math.sqrt(len(columns)))


def _parted(cells: Cells, factors: list[Factor], functions: list[Array]) -> list[bool]:
    """Return which factors the runs determine: those whose terms are independent of all others."""
    owners = [(k, n) for k, factor in enumerate(factors) for n in range(1, 2 if factor.is_number else factor.size)]
    columns = np.column_stack([functions[k][cells.levels[:, k], n] for k, n in owners])
    _, sizes, directions = np.linalg.svd(np.linalg.qr(columns - columns.mean(axis=0), mode="r"))
    rank = int((sizes > sizes[0] * 1e-9).sum())
    lost = np.abs(directions[rank:]).max(axis=0, initial=0.0) > 1e-6
    return [not any(lost[place] for place, (k, _) in enumerate(owners) if k == number)
            for number in range(len(functions))]  # fmt: skip


def _terms(factors: list[Factor], parted: list[bool], most: int) -> list[Term]:
    """Return products of functions of different factors, of as high degrees as there is room for."""
    for degree in range(MOST_DEGREE, 0, -1):
        for norm in NORMS:
            found = list(itertools.islice(_products(factors, parted, degree, norm), most + 1))
            if len(found) <= most:
                return found
    return found[:most]


def _products(factors: list[Factor], parted: list[bool], degree: int, norm: float) -> Iterator[Term]:
    """Yield the products whose degrees have a norm within the degree; a name's functions have degree 1."""
    single = [
        [((k, n), float(n if factor.is_number else 1) ** norm) for n in range(1, factor.size)
         if not factor.is_number or n <= degree]
        for k, factor in enumerate(factors) if parted[k]
    ]  # fmt: skip
    within = degree**norm + 1e-9
    for order in range(1, min(len(single), int(within)) + 1):
        for those in itertools.combinations(single, order):
            for product in itertools.product(*those):
                if sum(size for _, size in product) <= within:
                    yield tuple(part for part, _ in product)


def _columns(cells: Cells, functions: list[Array], terms: list[Term]) -> Array:
    table = np.ones((len(cells.means), len(terms)))
    for column, term in enumerate(terms):
        for k, n in term:
            table[:, column] *= functions[k][cells.levels[:, k], n]
    return table


MOST_VALUES = 12
"""Values of a number up to which each is a level of its own (ours); above, a figure is taken to change smoothly."""


@dataclass(frozen=True)
class Effect:
    """Effect of a setting on a figure; NaN where the runs do not determine it."""

    first_order: float  # share (0..1) of the variance that the setting alone explains: first-order Sobol index
    total: float  # the same with its interactions: total Sobol index
    rank_correlation: float  # Spearman's over all runs: 1 if the figure only rises with the setting


@dataclass(frozen=True)
class Sensitivity:
    """Sensitivity of a figure to the settings; first orders, interactions and the unexplained share add up to 1."""

    effects: dict[str, Effect]  # `Effect` of each setting, by name
    # share of the variance that only combinations of settings explain; NaN if the runs do not determine it
    interactions: float
    # share that no setting explains: chance and, for a sample, the error of the polynomial. NaN if every combination
    # was run once, as chance then counts as an effect.
    unexplained: float


def sensitivity(
    settings: Mapping[str, Sequence[Any]], figure: NDArray[np.float64], names: Collection[str] = ()
) -> Sensitivity:
    """Return the sensitivity of a figure to settings, from their values per run; runs without it are left out.

    The numbers of the settings in `names` are only names, like those of machines.
    """
    known = np.isfinite(figure)
    values = figure[known]
    factors = {name: _factor(column, known, name in names) for name, column in settings.items()}
    differ = {name: factor for name, factor in factors.items() if factor.size > 1}
    shares = _shares(list(differ.values()), values)
    unknown = math.nan, math.nan
    pairs = dict(zip(differ, zip(shares.first_order, shares.total, strict=True), strict=True))
    effects = {
        name: Effect(*pairs.get(name, unknown), _rank_correlation(factor, values)) for name, factor in factors.items()
    }
    return Sensitivity(effects, shares.interactions, shares.unexplained)


def _shares(factors: list[Factor], values: NDArray[np.float64]) -> Shares:
    if len(values) < 2 or np.ptp(values) == 0 or not factors:
        return Shares.unknown(len(factors))
    places = np.column_stack([factor.levels for factor in factors])
    has_repeats = len(np.unique(places, axis=0)) < len(places)
    is_smooth = any(factor.is_number and factor.size > MOST_VALUES for factor in factors)
    found = None if is_smooth and not has_repeats else decompose(factors, values)
    return fit(factors, values) if found is None else found


def _factor(column: Sequence[Any], known: NDArray[np.bool_], is_name: bool) -> Factor:
    """Return the levels of a setting in the runs whose figure is known."""
    known_values = [value for value, is_known in zip(column, known, strict=True) if is_known]
    is_number = not is_name and all(isinstance(value, int | float) for value in known_values)
    keep_if = np.array(known_values, float) if is_number else np.array([str(value) for value in known_values])
    kinds, levels = np.unique(keep_if, return_inverse=True)
    return Factor(levels, len(kinds), is_number)


def _rank_correlation(factor: Factor, values: NDArray[np.float64]) -> float:
    if not factor.is_number or factor.size < 2 or np.ptp(values) == 0:
        return math.nan
    return float(np.corrcoef(stats.rankdata(factor.levels), stats.rankdata(values))[0, 1])
