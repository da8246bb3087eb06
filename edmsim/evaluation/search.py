"""Search of the controllers' gains: what ``edmsim search-gains NAME... --write models/gains`` does.

Differential evolution (Storn and Price 1997, as SciPy has it) on episodes of the straight and the stepped workpiece
at resolution ``fast``, on randomised machines with training seeds; those of the comparison are never touched. What is
maximised is what a learner maximises in the same episodes, the environment's mean return; of the oracle, which is
the bound of it, the cutting rate. Same seed, same build: same gains.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim import __version__
from edmsim.controllers import FeedController, make
from edmsim.envs.episode import Task
from edmsim.errors import InputError, one_of
from edmsim.evaluation.episode import HELD_BACK, ORACLE, Episode, Result

Ranges = dict[str, tuple[float, float]]
BOUNDS: dict[str, Ranges] = {
    "fixed": {"feed_um_s": (1.0, 60.0)},
    "counts": {
        "open_target_share": (0.0, 0.2), "short_weight": (0.25, 1.5), "proportional_um_s": (1.0, 15.0),
        "integral_um_s2": (5.0, 40.0),
    },
    "voltage": {
        "reference_V": (5.0, 20.0), "proportional_um_s_V": (0.1, 8.0), "integral_um_s2_V": (0.1, 20.0),
        "filter_s": (0.02, 0.3),
    },
    "delay": {
        "reference_us": (1.0, 10.0), "proportional_um_s_us": (0.1, 20.0), "integral_um_s2_us": (0.1, 60.0),
        "filter_s": (0.02, 0.3),
    },
    "fuzzy": {
        "open_target_share": (0.02, 0.3), "open_width_share": (0.02, 0.3), "short_high_share": (0.3, 0.9),
        "rate_um_s2": (3.0, 300.0),
    },
    "adaptive-off-time": {
        "open_target_share": (0.0, 0.2), "short_weight": (0.25, 1.5), "integral_um_s2": (5.0, 200.0),
        "normal_at_10mm": (300.0, 1000.0),
    },
    "oracle": {
        "gap_target_um": (5.0, 35.0), "proportional_um_s_um": (0.3, 12.0), "integral_um_s2_um": (0.5, 40.0),
        "short_um": (0.0, 30.0),
    },
}  # fmt: skip
"""What is searched of each controller, and where (ours: from timid to reckless). Shorts must count for something, or
a gap that closes is not noticed. What is found for `counts` hunts at long periods, so it is not shipped."""
ENV_IDS = ("edmsim/GapFeed-v2", "edmsim/HeightStep-v2")
SEEDS = 5
"""Training seeds of each environment."""
POPULATION, GENERATIONS = 8, 4
"""Gains per generation, and generations after the first (ours: some three minutes a controller on two cores)."""


class SearchResult(NamedTuple):
    """Gains, and their score; that of the gains in use till then."""

    gains: dict[str, float]
    score: float
    default_score: float


def training_seeds(seed: int, seeds: int = SEEDS) -> range:
    """Return the seeds that gains are tried on in each environment, the first of which is `seed`.

    Raises `InputError` if there are none, or they reach the seeds that are held back.
    """
    if seeds < 1:
        raise InputError(f"{seeds} training seeds judge nothing: give 1 or more")
    if not 0 <= seed <= HELD_BACK - seeds:
        raise InputError(f"training seeds lie from 0 to {HELD_BACK - 1}: {seed} to {seed + seeds - 1} do not")
    return range(seed, seed + seeds)


def run_all(
    seeds: Sequence[int], controller: Callable[[], FeedController], threads: int | None = None
) -> list[Result]:
    """Make all cuts, each with a fresh controller, as many at a time as there are cores, or threads are given."""

    def run(env_id: str, seed: int) -> Result:
        law = controller()
        return Episode(Task(env_id, resolution="fast"), law, seed, law.name).run()

    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        jobs = [pool.submit(run, env_id, seed) for env_id in ENV_IDS for seed in seeds]
        return [job.result() for job in jobs]


def score(results: Sequence[Result]) -> float:
    """Mean return of the cuts; of the oracle's, their mean cutting rate in mm2/min."""
    if results[0].controller == ORACLE:
        return float(np.mean([result.rate_mm2_min for result in results]))
    return float(np.mean([result.total_return for result in results]))


def check(controller: str, seed: int, generations: int) -> None:
    """Raise `InputError` for a search that cannot be made."""
    training_seeds(seed)
    if generations < 0:
        raise InputError(f"{generations} generations after the first cannot be: give 0 or more")
    if controller not in BOUNDS:
        raise InputError(f"no gains of '{controller}' are searched; choose one of {one_of(controller, BOUNDS)}")


def search(controller: str, seed: int, *, seeds: int = SEEDS, population: int = POPULATION,
           generations: int = GENERATIONS, watch: Callable[[int], None] | None = None) -> SearchResult:
    """Look for a controller's gains.

    Parameters
    ----------
    controller : str
        One of `BOUNDS`.
    seed : int
        First training seed, and seed of the search.
    seeds : int
        Training seeds of each environment.
    population, generations : int
        Gains per generation, a power of 2 and at least 4, and generations after the first.
    watch : callable, optional
        Called with the number of gains tried so far.

    Raises
    ------
    InputError
        If nothing of the controller is searched, the seeds are held back, or there are fewer than no generations.
    """
    from scipy.optimize import Bounds, differential_evolution
    from scipy.stats import qmc

    check(controller, seed, generations)
    bounds = BOUNDS[controller]
    trained_on = training_seeds(seed, seeds)
    tried = 0

    def objective(values: NDArray[np.float64]) -> float:
        nonlocal tried
        tried += 1
        gains = _rounded(bounds, values)
        result = -score(run_all(trained_on, partial(make, controller, **gains)))
        if watch is not None:
            watch(tried)
        return result

    low, high = np.array(list(bounds.values())).T
    sobol = qmc.Sobol(len(bounds), rng=np.random.default_rng(seed)).random(population)
    found = differential_evolution(
        objective, Bounds(low, high), init=qmc.scale(sobol, low, high), maxiter=generations, tol=0.0, polish=False,
        rng=np.random.default_rng(seed),
    )
    before = score(run_all(trained_on, partial(make, controller)))
    return SearchResult(_rounded(bounds, found.x), -float(found.fun), before)


def _rounded(bounds: Ranges, values: NDArray[np.float64]) -> dict[str, float]:
    """Name the gains; three digits are what a search of this size can tell."""
    return {name: float(f"{value:.3g}") for name, value in zip(bounds, values, strict=True)}


def as_toml(controller: str, seed: int, generations: int, found: SearchResult) -> str:
    """Return the file of found gains, with the command that makes it again."""
    longer = "" if generations == GENERATIONS else f" --generations {generations}"
    what = "cutting rate in mm2/min" if controller == ORACLE else "return"
    lines = [f"{name} = {value!r}" for name, value in found.gains.items()]
    return "\n".join([
        f"# Found by: edmsim search-gains {controller} --seed {seed}{longer} --write models/gains",
        f"# Mean {what} {found.score:.4g} on {SEEDS} training seeds each of",
        f"# {' and '.join(ENV_IDS)}, resolution fast.",
        f"# Of the {POPULATION * (generations + 1)} gains tried, by edmsim {__version__}, the best.",
        "", "[gains]", *lines, "",
    ])  # fmt: skip
