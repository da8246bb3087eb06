"""Speed of trainings: environment, network and update, compared with HalfCheetah-v5 for one learner (extra ``rl``).

The learner is PPO of stable-baselines3 with the settings in docs/training.md. It steps all environments of edmsim in
one compiled call, and those of HalfCheetah-v5 in turn in one process.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym

from edmsim.bench.figures import half_cheetahs
from edmsim.errors import InputError

try:
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.logger import Logger
    from stable_baselines3.common.vec_env import DummyVecEnv, VecEnvWrapper, VecNormalize

    from edmsim.envs.sb3 import make_sb3_vec_env
except ImportError as error:
    raise InputError(f"the speed of trainings needs {error.name}: pip install 'edmsim[rl]'") from error

ENV_ID = "edmsim/GapFeed-v2"
COUNTS = (64, 256)
"""Numbers of environments."""
ROLLOUT, BATCH, EPOCHS = 64, 2048, 5
"""Steps of each environment between two updates; batch size and epochs of an update."""
SPELLS = 3
"""Timed rollouts with their updates; the fastest counts, because other programs use the machine, too."""


class _Timed(VecEnvWrapper):
    """Sub-environments with the total time of their steps."""

    spent_s = 0.0

    def reset(self) -> Any:
        return self.venv.reset()

    def step_wait(self) -> Any:
        start_s = time.perf_counter()
        found = self.venv.step_wait()
        self.spent_s += time.perf_counter() - start_s
        return found


def measure(watch: Callable[[str], None], counts: Sequence[int] = COUNTS) -> dict[str, float]:
    """Return steps per second of trainings (wall-clock time), and the environments' share of that time."""
    found: dict[str, float] = {}
    for count in counts:
        watch(f"first rollouts of {count} environments")
        with half_cheetahs():
            cheetahs = DummyVecEnv([lambda: gym.make("HalfCheetah-v5")] * count)
        ours = make_sb3_vec_env(ENV_ID, num_envs=count, seed=0, machine_episodes=4)
        both = {"training": _Training(ours), "half_cheetah_training": _Training(cheetahs)}
        for spell in range(SPELLS):
            watch(f"{count} environments, {spell + 1} of {SPELLS}")
            for training in both.values():  # by turns, so that neither always runs on the warmer machine
                training.spell()
        for name, training in both.items():
            found[f"{name}_steps_per_s_{count}"] = training.steps_per_s
            found[f"{name}_env_share_{count}"] = training.env_share
            training.vec_env.close()
    return found


class _Training:
    """A learner after its first rollout: rate of its fastest spell, and the environments' share of its time."""

    def __init__(self, vec_env: Any) -> None:
        torch.set_num_threads(1)  # as in a training
        self.vec_env = _Timed(vec_env)
        around = VecNormalize(self.vec_env)
        self._model = PPO("MlpPolicy", around, n_steps=ROLLOUT, batch_size=BATCH, n_epochs=EPOCHS, device="cpu")
        self._model.set_logger(Logger(None, []))  # the default logger leaves a folder
        self._steps = ROLLOUT * self.vec_env.num_envs
        self._model.learn(self._steps)
        self.steps_per_s = self.env_share = 0.0

    def spell(self) -> None:
        """Time a rollout with its update."""
        self.vec_env.spent_s, start_s = 0.0, time.perf_counter()
        self._model.learn(self._steps, reset_num_timesteps=False)
        took = time.perf_counter() - start_s
        if self._steps / took > self.steps_per_s:
            self.steps_per_s, self.env_share = self._steps / took, self.vec_env.spent_s / took
