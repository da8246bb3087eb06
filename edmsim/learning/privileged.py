"""Privileged critic: observes gap, wire temperature, debris and drawn constants, which no machine measures.

Only the value network gets these entries. In the policy's features they are 0: its actions cannot depend on them,
and the exported policy has no weights for them (Pinto et al., RSS 2018). It needs the extra ``rl``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

TRUTHS = ("gap_um", "wire_temperature_K", "debris", "error_um")
"""Entries of the last window's ``info`` that the critic observes; the episode's drawn constants follow."""


# untyped where the extra is missing
class PrivilegedVecEnv(VecEnvWrapper):  # type: ignore[misc, unused-ignore]
    """Sub-environments that append the true state to the observations."""

    def __init__(self, venv: VecEnv) -> None:
        vec_env: Any = venv.unwrapped
        self._names = tuple(vec_env.env.family.drawn_constants)
        shown = venv.observation_space
        assert isinstance(shown, gym.spaces.Box)
        more = np.full(len(TRUTHS) + len(self._names), np.inf, np.float32)
        space = gym.spaces.Box(np.append(shown.low, -more), np.append(shown.high, more), dtype=np.float32)
        super().__init__(venv, observation_space=space)
        self._constants = np.zeros((self.num_envs, len(self._names)), np.float32)

    def reset(self) -> Any:
        """Begin episodes, with the state of the gap still unknown."""
        observations = self.venv.reset()
        self._draw(range(self.num_envs))
        return self._with(observations, np.zeros((self.num_envs, len(TRUTHS)), np.float32))

    def step_wait(self) -> Any:
        """Run a step."""
        observations, rewards, done, infos = self.venv.step_wait()
        truths = np.array([[info[name] for name in TRUTHS] for info in infos], np.float32)
        ended = np.flatnonzero(done)
        for index in ended:
            last = infos[index]["terminal_observation"]
            infos[index]["terminal_observation"] = np.concatenate([last, truths[index], self._constants[index]])
        truths[ended] = 0.0
        self._draw(ended)
        return self._with(observations, truths), rewards, done, infos

    def _draw(self, indices: Sequence[int] | NDArray[np.int64] | range) -> None:
        infos = self.unwrapped.reset_infos
        for index in indices:
            self._constants[index] = [infos[index]["drawn"][name] for name in self._names]

    def _with(self, observations: Any, truths: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.concatenate([observations, truths, self._constants], axis=1)


class VisibleEntries(BaseFeaturesExtractor):  # type: ignore[misc, unused-ignore]
    """The first entries of an observation unchanged, and 0 in place of the others."""

    def __init__(self, observation_space: gym.spaces.Box[Any], entries: int) -> None:
        width = int(np.prod(observation_space.shape))
        super().__init__(observation_space, width)
        self.shown: torch.Tensor
        self.register_buffer("shown", (torch.arange(width) < entries).float())

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features as wide as the observations."""
        return observations * self.shown


class AsymmetricPolicy(ActorCriticPolicy):  # type: ignore[misc, unused-ignore]
    """An actor-critic whose actor sees only the first `shown_entries` of an observation."""

    def __init__(self, *args: Any, shown_entries: int, **kwargs: Any) -> None:
        self._shown_entries = shown_entries
        super().__init__(*args, **{**kwargs, "share_features_extractor": False})
        space = self.observation_space
        assert isinstance(space, gym.spaces.Box)
        self.pi_features_extractor = VisibleEntries(space, shown_entries)
        self.features_extractor = self.pi_features_extractor

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "shown_entries": self._shown_entries}
