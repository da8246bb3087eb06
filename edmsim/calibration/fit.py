"""Least squares on summary statistics: which constants let the model cut as the machine of a log did.

The statistics of steady stretches of the log are compared with those of straight cuts of the same feed and setting,
simulated with common random numbers. Both are known only to their noise, whose covariance is taken from batches of
the log. Constants are shares of their published ranges, which bound them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.calibration.log import STATISTICS, STRETCH_WINDOWS, Log, Stretch, stretches
from edmsim.calibration.simulate import simulate
from edmsim.errors import InputError
from edmsim.uncertainty import choose, share_of, value_at, with_values

if TYPE_CHECKING:
    from edmsim.machine import Constant, Machine

Array = NDArray[np.float64]

DEFAULT_CONSTANTS = ("gap.critical_um", "material.removal_mm3_J", "material.burning_voltage_V")
"""What is fitted if nothing else is said (ours: the three that every log tells of)."""
MOST_STRETCHES = 8
"""Stretches compared; if the log has more, those whose feeds and settings differ most (ours)."""
STEP = 0.15
"""Half the difference, in shares of the range, over which sensitivities are taken (ours: well above the noise)."""
MOST_ROUNDS = 10
"""Gauss-Newton steps at most (ours)."""
SHRINKAGE = 0.2
"""How far measured correlations of the statistics are drawn to none (ours: few batches know them badly)."""
READING = (1e-3, 1e-3, 2e-3, 2e-3, 5e-3)
"""Least standard deviation of a stretch's statistics, the latter three relative (ours: a meter's and a counter's)."""
UNTOLD = 0.29
"""A standard error of this share of the range is no more than the range says: a uniform draw has it (1/sqrt(12))."""
AT_BOUND = 0.01
CONFIDENCE = 0.95


class Fitted(NamedTuple):
    """One constant: its value, its 95 % interval, and what is to be said of it."""

    name: str
    before: float
    value: float
    interval: tuple[float, float]
    range: tuple[float, float]
    remark: str


class Progress(NamedTuple):
    """How far a calibration is: cuts simulated, and the misfit per degree of freedom last found (NaN: none yet)."""

    cuts: int
    misfit: float


@dataclass(frozen=True)
class Fit:
    """What came of a calibration.

    Attributes
    ----------
    machine : Machine
        With the fitted constants; its sources are still the old ones.
    constants : tuple of Fitted
    untold : dict of str to str
        Constants the log cannot tell, with the reason; they keep their values.
    correlation : float64 array (p, p)
        Of the fitted constants' errors.
    misfit : float
        Squared residuals in units of their noise, per degree of freedom: about 1 if the model can do what the
        machine did. Intervals are widened by its root where it is above 1.
    stretches : list of Stretch
        Those compared.
    simulated : float64 array (stretches, 5)
        `log.STATISTICS` of the fitted model.
    """

    machine: Machine
    constants: tuple[Fitted, ...]
    untold: dict[str, str]
    correlation: Array
    misfit: float
    stretches: list[Stretch]
    simulated: Array


def calibrate(
    log: Log, machine: Machine, only: Sequence[str] = DEFAULT_CONSTANTS, *, seed: int = 0, resolution: str = "fast",
    watch: Callable[[Progress], None] | None = None,
) -> Fit:
    """Fit constants of a machine to its log.

    Parameters
    ----------
    log : Log
    machine : Machine
        The set-up of the log; its constants are where the search starts.
    only : sequence of str
        Constants or sections, see `Machine.uncertain`.
    seed : int
        Of every simulated cut.
    resolution : {"fast", "default", "fine"}
        Of the simulation; constants belong to it, as shares of short circuits depend on it.
    watch : callable, optional
        Is told of the `Progress`.

    Raises
    ------
    InputError
        An unknown constant, no steady stretch, a setting that the generator refuses, fewer statistics than constants,
        or a log that tells none of the constants.
    """
    known = choose(machine, only)
    steady = stretches(log)
    if not steady:
        raise InputError(
            f"no steady stretch of {STRETCH_WINDOWS} windows in it, with metal near, one setting and one feed",
            log.name,
        )
    picked = spread(steady, MOST_STRETCHES)
    for stretch in picked:
        machine.with_(t_on_us=stretch.t_on_us, t_period_us=stretch.t_period_us)  # raises what the generator refuses
    comparison = _Comparison(machine, picked, seed, resolution, watch)
    if comparison.size <= len(known):
        raise InputError(f"{len(known)} constants cannot be told from {comparison.size} statistics", log.name)
    return _fit_what_is_told(comparison, known, log.name)


def spread(steady: Sequence[Stretch], most: int) -> list[Stretch]:
    """Return at most so many stretches, evenly spread over settings and feeds, in the order of the log."""
    ordered = sorted(steady, key=lambda s: (s.t_on_us, s.t_period_us, s.feed_um_s))
    places = np.unique(np.linspace(0, len(ordered) - 1, min(most, len(ordered))).round().astype(int))
    return sorted((ordered[k] for k in places), key=lambda s: s.first)


class _Comparison:
    """Residuals of a machine against the log, in units of their noise, and their sensitivities."""

    def __init__(
        self, machine: Machine, picked: list[Stretch], seed: int, resolution: str,
        watch: Callable[[Progress], None] | None,
    ) -> None:
        self.machine, self.picked = machine, picked
        self._seed, self._resolution, self._watch = seed, resolution, watch
        self._cuts, self._misfit = 0, float("nan")
        self._known = np.array([np.isfinite(stretch.mean) for stretch in picked])
        self._scales = _noise_scales(picked)
        self.size = int(self._known.sum())

    def statistics(self, machines: Sequence[Machine]) -> Array:
        """Simulate every stretch with every machine: (machines, stretches, 5)."""
        jobs = [(machine, number) for machine in machines for number in range(len(self.picked))]
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            try:
                found = []
                for row in pool.map(self._simulate, jobs):
                    found.append(row)
                    self._cuts += 1
                    if self._watch is not None:
                        self._watch(Progress(self._cuts, self._misfit))
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
        return np.array(found).reshape(len(machines), len(self.picked), len(STATISTICS))

    def _simulate(self, job: tuple[Machine, int]) -> Array:
        machine, number = job
        stretch = self.picked[number]
        batches = simulate(machine, stretch, STRETCH_WINDOWS, self._seed + number, self._resolution)
        return Stretch(0, stretch.feed_um_s, stretch.t_on_us, stretch.t_period_us, batches).mean

    def residuals(self, simulated: Array) -> Array:
        """Simulated less logged statistics, in units of their noise and uncorrelated, (size,)."""
        rows = []
        for number, stretch in enumerate(self.picked):
            known = self._known[number]
            # what the model never does (no ignition at all) is as far off as the log's own value
            apart = np.where(np.isfinite(simulated[number]), simulated[number], 0.0) - stretch.mean
            rows.append(np.linalg.solve(self._scales[number][np.ix_(known, known)], apart[known]))
        return np.concatenate(rows)

    def tell(self, misfit: float) -> None:
        """Take note of the misfit for whoever watches."""
        self._misfit = misfit


def _noise_scales(picked: Sequence[Stretch]) -> list[Array]:
    """Lower triangular roots of the covariance of simulated less logged statistics, one (5, 5) per stretch.

    The simulated cut is as long as the logged one, so that it doubles the log's variance.
    """
    apart = np.concatenate([stretch.batches - stretch.mean for stretch in picked])
    apart = np.where(np.isfinite(apart), apart, 0.0)
    size = np.maximum(apart.std(axis=0), 1e-12)
    correlation = (1 - SHRINKAGE) * (apart / size).T @ (apart / size) / len(apart)
    np.fill_diagonal(correlation, 1.0)
    root = np.linalg.cholesky(correlation)
    scales = []
    for stretch in picked:
        count = len(stretch.batches)
        own = np.nan_to_num(np.where(np.isfinite(stretch.batches), stretch.batches - stretch.mean, 0.0))
        variance = 2 * (own**2).sum(axis=0) / (count - 1) / count
        relative = np.where([False, False, True, True, True], np.abs(np.nan_to_num(stretch.mean)), 1.0)
        variance += (np.array(READING) * relative) ** 2
        scales.append(np.sqrt(variance)[:, None] * root)
    return scales


def _fit_what_is_told(comparison: _Comparison, known: dict[str, Constant], log_name: str) -> Fit:
    """Fit; give up, one after the other, the constants the log does not tell, and fit the rest again."""
    untold: dict[str, str] = {}
    while known:
        search = _Search(comparison, known)
        search.run()
        error = search.standard_errors()
        worst = int(error.argmax())
        if error[worst] < UNTOLD:
            return _result(search, error, untold)
        name = list(known)[worst]
        untold[name] = _why_untold(search, worst)
        known = {key: constant for key, constant in known.items() if key != name}
    reasons = "; ".join(f"{name}: {reason}" for name, reason in untold.items())
    raise InputError(f"the log tells none of the constants ({reasons})", log_name)


def _why_untold(search: _Search, place: int) -> str:
    alone = search.information[place, place]
    if alone * UNTOLD**2 < 1:
        return "the statistics do not depend on it"
    others = [name for name in search.names if name != search.names[place]]
    return f"another value of {', '.join(others)} does the same"


class _Search:
    """Gauss-Newton by SciPy in shares of the constants' ranges."""

    def __init__(self, comparison: _Comparison, known: dict[str, Constant]) -> None:
        self.comparison = comparison
        self.names = list(known)
        self.ranges = [constant.range for constant in known.values() if constant.range is not None]
        values = [constant.value for constant in known.values()]
        starts = [share_of(bounds, value) for bounds, value in zip(self.ranges, values, strict=True)]
        self.before = values
        self.shares: Array = np.clip(starts, 0.05, 0.95)
        self.simulated: Array = np.zeros((0, 5))
        self.information: Array = np.zeros((0, 0))
        self.misfit = float("nan")

    def machine(self, shares: Array) -> Machine:
        """Return the machine with its constants at these shares of their ranges."""
        return with_values(self.comparison.machine, self.values(shares))

    def values(self, shares: Array) -> dict[str, float]:
        """Return the constants' values at these shares of their ranges."""
        return {
            name: value_at(bounds, float(share))
            for name, bounds, share in zip(self.names, self.ranges, shares, strict=True)
        }

    def run(self) -> None:
        """Search, and take information and misfit where it ended."""
        from scipy.optimize import least_squares

        found = least_squares(
            self._residuals, self.shares, self._sensitivities, bounds=(0.0, 1.0), method="trf", x_scale=1.0,
            ftol=1e-3, xtol=3e-3, gtol=None, max_nfev=MOST_ROUNDS,
        )  # fmt: skip
        self.shares = found.x
        self.simulated = self.comparison.statistics([self.machine(found.x)])[0]
        self.misfit = self._misfit(self.comparison.residuals(self.simulated))
        self.information = self._information(self._sensitivities(found.x))

    def _residuals(self, shares: Array) -> Array:
        residuals = self.comparison.residuals(self.comparison.statistics([self.machine(shares)])[0])
        self.comparison.tell(self._misfit(residuals))
        return residuals

    def _misfit(self, residuals: Array) -> float:
        return float(residuals @ residuals) / (self.comparison.size - len(self.names))

    def _around(self, shares: Array) -> list[tuple[Array, Array]]:
        """Places below and above in every constant, within the ranges."""
        pairs = []
        for place in range(len(shares)):
            low, high = shares.copy(), shares.copy()
            low[place] = max(0.0, min(shares[place] - STEP, 1.0 - 2 * STEP))
            high[place] = low[place] + 2 * STEP
            pairs.append((low, high))
        return pairs

    def _sensitivities(self, shares: Array) -> Array:
        """Change of the residuals per share of the range, (size, p)."""
        pairs = self._around(shares)
        machines = [self.machine(place) for pair in pairs for place in pair]
        residuals = [self.comparison.residuals(row) for row in self.comparison.statistics(machines)]
        return np.column_stack([(residuals[2 * k + 1] - residuals[2 * k]) / (2 * STEP) for k in range(len(pairs))])

    def _information(self, sensitivities: Array) -> Array:
        """J^T J less what noise alone puts into it, (p, p).

        Half of a residual's variance is the simulation's, so a sensitivity has that of two of them, 2 * 1/2, over
        (2 STEP)^2; over all residuals this adds up in the diagonal.
        """
        noise = self.comparison.size / (2 * STEP) ** 2
        return np.asarray(sensitivities.T @ sensitivities - noise * np.eye(len(self.names)))

    def covariance(self) -> Array | None:
        """Return the covariance of the errors in shares, widened by the misfit; None if the log leaves some open."""
        if np.linalg.eigvalsh(self.information)[0] <= 0:
            return None
        return np.asarray(np.linalg.inv(self.information) * max(1.0, self.misfit))

    def standard_errors(self) -> Array:
        """Return the standard errors in shares of the ranges; infinite for the one that is told least."""
        covariance = self.covariance()
        if covariance is not None:
            return np.asarray(np.sqrt(np.diag(covariance)))
        vectors = np.linalg.eigh(self.information)[1]
        error = np.zeros(len(self.names))
        error[int(np.abs(vectors[:, 0]).argmax())] = np.inf
        return error


def _result(search: _Search, error: Array, untold: dict[str, str]) -> Fit:
    from scipy.stats import t as student

    covariance = search.covariance()
    assert covariance is not None
    half = error * student.ppf((1 + CONFIDENCE) / 2, search.comparison.size - len(search.names))
    constants = []
    for place, (name, bounds) in enumerate(zip(search.names, search.ranges, strict=True)):
        share = float(search.shares[place])
        low, high = (value_at(bounds, min(max(share + side * half[place], 0.0), 1.0)) for side in (-1, 1))
        remark = "at the end of its range" if min(share, 1 - share) < AT_BOUND else ""
        constants.append(Fitted(name, search.before[place], value_at(bounds, share), (low, high), bounds, remark))
    return Fit(
        search.machine(search.shares), tuple(constants), untold, covariance / np.outer(error, error), search.misfit,
        search.comparison.picked, search.simulated,
    )
