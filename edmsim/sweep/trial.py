"""One trial of a search: gains on some cuts, or a training with some settings, and what it is worth."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from edmsim.controllers import make
from edmsim.errors import InputError
from edmsim.evaluation.search import BOUNDS, run_all, score
from edmsim.sweep.perform import said

if TYPE_CHECKING:
    from edmsim.learning.train import Trained

Scale = Literal["linear", "log"]


class Bound(NamedTuple):
    """Where a value is searched."""

    low: float
    high: float
    scale: Scale = "linear"


TRAINING: dict[str, dict[str, Bound]] = {
    "ppo": {
        "learning_rate": Bound(1e-5, 3e-3, "log"), "gamma": Bound(0.95, 0.9995), "gae_lambda": Bound(0.85, 0.99),
        "clip_range": Bound(0.1, 0.4),
    },
    "sac": {
        "learning_rate": Bound(1e-5, 3e-3, "log"), "gamma": Bound(0.95, 0.9995), "tau": Bound(0.002, 0.05, "log"),
    },
}
TRAINING |= {"tqc": TRAINING["sac"], "ppo-lag": TRAINING["ppo"], "recurrent-ppo": TRAINING["ppo"]}
"""What is searched of a training, and where (ours: a factor of ten to both sides of what stable-baselines3 gives)."""


@dataclass(frozen=True)
class Trial:
    """A trial as plain data.

    Attributes
    ----------
    number : int
        In the study.
    kind : {"gains", "training"}
    name : str
        Controller, or environment.
    values : dict
    seeds : tuple of int
        Training seeds that it is judged by.
    algo : str
        Of a training.
    steps : int
        Windows of a training.
    """

    number: int
    kind: Literal["gains", "training"]
    name: str
    values: Mapping[str, float]
    seeds: tuple[int, ...]
    algo: str = ""
    steps: int = 0


@dataclass(frozen=True)
class Worth:
    """What a trial is worth, more is better, NaN with an error; and the policy it made."""

    value: float
    error: str | None = None
    files: Mapping[str, bytes] = field(default_factory=dict)


def bounds(kind: str, name: str) -> dict[str, Bound]:
    """Return what is searched of a controller, or of an algorithm.

    Raises
    ------
    InputError
        Nothing of this algorithm is searched.
    """
    if kind == "training":
        if name not in TRAINING:
            raise InputError(f"no settings of the algorithm '{name}' are searched; choose {', '.join(TRAINING)}")
        return TRAINING[name]
    return {key: Bound(*ends) for key, ends in BOUNDS[name].items()}


def judge_trial(trial: Trial) -> Worth:
    """Make a trial; a failure is told, not raised."""
    try:
        return _gains(trial) if trial.kind == "gains" else _training(trial)
    except Exception as error:  # whatever it is: the search goes on without this trial
        return Worth(math.nan, said(error))


def _gains(trial: Trial) -> Worth:
    return Worth(score(run_all(trial.seeds, partial(make, trial.name, **trial.values), 1)))


def _training(trial: Trial) -> Worth:
    from edmsim.learning import hyperparameters
    from edmsim.learning.train import train

    usual = hyperparameters.load(trial.name, trial.algo)
    given = usual.model_copy(update={"algorithm": {**usual.algorithm, **trial.values}})
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        trained = train(trial.name, trial.algo, folder / "run", steps=trial.steps, seed=trial.seeds[0], given=given)
        told = f"edmsim tune {trial.name} --algo {trial.algo}, trial {trial.number}"
        value = judge_policy(trained, told, folder, trial.seeds)
        files = {file.name: file.read_bytes() for file in sorted(folder.glob("policy.*"))}
    return Worth(value, None, files)


def judge_policy(trained: Trained, told: str, folder: Path, seeds: Sequence[int]) -> float:
    """Write a training's ``policy.json`` and ``policy.npz``; return the policy's mean return on training seeds."""
    from edmsim.evaluation.episode import cut
    from edmsim.learning import policy_file
    from edmsim.learning.export import export

    card, packed = export(trained, told)
    policy_file.write(card, packed, folder / "policy.json")
    results = [cut(trained.run.env_id, seed, f"policy:{folder / 'policy.json'}", "fast") for seed in seeds]
    return float(np.mean([result.total_return for result in results]))
