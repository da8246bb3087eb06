"""A choice of a few feeds, or of changes of the feed, in place of a continuous action."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import InvalidAction
from gymnasium.vector import VectorActionWrapper, VectorEnv
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.numeric import real

LEVELS = (-1.0, -0.25, -0.05, 0.0, 0.05, 0.25, 1.0)
"""Usual choices, as actions of the environment (ours: a retract, fine and coarse steps either way, and none)."""


class DiscreteFeed(
    gym.ActionWrapper[NDArray[np.float32], np.int64, NDArray[np.float32]], gym.utils.RecordConstructorArgs
):
    """Make the action the number of a level of the feed, or of its change.

    Parameters
    ----------
    env : gymnasium.Env
        An environment of edmsim.
    levels : sequence of float
        Value of action k, -1..1. Further actions, those on the generator, are 0, which keeps its first setting.

    Raises
    ------
    InputError
        If there are fewer than two levels, or one outside -1..1.
    """

    def __init__(self, env: gym.Env[Any, Any], levels: Sequence[float] = LEVELS) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, levels=tuple(levels))
        gym.ActionWrapper.__init__(self, env)
        assert env.action_space.shape is not None
        self._actions = _table(levels, env.action_space.shape[0])
        self.action_space = gym.spaces.Discrete(len(levels))

    def action(self, action: np.int64) -> NDArray[np.float32]:
        """Return the environment's action for a level's number."""
        if not self.action_space.contains(action):
            raise InvalidAction(f"an action is a whole number from 0 to {len(self._actions) - 1}, not {action!r}")
        return np.array(self._actions[int(action)])


class DiscreteFeedVector(VectorActionWrapper):
    """`DiscreteFeed` for a vector environment of edmsim; the same parameters."""

    def __init__(self, env: VectorEnv[Any, Any, Any], levels: Sequence[float] = LEVELS) -> None:
        super().__init__(env)
        assert env.single_action_space.shape is not None
        self._actions = _table(levels, env.single_action_space.shape[0])
        self.single_action_space = gym.spaces.Discrete(len(levels))
        self.action_space = gym.vector.utils.batch_space(self.single_action_space, env.num_envs)

    def actions(self, actions: Any) -> NDArray[np.float32]:
        """Return the environments' actions for the levels' numbers."""
        if not self.action_space.contains(np.asarray(actions)):
            raise InvalidAction(
                f"actions are {self.num_envs} whole numbers from 0 to {len(self._actions) - 1}, not {actions!r}"
            )
        return np.asarray(self._actions[np.asarray(actions)])


def _table(levels: Sequence[float], width: int) -> NDArray[np.float32]:
    table = np.zeros((len(levels), width), np.float32)
    numbers = [real(level) for level in levels]
    if len(numbers) < 2 or any(number is None or not -1 <= number <= 1 for number in numbers):
        raise InputError(f"levels are {tuple(levels)!r}: give two or more numbers from -1 to 1")
    table[:, 0] = numbers
    return table
