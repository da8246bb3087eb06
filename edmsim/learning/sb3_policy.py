"""Policies of stable-baselines3 and sb3-contrib as files: export, and learning on from a file (extra ``rl``)."""

from __future__ import annotations

import platform
import re
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import DummyVecEnv, VecCheckNan, VecMonitor, VecNormalize, VecVideoRecorder
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvWrapper

from edmsim.envs.arguments import plain
from edmsim.envs.environment import EdmEnv, RecordRerun
from edmsim.envs.registry import arguments_with, stand_in
from edmsim.envs.sb3 import EdmVecEnv
from edmsim.envs.task import EnvArguments
from edmsim.errors import InputError, refuses_wrong_types
from edmsim.files import make_writable
from edmsim.learning.kinds import CostVecEnv, PrivilegedVecEnv, ResidualVecEnv, TaughtVecEnv, VisibleEntries
from edmsim.learning.policy_file import Card, Lstm, Policy, Residual, card_of, load, meanings, pack, write

PACKAGES = ("edmsim", "stable-baselines3", "sb3-contrib", "torch", "gymnasium", "numpy")


@refuses_wrong_types
def export_sb3(model: BaseAlgorithm, vec_env: VecEnv, file: str | Path) -> Policy:
    """Write your learner's policy and its observation normalisation as files for ``--controller policy:FILE``.

    Parameters
    ----------
    model : learner of stable_baselines3 or sb3_contrib
        PPO, SAC, TQC, recurrent PPO, A2C, TRPO, TD3 or DDPG, with ``MlpPolicy`` (``MlpLstmPolicy``) and Tanh or ReLU.
    vec_env : VecEnv
        Its environments: `edmsim.envs.make_sb3_vec_env`, or a `DummyVecEnv` of edmsim's environments, with or
        without `VecNormalize`.
    file : path
        ``NAME.json``; ``NAME.npz`` goes into the same folder.

    Returns
    -------
    Policy
        The policy, read from the new files.

    Raises
    ------
    InputError
        If a policy file cannot describe the environment, wrapper or network.

    Examples
    --------
    >>> from edmsim.learning import export_sb3
    >>> export_sb3(model, vec_env, "policy.json")  # doctest: +SKIP
    """
    target = Path(file)
    if target.suffix != ".json":
        raise InputError("name the policy's file NAME.json; its arrays come into NAME.npz beside it", target)
    algorithm = re.sub(r"(?<=[a-z])(?=[A-Z])", "-", type(model).__name__).lower()
    made = exported(model, vec_env, algorithm, "edmsim.learning.export_sb3", model.seed)
    make_writable(target.parent)
    write(*made, target)
    return load(str(target))


def exported(model: Any, vec_env: Any, algorithm: str, command: str, seed: int | None) -> tuple[Card, bytes]:
    """Return a learner's policy as `policy_file.write` wants it; `command` is what made it."""
    network, wrapped = network_of(model), around(vec_env)
    env_id, environment = wrapped.environment()
    entry_count = len(arguments_with(env_id, **environment).entries())
    if vec_env.observation_space != model.observation_space or vec_env.action_space != model.action_space:
        raise InputError("the learner has other observations or actions than this environment: give its own")
    trained_in = model.get_vec_normalize_env()
    if trained_in is not None and trained_in.norm_obs and wrapped.normalise is None:
        raise InputError("the learner has learned from normalised observations: give its environment in VecNormalize")
    weights, biases, lstm = _arrays(network, entry_count)
    packed = pack(weights, biases, lstm)
    mean, variance, epsilon, clip = _normalisation(wrapped.normalise, entry_count)
    return card_of(
        env_id, environment, packed, mean, variance, epsilon=epsilon, clip=clip, widths=network.widths,
        lstm=network.lstm and network.lstm.hidden_size, residual=wrapped.residual, activation=network.activation,
        output=network.output, algorithm=algorithm, command=command, seed=seed, steps=int(model.num_timesteps),
        versions={"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
    ), packed


def _arrays(network: PolicyNetwork, entry_count: int) -> tuple[list[Any], list[Any], Lstm | None]:
    """Return weights, biases and LSTM; what only the critic sees comes behind, and is left away."""
    first = network.lstm or network.layers[0]
    inputs = network.shown or (first.input_size if network.lstm else first.in_features)
    if inputs != entry_count:
        raise InputError(f"the learner's network sees {inputs} entries, its environment shows {entry_count}")
    weights, lstm = [_array(layer.weight).T for layer in network.layers], None
    biases = [_array(layer.bias) for layer in network.layers]
    if network.lstm is None:
        weights[0] = weights[0][:entry_count]
    else:
        names = "weight_ih_l0", "weight_hh_l0", "bias_ih_l0", "bias_hh_l0"
        ih, hh, *two = (_array(getattr(network.lstm, name)) for name in names)
        lstm = Lstm(ih.T, hh.T, two[0] + two[1])  # torch's gates come in the order of ours
    if not all(np.isfinite(array).all() for array in [*weights, *biases, *(lstm or ())]):
        raise InputError("the learner's network holds numbers that are not finite: its training has diverged")
    return weights, biases, lstm


def _normalisation(normalise: Any, count: int) -> tuple[list[float], list[float], float, float]:
    """Return mean, variance, epsilon and clip of the observation; those that change nothing without normalisation."""
    if normalise is None:
        epsilon = float(np.finfo(np.float64).eps)
        return [0.0] * count, [1.0 - epsilon] * count, epsilon, float(np.finfo(np.float32).max)
    statistics = normalise.obs_rms
    return statistics.mean[:count].tolist(), statistics.var[:count].tolist(), normalise.epsilon, normalise.clip_obs


def _array(tensor: Any) -> Any:
    return tensor.detach().cpu().numpy().astype(np.float64)


SCALES = (
    "max_feed_um_s", "max_change_um_s", "setting_octaves", "offset_um", "servo_target_share", "set_point_octaves",
    "pause_octaves", "on_time_octaves",
)  # fmt: skip
"""Arguments of an environment that say how much an action of 1 is."""


@refuses_wrong_types
def start_sb3(model: BaseAlgorithm, vec_env: VecEnv, policy: str | Policy) -> None:
    """Set a learner's policy to one from a file; its critics and noise do not change.

    Parameters
    ----------
    model : learner of stable_baselines3 or sb3_contrib
        A class that `export_sb3` accepts.
    vec_env : VecEnv
        Its environments in a `VecNormalize`, which starts from the policy's statistics and updates them.
    policy : str or Policy
        Either of its files, or a name under ``models/policies``; the prefix ``policy:`` is optional.

    Raises
    ------
    InputError
        If the policy's observations, actions or network differ from the learner's.

    Examples
    --------
    >>> from edmsim.learning import start_sb3
    >>> start_sb3(model, vec_env, "policy:GapFeed-ppo")  # doctest: +SKIP
    """
    policy_file = load(policy) if isinstance(policy, str) else policy
    network, wrapped = network_of(model), around(vec_env)
    _check(policy_file, network, wrapped)
    with torch.no_grad():
        for layer, weight, bias in zip(network.layers, policy_file.weights, policy_file.biases, strict=True):
            _put(layer.weight, weight.T)
            _put(layer.bias, bias)
        if policy_file.lstm is not None:
            lstm = network.lstm
            _put(lstm.weight_ih_l0, policy_file.lstm.input_weights.T)
            _put(lstm.weight_hh_l0, policy_file.lstm.memory_weights.T)
            _put(lstm.bias_ih_l0, policy_file.lstm.bias)
            _put(lstm.bias_hh_l0, np.zeros_like(policy_file.lstm.bias))
    normalise, card = wrapped.normalise, policy_file.card
    assert normalise is not None
    normalise.epsilon, normalise.clip_obs = card.epsilon, card.clip
    statistics: Any = normalise.obs_rms
    statistics.mean = np.array([entry.mean for entry in card.observation])
    statistics.var = np.array([entry.variance for entry in card.observation])
    statistics.count = max(float(card.steps), 1.0)


def _put(parameter: Any, values: Any) -> None:
    parameter.copy_(torch.as_tensor(np.ascontiguousarray(values), dtype=parameter.dtype))


def _check(policy: Policy, network: PolicyNetwork, wrapped: Around) -> None:
    """Refuse a policy that the learner cannot begin with."""
    card, family, theirs = policy.card, wrapped.family, policy.family()
    if network.shown is not None:
        raise InputError("a policy file has no statistics of what only a privileged critic sees: start without one")
    if wrapped.normalise is None:
        raise InputError("a policy brings the statistics of its observation: wrap the environment in VecNormalize")
    if card.residual != wrapped.residual:
        both = card.residual, wrapped.residual
        laws = [f"to {each.law} by {each.range_um_s:g} um/s" if each else "to no law" for each in both]
        raise InputError(f"the policy adds {laws[0]}, the training {laws[1]}: begin with the same residual")
    sees = [[entry.name for entry in each.entries()] for each in (theirs, family)]
    if sees[0] != sees[1] or meanings(theirs) != meanings(family):
        has, expected = (
            f"{len(each.entries())} entries and sets {', '.join(each.action_names)}" for each in (theirs, family)
        )
        raise InputError(f"the policy, of {card.env_id}, sees {has}; in the training a policy sees {expected}")
    shape, own = shape_in_words(card.widths, card.activation, card.lstm, card.output), network.words()
    if shape != own:
        raise InputError(f"the policy has {shape}; the learner has {own}: choose its algorithm and network so")
    for name in SCALES:
        here, there = getattr(family, name, None), getattr(theirs, name, None)
        if here != there:
            raise InputError(f"the policy learnt with {name} {there}, the training has {here}: give it the same")


ACTIVATIONS = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}
_AROUND = (
    VecMonitor, VecCheckNan, VecVideoRecorder, VecNormalize, CostVecEnv, TaughtVecEnv, PrivilegedVecEnv,
    ResidualVecEnv,
)  # fmt: skip
_AROUND_ONE = (
    Monitor, RecordRerun, gym.RewardWrapper, gym.wrappers.OrderEnforcing, gym.wrappers.PassiveEnvChecker,
    gym.wrappers.TimeLimit, gym.wrappers.RecordEpisodeStatistics, gym.wrappers.RecordVideo,
)
"""Wrappers that leave observations and actions as they are, or whose part in them is in a policy's card."""


class PolicyNetwork(NamedTuple):
    """What of a learner turns an observation into an action."""

    layers: list[Any]
    activation: str  # between them
    lstm: Any  # before them
    output: str  # what brings the last one's outputs into -1..1
    shown: int | None  # entries of the observation that the actor sees; all where there is no number

    @property
    def widths(self) -> list[int]:
        """Neurons of the hidden layers."""
        return [int(layer.out_features) for layer in self.layers[:-1]]

    def words(self) -> str:
        """Return its shape, for a message."""
        return shape_in_words(self.widths, self.activation, self.lstm and self.lstm.hidden_size, self.output)


def shape_in_words(widths: list[int], activation: str, lstm: int | None, output: str) -> str:
    """Return a network's shape, for a message."""
    before = f"an LSTM of {lstm} cells and " if lstm else ""
    return f"{before}hidden layers {widths} with {activation}, output by {output}"


def network_of(model: Any) -> PolicyNetwork:
    """Return a learner's network; raises `InputError` for one that a policy file cannot hold."""
    policy, what = model.policy, type(model).__name__
    if not isinstance(model.action_space, gym.spaces.Box):
        raise InputError(f"{what} chooses among {model.action_space}: a policy file holds continuous actions")
    actor = getattr(policy, "actor", None)
    if isinstance(policy, ActorCriticPolicy):
        features = policy.pi_features_extractor
        layers = [*policy.mlp_extractor.policy_net, policy.action_net]
        output = "tanh" if policy.squash_output else "clip"
    elif actor is not None and hasattr(actor, "mu"):
        features, output = actor.features_extractor, "tanh"
        layers = [*_flat(getattr(actor, "latent_pi", ())), *_flat(actor.mu)]
        if not hasattr(actor, "latent_pi"):
            layers.pop()  # TD3's and DDPG's tanh
    else:
        raise InputError(f"{what} has no actor with a mean: use PPO, SAC, TQC, recurrent PPO, A2C or TD3")
    if type(features) not in (FlattenExtractor, VisibleEntries):
        raise InputError(f"{what} uses the observations that {type(features).__name__} returns: use MlpPolicy")
    shown = int(features.shown.sum()) if isinstance(features, VisibleEntries) else None
    return PolicyNetwork(layers[::2], _activation(layers, what), _lstm(policy, what), output, shown)


def _flat(layers: Any) -> list[Any]:
    return [layers] if isinstance(layers, torch.nn.Linear) else list(layers)


def _activation(layers: list[Any], what: str) -> str:
    """Return the activation between layers; refuse others than whole layers with one activation between them."""
    between = {type(layer) for layer in layers[1::2]} or {torch.nn.Tanh}
    names = [name for name, kind in ACTIVATIONS.items() if between == {kind}]
    whole = [*layers[::2], layers[-1]]
    wrong = next((layer for layer in whole if type(layer) is not torch.nn.Linear or layer.bias is None), None)
    if wrong is not None or not names:
        named = type(wrong).__name__ if wrong is not None else ", ".join(sorted(kind.__name__ for kind in between))
        raise InputError(f"{what}'s network has {named}: a policy file holds linear layers with Tanh or ReLU between")
    return names[0]


def _lstm(policy: Any, what: str) -> Any:
    lstm = getattr(policy, "lstm_actor", None)
    if lstm is None:
        return None
    if lstm.num_layers != 1 or lstm.bidirectional or lstm.proj_size or not lstm.bias:
        raise InputError(f"{what}'s {lstm} is more than a policy file holds: one layer, forward, with its bias")
    return lstm


class Around(NamedTuple):
    """What a learner's sub-environments are."""

    family: EnvArguments  # their arguments
    normalise: VecNormalize | None
    residual: Residual | None  # the law that actions are added to

    def environment(self) -> tuple[str, dict[str, Any]]:
        """Return id and arguments of the environment of edmsim that a card names."""
        own = {f.name: plain(getattr(self.family, f.name)) for f in fields(self.family)}  # type: ignore[arg-type]
        env_id, arguments = stand_in(type(self.family), own)
        usual = arguments_with(env_id)
        return env_id, {name: value for name, value in arguments.items() if plain(getattr(usual, name)) != value}


def around(vec_env: Any) -> Around:
    """Check the wrappers of a learner's environment; refuse those that may change observations or actions."""
    normalise = residual = None
    while isinstance(vec_env, VecEnvWrapper):
        if not isinstance(vec_env, _AROUND):
            raise _unknown(vec_env)
        if isinstance(vec_env, VecNormalize) and vec_env.norm_obs:
            if normalise is not None:
                raise InputError("the environment is normalised twice: a policy file holds one VecNormalize")
            normalise = vec_env
        if isinstance(vec_env, ResidualVecEnv):
            residual = vec_env.residual
        vec_env = vec_env.venv
    if isinstance(vec_env, EdmVecEnv):
        return Around(vec_env.env.family, normalise, residual)
    env = vec_env.envs[0] if isinstance(vec_env, DummyVecEnv) else vec_env
    while isinstance(env, gym.Wrapper):
        if not isinstance(env, _AROUND_ONE):
            raise _unknown(env)
        env = env.env
    if not isinstance(env, EdmEnv):
        raise InputError(
            f"{type(env).__name__} is not an environment of edmsim, or in other processes: give one of "
            "make_sb3_vec_env with the same arguments"
        )
    return Around(env.family, normalise, residual)


def _unknown(wrapper: Any) -> InputError:
    return InputError(
        f"{type(wrapper).__name__} around the environment may change what is seen or done, and no policy file says "
        "how: leave it away; to normalise, use VecNormalize"
    )
