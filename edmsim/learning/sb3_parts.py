"""What makes a policy of stable-baselines3: its learner's network and its environment's wrappers (extra ``rl``)."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, NamedTuple

import gymnasium as gym
import torch
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import DummyVecEnv, VecCheckNan, VecMonitor, VecNormalize, VecVideoRecorder
from stable_baselines3.common.vec_env.base_vec_env import VecEnvWrapper

from edmsim.envs.arguments import plain
from edmsim.envs.environment import EdmEnv
from edmsim.envs.record import RecordRerun
from edmsim.envs.registry import arguments_with, stand_in
from edmsim.envs.sb3 import EdmVecEnv
from edmsim.envs.task import EnvArguments
from edmsim.errors import InputError
from edmsim.learning.imitation import TaughtVecEnv
from edmsim.learning.lagrangian import CostVecEnv
from edmsim.learning.policy_file import Residual
from edmsim.learning.privileged import PrivilegedVecEnv, VisibleEntries
from edmsim.learning.residual import ResidualVecEnv

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
        raise InputError(f"{type(env).__name__} is not an environment of edmsim: make it by make_sb3_vec_env")
    return Around(env.family, normalise, residual)


def _unknown(wrapper: Any) -> InputError:
    return InputError(
        f"{type(wrapper).__name__} around the environment may change what is seen or done, and no policy file says "
        "how: leave it away; to normalise, use VecNormalize"
    )
