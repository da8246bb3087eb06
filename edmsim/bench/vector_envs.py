"""Speed of the vector environment, compared with HalfCheetah-v5 and by number of environments and threads."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

import gymnasium as gym
import mujoco
import numpy as np

from edmsim.bench import envs
from edmsim.errors import InputError

COUNTS, THREADS = (1, 4, 16, 64, 256), (1, 2)
"""Numbers of environments and threads of the table."""
ROUNDS = 8
"""Spells of every row of the table; they take turns, as others use the machine too."""


class VectorRate(NamedTuple):
    """One row: windows per second of all environments together, and processor time of one window in us."""

    environments: int
    threads: int
    windows_per_s: float
    processor_us: float


def half_cheetah_comparison() -> dict[str, float]:
    """Steps per second of `envs.NUM_ENVS` environments at ``fast`` and of as many HalfCheetah-v5, timed in turns.

    Raises `InputError` if ``gymnasium[mujoco]`` is not installed, which the extra ``test`` has.
    """
    cheetahs = _half_cheetahs(envs.NUM_ENVS)
    best = [np.inf, np.inf]
    with envs.straight_cuts(envs.NUM_ENVS, "fast") as ours:
        steps = [ours, cheetahs]
        spells = [envs.settled(step) for step in steps]
        for _ in range(envs.SLICES):
            for k, (step, spell) in enumerate(zip(steps, spells, strict=True)):
                best[k] = min(best[k], envs.wall_s(step, spell) / spell)
    names = "vector_env_steps_per_s_fast", "half_cheetah_vector_steps_per_s"
    return {name: envs.NUM_ENVS / step_s for name, step_s in zip(names, best, strict=True)}


def table(counts: Sequence[int] = COUNTS, threads: Sequence[int] = THREADS) -> list[VectorRate]:
    """Return the rows of straight cuts at ``fast``."""
    kinds = [(count, many) for count in counts for many in threads]
    wall_s, processor_s = np.full(len(kinds), np.inf), np.full(len(kinds), np.inf)
    with ExitStack() as opened:
        steps = [opened.enter_context(envs.straight_cuts(count, "fast", many)) for count, many in kinds]
        spells = [envs.settled(step) for step in steps]
        for _ in range(ROUNDS):
            for k, (step, spell) in enumerate(zip(steps, spells, strict=True)):
                start_s = time.process_time()
                wall_s[k] = min(wall_s[k], envs.wall_s(step, spell) / spell)
                processor_s[k] = min(processor_s[k], (time.process_time() - start_s) / spell)
    return [
        VectorRate(count, many, count / float(wall), 1e6 * float(processor) / count)
        for (count, many), wall, processor in zip(kinds, wall_s, processor_s, strict=True)
    ]


def _half_cheetahs(count: int) -> Callable[[], object]:
    """Gymnasium's default vector environment of HalfCheetah-v5, which steps them one after another in one process."""
    try:
        with warnings_unseen():
            env: Any = gym.make_vec("HalfCheetah-v5", num_envs=count, max_episode_steps=-1)
    except (ImportError, gym.error.DependencyNotInstalled) as error:
        raise InputError(
            'HalfCheetah-v5, which the environments are compared with, is missing: pip install "gymnasium[mujoco]"'
        ) from error
    env.reset(seed=0)
    actions = np.full(env.action_space.shape, 0.1, np.float32)
    return lambda: env.step(actions)


@contextmanager
def warnings_unseen() -> Iterator[None]:
    """Silence MuJoCo's warnings about Gymnasium's own models, one per environment."""
    mujoco.set_mju_user_warning(lambda _: None)
    yield
    mujoco.set_mju_user_warning(None)
