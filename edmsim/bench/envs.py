"""Speed of the environments, alone, many at once, and compared with HalfCheetah-v5: figures for ``edmsim bench``."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np

from edmsim.envs.task import MAX_FEED_UM_S
from edmsim.errors import InputError

FEED_UM_S = 28.0
"""Feed of the straight cut that is timed: most pulses spark."""
STANDARD: dict[str, Any] = {
    "action": "speed", "randomise": None, "height_mm": None, "tension": None, "episode_s": None, "length_mm": 30.0,
}
"""The standard set-up, cut for as long as it takes to time it."""
NUM_ENVS = 64
SETTLE_STEPS = 400
"""Steps before timing, until the wire cuts a full kerf."""
KNOB_STEPS, RESETS, EPISODES = 100, 50, 4
SLICE_S, SLICES = 0.05, 20
"""Spells of timing per figure, whose best counts, equally long for every environment: a short spell finds a quiet
moment of the computer more easily than a long one."""


def env_steps_per_s(resolution: str = "default") -> float:
    """Steps per second of processor time of one environment of `gymnasium.make`, in a straight cut."""
    env = gym.make("edmsim/GapFeed-v2", resolution=resolution, **STANDARD)
    env.reset(seed=0)
    action = np.array([FEED_UM_S / MAX_FEED_UM_S], np.float32)
    rate = _best_rate(lambda: env.step(action), processor_s)
    env.close()
    return rate


def vector_env_steps_per_s(resolution: str = "default", num_envs: int = NUM_ENVS) -> float:
    """Steps per second of all of the native vector environment together, in straight cuts on all processors."""
    with straight_cuts(num_envs, resolution) as step:
        return num_envs * _best_rate(step, wall_s)


@contextmanager
def straight_cuts(num_envs: int, resolution: str, threads: int | None = None) -> Iterator[Callable[[], object]]:
    """Give the step of a vector environment at the feed of the benchmark."""
    env = gym.make_vec(
        "edmsim/GapFeed-v2", num_envs=num_envs, vectorization_mode="vector_entry_point", resolution=resolution,
        threads=threads, **STANDARD,
    )
    with closing(env):
        env.reset(seed=0)
        actions = np.full((num_envs, 1), FEED_UM_S / MAX_FEED_UM_S, np.float32)
        yield lambda: env.step(actions)


def turned_knobs_cost() -> float:
    """Processor time of a step in which two knobs of the generator turn at random, over that of one at rest.

    Of 32 drawn machines at resolution ``fast``; the wire cuts in both.
    """
    env = gym.make_vec(
        "edmsim/Corner-v2", num_envs=32, vectorization_mode="vector_entry_point", resolution="fast", action="change",
        knobs=("on_time", "duty_factor"),
    )
    env.reset(seed=0)
    turns = np.random.default_rng(0).normal(0.0, 0.35, (KNOB_STEPS, *(env.action_space.shape or ())))
    turns = np.clip(turns, -1.0, 1.0).astype(np.float32)
    turns[..., 0] = 0.0  # the feed

    def timed(share: float) -> float:
        started = time.process_time()
        for actions in turns * np.float32(share):
            env.step(actions)
        return time.process_time() - started

    rest, turned = (min(values) for values in zip(*((timed(0.0), timed(1.0)) for _ in range(3)), strict=True))
    env.close()
    return float(turned / rest)


def drawn_machines() -> dict[str, float]:
    """Return the processor time of a reset that draws another machine, and its share of an episode's."""
    drawn, reused = (gym.make("edmsim/GapFeed-v2", resolution="fast", machine_episodes=n) for n in (1, 2 * RESETS))
    for env in (drawn, reused):
        env.reset(seed=0)
    drawn_s, reused_s = (_timed_s(env.reset, RESETS) for env in (drawn, reused))
    action = np.zeros(reused.action_space.shape or (), np.float32)

    def episode() -> None:
        reused.reset()
        over = False
        while not over:
            *_, terminated, truncated, _ = reused.step(action)
            over = terminated or truncated

    episode_s = _timed_s(episode, EPISODES)
    return {"drawn_reset_ms": drawn_s * 1e3, "drawn_machines_cost": (episode_s - reused_s + drawn_s) / episode_s}


def _timed_s(run: Callable[[], object], times: int) -> float:
    """Return the processor time of one of several runs."""
    started = time.process_time()
    for _ in range(times):
        run()
    return (time.process_time() - started) / times


def _best_rate(step: Callable[[], object], taken_s: Callable[[Callable[[], object], int], float]) -> float:
    steps = settled(step)
    return steps / min(taken_s(step, steps) for _ in range(SLICES))


def settled(step: Callable[[], object]) -> int:
    """Run environments to a steady state, and return the number of steps per spell."""
    return max(1, round(SLICE_S / wall_s(step, SETTLE_STEPS) * SETTLE_STEPS))


def processor_s(step: Callable[[], object], steps: int) -> float:
    """Return the processor time of some steps together."""
    return _timed_s(step, steps) * steps


def wall_s(step: Callable[[], object], steps: int) -> float:
    """Return how long some steps take together."""
    started = time.perf_counter()
    for _ in range(steps):
        step()
    return time.perf_counter() - started


def half_cheetah_comparison() -> dict[str, float]:
    """Steps per second of `NUM_ENVS` environments at ``fast`` and of as many HalfCheetah-v5, timed in turns.

    Raises `InputError` if ``gymnasium[mujoco]`` is not installed, which the extra ``test`` has.
    """
    cheetahs = _half_cheetahs(NUM_ENVS)
    best = [np.inf, np.inf]
    with straight_cuts(NUM_ENVS, "fast") as ours:
        steps = [ours, cheetahs]
        spells = [settled(step) for step in steps]
        for _ in range(SLICES):
            for k, (step, spell) in enumerate(zip(steps, spells, strict=True)):
                best[k] = min(best[k], wall_s(step, spell) / spell)
    names = "vector_env_steps_per_s_fast", "half_cheetah_vector_steps_per_s"
    return {name: NUM_ENVS / step_s for name, step_s in zip(names, best, strict=True)}


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
