"""Environments in processes of their own, and what they leave behind when they are closed."""

import gc
import multiprocessing
import os
import threading
import time
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np

from edmsim import Machine, Plant
from edmsim.closed_loop.straight import begin

ENV = "edmsim/GapFeed-v2"
SHARED = {"resolution": "fast", "episode_s": 2.0}
COUNT = 2
AGAIN = gym.vector.AutoresetMode.SAME_STEP


def left_open() -> dict[str, int]:
    """Return files, threads and child processes that this process has."""
    gc.collect()
    return {
        "files": len(os.listdir("/proc/self/fd")), "threads": threading.active_count(),
        "children": len(multiprocessing.active_children()),
    }


def make() -> gym.Env[Any, Any]:
    import edmsim.envs  # noqa: F401 - a spawned process has registered nothing yet

    return gym.make(ENV, **SHARED)


def actions(steps: int) -> np.ndarray[Any, Any]:
    return np.random.default_rng(0).uniform(-1, 1, (steps, COUNT, 1)).astype(np.float32)


def in_one_process(steps: int) -> list[float]:
    """Rewards of environments one after the other, seeds 5 and 6, begun again when they end."""
    return _gymnasium(gym.vector.SyncVectorEnv([make] * COUNT, autoreset_mode=AGAIN), steps)


def with_gymnasium(method: str, steps: int) -> list[float]:
    """Rewards of Gymnasium's `AsyncVectorEnv`."""
    return _gymnasium(gym.vector.AsyncVectorEnv([make] * COUNT, context=method, autoreset_mode=AGAIN), steps)


def _gymnasium(env: Any, steps: int) -> list[float]:
    try:
        env.reset(seed=[5 + i for i in range(COUNT)])
        return [float(r) for action in actions(steps) for r in env.step(action)[1]]
    finally:
        env.close()


def with_sb3(method: str, steps: int) -> list[float]:
    """Rewards of stable-baselines3's `SubprocVecEnv`."""
    from stable_baselines3.common.vec_env import SubprocVecEnv

    env = SubprocVecEnv([partial(make) for _ in range(COUNT)], start_method=method)
    try:
        env.seed(5)
        env.reset()
        return [float(r) for action in actions(steps) for r in env.step(action)[1]]
    finally:
        env.close()


KINDS = tuple((kind, method) for method in ("fork", "spawn") for kind in ("AsyncVectorEnv", "SubprocVecEnv"))


def compare(steps: int, kinds: tuple[tuple[str, str], ...] = KINDS) -> dict[str, Any]:
    """Run kinds under fork and spawn; tell which gave the rewards of one process, and what was left open."""
    began = time.monotonic()
    expected = in_one_process(steps)
    with_gymnasium("spawn", 1)  # whatever libraries open once for all
    with_sb3("fork", 1)
    before, same = left_open(), {}
    for kind, method in kinds:
        if kind == "AsyncVectorEnv":
            equal = with_gymnasium(method, steps) == expected
        else:
            equal = bool(np.allclose(with_sb3(method, steps), expected, rtol=1e-6, atol=1e-7))  # float32 there
        same[f"{kind}, {method}"] = equal
    after = left_open()
    return {
        "steps": steps * COUNT, "same_rewards": same, "left": {k: after[k] - before[k] for k in before},
        "wall_s": time.monotonic() - began,
    }


def open_and_close(times: int) -> dict[str, Any]:
    """Make plants and environments, use them, give them up; tell what they left open."""
    began = time.monotonic()

    def once(seed: int) -> None:
        plant: Plant = begin(Machine.load(height_mm=5.0), seed)
        plant.advance()
        env = gym.make_vec(ENV, num_envs=2, vectorization_mode="vector_entry_point", **SHARED)
        env.reset(seed=seed)
        env.step(env.action_space.sample())
        env.close()

    once(0)
    before = left_open()
    for seed in range(times):
        once(seed)
    after = left_open()
    return {"times": times, "left": {k: after[k] - before[k] for k in before}, "wall_s": time.monotonic() - began}
