"""One environment: a vector of a single lane, as Gymnasium's `Env`."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from edmsim.envs.batch import Batch, action_space_of, observation_space_of
from edmsim.envs.checks import checked_actions, checked_options
from edmsim.envs.path_follower import RUNNING
from edmsim.envs.registry import make_family
from edmsim.envs.render import RENDER_FPS, RENDER_MODES, Renderer, check_render_mode
from edmsim.envs.task import Family

_LANE = np.zeros(1, np.int64)


class EdmEnv(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Cut metal, one window of 255 pulses per step.

    Use ``gymnasium.make("edmsim/GapFeed-v0", ...)``, which makes the subclass `GapFeedEnv`: its description, and that
    of each of the others, has every entry of action, observation and reward.

    Parameters
    ----------
    task : str or type, optional
        A `Family`, its short name or the id of an environment; the class's own if not given.
    render_mode : {"rgb_array", "human"}, optional
    **options
        Fields of the `Family`, in the forms of `Family.of`.

    Attributes
    ----------
    family : Family
        The arguments in force.

    Raises
    ------
    InputError
        A value that cannot be used.
    TypeError
        An unknown argument.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium has it
        "render_modes": list(RENDER_MODES), "render_fps": RENDER_FPS,
    }

    task: ClassVar[str | type[Family]] = ""

    def __init__(
        self, task: str | type[Family] | None = None, render_mode: str | None = None, **options: Any
    ) -> None:
        self.family = make_family(self.task if task is None else task, **options)
        self.render_mode = check_render_mode(render_mode)
        self.action_space = action_space_of(self.family)
        self.observation_space = observation_space_of(self.family)
        self._batch = Batch(self.family, 1)
        self._running = False
        self._begun = False
        self._renderer = Renderer()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode.

        Parameters
        ----------
        seed : int, optional
            Same seed, same episodes from here on; without one, the draws go on.
        options : dict, optional
            ``{"machine": edmsim.Machine}`` cuts with that machine instead of one drawn.
        """
        given = checked_options(options, ("machine",))
        super().reset(seed=seed)
        info = self._batch.begin(0, self.np_random, given.get("machine"))
        self._running = self._begun = True
        if self.render_mode == "human":
            self.render()
        return self._batch.observations()[0], info

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Run one window; truncation is the wrapper's, see ``max_episode_steps`` of `gymnasium.make`.

        Raises
        ------
        gymnasium.error.ResetNeeded
            Before the first reset, or after the episode's end.
        gymnasium.error.InvalidAction
            Another shape than the action space's, or NaN.
        """
        if not self._running:
            why = "the episode has ended" if self._begun else "no episode has begun"
            raise ResetNeeded(f"{why}: call reset() before step()")
        actions = checked_actions(action, self.action_space.shape or ())[None]
        reward = self._batch.step(_LANE, actions)
        terminated = bool(self._batch.lanes.rows[0]["cause"] != RUNNING)
        self._running = not terminated
        info: dict[str, Any] = {name: value[0].item() for name, value in self._batch.infos().items()}
        if not self._batch.ignited()[0]:
            del info["gap_um"]
        info["reward_terms"] = {name: value.item() for name, value in self._batch.reward_terms().items()}
        info |= self._batch.words(0)
        if self.render_mode == "human":
            self.render()
        return self._batch.observations()[0], float(reward[0]), terminated, False, info

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture (height, width, 3), or show it; None without a render mode.

        Raises
        ------
        gymnasium.error.ResetNeeded
            Before the first reset.
        """
        if self.render_mode is None:
            gym.logger.warn("render() was called without a render_mode; give one to gymnasium.make")
            return None
        if not self._begun:
            raise ResetNeeded("no episode has begun: call reset() before render()")
        picture = self._renderer.picture(self._batch.lanes, 0)
        if self.render_mode == "human":
            self._renderer.show(picture)
            return None
        return picture

    def close(self) -> None:
        """Close the window of ``render_mode="human"``, if there is one."""
        self._renderer.close()
