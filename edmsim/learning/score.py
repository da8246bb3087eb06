"""What a controller is worth in an environment: its return, cutting rate and broken wires on held-back episodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from edmsim.controllers import FeedController
from edmsim.controllers.feed.setup import tell
from edmsim.envs.registration import EPISODE_STEPS
from edmsim.envs.tasks import Task

HELD_BACK = 1_000_000
"""First seed of the episodes policies are measured on; training's seeds are drawn from 32 bits and meet these by
chance only, one in ten million."""


class Score(NamedTuple):
    """Means over episodes; shares and counts over all of them.

    Attributes
    ----------
    controller, resolution : str
    seeds : int
    mean_return, return_error : float
        Mean of the returns, and its standard error.
    rate_mm2_min : float
        Area cut over machine time.
    error_um : float
        Distance of the wire's true place from the path, mean over the length cut.
    time_s : float
        Machine time of an episode.
    breaks, limits : int
        Episodes that ended by a broken wire, or at another limit.
    """

    controller: str
    resolution: str
    seeds: int
    mean_return: float
    return_error: float
    rate_mm2_min: float
    error_um: float
    time_s: float
    breaks: int
    limits: int


class _Episode(NamedTuple):
    reward: float
    area_mm2: float
    cut_um: float
    error_um2: float
    time_s: float
    broke: bool
    limited: bool


def score(
    env_id: str, controller: Callable[[], FeedController], options: dict[str, Any], *, seeds: int = 20,
    resolution: str = "fast", watch: Callable[[], object] | None = None,
) -> Score:
    """Let a controller cut held-back episodes, the same for every controller.

    Parameters
    ----------
    env_id : str
    controller : callable
        Makes a fresh one.
    options : dict
        Arguments of the environment.
    seeds : int
        Episodes, 2 or more.
    resolution : str
        Instead of that in `options`.
    watch : callable, optional
        Called after every episode.
    """
    task = Task(env_id, **{**options, "resolution": resolution})
    limit = EPISODE_STEPS[type(task.family).__name__]
    made = []
    law = controller()
    for seed in range(HELD_BACK, HELD_BACK + seeds):
        made.append(_run(task, law, seed, limit))
        if watch is not None:
            watch()
    returns = np.array([episode.reward for episode in made])
    cut_um, seconds = sum(e.cut_um for e in made), sum(e.time_s for e in made)
    return Score(
        law.name, resolution, seeds, float(returns.mean()), float(returns.std(ddof=1) / np.sqrt(seeds)),
        60.0 * sum(e.area_mm2 for e in made) / seconds, sum(e.error_um2 for e in made) / cut_um if cut_um else 0.0,
        seconds / seeds, sum(e.broke for e in made), sum(e.limited for e in made),
    )


def _run(task: Task, controller: FeedController, seed: int, limit: int) -> _Episode:
    """Cut one episode."""
    task.reset(seed)
    tell(controller, task.machine, task.scenario.legs_um[0])
    command = controller.reset(task.max_feed_um_s)
    reward = area = cut = error = time_s = 0.0
    for _ in range(limit):
        result = task.advance(command.feed_um_s, command.t_on_us, command.t_period_us)
        reward += result.reward
        area += result.area_mm2
        cut += result.progress_um
        error += result.progress_um * result.error_um
        time_s = result.seen.time_s
        if result.over:
            return _Episode(reward, area, cut, error, time_s, result.broken, result.limit is not None)
        command = controller.update(result.seen)
        if command.alarm is not None:
            reward -= task.family.reward_weights.limit  # giving up is no better than the limit it avoids
            return _Episode(reward, area, cut, error, time_s, False, True)
    return _Episode(reward, area, cut, error, time_s, False, False)
