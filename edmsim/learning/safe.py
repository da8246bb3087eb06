"""Safe training: a trained policy replaces its start only if its return on other machines is not lower."""

import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from edmsim.errors import InputError
from edmsim.evaluation.compare import Figure, mean
from edmsim.evaluation.episode import HELD_BACK, cut_job, engine_of
from edmsim.learning.policy_file import locate
from edmsim.runs import perform
from edmsim.user_code import policy_of

FIRST_SEED = HELD_BACK - 100_000
"""First seed of the machines that test a policy: comparisons use others, as their seeds must not choose a policy;
training, which draws its seeds from 32 bits, meets one only by chance."""
LEAST_MACHINES = 4
"""Least number of machines (ours: with fewer, a bootstrap has only a handful of means)."""
MOST_LOSS_SHARE = 0.02
"""How far below zero the difference's interval may reach, as a share of the start's return (ours: a policy compared
with itself must pass; one whose loss is unknown must not)."""


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
        return (f"{how}: on {self.machines} other machines it earns {value:+.4g} ({low:+.4g} to {high:+.4g}) "
                f"beside {self.start.value:.4g} of its start")  # fmt: skip


def check(machines: int, start: str | None) -> None:
    """Raise `InputError` before the training if there are too few machines, or no start."""
    if machines < LEAST_MACHINES:
        raise InputError(f"{machines} machines tell too little to accept a policy: give {LEAST_MACHINES} or more")
    if start is None:
        raise InputError("--safe compares with what the training starts from: give --start policy:NAME")


def verdict(returns: Sequence[float], start_returns: Sequence[float]) -> Verdict:
    """Compare the returns of a policy and of its start, machine by machine."""
    new, old = np.array(returns, float), np.array(start_returns, float)
    return Verdict(mean(old), mean(new - old), len(new))


def compare(
    env_id: str, policy: str, start: str, machines: int, watch: Callable[[str, int, int], None] | None = None
) -> Verdict:
    """Cut the same machines with a policy and its start; `watch` is called with a name, finished cuts and all."""
    jobs = [(name, FIRST_SEED + k) for k in range(machines) for name in (policy, start)]
    results = perform(
        partial(cut_job, env_id), jobs, watch and partial(watch, "accept"), engine=engine_of(env_id, len(jobs))
    )
    returns = [result.total_return for result in results]
    return verdict(returns[::2], returns[1::2])


def accept(
    env_id: str, trained: Path, start: str, machines: int, watch: Callable[[str, int, int], None] | None = None
) -> Verdict:
    """Compare a trained policy with its start: it becomes ``policy.json`` of its folder, or ``refused.json``.

    If it is refused, the start becomes ``policy.json``. The start is a file or a name.
    """
    found = compare(env_id, f"policy:{trained}", f"policy:{policy_of(start)}", machines, watch)
    file, refused = trained.with_name("policy.json"), trained.with_name("refused.json")
    first = locate(start)
    for ending in (".json", ".npz"):
        trained.with_suffix(ending).replace((file if found.accepted else refused).with_suffix(ending))
        if found.accepted:
            refused.with_suffix(ending).unlink(missing_ok=True)
        else:
            shutil.copy(first.with_suffix(ending), file.with_suffix(ending))
    return found
