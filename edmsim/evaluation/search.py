"""Search of the controllers' gains: ``python -m edmsim.evaluation.search NAME... --write models/gains``.

Differential evolution (Storn and Price 1997, as SciPy has it) on cuts of the straight and the stepped workpiece at
resolution ``fast``, on randomised machines with training seeds; those of the comparison are never touched. What
is maximised is the mean of the cutting rate over that of the oracle, less the share of cuts that lost
their wire, so that a lost wire costs as much as a cut at the oracle's rate gains. Same seed, same build: same gains.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
import typer
from numpy.typing import NDArray

from ..controllers import FeedController, make
from ..controllers.feed.oracle import OracleController
from ..errors import InputError
from .episode import ORACLE_GAPS_UM, Episode, Result
from .scenarios import HELD_BACK, Scenario, draw

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

Ranges = dict[str, tuple[float, float]]
BOUNDS: dict[str, Ranges] = {
    "counts": {
        "open_target_share": (0.0, 0.2), "short_weight": (0.0, 1.5), "proportional_um_s": (1.0, 60.0),
        "integral_um_s2": (5.0, 200.0),
    },
    "voltage": {
        "reference_V": (5.0, 20.0), "proportional_um_s_V": (0.1, 4.0), "integral_um_s2_V": (0.1, 10.0),
        "filter_s": (0.02, 0.3),
    },
    "delay": {
        "reference_us": (4.0, 14.0), "proportional_um_s_us": (0.1, 4.0), "integral_um_s2_us": (0.1, 10.0),
        "filter_s": (0.02, 0.3),
    },
    "fuzzy": {
        "open_target_share": (0.02, 0.3), "open_width_share": (0.02, 0.3), "short_high_share": (0.3, 0.9),
        "rate_um_s2": (3.0, 100.0),
    },
    "adaptive-off-time": {
        "open_target_share": (0.0, 0.2), "short_weight": (0.0, 1.5), "integral_um_s2": (5.0, 200.0),
        "normal_at_10mm": (300.0, 1000.0),
    },
    "oracle": {
        "gap_target_um": (3.0, 10.0), "proportional_um_s_um": (0.3, 6.0), "integral_um_s2_um": (0.5, 20.0),
        "short_um": (0.0, 15.0),
    },
}  # fmt: skip
"""What is searched of each controller, and where (ours: from timid to reckless)."""
ENV_IDS = ("edmsim/GapFeed-v0", "edmsim/HeightStep-v0")
SEEDS = 6
"""Training seeds of each environment."""
POPULATION, GENERATIONS = 8, 3
"""Gains per generation, and generations after the first (ours: some three minutes a controller on two busy cores)."""


class Found(NamedTuple):
    """Gains, and what they scored: at best about 1, the oracle's rate without a wire lost."""

    gains: dict[str, float]
    score: float
    default_score: float


def training_cuts(seed: int, seeds: int = SEEDS) -> list[tuple[Scenario, int]]:
    """Draw the cuts that gains are tried on, with their seeds, the first of which is `seed`.

    Raises
    ------
    InputError
        If they reach the seeds that are held back.
    """
    if not 0 <= seed <= HELD_BACK - seeds:
        raise InputError(f"training seeds lie from 0 to {HELD_BACK - 1}: {seed} to {seed + seeds - 1} do not")
    return [(draw(env_id, s), s) for env_id in ENV_IDS for s in range(seed, seed + seeds)]


def run_all(cuts: Sequence[tuple[Scenario, int]], controller: Callable[[], FeedController]) -> list[Result]:
    """Make all cuts, each with a fresh controller, as many at a time as there are cores."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        jobs = [pool.submit(Episode(c, controller(), s, "fast").run) for c, s in cuts]
        return [job.result() for job in jobs]


def bound_rates(cuts: Sequence[tuple[Scenario, int]]) -> list[float]:
    """Return the rehearsed oracle's cutting rate in every cut.

    Its gains are those in its code, not found ones: or every score would hang on which search was run first.
    """
    tried = [run_all(cuts, partial(OracleController, gap_target_um=gap)) for gap in ORACLE_GAPS_UM]
    return [max(result.rate_mm2_min for result in results) for results in zip(*tried, strict=True)]


def score(results: Sequence[Result], bound_rates: Sequence[float]) -> float:
    """Mean cutting rate over the bound's, less the share of cuts that lost their wire."""
    rates = [result.rate_mm2_min / bound for result, bound in zip(results, bound_rates, strict=True)]
    lost = [result.broke or result.jammed for result in results]
    return float(np.mean(rates) - np.mean(lost))


def search(controller: str, seed: int, *, seeds: int = SEEDS, population: int = POPULATION,
           generations: int = GENERATIONS, watch: Callable[[int], None] | None = None) -> Found:
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
        If nothing of the controller is searched, or the seeds are held back.
    """
    from scipy.optimize import Bounds, differential_evolution
    from scipy.stats import qmc

    if controller not in BOUNDS:
        raise InputError(f"no gains of '{controller}' are searched; choose one of {', '.join(BOUNDS)}")
    bounds = BOUNDS[controller]
    cuts = training_cuts(seed, seeds)
    bound = bound_rates(cuts)
    tried = 0

    def worth(values: NDArray[np.float64]) -> float:
        nonlocal tried
        tried += 1
        gains = _rounded(bounds, values)
        result = -score(run_all(cuts, partial(make, controller, **gains)), bound)
        if watch is not None:
            watch(tried)
        return result

    low, high = np.array(list(bounds.values())).T
    sobol = qmc.Sobol(len(bounds), rng=np.random.default_rng(seed)).random(population)
    found = differential_evolution(
        worth, Bounds(low, high), init=qmc.scale(sobol, low, high), maxiter=generations, tol=0.0, polish=False,
        rng=np.random.default_rng(seed),
    )
    return Found(_rounded(bounds, found.x), -float(found.fun), score(run_all(cuts, partial(make, controller)), bound))


def _rounded(bounds: Ranges, values: NDArray[np.float64]) -> dict[str, float]:
    """Name the gains; three digits are what a search of this size can tell."""
    return {name: float(f"{value:.3g}") for name, value in zip(bounds, values, strict=True)}


def as_toml(controller: str, seed: int, found: Found) -> str:
    """Return the file of found gains, with the command that makes it anew."""
    lines = [f"{name} = {value!r}" for name, value in found.gains.items()]
    return "\n".join([
        f"# Found by: python -m edmsim.evaluation.search {controller} --seed {seed} --write models/gains",
        f"# Score {found.score:.3f}: mean cutting rate over the oracle's less the share of wires lost, on {SEEDS}",
        f"# training seeds each of {' and '.join(ENV_IDS)}, resolution fast.",
        f"# Of the {POPULATION * (GENERATIONS + 1)} gains tried, by edmsim {version('edmsim')}, the best.",
        "", "[gains]", *lines, "",
    ])  # fmt: skip


def main(
    controllers: Annotated[list[str], typer.Argument(help=f"Of {', '.join(BOUNDS)}.")],
    seed: Annotated[int, typer.Option(help="First training seed, and seed of the search.")] = 0,
    write: Annotated[Path | None, typer.Option(help="Folder for the files of gains.")] = None,
) -> None:
    """Search the gains of feed controllers."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console()
    if write is not None and not write.is_dir():
        raise InputError("there is no such folder", write)
    with Progress(console=Console(stderr=True), transient=True) as bar:
        for name in controllers:
            task = bar.add_task(name, total=POPULATION * (GENERATIONS + 1))
            found = search(name, seed, watch=partial(_show, bar, task))
            gains = ", ".join(f"{key} {value:g}" for key, value in found.gains.items())
            told = f"{name}: {gains}; score {found.score:.3f} (before {found.default_score:.3f})"
            console.print(told, highlight=False, soft_wrap=True)
            if write is not None:
                (write / f"{name}.toml").write_text(as_toml(name, seed, found), encoding="utf-8")


def _show(bar: Progress, task: TaskID, tried: int) -> None:
    bar.update(task, completed=tried)


if __name__ == "__main__":
    from ..cli import main as run

    run(lambda: typer.run(main))
