"""One environment: a vector environment of one sub-environment with the API of Gymnasium's `Env`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from edmsim.envs.arguments import checked_actions, checked_options, plain
from edmsim.envs.batch import action_space_of, observation_space_of, reward_space_of
from edmsim.envs.engine import engine_of, picture_of, sub_envs_of
from edmsim.envs.registry import arguments_with
from edmsim.envs.render import RENDER_FPS, RENDER_MODES, Renderer, check_render_mode
from edmsim.envs.task import EnvArguments
from edmsim.numeric import whole_from

if TYPE_CHECKING:
    from edmsim.controllers import FeedController
    from edmsim.envs.attached_controller import AttachedController
    from edmsim.envs.recorder import EpisodeRecorder

_ONLY = np.zeros(1, np.int64)


class EdmEnv(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Cut metal. A step is a window of 255 pulses, all windows that begin within `Family.decision_s`, or a pass.

    Use ``gymnasium.make("edmsim/GapFeed-v2", ...)``, which makes the subclass `GapFeedEnv`. The subclasses describe
    every entry of action, observation and reward.

    Parameters
    ----------
    task : str or type, optional
        A `Family` or `Part`, its short name or the id of an environment; by default that of the class.
    render_mode : {"rgb_array", "human"}, optional
    **options
        Its arguments, in the forms of `EnvArguments.of`.

    Attributes
    ----------
    family : EnvArguments
        The arguments in force.
    reward_space : gymnasium.spaces.Box
        Space of the reward, one entry per objective, as in MO-Gymnasium.

    Raises
    ------
    InputError
        If a value cannot be used.
    TypeError
        If an argument is unknown.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium has it
        "render_modes": list(RENDER_MODES), "render_fps": RENDER_FPS,
    }

    task: ClassVar[str | type[EnvArguments]] = ""

    def __init__(
        self, task: str | type[EnvArguments] | None = None, render_mode: str | None = None, **options: Any
    ) -> None:
        self.family: EnvArguments = arguments_with(self.task if task is None else task, **options)
        self.render_mode = check_render_mode(render_mode)
        self.action_space = action_space_of(self.family)
        self.observation_space = observation_space_of(self.family)
        self.reward_space = reward_space_of(self.family)
        self._batch = engine_of(self.family, 1, 1)
        self._of_episode: dict[str, Any] = {}
        self._running = False
        self._started = False
        self._renderer = Renderer()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode.

        Parameters
        ----------
        seed : int, optional
            The same seed gives the same episodes from here on; without a seed, the generator is not reset.
        options : dict, optional
            ``{"machine": edmsim.Machine}`` cuts with that machine instead of a drawn one.
        """
        checked = checked_options(options, ("machine",))
        super().reset(seed=None if seed is None else whole_from("seed", seed, 0))
        info = self._batch.begin(0, self.np_random, checked.get("machine"), anew=seed is not None)
        self._running = self._started = True
        self._batch.clear()
        self._of_episode = info
        if self.render_mode == "human":
            self.render()
        return self._batch.observations()[0], self._info()

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float32], Any, bool, bool, dict[str, Any]]:
        """Run a step: the windows until the next action.

        Returns
        -------
        observation, reward, terminated, truncated, info
            The reward is a float, or with objectives an array float32 of one for each.

        Raises
        ------
        gymnasium.error.ResetNeeded
            Before the first reset, or after the episode's end.
        gymnasium.error.InvalidAction
            If an action has not the shape of the action space, or is NaN.
        """
        if not self._running:
            why = "the episode has ended" if self._started else "no episode has begun"
            raise ResetNeeded(f"{why}: call reset() before step()")
        batch = self._batch
        actions = checked_actions(action, self.action_space.shape or ())[None]
        reward = batch.step(_ONLY, actions)[0]
        terminated = bool(batch.ended[0])
        truncated = not terminated and bool(batch.out_of_time[0])
        self._running = not (terminated or truncated)
        if self.render_mode == "human":
            self.render()
        reward_out = reward.astype(np.float32) if self.family.objectives else float(reward)
        return batch.observations()[0], reward_out, terminated, truncated, self._info()

    def _info(self) -> dict[str, Any]:
        """Return the info of a step or a reset, which have the same keys: records of Minari want that."""
        batch = self._batch
        info: dict[str, Any] = {name: value[0].item() for name, value in batch.infos().items()}
        info["reward_terms"] = {name: value.item() for name, value in batch.reward_terms().items()}
        info |= {name: value[0] for name, value in batch.words().items()}
        return info | self._of_episode | {"drawn": dict(self._of_episode["drawn"])}

    def attach_controller(self, controller: FeedController) -> AttachedController:
        """Attach a feed controller to this environment: see `AttachedController`."""
        from edmsim.envs.attached_controller import AttachedController

        return AttachedController(sub_envs_of(self._batch), 0, controller)

    def recorder(self, actions: Sequence[str] | None = None) -> EpisodeRecorder:
        """Return a recorder of the episode that has just begun; `RecordRerun` records with it.

        Parameters
        ----------
        actions : sequence of str, optional
            Names of the entries of the recorded actions; those of the family by default.
        """
        from edmsim.envs.recorder import EpisodeRecorder

        return EpisodeRecorder(sub_envs_of(self._batch), 0, self.family.action_names if actions is None else actions)

    def change(self, **options: Any) -> None:
        """Change arguments for the next episodes, for a curriculum.

        Parameters
        ----------
        **options
            Arguments to change; those that make spaces or plants cannot change (see `EnvArguments.changed`).
        """
        self.family = self.family.changed(**options)
        self._batch.change(self.family)

    def render(self) -> NDArray[np.uint8] | None:
        """Return an image (height, width, 3), or show it; None without a render mode.

        Raises
        ------
        gymnasium.error.ResetNeeded
            Before the first reset.
        """
        if self.render_mode is None:
            gym.logger.warn("render() was called without a render_mode; give one to gymnasium.make")
            return None
        if not self._started:
            raise ResetNeeded("no episode has begun: call reset() before render()")
        picture = picture_of(self._batch, self._renderer, 0)
        if self.render_mode == "human":
            self._renderer.show(picture)
            return None
        return picture

    def close(self) -> None:
        """Close the window of ``render_mode="human"``, if there is one."""
        self._renderer.close()

    def __setattr__(self, name: str, value: Any) -> None:
        """Keep the specification that Gymnasium notes in a form that JSON can write."""
        if name == "spec" and value is not None:
            value.kwargs = plain(value.kwargs)
        super().__setattr__(name, value)
