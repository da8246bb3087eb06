"""Gymnasium's two kinds of environment, single and vector, and a wrapper that records episodes.

Sub-environments step window by window, parts pass by pass. The code of parts is imported only when they are made,
because its import takes longer.
"""

import copy
import os
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from edmsim.controllers import FeedController
from edmsim.envs.arguments import checked_actions, checked_mask, checked_options, one_each, plain
from edmsim.envs.episode import EVERY, AttachedController, EpisodeRecorder, RecordedEpisodes
from edmsim.envs.registry import arguments_with
from edmsim.envs.sub_envs import Batch, SubEnvs
from edmsim.envs.task import EnvArguments, Family
from edmsim.errors import InputError, refuse_unknown
from edmsim.numeric import whole_from, whole_within

if TYPE_CHECKING:
    from edmsim.envs.part_task import Parts

    Engine: TypeAlias = Batch | Parts  # both have the members that Gymnasium's environments need


def engine_of(family: EnvArguments, count: int, threads: int) -> "Engine":
    """Return the engine that runs `count` episodes in parallel."""
    if isinstance(family, Family):
        return Batch(family, count, threads)
    from edmsim.envs.part_task import Part, Parts

    assert isinstance(family, Part)
    return Parts(family, count, threads)


def sub_envs_of(engine: "Engine") -> SubEnvs:
    """Return the sub-environments that step window by window; raises `InputError` for Part, which has none."""
    if isinstance(engine, Batch):
        return engine.sub_envs
    raise InputError(
        "Part is decided on pass by pass: no feed controller or recorder can be attached; edmsim cut --passes "
        "records the same part"
    )


def _spaces_of(family: EnvArguments) -> tuple[gym.spaces.Box[np.float32], ...]:
    """Return the spaces of actions, observations and rewards; rewards have an entry per objective, or one."""
    low, high = (np.array([getattr(e, end) for e in family.entries()], np.float32) for end in ("low", "high"))
    return (
        gym.spaces.Box(-1.0, 1.0, (len(family.action_names),), np.float32),
        gym.spaces.Box(low, high, dtype=np.float32),
        gym.spaces.Box(-np.inf, np.inf, (len(family.objectives) or 1,), np.float32),
    )


def _first(infos: dict[str, Any]) -> dict[str, Any]:
    """Return the infos of the first sub-environment, as Python's own values."""
    return {name: _first(value) if isinstance(value, dict) else value.item(0) for name, value in infos.items()}


# One environment: a vector environment of one sub-environment with the API of Gymnasium's `Env`.

_ONLY = np.zeros(1, np.int64)


RENDER_MODES = ("rgb_array", "human")
RENDER_FPS = 39  # pictures per second at the machine's own pace: a window of the standard setting takes 25.5 ms


def _check_render_mode(mode: str | None) -> str | None:
    """Return a render mode; raises `InputError` if it is unknown."""
    if mode is not None:
        refuse_unknown("render_mode", mode, RENDER_MODES)
    return mode


class _Common:
    """Base of single and vector environments: arguments that `change` replaces, and pictures."""

    family: EnvArguments
    spec: gym.envs.registration.EnvSpec | None
    _batch: "Engine"
    _renderer: Any = None  # a `Renderer`, loaded with the first picture

    def __setattr__(self, name: str, value: Any) -> None:
        """Store the specification with arguments that JSON can write."""
        if name == "spec" and value is not None:
            value.kwargs = plain(value.kwargs)
        super().__setattr__(name, value)

    def change(self, **options: Any) -> None:
        """Change arguments of the next episodes, for a curriculum; a running episode keeps its own.

        Parameters
        ----------
        **options
            Arguments to change; those of spaces or plants cannot change (see `EnvArguments.changed`).
        """
        self.family = self.family.changed(**options)
        self._batch.change(self.family)
        if self.spec is not None:
            self.spec.kwargs |= plain(options)

    def _picture(self, index: int) -> NDArray[np.uint8]:
        from edmsim.envs.render import Renderer

        self._renderer = self._renderer or Renderer()
        picture: NDArray[np.uint8] = self._renderer.picture(self._batch, index)
        return picture

    def _close_window(self) -> None:
        if self._renderer is not None:
            self._renderer.close()


class EdmEnv(_Common, gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Cut metal. A step is a window of 255 pulses, all windows that begin within `Family.decision_s`, or a pass.

    Use ``gymnasium.make("edmsim/GapFeed-v2", ...)``, which makes the subclass `GapFeedEnv`. The subclasses describe
    every entry of action, observation and reward.

    Parameters
    ----------
    task : str or type, optional
        A `Family` or `Part`, its short name or the id of an environment; by default that of the class.
    render_mode : {"rgb_array", "human"}, optional
    **options
        Arguments of the task, in the forms of `EnvArguments.of`.

    Attributes
    ----------
    family : EnvArguments
        The arguments; after `change` those of the next episodes.
    reward_space : gymnasium.spaces.Box
        Space of the reward, one entry per objective, as in MO-Gymnasium.

    Raises
    ------
    InputError
        If an argument is unknown, or a value cannot be used.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium has it
        "render_modes": list(RENDER_MODES), "render_fps": RENDER_FPS,
    }

    task: ClassVar[str | type[EnvArguments]] = ""

    def __init__(
        self, task: str | type[EnvArguments] | None = None, render_mode: str | None = None, **options: Any
    ) -> None:
        self.family: EnvArguments = arguments_with(self.task if task is None else task, **options)
        self.render_mode = _check_render_mode(render_mode)
        self.action_space, self.observation_space, self.reward_space = _spaces_of(self.family)
        self._batch = engine_of(self.family, 1, 1)
        self._of_episode: dict[str, Any] = {}
        self._running = False
        self._started = False

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
        info = self._batch.begin(0, self.np_random, checked.get("machine"), redraw=seed is not None)
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
            If an action does not have the shape of the action space, or is NaN.
        """
        if not self._running:
            why = "the episode has ended" if self._started else "no episode has begun"
            raise gym.error.ResetNeeded(f"{why}: call reset() before step()")
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
        """Return the info of a step or a reset; both have the same keys, because Minari's records need that."""
        info = _first(self._batch.infos())
        return info | self._of_episode | {"drawn": dict(self._of_episode["drawn"])}

    def attach_controller(self, controller: FeedController) -> AttachedController:
        """Attach a feed controller to this environment: see `AttachedController`."""
        return AttachedController(sub_envs_of(self._batch), 0, controller)

    def recorder(self, actions: Sequence[str] | None = None) -> EpisodeRecorder:
        """Return a recorder of the episode that has just begun; `RecordRerun` records with it.

        Parameters
        ----------
        actions : sequence of str, optional
            Names of the entries of the recorded actions; those of the family by default.
        """
        return EpisodeRecorder(sub_envs_of(self._batch), 0, actions)

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
            raise gym.error.ResetNeeded("no episode has begun: call reset() before render()")
        picture = self._picture(0)
        if self.render_mode == "human":
            self._renderer.show(picture)
            return None
        return picture

    def close(self) -> None:
        """Close the window of ``render_mode="human"``, if there is one."""
        self._close_window()


# The native vector environment: the plants of all sub-environments run in one compiled call.

# Arguments that only vector environments have.

_OF_VECTORS = "num_envs", "vectorization_mode", "autoreset_mode", "threads", "max_episode_steps"


class SubEnvView:
    """A sub-environment as a single `EdmEnv`, without `reset`, `step` and `close`, which its vector environment has.

    Other attributes may be set, and are the sub-environment's own. The seed is -1 if the generator was set, as in
    Gymnasium.
    """

    def __init__(self, env: "EdmVectorEnv", index: int) -> None:
        self._env, self._index = env, index
        self._spaces = copy.deepcopy((env.single_action_space, env.single_observation_space, env.reward_space))
        self._random: np.random.Generator | None = None
        self._seed = -1

    action_space = property(lambda self: self._spaces[0], doc="The sub-environment's own, which can be seeded.")
    observation_space = property(lambda self: self._spaces[1], doc="The sub-environment's own.")
    reward_space = property(lambda self: self._spaces[2], doc="The sub-environment's own.")
    metadata = property(lambda self: EdmEnv.metadata, doc="As of a single environment.")
    family = property(lambda self: self._env.family, doc="The arguments in force.")
    render_mode = property(lambda self: self._env.render_mode, doc="As of all sub-environments.")
    unwrapped = property(lambda self: self, doc="The sub-environment itself: there are no wrappers around it.")

    @property
    def spec(self) -> gym.envs.registration.EnvSpec | None:
        """Specification of a single environment with the same arguments."""
        spec = copy.deepcopy(self._env.spec)
        if spec is not None:
            spec.kwargs = {name: value for name, value in spec.kwargs.items() if name not in _OF_VECTORS}
            spec.max_episode_steps = self._env.max_episode_steps
        return spec

    def take(self, name: str, value: Any) -> None:
        """Set an attribute; raises `InputError` if all sub-environments share it."""
        shared = getattr(type(self), name, None)
        fixed = isinstance(shared, property) and shared.fset is None
        if fixed or callable(shared) or name in {f.name for f in fields(self.family)}:
            raise InputError(
                f"{name} cannot be set: the sub-environments share it; give it when making them, or change an "
                "argument of the next episodes by change(...), env_method('change', ...) in stable-baselines3"
            )
        setattr(self, name, value)

    def begin_draws(self, seed: int | None) -> None:
        """Seed the sub-environment's random draws; without a seed, at random."""
        self._random, self._seed = gym.utils.seeding.np_random(seed)

    @property
    def np_random(self) -> np.random.Generator:
        """Generator of the sub-environment's random draws."""
        if self._random is None:
            self.begin_draws(None)
        assert self._random is not None
        return self._random

    @np_random.setter
    def np_random(self, generator: np.random.Generator) -> None:
        self._random, self._seed = generator, -1

    @property
    def np_random_seed(self) -> int:
        """Seed of `np_random`."""
        _ = self.np_random  # creates the generator if there is none
        return self._seed

    def attach_controller(self, controller: FeedController) -> AttachedController:
        """Attach a feed controller to the sub-environment: see `AttachedController`."""
        return self._env.attach_controller(self._index, controller)

    def recorder(self, actions: Sequence[str] | None = None) -> EpisodeRecorder:
        """Return a recorder of the episode that the sub-environment has just begun; see `EdmEnv.recorder`."""
        return self._env.recorder(self._index, actions)

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture of the sub-environment; with ``"human"`` sub-environment 0 is shown, and no other."""
        if self._env.render_mode == "rgb_array":
            return self._env.picture(self._index)
        if self._index == 0:
            self._env.render()
        return None


Flags = NDArray[np.bool_]


class EdmVectorEnv(_Common, gym.vector.VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """Many cuts at once. A step is a window of 255 pulses, all windows within `Family.decision_s`, or a pass.

    Use ``gymnasium.make_vec("edmsim/GapFeed-v2", num_envs=64, vectorization_mode="vector_entry_point", ...)``.
    Sub-environment i, reset with seed s, is bit for bit the single environment reset with seed s + i.

    Parameters
    ----------
    task : str or type
        A `Family` or `Part`, its short name or the id of an environment.
    num_envs : int
    max_episode_steps : int, optional
        Steps after which an episode is truncated, in addition to its time limit; by default none.
    render_mode : {"rgb_array", "human"}, optional
        ``"human"`` shows sub-environment 0.
    autoreset_mode : AutoresetMode
        Gymnasium's three modes. With ``DISABLED``, reset ended episodes with ``options={"reset_mask": ...}``.
    threads : int, optional
        Threads that share a step; by default one per processor. Results do not depend on it.
    **options
        Arguments of the task, in the forms of `EnvArguments.of`.

    Attributes
    ----------
    watch : callable or None
        Called after every step with actions, infos and a mask of ended episodes, before new episodes begin.
    views : tuple of SubEnvView
        The sub-environments as single environments.

    Raises
    ------
    InputError
        If an argument is unknown, or a value cannot be used.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium has it
        **EdmEnv.metadata, "autoreset_mode": gym.vector.AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self, task: str | type[EnvArguments], num_envs: int = 1, *, max_episode_steps: int | None = None,
        render_mode: str | None = None,
        autoreset_mode: gym.vector.AutoresetMode | str = gym.vector.AutoresetMode.NEXT_STEP,
        threads: int | None = None, **options: Any,
    ) -> None:
        num_envs = whole_from("num_envs", num_envs, 1)
        if max_episode_steps is not None:
            max_episode_steps = whole_from("max_episode_steps", max_episode_steps, 1)
        if threads is not None:
            threads = whole_from("threads", threads, 1)
        self.family: EnvArguments = arguments_with(task, **options)
        self.render_mode = _check_render_mode(render_mode)
        refuse_unknown("autoreset_mode", plain(autoreset_mode), [m.value for m in gym.vector.AutoresetMode])
        self.autoreset_mode = gym.vector.AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps
        self.single_action_space, self.single_observation_space, self.reward_space = _spaces_of(self.family)
        self._action_shape = (num_envs, *(self.single_action_space.shape or ()))
        self.action_space = gym.vector.utils.batch_space(self.single_action_space, num_envs)
        self.observation_space = gym.vector.utils.batch_space(self.single_observation_space, num_envs)
        self._batch = engine_of(self.family, num_envs, threads or os.cpu_count() or 1)
        self._elapsed = np.zeros(num_envs, np.int64)
        self._started: Flags = np.zeros(num_envs, np.bool_)
        self._ended: Flags = np.zeros(num_envs, np.bool_)
        self.views = tuple(SubEnvView(self, index) for index in range(num_envs))
        self.watch: Callable[[NDArray[np.float32], dict[str, Any], Flags], None] | None = None

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin episodes.

        Parameters
        ----------
        seed : int or sequence of int or None, optional
            Sub-environment i gets seed + i, or the sequence's i-th; without a seed, its generator is not reset.
        options : dict, optional
            ``"reset_mask"``: bool array (num_envs,), the sub-environments to reset, by default all. ``"machine"``: an
            `edmsim.Machine` to cut with instead of a drawn one.

        Raises
        ------
        InputError
            If seeds, mask or options cannot be used.
        """
        checked = checked_options(options, ("machine", "reset_mask"))
        seeds = self._seeds(seed)
        mask = checked_mask(checked.get("reset_mask"), self.num_envs)
        first = seeds[0]
        if first is not None:
            super().reset(seed=first)
        for index in np.flatnonzero(mask):
            if seeds[index] is not None:
                self.views[index].begin_draws(seeds[index])
        infos = self._begin(mask, checked.get("machine"), np.array([s is not None for s in seeds]))
        return self._batch.observations(), infos

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, str) or not isinstance(seed, Sequence | np.ndarray) or getattr(seed, "ndim", 1) == 0:
            first = whole_from("seed", seed, 0)
            return [first + index for index in range(self.num_envs)]
        each = one_each("seeds", list(seed), self.num_envs)
        return [None if one is None else whole_from("seed", one, 0) for one in each]

    def _begin(self, mask: Flags, machine: Any = None, redraw: Flags | None = None) -> dict[str, Any]:
        infos: dict[str, Any] = {}
        for index in np.flatnonzero(mask):
            random, again = self.views[index].np_random, redraw is not None and bool(redraw[index])
            info = self._batch.begin(int(index), random, machine, redraw=again)
            infos = self._add_info(infos, info, int(index))
        self._elapsed[mask] = 0
        self._started[mask] = True
        self._ended[mask] = False
        return infos

    def step(self, actions: NDArray[np.float32]) -> tuple[NDArray[np.float32], Any, Flags, Flags, dict[str, Any]]:
        """Run a step in every sub-environment.

        Returns
        -------
        observations, rewards, terminated, truncated, infos
            Rewards are float64 (num_envs,), or with objectives float32 (num_envs, objectives).

        Raises
        ------
        gymnasium.error.ResetNeeded
            Before the first reset of a sub-environment, or with ``DISABLED`` after its episode's end.
        gymnasium.error.InvalidAction
            If an action does not have the shape of the action space, or is NaN.
        """
        if not self._started.all():
            raise gym.error.ResetNeeded("not every environment has begun an episode: call reset() before step()")
        actions = checked_actions(actions, self._action_shape)
        running = ~self._ended
        active = running.nonzero()[0]
        others = ~running if len(active) < self.num_envs else None
        if others is not None and self.autoreset_mode is gym.vector.AutoresetMode.DISABLED:
            ended = np.flatnonzero(others).tolist()
            raise gym.error.ResetNeeded(f"sub-environments {ended} have ended: reset them with options['reset_mask']")
        reward = self._batch.step(active, actions)
        terminated = self._batch.ended & running
        truncated = self._batch.out_of_time & running & ~terminated
        if self.max_episode_steps is not None:
            self._elapsed[active] += 1
            truncated[active] |= self._elapsed[active] >= self.max_episode_steps
        infos = _masked(self._batch.infos(), running, others)
        self._ended = terminated | truncated
        if self.watch is not None:
            self.watch(actions, infos, self._ended)
        if others is not None:
            infos.update(self._begin(others))  # resets and steps have infos with different names
        elif self._ended.any() and self.autoreset_mode is gym.vector.AutoresetMode.SAME_STEP:
            infos = self._begin_at_once(infos, self._ended.copy())
        if self.render_mode == "human":
            self.render()
        reward_out = reward.astype(np.float32) if self.family.objectives else reward
        return self._batch.observations(), reward_out, terminated, truncated, infos

    def attach_controller(self, index: int, controller: FeedController) -> AttachedController:
        """Attach a feed controller to a sub-environment: see `AttachedController`."""
        return AttachedController(sub_envs_of(self._batch), self._checked(index), controller)

    def recorder(self, index: int, actions: Sequence[str] | None = None) -> EpisodeRecorder:
        """Return a recorder of the episode that a sub-environment has just begun; see `EdmEnv.recorder`."""
        return EpisodeRecorder(sub_envs_of(self._batch), self._checked(index), actions)

    def _checked(self, index: int) -> int:
        """Return the number of a sub-environment; raises `InputError` if it does not exist."""
        return whole_within("index", index, 0, self.num_envs - 1)

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of every environment, or return an attribute of each, as Gymnasium's `SyncVectorEnv` does.

        `change` changes all, and is called once.
        """
        if name == "change":
            self.change(*args, **kwargs)
            return (None,) * self.num_envs
        found = (getattr(view, name) for view in self.views)
        return tuple(value(*args, **kwargs) if callable(value) else value for value in found)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return an attribute of every sub-environment, as of a single environment: spaces, generator and so on."""
        return tuple(getattr(view, name) for view in self.views)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of every sub-environment; a list or tuple has a value for each.

        Raises
        ------
        InputError
            If the attribute is shared, or the number of values is wrong.
        """
        for view, value in zip(self.views, one_each("values", values, self.num_envs), strict=True):
            view.take(name, value)

    def _begin_at_once(self, infos: dict[str, Any], ended: Flags) -> dict[str, Any]:
        """Begin the next episodes in the same step; final_obs and final_info are those of the ended ones."""
        last = self._batch.observations()
        final = np.full(self.num_envs, None, dtype=object)
        for index in np.flatnonzero(ended):
            final[index] = last[index]
        final_info, infos = _only(infos, ended), _only(infos, ~ended)
        infos["final_obs"], infos["_final_obs"] = final, ended
        infos["final_info"], infos["_final_info"] = final_info, ended.copy()
        infos.update(self._begin(ended))
        return infos

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return an image of every sub-environment, or show that of sub-environment 0; None without a render mode."""
        if self.render_mode is None:
            gym.logger.warn("render() was called without a render_mode; give one to gymnasium.make_vec")
            return None
        if self.render_mode == "human":
            self._renderer.show(self.picture(0))
            return None
        return tuple(self.picture(index) for index in range(self.num_envs))

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Return an image of a sub-environment."""
        if not self._started.all():
            raise gym.error.ResetNeeded("not every environment has begun an episode: call reset() before render()")
        return self._picture(self._checked(index))

    def close_extras(self, **_: Any) -> None:
        """Shut down the threads and close the window."""
        self._batch.close()
        self._close_window()


def _masked(values: dict[str, Any], mask: Flags, others: Flags | None) -> dict[str, Any]:
    """Return infos, each with the mask of the sub-environments that have it; the others have 0 or None."""
    infos: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            value = _masked(value, mask, others)
        elif others is not None:
            value[others] = None if value.dtype == object else 0
        infos[name], infos[f"_{name}"] = value, mask
    return infos


def _only(infos: dict[str, Any], mask: Flags) -> dict[str, Any]:
    """Return infos with their masks limited to some sub-environments; the arrays of values are not copied."""
    masked: dict[str, Any] = {}
    for name, values in infos.items():
        if not name.startswith("_"):
            masked[name] = _only(values, mask) if isinstance(values, dict) else values
            masked[f"_{name}"] = infos[f"_{name}"] & mask
    return masked


class RecordRerun(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Record every n-th episode: wire, gap and kerf as of a cut, with actions, terms of the reward, costs and counts.

    The first episode is recorded, then every `every`-th. Each has a folder, ``episode-000000`` and so on, with a file
    ``cut.rrd`` for `edmsim view`, written at the episode's end. A recording that a reset or `close` ends early has
    the result "running". Recording changes no episode.

    Parameters
    ----------
    env : gymnasium.Env
        An environment of edmsim, with any wrappers; the recorded actions are those given to this wrapper.
    folder : path
        Created if it is missing; recordings in it are overwritten.
    every : int
        1 records all.
    live : bool
        Whether to show each in rerun's viewer when it ends.

    Attributes
    ----------
    recordings : list of pathlib.Path
        Folders written so far.

    Raises
    ------
    InputError
        If the environment is not edmsim's, the folder cannot be written to, or ``every`` is below 1.

    Examples
    --------
    >>> import gymnasium, edmsim
    >>> env = edmsim.envs.RecordRerun(gymnasium.make("edmsim/GapFeed-v2"), "runs/gap", every=100)  # doctest: +SKIP
    """

    def __init__(self, env: gym.Env[Any, Any], folder: str | Path, every: int = EVERY, live: bool = False) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, folder=str(folder), every=every, live=live)
        gym.Wrapper.__init__(self, env)
        if not isinstance(env.unwrapped, EdmEnv):
            raise InputError(f"RecordRerun records environments of edmsim, and this is {env.unwrapped!r}")
        hint = "without live they are recorded all the same" if live else None
        self._recorded = RecordedEpisodes(folder, every, hint)
        self.recordings: list[Path] = self._recorded.folders
        self._edm: EdmEnv = env.unwrapped
        self._episode = -1
        self._made_with: dict[str, Any] = {}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, and its recording if it is an `every`-th one."""
        self._recorded.end(self._made_with)
        observation, info = self.env.reset(seed=seed, options=options)
        self._episode += 1
        if self._recorded.is_due(self._episode):
            self._recorded.recorder = self._edm.recorder(self._action_names())
            spec = self._edm.spec
            self._made_with = {"environment": "own" if spec is None else spec.id, "episode": self._episode}
            self._made_with |= {} if seed is None else {"seed of the reset": seed}
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Run and record a step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if (recorder := self._recorded.recorder) is not None:
            action_list = np.ravel(action).tolist()
            recorder.step(action_list, info["reward_terms"], info["cost"], info["error_um"], info["area_mm2"])
            if terminated or truncated:
                self._recorded.end(self._made_with)
        return observation, reward, terminated, truncated, info

    def close(self) -> None:
        """Write the recording of a running episode, and close the environment."""
        self._recorded.end(self._made_with)
        self._recorded.close()
        self.env.close()

    def _action_names(self) -> list[str]:
        space, names = self.env.action_space, list(self._edm.family.action_names)
        width = int(np.prod(space.shape or ()))
        return names if width == len(names) and space == self._edm.action_space else (
            [f"action_{k}" for k in range(width)]
        )
