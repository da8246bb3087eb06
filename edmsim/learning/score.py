"""Scores of a policy next to classic controllers, and whether it may replace the policy its training started from.

``edmsim evaluate --policy NAME --write-card`` measures a policy again and writes the scores into its card. A safe
training accepts its policy only if its return on other machines is not lower than that of its start.
"""

import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from edmsim.envs.families import Shift
from edmsim.envs.registry import find
from edmsim.errors import InputError, refuses_wrong_types
from edmsim.evaluation.compare import Figure, mean, run
from edmsim.evaluation.episode import HELD_BACK, Result, cut_job, engine_of, is_part
from edmsim.learning import bandit, policy_file
from edmsim.numeric import whole_from
from edmsim.plant.resolution import RESOLUTIONS
from edmsim.runs import RunTable, perform
from edmsim.screen import ScreenTable
from edmsim.user_code import policy_of

RIVALS = ("counts", "voltage")
"""Controllers with which policies are compared: that of 1982, and the classic servo on the mean voltage."""
FIRST_SEED = HELD_BACK - 100_000
"""First seed of the machines that test a policy: comparisons use others, since their seeds must not choose a policy;
training, which draws its seeds from 32 bits, meets one only by chance."""
LEAST_MACHINES = 4
"""Least number of machines (ours: with fewer, a bootstrap has only a handful of means)."""
MOST_LOSS_SHARE = 0.02
"""How far below zero the difference's interval may reach, as a share of the start's return (ours: a policy compared
with itself must pass; one whose loss is unknown must not)."""


def measured_with(env_id: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return rivals and resolutions of an environment; parts and shifts take long, so only those of the training."""
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
    """Return the scores of a policy and its rivals, resolution by resolution.

    Parameters
    ----------
    env_id : str
    policy : str
        Either of its files, or a name under ``models/policies``; the prefix ``policy:`` is optional.
    episodes : int
        Number of episodes, 2 or more.
    watch : callable, optional
        Called with a resolution, and its number of finished and of all episodes.
    resolutions : sequence of {"fast", "default", "fine"}
        By default all; for parts and shifts only "fast".
    table : edmsim.runs.RunTable, optional
        Finished cuts; see `edmsim.evaluation.compare.evaluate`.

    Raises
    ------
    InputError
        If `episodes` is below 2.
    """
    whole_from("episodes", episodes, 2)  # a standard error needs two
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


def write_card(policy: str, scores: Sequence[Score], env_id: str | None = None) -> None:
    """Write scores of `measure` into a policy's card, in place of those at the same resolutions.

    `env_id` is the environment of the scores, by default the policy's; scores of other environments stay in the card.
    """
    card = _card(policy)
    elsewhere = {} if env_id is None or find(env_id) == find(card.env_id) else {"env_id": env_id}
    measured = {(row.resolution, elsewhere.get("env_id")) for row in scores}
    others = [row for row in card.scores if (row["resolution"], row.get("env_id")) not in measured]
    card = card.model_copy(update={"scores": [*others, *(row._asdict() | elsewhere for row in scores)]})
    file = policy_file.locate(policy)
    if isinstance(card, bandit.BanditCard):
        bandit.write(card, file)
    else:
        policy_file.write(card, file.with_suffix(".npz").read_bytes(), file)


def _card(policy: str) -> policy_file.Card | bandit.BanditCard:
    file = bandit.find(policy)
    return policy_file.load(policy).card if file is None else bandit.load(file)


def env_id_of(policy: str) -> str:
    """Return the environment of a policy's training."""
    return _card(policy).env_id


def render(policy: str, env_id: str, scores: list[Score]) -> ScreenTable:
    """Return the scores of a policy in an environment as a table."""
    numbers = ("return", "mm2/min", "error, um", "breaks", "jams")
    title = f"{policy} in {env_id}; mean return ± its standard error"
    table = ScreenTable("controller", "resolution", numbers=numbers, keys=2, title=title)
    for row in scores:
        error = "" if row.error_um is None else f"{row.error_um:.2f}"
        table.add_row(
            row.controller, row.resolution, f"{row.mean_return:.1f} ± {row.return_error:.1f}",
            f"{row.rate_mm2_min:.2f}", error, f"{row.breaks} of {row.seeds}", f"{row.limits} of {row.seeds}",
        )
    return table


class Verdict(NamedTuple):
    """Comparison of a policy with its start on the same machines."""

    # start, difference: mean return of the start, and of the paired differences, with their 95 % bootstrap intervals
    start: Figure
    difference: Figure
    machines: int

    @property
    def accepted(self) -> bool:
        """Whether the lower end of the interval is within the allowed loss."""
        return bool(self.difference.low >= -MOST_LOSS_SHARE * abs(self.start.value))

    def words(self) -> str:
        """Return the verdict as a line of text."""
        value, low, high = self.difference.value, self.difference.low, self.difference.high
        how = "accepted" if self.accepted else "refused"
        return (f"{how}: on {self.machines} other machines its return differs by {value:+.4g} ({low:+.4g} to "
                f"{high:+.4g}) from its start's {self.start.value:.4g}")  # fmt: skip


def check_safe(machines: int, start: str | None) -> None:
    """Raise `InputError` before the training if there are too few machines, or no start."""
    if machines < LEAST_MACHINES:
        raise InputError(f"{machines} machines are too few to accept a policy: give {LEAST_MACHINES} or more")
    if start is None:
        raise InputError("--safe compares with what the training starts from: give --start policy:NAME")


def verdict(returns: Sequence[float], start_returns: Sequence[float]) -> Verdict:
    """Compare the returns of a policy and of its start, machine by machine."""
    new, old = np.array(returns, float), np.array(start_returns, float)
    return Verdict(mean(old), mean(new - old), len(new))


def accept(
    env_id: str, trained: Path, start: str, machines: int, watch: Callable[[str, int, int], None] | None = None
) -> Verdict:
    """Compare a trained policy with its start; if accepted, it becomes ``policy.json`` of its folder.

    Otherwise it becomes ``refused.json``, and the start ``policy.json``. The start is a file or a name. `watch` is
    called with a name, finished cuts and all.
    """
    both = f"policy:{trained}", f"policy:{policy_of(start)}"
    jobs = [(name, FIRST_SEED + k) for k in range(machines) for name in both]
    results = perform(
        partial(cut_job, env_id), jobs, watch and partial(watch, "accept"), engine=engine_of(env_id, len(jobs))
    )
    returns = [result.total_return for result in results]
    found = verdict(returns[::2], returns[1::2])
    file, refused = trained.with_name("policy.json"), trained.with_name("refused.json")
    first = policy_file.locate(start)
    for ending in (".json", ".npz"):
        trained.with_suffix(ending).replace((file if found.accepted else refused).with_suffix(ending))
        if found.accepted:
            refused.with_suffix(ending).unlink(missing_ok=True)
        else:
            shutil.copy(first.with_suffix(ending), file.with_suffix(ending))
    return found
