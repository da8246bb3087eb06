"""The summary of a sweep as text and picture: means with intervals, sensitivities, the Pareto front.

A sensitivity is given by Sobol' indices from the existing runs, for any design. Shares refer to the variance that a
figure would have if all combinations of the values in the runs were equally likely. Analysis of variance
(`decompose`) handles grids, and lists that change one setting at a time; a fitted polynomial (`fit`) handles samples,
in which hardly any value occurs twice.

In a complete grid the means over its cells give the decomposition exactly (Hoeffding; Sobol' 1993). If cells are
missing, the effects of single settings are fitted simultaneously to the existing cells. This is the same as filling
the gaps with values that minimise the interactions (Yates 1933). Runs with the same settings measure chance, and its
contribution is subtracted from each share.

The polynomial's terms are products of polynomials that are orthonormal over the values of each setting, so each
term's squared coefficient is its share of the variance (polynomial chaos; Sudret 2008). They are selected one by one,
the most explanatory first (orthogonal least squares; Chen et al. 1989), until the next would be as good by chance
(F test, times the number of terms). The polynomial's error on runs outside the fit is the unexplained share.
"""

import itertools
import math
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import rich.console
from matplotlib.figure import Figure as Drawing
from numpy.typing import NDArray
from scipy import sparse, stats

from edmsim.errors import refuse_unknown, refuses_wrong_types
from edmsim.evaluation.compare import Figure, students_t
from edmsim.recording.figures import palette, style
from edmsim.screen import ScreenTable
from edmsim.sweep.run import FIGURES
from edmsim.sweep.specification import number_or_text

# Sensitivity of a figure to the settings.

Array = NDArray[np.float64]


class Factor(NamedTuple):
    """A setting: index of each run's value in the sorted values, number of values, and whether they are numbers."""

    levels: NDArray[np.intp]
    size: int
    is_number: bool


class Shares(NamedTuple):
    """Shares of a variance: first-order and total per factor, all interactions, and the rest; NaN if unknown."""

    first_order: list[float]
    total: list[float]
    interactions: float
    unexplained: float

    @classmethod
    def unknown(cls, factors: int) -> "Shares":
        """Return shares that are all NaN."""
        return cls([math.nan] * factors, [math.nan] * factors, math.nan, math.nan)


class Cells(NamedTuple):
    """Cells: the runs with the same settings are one cell."""

    levels: NDArray[np.intp]
    means: Array
    counts: NDArray[np.intp]
    chance: float  # variance between runs of a cell; NaN if no cell has two


def cells_of(factors: list[Factor], values: Array) -> Cells:
    """Combine the runs with the same settings in cells."""
    levels, cell = np.unique(np.column_stack([f.levels for f in factors]), axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    counts = np.bincount(cell)
    means = np.bincount(cell, values) / counts
    more = len(values) - len(means)
    chance = float(((values - means[cell]) ** 2).sum()) / more if more else math.nan
    return Cells(levels, means, counts, chance)


MOST_CELLS = 4_000_000  # largest grid whose interactions are computed (ours: 32 MB)
MOST_LEVELS = 1000  # of all factors together (ours); for more, a polynomial is fitted


def decompose(factors: list[Factor], values: Array) -> Shares | None:
    """Return the shares of every factor; None if the effects of its levels cannot be separated or are too many."""
    # Interactions are computed if more than half of all combinations were run (ours). Otherwise they count as
    # unexplained, as far as the runs show them.
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
    """Additive model: one effect per level of each factor, fitted to the means of cells with equal weights."""

    def __init__(self, cells: Cells, counts: list[int]) -> None:
        first = 1 + np.concatenate([[0], np.cumsum(counts)])
        self._spans = [slice(a, b) for a, b in itertools.pairwise(first.tolist())]
        columns = np.column_stack([np.zeros(len(cells.means), int), cells.levels + first[:-1]])
        rows = np.repeat(np.arange(len(columns)), columns.shape[1])
        places = rows, columns.reshape(-1)
        self._design = sparse.csr_array((np.ones(columns.size), places), (len(columns), int(first[-1])))
        gram = (self._design.T @ self._design).toarray()
        self.rank = int(np.linalg.matrix_rank(gram, hermitian=True))
        self._inverse = np.linalg.pinv(gram, hermitian=True)
        self._effects: Array = np.asarray(self._inverse @ (self._design.T @ cells.means))
        self.residuals: Array = cells.means - self._design @ self._effects

    def variances(self, noise: Array) -> list[float]:
        """Return each factor's variance over its levels, less the part due to noise with a variance for each cell."""
        scattered = (self._design.T @ sparse.diags_array(noise) @ self._design).toarray()
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
    """Return for each factor the variance of all interactions that include it; missing cells count as zero."""
    grid = np.zeros(counts)
    grid[tuple(cells.levels.T)] = residuals
    whole = float(np.mean(grid**2))
    return [whole - float(np.mean(grid.mean(axis=axis) ** 2)) for axis in range(len(counts))]


MOST_DEGREE = 10  # highest degree of the polynomial (ours: it can follow two waves)
NORMS = 1.0, 0.75, 0.5
"""Norms of a term's degrees, tried until there are few enough terms: below 1, high degrees of several factors are
left out (Blatman and Sudret 2011)."""
MOST_TERMS = 1000
"""Most candidate terms (ours); fewer if the table of all cells would have more than `MOST_NUMBERS` numbers."""
MOST_NUMBERS = 30_000_000
MOST_CHOSEN = 60  # most selected terms (ours)
BY_CHANCE = 0.05  # highest probability that the best candidate is by chance as good as the selected term (ours)
Term = tuple[tuple[int, int], ...]  # pairs: index of a factor, and of its function from 1 on


def fit(factors: list[Factor], values: Array) -> Shares:
    """Return the shares of every factor; NaN for factors that change only together."""
    cells = cells_of(factors, values)
    functions = [_functions(factor) for factor in factors]
    parted = _parted(cells, factors, functions)
    if not any(parted):
        return Shares.unknown(len(factors))
    terms = _terms(factors, parted, min(MOST_TERMS, MOST_NUMBERS // len(cells.means)))
    order = _selected(_columns(cells, functions, terms), cells.means)
    design = np.column_stack([np.ones(len(cells.means)), _columns(cells, functions, [terms[k] for k in order])])
    inverse = np.linalg.pinv(design)
    coefficients = inverse @ cells.means
    left = cells.means - design @ coefficients
    free = 1.0 - np.einsum("ij,ji->i", design, inverse)
    others = free > 1e-9  # without cells that alone determine a coefficient: their error is unknown
    left_out = left[others] / free[others]  # error of each cell if it is left out of the fit
    by_noise = float(left @ left) / max(len(design) - design.shape[1], 1) * (inverse**2).sum(axis=1)
    within = 0.0 if math.isnan(cells.chance) else cells.chance * (1 - float(np.mean(1 / cells.counts)))
    rest = float(np.mean(left_out**2)) + within  # of a single run, not of a cell's mean
    parts = np.maximum(coefficients**2 - by_noise, 0.0)[1:]
    whole = float(parts.sum()) + rest
    shares = [({k for k, _ in terms[place]}, float(part) / whole) for place, part in zip(order, parts, strict=True)]

    def summed(k: int, alone: bool) -> float:
        return sum(s for those, s in shares if (those == {k} if alone else k in those)) if parted[k] else math.nan

    return Shares(
        [summed(k, True) for k in range(len(factors))], [summed(k, False) for k in range(len(factors))],
        sum(s for those, s in shares if len(those) > 1), rest / whole,
    )  # fmt: skip


def _selected(columns: Array, values: Array) -> list[int]:
    """Select terms one by one: the next explains most of the rest, until that may be chance. Return their indices."""
    columns, rest = columns - columns.mean(axis=0), values - values.mean()
    first = np.maximum((columns**2).sum(axis=0), 1e-300)
    left = first.copy()  # part of each term's square that the selected ones do not explain
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
    """Return functions that are orthonormal over a factor's values: (values, functions), the constant one first."""
    # a number is replaced by its rank among the values, so a logarithmic sample needs no case of its own
    count = factor.size
    if not factor.is_number:
        return _orthonormal(np.column_stack([np.ones(count), np.eye(count)[:, 1:]]))
    places = (2 * np.arange(count) + 1) / count - 1
    return _orthonormal(np.asarray(np.polynomial.legendre.legvander(places, min(MOST_DEGREE, count - 1)), np.float64))


def _orthonormal(columns: Array) -> Array:
    q, r = np.linalg.qr(columns)
    return np.asarray(q * np.sign(np.diag(r)) * math.sqrt(len(columns)))


def _parted(cells: Cells, factors: list[Factor], functions: list[Array]) -> list[bool]:
    """Return for each factor whether the runs determine it: its terms are linearly independent of all others."""
    owners = [(k, n) for k, factor in enumerate(factors) for n in range(1, 2 if factor.is_number else factor.size)]
    columns = np.column_stack([functions[k][cells.levels[:, k], n] for k, n in owners])
    _, sizes, directions = np.linalg.svd(np.linalg.qr(columns - columns.mean(axis=0), mode="r"))
    rank = int((sizes > sizes[0] * 1e-9).sum())
    lost = np.abs(directions[rank:]).max(axis=0, initial=0.0) > 1e-6
    return [not any(lost[place] for place, (k, _) in enumerate(owners) if k == number)
            for number in range(len(functions))]  # fmt: skip


def _terms(factors: list[Factor], parted: list[bool], most: int) -> list[Term]:
    """Return at most `most` products of functions of different factors, up to the highest possible degree."""
    for degree in range(MOST_DEGREE, 0, -1):
        for norm in NORMS:
            found = list(itertools.islice(_products(factors, parted, degree, norm), most + 1))
            if len(found) <= most:
                return found
    return found[:most]


def _products(factors: list[Factor], parted: list[bool], degree: int, norm: float) -> Iterator[Term]:
    """Yield the products whose degrees have at most `degree` as norm; functions of names have degree 1."""
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
"""Most values of a number that are separate levels (ours); with more, figures are assumed to change smoothly."""


@dataclass(frozen=True)
class Effect:
    """Effect of a setting on a figure; NaN if the runs do not determine it."""

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
    # was run once, because chance then counts as an effect.
    unexplained: float


def sensitivity(
    settings: Mapping[str, Sequence[Any]], figure: Array, names: Collection[str] = ()
) -> Sensitivity:
    """Return the sensitivity of a figure to settings, from their values per run; runs without a figure are left out.

    Numbers in the settings `names` are only names, like those of machines.
    """
    known = np.isfinite(figure)
    values = _comparable(figure[known])
    factors = {name: _factor(column, known, name in names) for name, column in settings.items()}
    differ = {name: factor for name, factor in factors.items() if factor.size > 1}
    shares = _shares(list(differ.values()), values)
    unknown = math.nan, math.nan
    pairs = dict(zip(differ, zip(shares.first_order, shares.total, strict=True), strict=True))
    effects = {
        name: Effect(*pairs.get(name, unknown), _rank_correlation(factor, values)) for name, factor in factors.items()
    }
    return Sensitivity(effects, shares.interactions, shares.unexplained)


def _comparable(values: Array) -> Array:
    """Return values over the greatest, to twelve digits: cuts at the greatest feed differ by rounding errors."""
    most = float(np.abs(values).max(initial=0.0))
    return np.round(values / most, 12) if most else values


def _shares(factors: list[Factor], values: Array) -> Shares:
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


def _rank_correlation(factor: Factor, values: Array) -> float:
    if not factor.is_number or factor.size < 2 or np.ptp(values) == 0:
        return math.nan
    return float(np.corrcoef(stats.rankdata(factor.levels), stats.rankdata(values))[0, 1])


# Summary of a sweep.

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
    """Return each figure's sensitivity to the settings that differ; see `sensitivity`.

    Constants of drawn machines count as settings if the sweep drew more machines than there are constants.
    Otherwise their effects cannot be separated, and the machine counts as one setting.
    """
    constants, machines = _drawn(table), len(table[MACHINE].unique())
    left_out = constants if machines <= len(constants) + 1 else [MACHINE]
    settings = {name: _settings(table, name) for name in varied(table) if name not in left_out}
    return {name: sensitivity(settings, _values(table, name), [MACHINE]) for name in measured(table)}


def pareto_front(points: Array) -> NDArray[np.bool_]:
    """Return for each point whether no other is as good in every column and better in one; more is better."""
    front = np.ones(len(points), bool)
    points = np.apply_along_axis(_comparable, 0, points)
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


def _values(table: pa.Table, name: str) -> Array:
    values = np.array([math.nan if value is None else value for value in table[name].to_pylist()], np.float64)
    if name == TIME:
        values[[outcome != "finished" for outcome in table["outcome"].to_pylist()]] = math.nan
    return values


def _mean(values: Array, machines: Sequence[Any]) -> Figure:
    """Return the mean of the known values, with its interval over machines if there are several."""
    # the runs of a machine are alike; if they counted as independent, the interval would be too narrow. Student's t,
    # because a bootstrap of two to five runs holds the mean in half to five sixths of all cases
    units = machines if len(set(machines)) > 1 else range(len(values))
    numbers: dict[Any, int] = {}
    known = np.isfinite(values)
    unit = np.array([numbers.setdefault(units[int(row)], len(numbers)) for row in np.flatnonzero(known)], int)
    sums, counts, size = np.bincount(unit, values[known]), np.bincount(unit), len(numbers)
    mean = float(sums.sum() / counts.sum()) if size else math.nan
    if size < 2:
        return Figure(mean, math.nan, math.nan)
    error = math.sqrt(size / (size - 1) * float(((sums - mean * counts) ** 2).sum())) / float(counts.sum())
    half = students_t(size - 1) * error
    return Figure(mean, mean - half, mean + half)


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


@style.in_style
def pareto_figure(table: pa.Table) -> Drawing:
    """Draw the groups of a sweep by rate, roughness and error, and mark the Pareto front."""
    goals = goals_of(table)
    found, front = front_of(table)
    if len(goals) < 2 or not found:
        return style.EmptyFigure("No two of rate, roughness and error were measured in a run.")
    figure = style.column_figure(2.9, top_in=0.5 if len(goals) > 2 else 0.12)
    values = {name: np.array([group.figures[name].value for group in found]) for name in goals}
    x, y = goals[0], goals[1]
    axes = figure.subplots()
    order = np.argsort(values[x][front])
    axes.plot(values[x][front][order], values[y][front][order], color=palette.LINE, lw=1.0, zorder=1)
    colour: dict[str, Any] = {"c": values[goals[2]], "cmap": "viridis_r"} if len(goals) > 2 else {"c": palette.BLUE}
    dots = axes.scatter(values[x], values[y], s=14, lw=0, zorder=2, **colour)
    axes.scatter(
        values[x][front], values[y][front], s=34, facecolors="none", edgecolors=palette.VERMILION, lw=1.0, zorder=3,
        label="Pareto-optimal",
    )
    axes.ticklabel_format(useOffset=False)  # full values on the axis, even if they hardly differ
    style.dress(axes, _label(x), _label(y))
    style.legend(axes)
    if len(goals) > 2:
        style.colour_bar(figure, dots, _label(goals[2]))
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
