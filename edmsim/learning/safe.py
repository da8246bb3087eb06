"""Safe training: what a policy learned since its start counts only where other machines do not earn less by it."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from edmsim.errors import InputError
from edmsim.evaluation.compare import Figure, mean
from edmsim.evaluation.episode import HELD_BACK, cut
from edmsim.evaluation.parts import cut_part, is_part
from edmsim.learning.policy_file import locate

FIRST_SEED = HELD_BACK - 100_000
"""First seed of the machines that a policy is accepted on: not those of comparisons, which must not choose a policy;
training meets one by chance only, as it draws its seeds from 32 bits."""
LEAST_MACHINES = 4
"""Ours: with fewer, a bootstrap of the machines knows only a handful of means."""
MOST_LOSS_SHARE = 0.02
"""What the interval of the difference may reach below zero, as a share of what the start earns (ours: a comparison of
the same policy with itself must pass, one of whose losses nothing is known must not)."""


class Verdict(NamedTuple):
    """How a policy compares with its start on the same machines.

    Attributes
    ----------
    start, difference : Figure
        Mean return of the start, and of the paired differences, with their 95 % bootstrap intervals.
    machines : int
    """

    start: Figure
    difference: Figure
    machines: int

    @property
    def accepted(self) -> bool:
        """Whether the interval's lower end is not below the loss that is allowed."""
        return bool(self.difference.low >= -MOST_LOSS_SHARE * abs(self.start.value))

    def words(self) -> str:
        """Return it as a line of text."""
        value, low, high = self.difference.value, self.difference.low, self.difference.high
        how = "accepted" if self.accepted else "refused"
        return (f"{how}: on {self.machines} other machines it earns {value:+.4g} ({low:+.4g} to {high:+.4g}) "
                f"beside {self.start.value:.4g} of its start")  # fmt: skip


def check(machines: int, start: str | None) -> None:
    """Refuse too few machines, and a training without a start, before anything is trained."""
    if machines < LEAST_MACHINES:
        raise InputError(f"{machines} machines tell too little to accept a policy: give {LEAST_MACHINES} or more")
    if start is None:
        raise InputError("--safe compares with what the training starts from: give --start policy:NAME")


def verdict(returns: Sequence[float], start_returns: Sequence[float]) -> Verdict:
    """Compare returns of a policy with those of its start, machine by machine."""
    new, old = np.array(returns, float), np.array(start_returns, float)
    return Verdict(mean(old), mean(new - old), len(new))


def compare(
    env_id: str, policy: str, start: str, machines: int, watch: Callable[[str, int, int], None] | None = None
) -> Verdict:
    """Cut the same machines with a policy and its start.

    Parameters
    ----------
    env_id : str
    policy, start : str
        Controllers, see `edmsim.controllers.from_text`.
    machines : int
        `LEAST_MACHINES` or more.
    watch : callable, optional
        Called with a name, and the cuts made and to make.
    """
    jobs = [(name, FIRST_SEED + k) for k in range(machines) for name in (policy, start)]
    make = partial(cut_part if is_part(env_id) else cut, env_id)
    returns = []
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for result in pool.map(lambda job: make(job[1], job[0]), jobs):
            returns.append(result.total_return)
            if watch is not None:
                watch("accept", len(returns), len(jobs))
    return verdict(returns[::2], returns[1::2])


def accept(
    env_id: str, file: Path, start: str, machines: int, watch: Callable[[str, int, int], None] | None = None
) -> Verdict:
    """Leave a trained policy where it is if it is accepted; otherwise put its start there, and it beside.

    Parameters
    ----------
    env_id : str
    file : Path
        The trained policy's ``.json``. A refused one is in ``refused.json`` beside it afterwards.
    start : str
        Policy that the training began with, as ``policy:NAME`` or a file of it.
    machines, watch
        See `compare`.
    """
    named = start if start.startswith("policy:") else f"policy:{start}"
    found = compare(env_id, f"policy:{file}", named, machines, watch)
    if not found.accepted:
        refused = file.with_name("refused.json")
        for ending in (".json", ".npz"):
            file.with_suffix(ending).replace(refused.with_suffix(ending))
        first = locate(named.removeprefix("policy:"))
        for ending in (".json", ".npz"):
            shutil.copy(first.with_suffix(ending), file.with_suffix(ending))
    return found
