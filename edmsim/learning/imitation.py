"""Imitation of a teacher, which may know the true state, in the states visited by the learner (extra ``rl``).

The learner cuts; in every state the teacher gives the action it would take, and the policy's mean is fitted to it. So
the policy learns for its own states, not for the teacher's (DAgger, Ross et al., AISTATS 2011). If the teacher knows
more than the policy, the policy learns the mean of the teacher's actions (Chen et al., CoRL 2019).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnvWrapper

from edmsim.controllers import from_text
from edmsim.envs.sb3 import EdmVecEnv

LEAST_VARIANCE = 1e-4
"""Of an action that a teacher hardly changes: it counts no more than one it changes by a hundredth (ours)."""
LEAST_RATE = 0.02
"""What is left of the learning rate in the end (ours): it falls with the steps left, so that noise averages out."""


# untyped where the extra is missing
class TaughtVecEnv(VecEnvWrapper):  # type: ignore[misc, unused-ignore]
    """Sub-environments, each with a teacher that observes every window; they record observations and its actions."""

    def __init__(self, venv: EdmVecEnv, teacher: str) -> None:
        super().__init__(venv)
        self._laws = [venv.env.attach_controller(index, from_text(teacher)) for index in range(self.num_envs)]
        self._observations: Any = None
        self._states: list[NDArray[np.float32]] = []
        self._teacher_actions: list[NDArray[np.float32]] = []

    def reset(self) -> Any:
        """Begin an episode, and the teacher, in every sub-environment."""
        self._observations = self.venv.reset()
        for law in self._laws:
            law.begin()
        return self._observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Record the observations and the teachers' actions for them, and run the learner's actions."""
        self._states.append(np.array(self._observations, np.float32))
        self._teacher_actions.append(np.array([law.action() for law in self._laws]))
        self.venv.step_async(actions)

    def step_wait(self) -> Any:
        """Run a step, which the teachers see."""
        self._observations, rewards, done, infos = self.venv.step_wait()
        for index in np.flatnonzero(done):
            self._laws[index].begin()
        return self._observations, rewards, done, infos

    def taken(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return observations (n, entries) and the teacher's actions (n, k) since the last call, and forget them."""
        states, teacher_actions = np.concatenate(self._states), np.concatenate(self._teacher_actions)
        self._states.clear()
        self._teacher_actions.clear()
        return states, teacher_actions


# untyped where the extra is missing
class Imitation(PPO):  # type: ignore[misc, unused-ignore]
    """A learner that cuts as PPO does, and follows a teacher in place of the reward.

    Its environment is a `VecNormalize` of a `TaughtVecEnv`. It keeps all it was shown, a quarter of a kilobyte for a
    decision, and its checkpoints have that, too.
    """

    def _setup_model(self) -> None:
        super()._setup_model()
        self.states: list[NDArray[np.float32]] = getattr(self, "states", [])  # a checkpoint has some
        self.teacher_actions: list[NDArray[np.float32]] = getattr(self, "teacher_actions", [])

    def train(self) -> None:
        """Fit the policy's mean to the teacher's actions so far, each action in units of its own variance."""
        self.policy.set_training_mode(True)
        left = self._current_progress_remaining
        for group in self.policy.optimizer.param_groups:
            group["lr"] = self.lr_schedule(left) * max(left, LEAST_RATE)
        normalise: Any = self.env
        for stored, new in zip((self.states, self.teacher_actions), normalise.venv.taken(), strict=True):
            stored.append(new)
        observations = torch.as_tensor(normalise.normalize_obs(np.concatenate(self.states)))
        teacher_actions = torch.as_tensor(np.concatenate(self.teacher_actions))
        variance = teacher_actions.var(0).clamp(min=LEAST_VARIANCE)
        losses = []
        for _ in range(max(self.n_epochs * len(self.teacher_actions[-1]) // self.batch_size, 1)):
            rows = torch.randint(len(teacher_actions), (self.batch_size,))
            gaussian: Any = self.policy.get_distribution(observations[rows]).distribution
            loss = ((gaussian.mean - teacher_actions[rows]) ** 2 / variance).mean()
            self.policy.optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(self.policy.parameters(), self.max_grad_norm)
            self.policy.optimizer.step()
            losses.append(float(loss.detach()))
        self.logger.record("train/unexplained_share", float(np.mean(losses)))
