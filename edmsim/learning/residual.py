"""Residual policies: a classic law sets the feed, and the policy adds a correction (extra ``rl``)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnvWrapper

from edmsim.controllers.protocols import FeedCommand
from edmsim.envs.sb3 import EdmVecEnv
from edmsim.envs.task import Family
from edmsim.errors import InputError
from edmsim.learning.policy_file import Residual


# untyped where the extra is missing
class ResidualVecEnv(VecEnvWrapper):  # type: ignore[misc, unused-ignore]
    """Environments whose first action is added to the feed of a law (Johannink et al., ICRA 2019)."""

    def __init__(self, venv: EdmVecEnv, residual: Residual) -> None:
        super().__init__(venv)
        self.residual = residual
        envs = venv.env
        family = envs.family
        assert isinstance(family, Family)
        self._family = family
        self._laws = [envs.attach_controller(index, residual.make()) for index in range(self.num_envs)]
        self._feed_um_s = np.zeros(self.num_envs)

    def reset(self) -> Any:
        """Begin an episode and reset the law in every sub-environment."""
        observations = self.venv.reset()
        for index, law in enumerate(self._laws):
            self._take(index, law.begin())
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Add the actions to the laws' commands."""
        total = np.array(actions, np.float32)
        for index, feed_um_s in enumerate(self._feed_um_s):
            total[index, 0] = self.residual.action(self._family, feed_um_s, total[index, 0])
        self.venv.step_async(total)

    def step_wait(self) -> Any:
        """Run a step, and take the laws' commands for the next one."""
        observations, rewards, done, infos = self.venv.step_wait()
        for index, law in enumerate(self._laws):
            self._take(index, law.begin() if done[index] else law.command())
        return observations, rewards, done, infos

    def _take(self, index: int, command: FeedCommand) -> None:
        if command.t_on_us is not None or command.t_period_us is not None:
            law = self.residual.law
            raise InputError(f"'{law}' turns the generator's knobs: a policy adds to a law that only feeds")
        self._feed_um_s[index] = command.feed_um_s
