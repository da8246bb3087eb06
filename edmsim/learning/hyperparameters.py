"""Hyperparameters: ``models/training/ALGO.toml``, or ``NAME-ALGO.toml`` for a task with its own."""

import math
import re
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainValidator, ValidationError, with_config
from typing_extensions import TypedDict

from edmsim import files, models
from edmsim.envs.registry import arguments_with, base_of, find
from edmsim.errors import InputError, invalid_entry, located, one_of, refuse_unknown, refuses_wrong_types
from edmsim.evaluation.episode import ORACLE, lines_of
from edmsim.numeric import Number, WholeNumber, real, whole_from

CHECKPOINT = "checkpoint-*/run.json"
"""Pattern (glob) of the last checkpoint in the folder of a training."""
HISTORIES = "histories.jsonl"  # file with the state of a bandit's training
ALGORITHMS = ("ppo", "sac", "tqc", "ppo-lag", "recurrent-ppo", "imitation")
"""Algorithms that have hyperparameters."""
LOG_STD_AFTER_START = -1.0
"""Logarithm of the action noise in a training that starts from a policy (ours: a third of that from scratch, with
which short trainings in GapFeed lost more than they learned)."""
REPLAYS = ("sac", "tqc")  # algorithms with a replay buffer
RECURRENT = ("recurrent-ppo", "imitation")  # algorithms whose policy may have an LSTM
Positive = Annotated[Number, Field(gt=0, allow_inf_nan=False)]
Share = Annotated[Number, Field(ge=0, le=1)]
Count = Annotated[WholeNumber, Field(gt=0)]


def _entropy(value: object) -> object:
    """Check SAC's weight of the entropy."""
    number = real(value)
    first = re.fullmatch(r"auto(?:_(\d*\.?\d+))?", str(value))
    if (number is not None and 0 <= number < math.inf) or (first and float(first[1] or 1) > 0):
        return value
    raise ValueError("must be a number of 0 or more, or 'auto_0.1'")


@with_config(ConfigDict(extra="forbid"))
class Algorithm(TypedDict, total=False):
    """Arguments of stable-baselines3's class; an algorithm takes those that its file has."""

    learning_rate: Positive
    gamma: Share  # discount of a step
    batch_size: Annotated[WholeNumber, Field(gt=1)]
    # weight of the entropy; with "auto_0.1" SAC and TQC adapt it, starting at 0.1
    ent_coef: Annotated[Any, PlainValidator(_entropy)]
    # n_steps, n_epochs: of PPO and its kind
    n_steps: Count
    n_epochs: Count
    gae_lambda: Share  # of PPO and its kind
    # clip_range, target_kl: of PPO and its kind
    clip_range: Positive
    target_kl: Positive
    # buffer_size, train_freq, gradient_steps: of SAC and TQC
    buffer_size: Count
    train_freq: Count
    gradient_steps: Count
    learning_starts: Annotated[WholeNumber, Field(ge=0)]  # of SAC and TQC
    tau: Annotated[Number, Field(gt=0, le=1)]  # of SAC and TQC
    top_quantiles_to_drop_per_net: Annotated[WholeNumber, Field(ge=0, lt=25)]  # of TQC's 25 quantiles


class Network(BaseModel, extra="forbid", frozen=True):
    """The policy's network; the value network has the same shape."""

    # number of neurons of each hidden layer
    widths: Annotated[list[Count], Field(min_length=1)]
    activation: Literal["tanh", "relu"]
    # PPO: natural logarithm of the initial action noise, within the bounds of stable-baselines3's SAC; by default 0,
    # or `LOG_STD_AFTER_START`
    log_std_init: Annotated[Number, Field(ge=-20, le=2)] | None = None
    # PPO: centre of the initial exploration, one action (-1..1) per entry; by default 0
    first_action: list[Annotated[Number, Field(ge=-1.0, le=1.0)]] | None = None
    # recurrent PPO and imitation: number of cells of the LSTM before the hidden layers
    lstm: Count | None = None


class Lagrangian(BaseModel, extra="forbid", frozen=True):
    """Lagrangian PPO: weight of costs in the reward (see `edmsim.learning.sb3`)."""

    multiplier: Annotated[Number, Field(ge=0, allow_inf_nan=False)]  # first reduction of the reward per unit of cost
    rate: Positive  # change of the multiplier per rollout and unit of cost above the limit


class Hyperparameters(BaseModel, extra="forbid", frozen=True):
    """Hyperparameters of a training."""

    steps: Count  # of all sub-environments together: windows, or decisions
    num_envs: Count  # number of sub-environments
    environment: dict[str, Any]  # arguments of the environment
    algorithm: Algorithm
    network: Network
    lagrangian: Lagrangian | None = None  # only for Lagrangian PPO
    residual: str | None = None  # classic law whose feed the policy corrects (see `edmsim.learning.sb3`)
    # change of that feed per action of 1 (ours: a fifth of a cutting feed, which leaves the law in control)
    residual_um_s: Positive = 5.0
    teacher: str | None = None  # imitation: controller to imitate (see `edmsim.learning.sb3`)
    # PPO: whether the value network observes the true state (see `edmsim.learning.sb3`)
    privileged_critic: bool = False


def has_training(out: Path) -> bool:
    """Return whether a folder has a training, finished or not, that can be resumed."""
    return any(found for pattern in (CHECKPOINT, HISTORIES) for found in out.glob(pattern))


def refuse_training(out: Path) -> None:
    """Raise `InputError` if a folder has a training, which a new one would replace."""
    if has_training(out):
        raise InputError("this folder has a training: continue it with --resume, or give another folder", out)


@refuses_wrong_types
def load(env_id: str, algo: str, settings: str | Path | None = None) -> Hyperparameters:
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
    refuse_unknown("algorithm", algo, ALGORITHMS)
    general = models.path(f"training/{algo}.toml")
    own = general.with_name(f"{base_of(family)}-{algo}.toml")
    ours = files.read_toml(own if own.is_file() else general)
    if algo == "imitation" and not own.is_file() and (reference := lines_of(env_id).reference) != ORACLE:
        ours["teacher"] = reference  # the oracle is the best of several cuts, which no learner can imitate
    known = {one.name for one in fields(family)} - set(registered)  # type: ignore[arg-type]
    left = {name: value for name, value in ours["environment"].items() if name in known}
    usual = Hyperparameters.model_validate({**ours, "environment": left})
    found = usual if settings is None else _changed(usual, settings)
    with located(settings):
        _check(env_id, algo, found)
    return found


def steps_of(parameters: Hyperparameters, algo: str, steps: int | None) -> int:
    """Return a training's steps, by default its hyperparameters'; raise `InputError` if too few to learn."""
    total = parameters.steps if steps is None else whole_from("steps", steps, 1)
    first = parameters.algorithm.get("learning_starts", -1)
    if total <= first:
        raise InputError(f"{algo} learns after {first} steps (learning_starts): give more than {total}")
    return total


def _changed(usual: Hyperparameters, file: str | Path) -> Hyperparameters:
    """Return hyperparameters with overrides from a file."""
    table = files.read_toml(file)
    if "gains" in table:
        raise InputError("these are gains of a controller, not settings of a training", file)
    before = usual.model_dump()
    for name, value in table.items():
        inner = before.get(name)
        before[name] = {**inner, **value} if isinstance(inner, dict) and isinstance(value, dict) else value
    if "lagrangian" in table and usual.lagrangian is None:
        raise InputError("the table lagrangian is for the algorithm ppo-lag: leave it out", file)
    own = table.get("algorithm")
    if isinstance(own, dict) and (unknown := sorted(set(own) - set(usual.algorithm))):
        known = one_of(unknown[0], usual.algorithm)
        raise InputError(f"algorithm has no entry {', '.join(unknown)!r}; it has {known}", file)
    try:
        return Hyperparameters.model_validate(before)
    except ValidationError as error:
        raise InputError(invalid_entry(error), file) from None


def _check(env_id: str, algo: str, found: Hyperparameters) -> None:
    """Raise `InputError` if environment, algorithm and network do not fit each other."""
    network = found.network
    if network.lstm is None and algo == "recurrent-ppo":
        raise InputError("recurrent-ppo needs an LSTM: give network.lstm its number of cells")
    if network.lstm is not None and algo not in RECURRENT:
        raise InputError(f"network.lstm is for {' and '.join(RECURRENT)}; the algorithm is {algo}")
    if isinstance(found.algorithm.get("ent_coef"), str) and algo not in REPLAYS:
        raise InputError(f"algorithm.ent_coef is a number; {' and '.join(REPLAYS)} find one, the algorithm is {algo}")
    if found.num_envs * found.algorithm.get("n_steps", 2) < 2:
        raise InputError("a rollout of num_envs * n_steps is 1 step: give 2 or more")
    with located(name="environment"):
        actions = arguments_with(env_id, **found.environment).action_names
    first = network.first_action
    if first is not None and algo in REPLAYS:
        raise InputError(f"network.first_action is for PPO and its kind; the algorithm is {algo}")
    if first is not None and len(first) != len(actions):
        raise InputError(f"network.first_action has {len(first)} entries; an action has {', '.join(actions)}")
