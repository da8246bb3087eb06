"""Least squares on summary statistics: find constants with which the model cuts like the machine of a log.

The statistics of steady stretches of the log are compared with those of straight cuts of the same feed and setting,
simulated with common random numbers. Both have noise, whose covariance is measured with batches of the log and cuts
with other seeds. The search uses shares of the constants' published ranges, which are its bounds.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize

from edmsim import numeric, runs
from edmsim.calibration.comparison import CalibrationProgress, StretchComparison, settle_um
from edmsim.calibration.log import STATISTICS, STRETCH_WINDOWS, Log, Stretch, stretches
from edmsim.errors import InputError, refuses_wrong_types
from edmsim.evaluation import compare, stable_rate
from edmsim.geometry import Floats
from edmsim.job.options import CutSettings
from edmsim.machine import overrides, ranges, setting
from edmsim.machine.machine import Machine

# The set-up for the comparison with a log: the log's settings, and the user's overrides.


def start_of(log: Log) -> CutSettings:
    """Return the settings of the logged cut; if the log has none, the defaults with resolution "fast"."""
    return CutSettings(resolution="fast") if log.settings is None else log.settings


SET_UP = ("machine", "material", "wire", "generator", "height_mm")
"""Options that describe the set-up of a log."""


@refuses_wrong_types
def settings_for(log: Log, **options: Any) -> tuple[CutSettings, list[str]]:
    """Return the settings for comparing a log with the model, with overrides, and notices for the user.

    The workpiece has one height, by default the greatest of the cut. A notice names every option that differs from
    the log's, and the log's constants that are not used because of another machine, material or wire. If the log has
    no settings, a notice lists the assumed part of the set-up.
    """
    start = start_of(log)
    notices = []
    if start.workpiece.lowest_mm < start.workpiece.greatest_mm:
        height_mm = start.workpiece.greatest_mm
        if "height_mm" not in options:
            notices.append(f"the height changed in the cut of this log: {height_mm:g} mm is taken for all of it")
        start = start.model_copy(update={"height_mm": height_mm, "heights": (), "height_areas": ()})
    parts = "machine", "material", "wire"
    others = {part for part in parts if options.get(part) not in (None, getattr(start, part))}
    left_out = [name for name, _ in start.overrides if _part(name) in others]
    start_constants = {name: value for name, value in start.overrides if name not in left_out}
    if left_out and log.settings is not None:
        notices.append(f"the log was cut with another value of {', '.join(left_out)}: that of the file given is used")
    combined = CutSettings.model_validate({**dict(start), "constants": start_constants, **options})
    for name in options if log.settings is not None else ():
        logged, overridden = getattr(start, name), getattr(combined, name)
        if logged != overridden:
            was = "its default" if logged is None else logged
            notices.append(f"{name} {overridden} is used, though the log was cut with {was}")
    assumed = [f"{name} {getattr(combined, name)}" for name in SET_UP if options.get(name) is None]
    if assumed and log.settings is None:
        notices.append(f"the log does not name its set-up; assumed: {', '.join(assumed)}")
    return combined, notices


def machine_of(settings: CutSettings) -> Machine:
    """Return the set-up for comparing a log; overridden constants have the ranges of their files."""
    # in a cut, overridden constants have no range; here they are start values of the search, or held
    machine = settings.model_copy(update={"constants": ()}).load_machine()
    listed = dict(settings.overrides)
    checked = overrides.with_overrides(machine, listed.items())
    bounds = {name: constant.range for name, constant in ranges.uncertain(machine).items()}
    source = "given to the cut of the log"
    changed = {
        name: overrides.KINDS[name].model_construct(value=value, source=source, range=bounds.get(name))
        for name, value in listed.items()
    }
    return ranges.with_constants(checked, changed)


def held(settings: CutSettings, machine: Machine, fitted: Iterable[str]) -> list[str]:
    """Return a line for every override of the log's cut that is not fitted, or is outside its range."""
    chosen = ranges.choose(machine, fitted)
    lines = []
    for name, value in settings.overrides:
        bounds = chosen[name].range if name in chosen else None
        if bounds is None:
            lines.append(f"{name} is held at {value:g}, as in the cut of the log")
        elif not bounds[0] <= value <= bounds[1]:
            within = f"its range {bounds[0]:g}..{bounds[1]:g}"
            lines.append(f"{name} was {value:g} in the cut of the log, outside {within}: the fitted value is inside")
    return lines


def _part(constant: str) -> str:
    """Return the option that names the file of a constant."""
    section = constant.partition(".")[0]
    return section if section in ("material", "wire") else "machine"


DEFAULT_CONSTANTS = ("gap.particle_share", "material.removal_mm3_J", "material.burning_voltage_V")
"""Constants that are fitted by default (ours: every log determines these three)."""
MOST_STRETCHES = 8  # of a comparison; if the log has more, those whose feeds and settings differ most (ours)
STEP = 0.15
"""Half the difference, in shares of the range, over which sensitivities are computed (ours: well above noise)."""
MOST_ROUNDS = 10  # most Gauss-Newton steps (ours)
UNTOLD = 0.29
"""Standard error of a uniform draw, 1/sqrt(12), in shares of the range: a fit with more adds nothing to the range."""
MUCH = 4.0  # a larger misfit is not noise: residuals are twice as large as noise (ours)
AT_BOUND = 0.01


class FittedConstant(NamedTuple):
    """One fitted constant: its values before and after, 95 % interval, allowed range, and a remark."""

    name: str
    before: float
    value: float
    interval: tuple[float, float]
    range: tuple[float, float]
    remark: str


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of a calibration."""

    machine: Machine  # machine with the fitted constants; their source texts are unchanged
    constants: tuple[FittedConstant, ...]
    # constants that the log does not determine, with the reason; their values are unchanged
    undetermined: dict[str, str]
    correlation: Floats  # (p, p): correlation of the fitted constants' errors
    # squared residuals in units of their noise, per degree of freedom: about 1 if the model reproduces the log. If it
    # is above 1, its square root widens the intervals.
    misfit: float
    stretches: list[Stretch]  # compared stretches of the log
    simulated: Floats  # (stretches, 5): `log.STATISTICS` of the fitted model
    noise: Floats  # (stretches, 5): standard deviation of simulated minus logged statistics by chance


@refuses_wrong_types
def calibrate(
    log: Log, machine: Machine, only: Sequence[str] = DEFAULT_CONSTANTS, *, seed: int = 0,
    resolution: str | None = None, table: runs.RunTable | None = None,
    watch: Callable[[CalibrationProgress], None] | None = None,
) -> Fit:
    """Fit constants of a machine to its log.

    Parameters
    ----------
    log : Log
    machine : Machine
        The set-up of the log; the search starts at its constants.
    only : sequence of str
        Constants or sections to fit, see `Machine.uncertain`.
    seed : int
        Seed of every simulated cut.
    resolution : {"fast", "default", "fine"}, optional
        Resolution of the simulation. Fitted constants hold only for it, because the share of short circuits
        depends on it. By default that of a simulated log, or "fast" for a real machine's.
    table : edmsim.runs.RunTable, optional
        Simulated cuts; an interrupted calibration resumes from it.
    watch : callable, optional
        Called with the `CalibrationProgress`.

    Raises
    ------
    InputError
        If a constant is unknown, the generator refuses a setting, or the log has no steady stretch, has fewer
        statistics than constants, or determines no constant.
    """
    seed = numeric.whole_from("seed", seed)
    if not only:
        raise InputError("there is no constant to fit: name some, or sections, as 'gap'")
    known = ranges.choose(machine, only)
    picked = spread(stretches(log, settle_um(machine)), MOST_STRETCHES)
    for stretch in picked:
        # raises `InputError` if the generator cannot run this setting
        set_up = machine.with_(t_on_us=stretch.t_on_us, t_period_us=stretch.t_period_us)
        _check_means(stretch, set_up, log.name)
    size = int(sum(np.isfinite(stretch.mean).sum() for stretch in picked))
    if size <= len(known):
        raise InputError(f"{len(known)} constants cannot be determined from {size} statistics", log.name)
    if resolution is None:
        resolution = start_of(log).resolution
    comparison = StretchComparison(machine, picked, seed, resolution, table or runs.RunTable(), watch, len(known))
    return _fit_what_is_determined(comparison, list(known), log.name)


def _check_means(stretch: Stretch, machine: Machine, log_name: str) -> None:
    """Raise `InputError` if voltage or current exceed the generator's, for example because they are in mV or mA."""
    most_A = max(setting.short_current_A(machine), setting.discharge_current_A(machine))
    most = {"mean_voltage_V": setting.open_V(machine), "mean_current_A": most_A}
    for name, mean in zip(STATISTICS, stretch.mean.tolist(), strict=True):
        if abs(mean) > most.get(name, math.inf):
            unit = name[-1]
            raise InputError(
                f"windows {stretch.first + 1} to {stretch.first + STRETCH_WINDOWS}: {name} is {mean:.4g} on average, "
                f"above the generator's {most[name]:.4g} {unit}: give {unit}, and the generator of the log",
                log_name,
            )


def spread(steady: Sequence[Stretch], most: int) -> list[Stretch]:
    """Return at most `most` stretches, evenly spread over settings and feeds, in the order of the log."""
    ordered = sorted(steady, key=lambda s: (s.t_on_us, s.t_period_us, s.feed_um_s))
    places = np.unique(np.linspace(0, len(ordered) - 1, min(most, len(ordered))).round().astype(int))
    return sorted((ordered[k] for k in places), key=lambda s: s.first)


def _fit_what_is_determined(comparison: StretchComparison, names: Sequence[str], log_name: str) -> Fit:
    """Fit the constants that the log determines; remove those without effect, and correlated ones one by one."""
    # A constant may have no effect at the start of the search, but have one at the log's share of shorts. So those
    # without effect are tested again at the end of the first search.
    start = comparison.machine
    search: _Search | None = None
    determined = _determined_alone(comparison, names, start)
    if 0 < len(determined) < len(names):
        search = _Search(comparison, determined, start)
        search.run()
        start = search.machine(search.shares)
        also = _determined_alone(comparison, [name for name in names if name not in determined], start)
        determined = [name for name in names if name in determined or name in also]
    undetermined = {name: "the statistics do not depend on it" for name in names if name not in determined}
    while determined:
        if search is None or search.names != determined:
            at = ranges.with_values(comparison.machine, ranges.values_of(start, determined))
            search = _Search(comparison, determined, at)
            search.run()
        error = search.standard_errors()
        worst = int(error.argmax())
        if error[worst] < UNTOLD:
            return _result(search, error, undetermined)
        name = determined[worst]
        determined = [other for other in determined if other != name]
        value = ranges.values_of(comparison.machine, [name])[name]
        others = f"another value of {', '.join(determined)} does the same; the fit holds for {value:g} only"
        undetermined[name] = others if determined else "the noise hides it"
    reasons = "; ".join(f"{name}: {reason}" for name, reason in undetermined.items())
    far = "" if search is None or search.misfit <= MUCH else (
        f"; the misfit of {search.misfit:.3g} is far above 1: see whether units, set-up and resolution are the log's"
    )  # fmt: skip
    raise InputError(f"the log determines none of the constants ({reasons}){far}", log_name)


def _determined_alone(comparison: StretchComparison, names: Sequence[str], at: Machine) -> list[str]:
    """Return the constants that the log would determine at this machine if each were the only unknown one."""
    search = _Search(comparison, names, at)
    alone = np.diag(search.information_at(search.shares))
    return [name for name, value in zip(names, alone, strict=True) if value * UNTOLD**2 > 1]


class _Search:
    """Gauss-Newton search (SciPy) in shares of the constants' ranges; starts at a machine's constants."""

    def __init__(self, comparison: StretchComparison, names: Sequence[str], start: Machine) -> None:
        self.comparison = comparison
        self.names = list(names)
        self.before = ranges.values_of(comparison.machine, names)
        chosen = ranges.choose(start, names)
        self.ranges = [bounds for name in names if (bounds := chosen[name].range) is not None]
        values = ranges.values_of(start, names).values()
        starts = [ranges.share_of(bounds, value) for bounds, value in zip(self.ranges, values, strict=True)]
        self.shares: Floats = np.clip(starts, 0.05, 0.95)
        self.simulated: Floats = np.zeros((0, 5))
        self.information: Floats = np.zeros((0, 0))
        self.misfit = math.nan
        self._start = start

    def machine(self, shares: Floats) -> Machine:
        """Return the machine with its constants at these shares of their ranges."""
        named = zip(self.names, self.ranges, shares.tolist(), strict=True)
        values = {name: ranges.value_at(bounds, share) for name, bounds, share in named}
        return ranges.with_values(self._start, values)

    def run(self) -> None:
        """Search, and compute information and misfit at the end of the search."""
        # The search runs twice, because the noise at its end differs from that at its start, and wrong weights would
        # give a wrong misfit and wrong information.
        self._descend()
        self.comparison.weight_by_noise_of(self.machine(self.shares))
        self._descend()
        self.simulated = self._statistics([self.shares])[0]
        self.misfit = self._misfit(self.comparison.residuals(self.simulated))
        self.information = self.information_at(self.shares)

    def _descend(self) -> None:
        found = optimize.least_squares(
            self._residuals, self.shares, self._sensitivities, bounds=(0.0, 1.0), method="trf", x_scale=1.0,
            ftol=1e-3, xtol=3e-3, gtol=None, max_nfev=MOST_ROUNDS,
        )  # fmt: skip
        self.shares = found.x

    def _statistics(self, places: Sequence[Floats]) -> Floats:
        """Simulate at these shares; return (places, stretches, 5). The table of runs caches the cuts."""
        return self.comparison.statistics([self.machine(place) for place in places])

    def _residuals(self, shares: Floats) -> Floats:
        residuals = self.comparison.residuals(self._statistics([shares])[0])
        self.comparison.misfit = self._misfit(residuals)
        return residuals

    def _misfit(self, residuals: Floats) -> float:
        return float(residuals @ residuals) / (self.comparison.size - len(self.names))

    def _sensitivities(self, shares: Floats) -> Floats:
        """Return the change of the residuals per share of the range, (size, p)."""
        return self._slopes(shares)[0]

    def _slopes(self, shares: Floats) -> tuple[Floats, Floats]:
        """Return `_sensitivities`, and the share of the range over which each was computed, (p,)."""
        # a cut that jams on one side does not show how the statistics change, so only the other side is used
        columns, spans = [], []
        for place in range(len(shares)):
            low, high = shares.copy(), shares.copy()
            low[place] = max(0.0, min(shares[place] - STEP, 1.0 - 2 * STEP))
            high[place] = low[place] + 2 * STEP
            rows = self._statistics([low, high])
            low_jams, high_jams = (bool((row[:, 0] > stable_rate.JAMMED_SHARE).any()) for row in rows)
            if low_jams and not high_jams and high[place] > shares[place]:
                low, rows[0] = shares, self._statistics([shares])[0]
            elif high_jams and not low_jams and shares[place] > low[place]:
                high, rows[1] = shares, self._statistics([shares])[0]
            spans.append(float(high[place] - low[place]))
            columns.append((self.comparison.residuals(rows[1]) - self.comparison.residuals(rows[0])) / spans[-1])
        return np.column_stack(columns), np.array(spans)

    def information_at(self, shares: Floats) -> Floats:
        """Return J^T J minus the part due to noise, (p, p)."""
        # A sensitivity is the difference of two simulated cuts over the span, so its variance is that of both over
        # span^2; the diagonal has the sum over all residuals. Errors of counter and meter are only in the log.
        sensitivities, spans = self._slopes(shares)
        noise = 2 * self.comparison.simulation_share / spans**2
        return np.asarray(sensitivities.T @ sensitivities - np.diag(noise))

    def covariance(self) -> Floats | None:
        """Return the covariance of the errors in shares, widened by the misfit; None if some are undetermined."""
        if np.linalg.eigvalsh(self.information)[0] <= 0:
            return None
        return np.asarray(np.linalg.inv(self.information) * max(1.0, self.misfit))

    def standard_errors(self) -> Floats:
        """Return the standard errors in shares of the ranges; infinite for the least determined constant."""
        covariance = self.covariance()
        if covariance is not None:
            return np.asarray(np.sqrt(np.diag(covariance)))
        vectors = np.linalg.eigh(self.information)[1]
        error = np.zeros(len(self.names))
        error[int(np.abs(vectors[:, 0]).argmax())] = np.inf
        return error


def remark(share: float, half: float) -> str:
    """Return a remark if a value or an end of its interval is set by the range instead of the log."""
    at_end = ["at the end of its range"] if min(share, 1 - share) < AT_BOUND else []
    ends = [name for name, beyond in (("lower", share - half < 0), ("upper", share + half > 1)) if beyond]
    cut_off = [f"interval cut off at the range's {' and '.join(ends)} end"] if ends else []
    return "; ".join([*at_end, *cut_off])


def _result(search: _Search, error: Floats, undetermined: dict[str, str]) -> Fit:
    covariance = search.covariance()
    assert covariance is not None
    half = error * compare.students_t(search.comparison.size - len(search.names))
    constants = []
    both = zip(search.shares.tolist(), half.tolist(), strict=True)
    for (name, before), bounds, (share, off) in zip(search.before.items(), search.ranges, both, strict=True):
        value, *ends = (ranges.value_at(bounds, min(max(at, 0.0), 1.0)) for at in (share, share - off, share + off))
        constants.append(FittedConstant(name, before, value, (ends[0], ends[1]), bounds, remark(share, off)))
    return Fit(
        search.machine(search.shares), tuple(constants), undetermined, covariance / np.outer(error, error),
        search.misfit, search.comparison.picked, search.simulated, search.comparison.noise,
    )
