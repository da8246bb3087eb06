"""Lagrangian PPO: the reward minus a multiple of ``info["cost"]`` that keeps the cost at a limit (extra ``rl``).

The multiplier grows while the mean cost is above the limit, and shrinks below it (Tessler, Mankowitz and Mannor,
"Reward constrained policy optimization", ICLR 2019, arXiv:1805.11074).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper


# untyped where the extra is missing
class CostVecEnv(VecEnvWrapper):  # type: ignore[misc, unused-ignore]
    """Sub-environments whose rewards are less `multiplier` times their costs."""

    def __init__(self, venv: VecEnv, multiplier: float) -> None:
        super().__init__(venv)
        self.multiplier = multiplier
        self.ended: list[float] = []  # costs of the episodes that ended since `Multiplier` looked last
        self._cost = np.zeros(self.num_envs)

    def reset(self) -> Any:
        """Begin episodes, without a cost so far."""
        self._cost[:] = 0.0
        return self.venv.reset()

    def step_wait(self) -> Any:
        """Run a step."""
        observations, rewards, done, infos = self.venv.step_wait()
        cost = np.array([info["cost"] for info in infos])
        self._cost += cost
        self.ended += self._cost[done].tolist()
        self._cost[done] = 0.0
        return observations, (rewards - self.multiplier * cost).astype(np.float32), done, infos


class Multiplier(BaseCallback):  # type: ignore[misc, unused-ignore]
    """Raises the multiplier by `rate` per mean cost of a rollout's episodes beyond the limit, or lowers it."""

    def __init__(self, vec_env: CostVecEnv, limit: float, rate: float) -> None:
        super().__init__()
        self._vec_env, self._limit, self._rate = vec_env, limit, rate

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        if self._vec_env.ended:
            beyond = float(np.mean(self._vec_env.ended)) - self._limit
            self._vec_env.multiplier = max(0.0, self._vec_env.multiplier + self._rate * beyond)
            self.logger.record("cost/mean_of_episodes", beyond + self._limit)
            self.logger.record("cost/multiplier", self._vec_env.multiplier)
            self._vec_env.ended = []
