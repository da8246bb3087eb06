"""Hyperparameters: one file per environment and algorithm, ``models/training/NAME-ALGO.toml``."""

from __future__ import annotations

import tomllib
from importlib import resources
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from edmsim.envs.registry import base_of, find
from edmsim.errors import InputError

ALGORITHMS = ("ppo", "sac")
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
        PPO: natural logarithm of the noise on the first actions; stable-baselines3's own if not given.
    first_action : list of float, optional
        PPO: the actions (-1..1) around which exploring begins, one per entry; around 0 if not given.
    """

    widths: Annotated[list[Annotated[int, Field(gt=0)]], Field(min_length=1)]
    activation: Literal["tanh", "relu"]
    log_std_init: float | None = None
    first_action: list[Annotated[float, Field(ge=-1.0, le=1.0)]] | None = None


class Hyperparameters(_Strict):
    """What a training is made with.

    Attributes
    ----------
    steps : int
        Windows in all, over all lanes.
    num_envs : int
        Lanes side by side.
    environment : dict
        Arguments of the environment.
    algorithm : dict
        Arguments of stable-baselines3's class.
    network : Network
    """

    steps: Annotated[int, Field(gt=0)]
    num_envs: Annotated[int, Field(gt=0)]
    environment: dict[str, Any]
    algorithm: dict[str, Any]
    network: Network


def load(env_id: str, algo: str) -> Hyperparameters:
    """Return the hyperparameters of an environment and an algorithm.

    A user's environment has those of the one of ours it derives from; arguments it was registered with stay.

    Raises
    ------
    InputError
        If there is no such environment or algorithm.
    """
    family, registered = find(env_id)
    if algo not in ALGORITHMS:
        raise InputError(f"unknown algorithm '{algo}'; there are: {', '.join(ALGORITHMS)}")
    file = resources.files("edmsim.models") / "training" / f"{base_of(family)}-{algo}.toml"
    found = Hyperparameters.model_validate(tomllib.loads(file.read_text(encoding="utf-8")))
    left = {name: value for name, value in found.environment.items() if name not in registered}
    return found.model_copy(update={"environment": left})
