"""Scores of a policy and of classic controllers, from their cuts of held-back episodes.

``edmsim evaluate --policy NAME --write-card`` measures a policy again and writes the scores into its card.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from edmsim.envs.families import Shift
from edmsim.envs.registry import find
from edmsim.errors import refuses_wrong_types
from edmsim.evaluation.compare import run
from edmsim.evaluation.episode import Result, is_part
from edmsim.learning import bandit_file, policy_file
from edmsim.numeric import whole_from
from edmsim.plant.resolution import RESOLUTIONS
from edmsim.runs import RunTable
from edmsim.screen import ScreenTable
from edmsim.user_code import policy_of

RIVALS = ("counts", "voltage")
"""The controllers policies are measured against: that of 1982, and the classic servo on the mean voltage."""


def measured_with(env_id: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return rivals and resolutions of an environment; parts and shifts take long, and are cut as they are learnt."""
    if is_part(env_id):
        return ("technology", "corrected"), ("fast",)
    return (("adaptive-hold",), ("fast",)) if issubclass(find(env_id)[0], Shift) else (RIVALS, tuple(RESOLUTIONS))


class Score(NamedTuple):
    """Means and counts over episodes."""

    controller: str
    resolution: str
    seeds: int
    # mean_return, return_error: mean return, and its standard error
    mean_return: float
    return_error: float
    rate_mm2_min: float  # area cut over machine time
    # path error (see `edmsim.evaluation.episode.Result`); for parts the edge error; None for straight cuts
    error_um: float | None
    time_s: float  # mean machine time of an episode
    # breaks, limits: number of episodes that ended by a wire break, or by another limit such as a persistent short
    breaks: int
    limits: int


@refuses_wrong_types
def measure(
    env_id: str, policy: str, episodes: int, watch: Callable[[str, int, int], None] | None = None,
    resolutions: Sequence[str] = (), table: RunTable | None = None,
) -> list[Score]:
    """Return the scores of a policy and its rivals at `resolutions`: by default all, for parts and shifts ``fast``.

    Parameters
    ----------
    env_id : str
    policy : str
        Either of its files, or a name under ``models/policies``; the prefix ``policy:`` is optional.
    episodes : int
        Number of episodes, 2 or more.
    watch : callable, optional
        Called with a resolution, and its number of finished and of all episodes.
    table : edmsim.runs.RunTable, optional
        Finished cuts; see `edmsim.evaluation.compare.evaluate`.

    Raises
    ------
    InputError
        If `episodes` is below 2.
    """
    whole_from("episodes", episodes, 2)  # one gives no mean with an error
    scores = []
    rivals, usual = measured_with(env_id)
    controllers = [f"policy:{policy_of(policy)}", *rivals]
    for resolution in resolutions or usual:
        made_so_far = None if watch is None else partial(watch, f"{policy}, {resolution}")
        results = run(env_id, controllers, episodes, resolution, made_so_far, table=table)
        scores += [score(made, resolution) for made in results.values()]
    return [row._replace(controller="policy") if row.controller.startswith("policy:") else row for row in scores]


def score(results: Sequence[Result], resolution: str) -> Score:
    """Return the score of a controller's cuts."""
    returns = np.array([result.total_return for result in results])
    known = [(r.error_um if np.isfinite(r.error_um) else r.edge_error_um) for r in results]
    errors = [error for error in known if np.isfinite(error)]
    seconds = sum(result.time_s for result in results)
    return Score(
        results[0].controller, resolution, len(results), float(returns.mean()),
        float(returns.std(ddof=1) / np.sqrt(len(results))), 60.0 * sum(r.area_mm2 for r in results) / seconds,
        float(np.mean(errors)) if errors else None, seconds / len(results), sum(r.broke for r in results),
        sum(r.jammed for r in results),
    )


def write_card(policy: str, scores: Sequence[Score]) -> None:
    """Write scores of `measure` into a policy's card, in the place of those at the same resolutions."""
    bandit = bandit_file.find(policy)
    card: Any = policy_file.load(policy).card if bandit is None else bandit_file.load(bandit)
    measured = {row.resolution for row in scores}
    others = [row for row in card.scores if row["resolution"] not in measured]
    card = card.model_copy(update={"scores": [*others, *(row._asdict() for row in scores)]})
    if bandit is not None:
        bandit_file.write(card, bandit)
        return
    file = policy_file.locate(policy)
    policy_file.write(card, file.with_suffix(".npz").read_bytes(), file)


def env_id_of(policy: str) -> str:
    """Return the environment of a policy's training."""
    bandit = bandit_file.find(policy)
    return policy_file.load(policy).card.env_id if bandit is None else bandit_file.load(bandit).env_id


def render(scores: list[Score]) -> ScreenTable:
    """Return the scores as a table."""
    numbers = ("return", "mm2/min", "error, um", "breaks", "limits")
    table = ScreenTable("controller", "resolution", numbers=numbers, keys=2)
    for row in scores:
        error = "" if row.error_um is None else f"{row.error_um:.2f}"
        table.add_row(
            row.controller, row.resolution, f"{row.mean_return:.1f} ± {row.return_error:.1f}",
            f"{row.rate_mm2_min:.2f}", error, f"{row.breaks} of {row.seeds}", f"{row.limits} of {row.seeds}",
        )
    return table
