"""Hyperparameters: ``models/training/ALGO.toml``, or ``NAME-ALGO.toml`` for a task with its own."""

from __future__ import annotations

import tomllib
from dataclasses import fields
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from edmsim.envs.registry import base_of, find
from edmsim.errors import InputError, one_of
from edmsim.numeric import Number, WholeNumber

ALGORITHMS = ("ppo", "sac", "tqc", "ppo-lag", "recurrent-ppo", "imitation")
"""Algorithms there are hyperparameters for."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Network(_Strict):
    """The policy's network; the value network is another of the same shape.

    Attributes
    ----------
    widths : list of int
        Neurons of the hidden layers.
    activation : {"tanh", "relu"}
    log_std_init : float, optional
        PPO: natural logarithm of the noise on the first actions; by default that of stable-baselines3.
    first_action : list of float, optional
        PPO: the actions (-1..1) around which exploration begins, one per entry; by default 0.
    lstm : int, optional
        Recurrent PPO: cells of the LSTM before the hidden layers.
    """

    widths: Annotated[list[Annotated[WholeNumber, Field(gt=0)]], Field(min_length=1)]
    activation: Literal["tanh", "relu"]
    log_std_init: Number | None = None
    first_action: list[Annotated[Number, Field(ge=-1.0, le=1.0)]] | None = None
    lstm: Annotated[WholeNumber, Field(gt=0)] | None = None


class Lagrangian(_Strict):
    """Costs as part of the reward in Lagrangian PPO (see `edmsim.learning.lagrangian`).

    Attributes
    ----------
    multiplier : float
        Initial reduction of the reward by a cost of 1.
    rate : float
        Change of the multiplier per rollout and cost above the limit.
    """

    multiplier: Annotated[Number, Field(ge=0)]
    rate: Annotated[Number, Field(gt=0)]


class Hyperparameters(_Strict):
    """Hyperparameters of a training.

    Attributes
    ----------
    steps : int
        Total number of windows, over all sub-environments.
    num_envs : int
        Number of sub-environments.
    environment : dict
        Arguments of the environment.
    algorithm : dict
        Arguments of stable-baselines3's class.
    network : Network
    lagrangian : Lagrangian, optional
        Of Lagrangian PPO.
    residual : str, optional
        The classic law to which the policy adds (see `edmsim.learning.residual`).
    residual_um_s : float
        Change of that law's feed by an action of 1 (ours: a fifth of a cutting feed; the law keeps control).
    teacher : str, optional
        Imitation: the controller to imitate (see `edmsim.learning.imitation`).
    privileged_critic : bool
        PPO: whether the value network gets the true state (see `edmsim.learning.privileged`).
    """

    steps: Annotated[WholeNumber, Field(gt=0)]
    num_envs: Annotated[WholeNumber, Field(gt=0)]
    environment: dict[str, Any]
    algorithm: dict[str, Any]
    network: Network
    lagrangian: Lagrangian | None = None
    residual: str | None = None
    residual_um_s: Annotated[Number, Field(gt=0)] = 5.0
    teacher: str | None = None
    privileged_critic: bool = False


def load(env_id: str, algo: str, settings: Path | None = None) -> Hyperparameters:
    """Return the hyperparameters of an environment and an algorithm.

    Your own environment has those of its base class in edmsim; the arguments of its registration stay.

    Parameters
    ----------
    env_id, algo : str
    settings : path, optional
        A TOML file with overrides: ``steps``, ``num_envs`` and so on, and entries of the tables ``algorithm``,
        ``environment``, ``network`` and ``lagrangian``; for example the ``best.toml`` of `edmsim tune`.

    Raises
    ------
    InputError
        If there is no such environment or algorithm, or the settings cannot be used.
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
    """Return hyperparameters with what a file says in place of theirs."""
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"the settings cannot be read: {error}", file) from None
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
        first = error.errors()[0]
        raise InputError(f"{'.'.join(map(str, first['loc']))}: {first['msg']}", file) from None
