"""A sub-environment of a vector environment as the single environment that it stands for."""

from __future__ import annotations

import copy
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from edmsim.envs.single import EdmEnv
from edmsim.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmsim.controllers import FeedController
    from edmsim.envs.attached_controller import AttachedController
    from edmsim.envs.recorder import EpisodeRecorder
    from edmsim.envs.task import EnvArguments

_OF_VECTORS = "num_envs", "vectorization_mode", "autoreset_mode", "threads", "max_episode_steps"


class SubEnvView:
    """What a single `EdmEnv` has, of a sub-environment; all step, end and close together, in one vector environment.

    Other attributes may be set, and are the sub-environment's own. The seed is -1 if the generator was set, as
    Gymnasium has it.
    """

    def __init__(self, env: Any, index: int) -> None:
        self._env, self._index = env, index
        self._spaces = copy.deepcopy((env.single_action_space, env.single_observation_space, env.reward_space))
        self._random: np.random.Generator | None = None
        self._seed = -1

    action_space = property(lambda self: self._spaces[0], doc="The sub-environment's own, which can be seeded.")
    observation_space = property(lambda self: self._spaces[1], doc="The sub-environment's own.")
    reward_space = property(lambda self: self._spaces[2], doc="The sub-environment's own.")
    metadata = property(lambda self: EdmEnv.metadata, doc="As of a single environment.")

    @property
    def family(self) -> EnvArguments:
        """The arguments in force."""
        family: EnvArguments = self._env.family
        return family

    @property
    def render_mode(self) -> str | None:
        """As of all sub-environments."""
        mode: str | None = self._env.render_mode
        return mode

    @property
    def unwrapped(self) -> SubEnvView:
        """The sub-environment itself: there are no wrappers around it."""
        return self

    @property
    def spec(self) -> gym.envs.registration.EnvSpec | None:
        """Specification of a single environment like it."""
        spec: gym.envs.registration.EnvSpec | None = copy.deepcopy(self._env.spec)
        if spec is not None:
            spec.kwargs = {name: value for name, value in spec.kwargs.items() if name not in _OF_VECTORS}
            spec.max_episode_steps = self._env.max_episode_steps
        return spec

    def take(self, name: str, value: Any) -> None:
        """Set an attribute; refuse what all sub-environments share."""
        shared = getattr(type(self), name, None)
        fixed = isinstance(shared, property) and shared.fset is None
        if fixed or callable(shared) or name in {f.name for f in fields(self.family)}:  # type: ignore[arg-type]
            raise InputError(
                f"{name} cannot be set: the sub-environments share it; give it when making them, or change an "
                "argument of the next episodes by change(...), env_method('change', ...) in stable-baselines3"
            )
        setattr(self, name, value)

    def begin_draws(self, seed: int | None) -> None:
        """Let the sub-environment's draws begin as a seed has them, or as nobody knows."""
        self._random, self._seed = seeding.np_random(seed)

    @property
    def np_random(self) -> np.random.Generator:
        """Generator of what is drawn."""
        if self._random is None:
            self.begin_draws(None)
        assert self._random is not None
        return self._random

    @np_random.setter
    def np_random(self, generator: np.random.Generator) -> None:
        self._random, self._seed = generator, -1

    @property
    def np_random_seed(self) -> int:
        """Seed of that generator."""
        if self._random is None:
            self.begin_draws(None)
        return self._seed

    def attach_controller(self, controller: FeedController) -> AttachedController:
        """Return a feed controller's place at the sub-environment: see `AttachedController`."""
        law: AttachedController = self._env.attach_controller(self._index, controller)
        return law

    def recorder(self, actions: Sequence[str] | None = None) -> EpisodeRecorder:
        """Return a recorder of the episode that the sub-environment has just begun; see `EdmEnv.recorder`."""
        recorder: EpisodeRecorder = self._env.recorder(self._index, actions)
        return recorder

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture of the sub-environment; with ``"human"`` sub-environment 0 is shown, and no other."""
        if self._env.render_mode == "rgb_array":
            picture: NDArray[np.uint8] = self._env.picture(self._index)
            return picture
        if self._index == 0:
            self._env.render()
        return None
