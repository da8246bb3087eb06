"""Basis of gain searches: bounds, training seeds, and the score of cuts.

Episodes are of the straight and the stepped workpiece at resolution ``fast``, on randomised machines with training
seeds, never those of comparisons. A search maximises the environment's mean return, as a learner does in the same
episodes; for the oracle, the upper bound, it maximises the cutting rate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from edmsim.controllers import FeedController
from edmsim.envs.episode import Task
from edmsim.errors import InputError
from edmsim.evaluation.episode import HELD_BACK, ORACLE, Episode, Result
from edmsim.runs import perform

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
"""Number of training seeds per environment."""
POPULATION = 8
"""Gains in a generation of an evolution (ours: five of them take some three minutes a controller on two cores)."""


def training_seeds(seed: int, seeds: int = SEEDS) -> range:
    """Return the training seeds of each environment, from `seed` on.

    Raises `InputError` if `seeds` is below 1, or the seeds reach the held-back ones.
    """
    if seeds < 1:
        raise InputError(f"{seeds} training seeds judge nothing: give 1 or more")
    if not 0 <= seed <= HELD_BACK - seeds:
        raise InputError(f"training seeds lie from 0 to {HELD_BACK - 1}: {seed} to {seed + seeds - 1} do not")
    return range(seed, seed + seeds)


def run_all(
    seeds: Sequence[int], controller: Callable[[], FeedController], threads: int | None = None
) -> list[Result]:
    """Make all cuts, each with a new controller, in as many threads as there are cores, or in `threads`."""

    def run(job: tuple[str, int]) -> Result:
        law = controller()
        return Episode(Task(job[0], resolution="fast"), law, job[1], law.name).run()

    return perform(run, [(env_id, seed) for env_id in ENV_IDS for seed in seeds], threads=threads)


def score(results: Sequence[Result]) -> float:
    """Return the mean return of the cuts; for the oracle their mean cutting rate in mm2/min."""
    if results[0].controller == ORACLE:
        return float(np.mean([result.rate_mm2_min for result in results]))
    return float(np.mean([result.total_return for result in results]))
