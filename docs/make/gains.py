"""Gains of `models/gains`, by differential evolution (Storn and Price 1997) on training seeds.

python docs/make/gains.py voltage --trials 16    # prints the gains; out/gains/voltage.jsonl holds the trials
"""

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, differential_evolution
from scipy.stats import qmc

from edmsim import __version__
from edmsim.controllers import FeedController, make
from edmsim.envs.episode import Task
from edmsim.evaluation.episode import ORACLE, Episode, Result
from edmsim.runs import RunTable, perform
from edmsim.sweep import tune

POPULATION = 8
"""Gains in a generation (ours: five generations take about three minutes per controller on two cores)."""
FOLDER = Path("out/gains")
ENV_IDS = ("edmsim/GapFeed-v2", "edmsim/HeightStep-v2")
SEEDS = 5
"""Number of training seeds per environment."""


def run_all(seeds: Sequence[int], controller: Callable[[], FeedController]) -> list[Result]:
    """Make all cuts at resolution ``fast``, each with a new controller."""

    def run(job: tuple[str, int]) -> Result:
        law = controller()
        return Episode(Task(job[0], resolution="fast"), law, job[1], law.name).run()

    return perform(run, [(env_id, seed) for env_id in ENV_IDS for seed in seeds])


def score(results: Sequence[Result]) -> float:
    """Return the mean return of the cuts; for the oracle, the upper bound, their mean cutting rate in mm2/min."""
    if results[0].controller == ORACLE:
        return float(np.mean([result.rate_mm2_min for result in results]))
    return float(np.mean([result.total_return for result in results]))


def search(name: str, trials: int = 40, seed: int = 0, seeds: int = SEEDS) -> tuple[dict[str, float], float]:
    """Return the best gains and their score. Finished trials are saved, so the same search resumes."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    judged_by = tuple(tune.training_seeds(seed, seeds))
    tried = RunTable(FOLDER / f"{name}.jsonl", {"name": name, "seed": seed, "seeds": judged_by})

    def objective(values: NDArray[np.float64]) -> float:
        gains = {gain: float(f"{value:.3g}") for gain, value in zip(tune.BOUNDS[name], values, strict=True)}
        key = " ".join(f"{value!r}" for value in gains.values())
        if key not in tried.rows:
            cuts = run_all(judged_by, partial(make, name, **gains))
            tried.add({"id": key, "gains": gains, "value": score(cuts)})
        return -float(tried.rows[key]["value"])

    low, high = np.array(list(tune.BOUNDS[name].values())).T
    first = qmc.scale(qmc.Sobol(len(low), rng=np.random.default_rng(seed)).random(POPULATION), low, high)
    differential_evolution(
        objective, Bounds(low, high), init=first, maxiter=max(-(-trials // POPULATION) - 1, 0), tol=0.0, polish=False,
        rng=np.random.default_rng(seed),
    )
    best = max(tried.rows.values(), key=lambda row: row["value"])
    return best["gains"], best["value"]


def main() -> None:
    """Search, and print a file with the gains."""
    parser = argparse.ArgumentParser(description="Search gains by differential evolution.")
    parser.add_argument("name", choices=tune.BOUNDS)
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    gains, value = search(options.name, options.trials, options.seed)
    print(f"# Found by: python docs/make/gains.py {options.name} --trials {options.trials} --seed {options.seed}")
    print(f"# {value:.4g} on training seeds, of edmsim {__version__}", "", "[gains]", sep="\n")
    print(*(f"{gain} = {number!r}" for gain, number in gains.items()), sep="\n")


if __name__ == "__main__":
    main()
