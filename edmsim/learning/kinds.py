"""Kinds of learning besides plain PPO and SAC, as sub-environments and learners of stable-baselines3 (extra ``rl``).

- Imitation of a teacher, which may know the true state, in the states that the learner visits: in every state the
  teacher gives the action it would take, and the policy's mean is fitted to it (DAgger, Ross et al., AISTATS 2011).
  If the teacher knows more than the policy, the policy learns the mean of its actions (Chen et al., CoRL 2019). With
  an LSTM it can identify from its history what the teacher knows (Kumar et al., RSS 2021, adapt a policy so).
- Lagrangian PPO: the reward minus a multiple of ``info["cost"]``. The multiplier grows while the mean cost is above a
  limit, and shrinks below it (Tessler, Mankowitz and Mannor, ICLR 2019, arXiv:1805.11074).
- Privileged critic: it observes gap, wire temperature, debris and drawn constants, which no machine measures. In the
  policy's features they are 0: its actions cannot depend on them, and the exported policy has no weights for them
  (Pinto et al., RSS 2018).
- Residual policies: a classic law sets the feed, and the policy adds a correction (Johannink et al., ICRA 2019).
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from edmsim.controllers import from_text
from edmsim.envs.sb3 import EdmVecEnv
from edmsim.envs.task import Family
from edmsim.learning.policy_file import Residual

LEAST_VARIANCE = 1e-4
"""Of an action that a teacher hardly changes: it counts no more than one it changes by a hundredth (ours)."""
LEAST_RATE = 0.02
"""What is left of the learning rate in the end (ours): it falls with the steps left, so that noise averages out."""


class TaughtVecEnv(VecEnvWrapper):
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


class _Follows(ABC):
    """Follows a teacher in place of the reward, in a `VecNormalize` of a `TaughtVecEnv`; a base before one of PPO."""

    # all decisions so far are stored, a quarter of a kilobyte each, and checkpoints have them, too

    STORED: tuple[str, ...] = ()
    """Further lists that are stored, with an entry for each rollout."""

    def _setup_model(self) -> None:
        super()._setup_model()  # type: ignore[misc]
        for name in ("states", "teacher_actions", *self.STORED):
            setattr(self, name, getattr(self, name, []))  # a checkpoint has some

    def train(self) -> None:
        """Fit the policy's mean to the teacher's actions so far, each action in units of its own variance."""
        learner: Any = self
        learner.policy.set_training_mode(True)
        left = learner._current_progress_remaining
        for group in learner.policy.optimizer.param_groups:
            group["lr"] = learner.lr_schedule(left) * max(left, LEAST_RATE)
        normalise = learner.env
        for stored, new in zip((learner.states, learner.teacher_actions), normalise.venv.taken(), strict=True):
            stored.append(new)
        self.store()
        observations = torch.as_tensor(normalise.normalize_obs(np.concatenate(learner.states)))
        teacher_actions = torch.as_tensor(np.concatenate(learner.teacher_actions))
        variance = teacher_actions.var(0).clamp(min=LEAST_VARIANCE)
        losses = []
        for _ in range(max(learner.n_epochs * len(learner.teacher_actions[-1]) // learner.batch_size, 1)):
            rows, mean = self.drawn(observations)
            loss = ((mean - teacher_actions[rows]) ** 2 / variance).mean()
            learner.policy.optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(learner.policy.parameters(), learner.max_grad_norm)
            learner.policy.optimizer.step()
            losses.append(float(loss.detach()))
        learner.logger.record("train/unexplained_share", float(np.mean(losses)))

    def store(self) -> None:  # noqa: B027 - one without memory has nothing else
        """Store what else the last rollout has."""

    @abstractmethod
    def drawn(self, observations: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw decisions, and return their rows and the policy's means."""


class Imitation(_Follows, PPO):
    """A learner that cuts as PPO does, and follows a teacher in place of the reward."""

    def drawn(self, observations: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw single decisions."""
        rows = torch.randint(len(observations), (self.batch_size,))
        gaussian: Any = self.policy.get_distribution(observations[rows]).distribution
        return rows, gaussian.mean


class RecurrentImitation(_Follows, RecurrentPPO):
    """The same with an LSTM, which learns from whole rollouts and begins each with the memory that it had there.

    The memory of an old rollout is that of the network of then (Kapturowski et al., ICLR 2019, measure the effect).
    """

    STORED = ("memories", "starts")
    memories: list[tuple[NDArray[np.float32], NDArray[np.float32]]]  # LSTM's output and cells, (layers, envs, cells)
    starts: list[NDArray[np.float32]]  # (steps, envs)

    def store(self) -> None:
        """Store the memory at the rollout's beginning, and where episodes began."""
        buffer: Any = self.rollout_buffer
        self.memories.append((buffer.hidden_states_pi[0].copy(), buffer.cell_states_pi[0].copy()))
        self.starts.append(buffer.episode_starts.copy())

    def drawn(self, observations: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw the rollouts of single sub-environments, as many as fill a batch."""
        policy: Any = self.policy
        count = max(int(self.batch_size or 1) // self.n_steps, 1)
        rollouts = torch.randint(len(self.starts), (count,))
        envs = torch.randint(self.n_envs, (count,))
        steps = torch.arange(self.n_steps)
        rows = ((rollouts[:, None] * self.n_steps + steps) * self.n_envs + envs[:, None]).flatten()
        starts = torch.as_tensor(np.concatenate(self.starts)).flatten()[rows]
        pairs = list(zip(rollouts.tolist(), envs.tolist(), strict=True))
        memory = tuple(
            torch.as_tensor(np.stack([self.memories[rollout][part][:, env] for rollout, env in pairs], axis=1))
            for part in (0, 1)
        )
        gaussian = policy.get_distribution(observations[rows], memory, starts)[0].distribution
        return rows, gaussian.mean


class CostVecEnv(VecEnvWrapper):
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


class Multiplier(BaseCallback):
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


TRUTHS = ("gap_um", "wire_temperature_K", "debris", "error_um")
"""Entries of the last window's ``info`` that the critic observes; the episode's drawn constants follow."""


class PrivilegedVecEnv(VecEnvWrapper):
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


class VisibleEntries(BaseFeaturesExtractor):
    """The first entries of an observation unchanged, and 0 in place of the others."""

    def __init__(self, observation_space: gym.spaces.Box[Any], entries: int) -> None:
        width = int(np.prod(observation_space.shape))
        super().__init__(observation_space, width)
        self.shown: torch.Tensor
        self.register_buffer("shown", (torch.arange(width) < entries).float())

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features as wide as the observations."""
        return observations * self.shown


class AsymmetricPolicy(ActorCriticPolicy):
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


class ResidualVecEnv(VecEnvWrapper):
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
            self._feed_um_s[index] = law.begin().feed_um_s
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
            self._feed_um_s[index] = (law.begin() if done[index] else law.command()).feed_um_s
        return observations, rewards, done, infos
