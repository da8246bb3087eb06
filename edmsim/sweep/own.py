"""Search of the settings of a user's own controller: what ``edmsim tune own FILE.py:CLASS`` does.

Firmware has dozens of settings that users tune by trial on the machine. The search tries them on machines drawn
within the ranges of the gap's uncertain constants. It chooses settings that do well on the worst machines, and tests
them once more on other machines.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from edmsim.controllers.own import from_file
from edmsim.envs.episode import Task
from edmsim.errors import InputError
from edmsim.files import make_writable
from edmsim.numeric import real
from edmsim.runs import Engine, LostJob, Processes
from edmsim.sweep.tune import (
    OWN_ENV,
    WORST_SHARE,
    Bound,
    Trial,
    TrialResult,
    judge_trial,
    made_in,
    open_study,
    run_study,
    training_seeds,
    write_found,
)
from edmsim.user_code import named, run

FINALISTS = 8  # trials that are tried once more, besides the settings in use (ours: the best has been lucky, too)
FRESH = 2  # times as many machines as a trial has had, the same for all (ours)
_RULE = 'BOUNDS = {"gain": (0.1, 10.0), "window_s": (0.01, 1.0, "log")}'


class Spread(NamedTuple):
    """Returns of settings on drawn machines: mean of the worst quarter, mean, and the 10 and 90 % quantiles."""

    worst: float
    mean: float
    low: float
    high: float

    @classmethod
    def of(cls, result: TrialResult) -> Spread:
        """Return the spread of a trial."""
        returns = np.asarray(result.returns)
        low, high = np.quantile(returns, (0.1, 0.9)).tolist()
        return cls(result.value, float(returns.mean()), low, high)

    def __str__(self) -> str:
        """Return the spread as text."""
        return (
            f"worst {100 * WORST_SHARE:.0f} % {self.worst:.4g}, mean {self.mean:.4g}, "
            f"10 to 90 % {self.low:.4g} to {self.high:.4g}"
        )


class TunedOwn(NamedTuple):
    """Result of `tune_own`.

    Attributes
    ----------
    values : dict
        The most robust settings.
    spread, first_spread : Spread
        Spreads of `values` and of the settings in use, both on machines that the choice did not use.
    trials, failed : int
        Number of all trials, and of those that failed.
    machines : int
        Number of machines in the spreads.
    tried_again : dict
        Values and spread of each finalist by the number of its trial; -1 is the settings in use.
    """

    values: dict[str, float]
    spread: Spread
    first_spread: Spread
    trials: int
    failed: int
    machines: int
    tried_again: dict[int, tuple[dict[str, float], Spread]]


def tune_own(
    own: str, out: str | Path, *, trials: int = 40, seed: int = 0, seeds: int = 8, engine: Engine | None = None,
    watch: Callable[[int, float], None] | None = None, **options: Any,
) -> TunedOwn:
    """Search the settings of your own controller on drawn machines.

    Parameters
    ----------
    own : str
        ``FILE.py:CLASS``. The class names the settings and their bounds in `BOUNDS`.
    out : path
        Folder for ``best.toml`` and the study; an existing study is resumed.
    trials : int
        Number of all trials; the first uses the settings in use.
    seed : int
        First training seed, and seed of the search.
    seeds : int
        Number of drawn machines per trial; every trial draws others.
    engine : Engine, optional
        By default all processors of this computer.
    watch : callable, optional
        Called with the number of finished trials and the best score.
    **options
        Arguments of the environment GapFeed: ``machine``, ``height_mm``, ``randomise``.

    Raises
    ------
    InputError
        If the file has no such controller, the class has no `BOUNDS`, or an argument is invalid.
    """
    own_class = named(own)
    if own_class is None or not own_class.name:
        raise InputError(f"'{own}' names no controller of your own: give FILE.py:CLASS")
    text = f"{Path(own_class.file).absolute()}:{own_class.name}"
    law = from_file(own_class, {})
    space = bounds_of(own)
    if trials < 1:
        raise InputError(f"{trials} trials find nothing: give 1 or more")
    fresh = tuple(training_seeds(seed, FRESH * seeds))
    first_of_trials = seed + FRESH * seeds
    training_seeds(first_of_trials, (trials + 1) * seeds)
    options = {"resolution": "fast", **options}
    Task(OWN_ENV, **options)  # refused here, in one line, and not in every trial
    folder = Path(out)
    make_writable(folder)
    study = open_study(folder, f"own {own_class.name}", seed)
    if not study.trials:
        study.enqueue_trial({name: min(max(_in_use(law, name), b.low), b.high) for name, b in space.items()})
    machines = engine or Processes()

    def made(number: int, values: dict[str, float]) -> Trial:
        # machines of its own: on the same ones a search finds what these bear, and not what most do
        judged_by = training_seeds(first_of_trials + max(number, 0) * seeds, seeds)
        return Trial(number, "own", text, values, tuple(judged_by), options=options)

    def ended(trial: Trial, result: TrialResult) -> None:
        if watch is not None and made_in(study, "COMPLETE"):
            watch(made_in(study), float(study.best_value))

    run_study(study, space, trials, machines, made, ended)
    first = made(-1, {name: _in_use(law, name) for name in space})
    spreads = _judged_again([first, *_finalists(study, made)], fresh, machines)
    chosen = max(spreads, key=lambda number: spreads[number][1].worst)
    values, spread = spreads[chosen]
    found = TunedOwn(values, spread, spreads[-1][1], made_in(study), made_in(study, "FAIL"), len(fresh), spreads)
    what = f"own: {own_class.name}, {spread} on {len(fresh)} drawn machines; in use before: {found.first_spread}"
    write_found(folder, what, spread.worst, fresh, "parameters", values, {})
    return found


def bounds_of(own: str) -> dict[str, Bound]:
    """Return the bounds of the settings that a user's class searches; raise `InputError` if they are invalid."""
    own_class = named(own)
    assert own_class is not None
    kind = vars(run(own_class.file))[own_class.name]
    declared = getattr(kind, "BOUNDS", None)
    if not isinstance(declared, Mapping) or not declared:
        raise InputError(f"{own_class.name} does not say what is searched: give it {_RULE}", own_class.file)
    known = inspect.signature(kind).parameters
    found = {}
    for name, ends in declared.items():
        if name not in known:
            has = ", ".join(known)
            raise InputError(f"BOUNDS of {own_class.name} name {name!r}; its parameters are {has}", own_class.file)
        found[name] = _bound(name, ends, own_class.file)
    return found


def _bound(name: str, ends: Any, file: str) -> Bound:
    low, high, scale = (*ends, "linear")[:3] if isinstance(ends, tuple | list) and len(ends) in (2, 3) else (0, 0, "")
    numbers = real(low), real(high)
    if None not in numbers and scale in ("linear", "log"):
        bound = Bound(float(low), float(high), scale)
        if math.isfinite(bound.high - bound.low) and bound.low < bound.high and (scale == "linear" or bound.low > 0):
            return bound
    raise InputError(f"{name} is searched from a number to a greater one, not {ends!r}: {_RULE}", file)


def _in_use(law: object, name: str) -> float:
    value = real(getattr(law, name, None))
    if value is None:
        raise InputError(f"{name} of your controller has no value to begin with: give the parameter a default")
    return value


def _finalists(study: Any, made: Callable[[int, dict[str, float]], Trial]) -> list[Trial]:
    """Return the best trials of a study."""
    whole = [trial for trial in study.trials if trial.state.name == "COMPLETE"]
    best = sorted(whole, key=lambda trial: -trial.value)[:FINALISTS]
    return [made(trial.number, {name: float(f"{v:.3g}") for name, v in trial.params.items()}) for trial in best]


def _judged_again(
    trials: list[Trial], fresh: tuple[int, ...], engine: Engine
) -> dict[int, tuple[dict[str, float], Spread]]:
    """Return values and spread of trials by number, on machines that they were not chosen by."""
    found = {}
    for trial, answer in engine.done(judge_trial, iter([replace(trial, seeds=fresh) for trial in trials])):
        result = TrialResult(math.nan, answer.why) if isinstance(answer, LostJob) else answer
        if result.error is not None:
            raise InputError(f"the settings of trial {trial.number} could not be tried again: {result.error}")
        found[trial.number] = dict(trial.values), Spread.of(result)
    return found
