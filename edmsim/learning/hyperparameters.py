"""Hyperparameters: ``models/training/ALGO.toml``, or ``NAME-ALGO.toml`` for a task with its own."""

from __future__ import annotations

import tomllib
from dataclasses import fields
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, ValidationError

from edmsim.envs.registry import base_of, find
from edmsim.errors import InputError, invalid_entry, one_of
from edmsim.files import read_toml
from edmsim.numeric import Number, WholeNumber

ALGORITHMS = ("ppo", "sac", "tqc", "ppo-lag", "recurrent-ppo", "imitation")
"""Algorithms there are hyperparameters for."""


class Network(BaseModel, extra="forbid", frozen=True):
    """The policy's network; the value network has the same shape."""

    # number of neurons of each hidden layer
    widths: Annotated[list[Annotated[WholeNumber, Field(gt=0)]], Field(min_length=1)]
    activation: Literal["tanh", "relu"]
    # PPO: natural logarithm of the initial action noise; by default that of stable-baselines3
    log_std_init: Number | None = None
    # PPO: centre of the initial exploration, one action (-1..1) per entry; by default 0
    first_action: list[Annotated[Number, Field(ge=-1.0, le=1.0)]] | None = None
    # recurrent PPO and imitation: number of cells of the LSTM before the hidden layers
    lstm: Annotated[WholeNumber, Field(gt=0)] | None = None


class Lagrangian(BaseModel, extra="forbid", frozen=True):
    """Lagrangian PPO: weight of costs in the reward (see `edmsim.learning.kinds`)."""

    multiplier: Annotated[Number, Field(ge=0)]  # initial reduction of the reward per unit of cost
    rate: Annotated[Number, Field(gt=0)]  # change of the multiplier per rollout and unit of cost above the limit


class Hyperparameters(BaseModel, extra="forbid", frozen=True):
    """Hyperparameters of a training."""

    steps: Annotated[WholeNumber, Field(gt=0)]  # of all sub-environments together: windows, or decisions
    num_envs: Annotated[WholeNumber, Field(gt=0)]  # number of sub-environments
    environment: dict[str, Any]  # arguments of the environment
    algorithm: dict[str, Any]  # arguments of stable-baselines3's class
    network: Network
    lagrangian: Lagrangian | None = None  # only for Lagrangian PPO
    residual: str | None = None  # classic law whose feed the policy corrects (see `edmsim.learning.kinds`)
    # change of that feed per action of 1 (ours: a fifth of a cutting feed, which leaves the law in control)
    residual_um_s: Annotated[Number, Field(gt=0)] = 5.0
    teacher: str | None = None  # imitation: controller to imitate (see `edmsim.learning.kinds`)
    # PPO: whether the value network observes the true state (see `edmsim.learning.kinds`)
    privileged_critic: bool = False


def load(env_id: str, algo: str, settings: Path | None = None) -> Hyperparameters:
    """Return the hyperparameters of an environment and an algorithm.

    Your own environment uses those of its base class in edmsim, and the arguments of its registration.

    Parameters
    ----------
    env_id, algo : str
    settings : path, optional
        TOML file of overrides, for example ``best.toml`` of `edmsim tune`: ``steps``, ``num_envs`` and so on, and
        entries of the tables ``algorithm``, ``environment``, ``network`` and ``lagrangian``.

    Raises
    ------
    InputError
        If the environment or algorithm is unknown, or the settings are invalid.
    """
    family, registered = find(env_id)
    if algo not in ALGORITHMS:
        raise InputError(f"unknown algorithm '{algo}'; there are: {one_of(algo, ALGORITHMS)}")
    folder = resources.files("edmsim.models") / "training"
    own = folder / f"{base_of(family)}-{algo}.toml"
    file = own if own.is_file() else folder / f"{algo}.toml"
    found = tomllib.loads(file.read_text(encoding="utf-8"))
    known = {one.name for one in fields(family)} - set(registered)  # type: ignore[arg-type]
    left = {name: value for name, value in found["environment"].items() if name in known}
    usual = Hyperparameters.model_validate({**found, "environment": left})
    return usual if settings is None else _changed(usual, settings)


def _changed(usual: Hyperparameters, file: Path) -> Hyperparameters:
    """Return hyperparameters with overrides from a file."""
    table = read_toml(file)
    if "gains" in table:
        raise InputError("these are gains of a controller, not settings of a training", file)
    before = usual.model_dump()
    for name, value in table.items():
        inner = before.get(name)
        before[name] = {**inner, **value} if isinstance(inner, dict) and isinstance(value, dict) else value
    unknown = set(table.get("algorithm", {})) - set(usual.algorithm)
    if unknown:
        known = ", ".join(usual.algorithm)
        raise InputError(f"algorithm has no entry {', '.join(sorted(unknown))!r}; it has {known}", file)
    try:
        return Hyperparameters.model_validate(before)
    except ValidationError as error:
        raise InputError(invalid_entry(error), file) from None
