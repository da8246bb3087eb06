"""Gymnasium's two kinds of environment, single and vector, and what runs their episodes.

Sub-environments step window by window, parts pass by pass. Parts are loaded where they are made: what cuts programs
takes longer to load than sub-environments.
"""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from edmsim.controllers import FeedController, SeesTruth, from_text
from edmsim.controllers.protocols import FeedCommand, check_command, next_wire, tell
from edmsim.controllers.user_controllers import check_is_controller, rehearsed
from edmsim.envs.arguments import checked_actions, checked_options, plain
from edmsim.envs.recorder import EpisodeRecorder
from edmsim.envs.registry import arguments_with
from edmsim.envs.render import RENDER_FPS, RENDER_MODES, Renderer, check_render_mode
from edmsim.envs.sub_envs import Batch, SubEnvs
from edmsim.envs.task import EnvArguments, Family
from edmsim.errors import InputError, refuse_unknown
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.numeric import whole_from, whole_within

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmsim.envs.part_task import Parts

    Engine: TypeAlias = Batch | Parts  # both have the members that Gymnasium's environments need


# A feed controller that watches a sub-environment: it sees what a machine shows, and says what it would command.


def as_action(
    family: Family, controller: FeedController, command: FeedCommand, first_us: Sequence[float],
    now_us: Sequence[float], feed_um_s: float,
) -> NDArray[np.float32]:
    """Return the action within -1..1 for what a controller wants; refuse where the environment has none."""
    if family.action == "servo":
        low, high = family.servo_target_share
        entries = [2.0 * (target_share(controller) - low) / (high - low) - 1.0]
    elif family.action == "speed":
        entries = [command.feed_um_s / family.max_feed_um_s]
    else:
        entries = [(command.feed_um_s - feed_um_s) / family.max_change_um_s]
    on_us, period_us = (
        now if chosen is None else chosen
        for chosen, now in zip((command.t_on_us, command.t_period_us), now_us, strict=True)
    )
    octaves = {"on_time": math.log2(on_us / first_us[0]), "period": math.log2(period_us / first_us[1])}
    octaves["duty_factor"] = octaves["period"] - octaves["on_time"]
    if not family.knobs and any(octaves.values()):
        raise _has_no(controller, "turns the generator's knobs")
    entries += [octaves[name] / family.setting_octaves for name in family.knobs]
    if family.offset_um is not None:
        entries.append(command.offset_um / family.offset_um)
    elif command.offset_um:
        raise _has_no(controller, "commands an offset")
    return np.clip(np.array(entries, np.float32), -1.0, 1.0)


def check_acts(family: Family, name: str) -> None:
    """Refuse a controller before it acts whose commands are no actions of the environment."""
    controller = from_text(name)
    if family.action == "servo":
        target_share(controller)
    usual, commands = Machine.load(), rehearsed(lambda: from_text(name), family.greatest_feed_um_s)
    settings_us = {each_us for command in commands for each_us in (command.t_on_us, command.t_period_us)}
    if not family.knobs and not settings_us <= {None, usual.t_on_us, usual.t_period_us}:
        raise _has_no(controller, "turns the generator's knobs")
    if family.offset_um is None and any(command.offset_um for command in commands):
        raise _has_no(controller, "commands an offset")


def _has_no(controller: FeedController, what: str) -> InputError:
    return InputError(f"{controller.name} {what}, and this environment has none: leave it out")


def target_share(controller: FeedController) -> float:
    """Return the share of open pulses that a controller holds; raises `InputError` where it holds none."""
    target: float | None = getattr(controller, "open_target_share", None)
    if target is None:
        raise InputError(f"{controller.name} holds no share of open pulses: the environment's servo asks for one")
    return target


class AttachedController:
    """A feed controller that is shown every window until `stop`; whether its commands are run is up to the caller."""

    def __init__(self, sub_envs: SubEnvs, index: int, controller: FeedController) -> None:
        self._sub_envs, self._index, self._controller = sub_envs, index, check_is_controller(controller)
        # asked once, as it takes a tenth of a window
        self._seer = controller if isinstance(controller, SeesTruth) else None
        self._leg = self._lost = 0
        self.latest = FeedCommand(0.0)  # what it answered to the last window, on the leg and with the wire of then
        sub_envs.watchers.append((index, self._see))

    def stop(self) -> None:
        """Detach the controller."""
        self._sub_envs.watchers.remove((self._index, self._see))

    @property
    def _family(self) -> Family:
        return self._sub_envs.families[self._index]

    def begin(self) -> FeedCommand:
        """Begin the leg that the sub-environment is on; returns the command for its first window."""
        sub_envs, index = self._sub_envs, self._index
        scenario = sub_envs.scenario(index)
        self._leg, self._lost = sub_envs.leg[index], int(sub_envs.rows[index]["wires_lost"])
        start_um = float(sub_envs.rows[index]["before_um"])
        tell(self._controller, scenario.machine, scenario.legs_um[self._leg], start_um)
        self._take(self._controller.reset(self._family.greatest_feed_um_s))
        return self.latest

    def command(self) -> FeedCommand:
        """Return what it commands for the next window, after all that the sub-environment has had."""
        sub_envs, index = self._sub_envs, self._index
        if self._leg != sub_envs.leg[index]:
            return self.begin()
        if self._lost != sub_envs.rows[index]["wires_lost"]:
            self._lost = int(sub_envs.rows[index]["wires_lost"])
            self._take(next_wire(self._controller, self._family.greatest_feed_um_s))
        return self.latest

    def action(self) -> NDArray[np.float32]:
        """Return the action of the environment that commands what it wants: see `as_action`."""
        row, machine = self._sub_envs.rows[self._index], self._sub_envs.scenario(self._index).machine
        first_us = machine.t_on_us, machine.t_period_us
        now_us, feed_um_s = row["setting_us"].tolist(), float(row["feed_um_s"])
        return as_action(self._family, self._controller, self.command(), first_us, now_us, feed_um_s)

    def _see(self) -> None:
        """Show it the window that the sub-environment has just had."""
        self.command()  # a leg or wire that the last window ended is over before this one
        window = self._sub_envs.fleet.plants[self._index].window()
        if window.pulses != WINDOW_PULSES:
            return
        if self._seer is not None:
            self._seer.see(window)
        self._take(self._controller.update(self._sub_envs.observation(self._index)))

    def _take(self, command: FeedCommand) -> None:
        self.latest = check_command(self._controller.name, command)


def engine_of(family: EnvArguments, count: int, threads: int) -> Engine:
    """Return what runs `count` episodes side by side."""
    if isinstance(family, Family):
        return Batch(family, count, threads)
    from edmsim.envs.part_task import Part, Parts

    assert isinstance(family, Part)
    return Parts(family, count, threads)


def sub_envs_of(engine: Engine) -> SubEnvs:
    """Return the sub-environments that step window by window; raises `InputError` where there are none."""
    if isinstance(engine, Batch):
        return engine.sub_envs
    raise InputError(
        "Part is decided on pass by pass: no feed controller can look on, and no recorder; edmsim cut --passes "
        "records the same part"
    )


def _spaces_of(family: EnvArguments) -> tuple[gym.spaces.Box[np.float32], ...]:
    """Return the spaces of actions, observations and rewards: of these as many as objectives, or one."""
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


class _Common:
    """What a single and a vector environment have in common: arguments that `change` replaces, and pictures."""

    family: EnvArguments
    spec: gym.envs.registration.EnvSpec | None
    _batch: Engine
    _renderer: Renderer

    def __setattr__(self, name: str, value: Any) -> None:
        """Keep the specification in a form that JSON can write."""
        if name == "spec" and value is not None:
            value.kwargs = plain(value.kwargs)
        super().__setattr__(name, value)

    def change(self, **options: Any) -> None:
        """Change arguments of the next episodes, for a curriculum; an episode that runs keeps its own.

        Parameters
        ----------
        **options
            Arguments to change; those that make spaces or plants cannot change (see `EnvArguments.changed`).
        """
        self.family = self.family.changed(**options)
        self._batch.change(self.family)
        if self.spec is not None:
            self.spec.kwargs |= plain(options)

    def _picture(self, index: int) -> NDArray[np.uint8]:
        from edmsim.envs.pictures import picture

        return picture(self._batch, index, self._renderer)


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
        Its arguments, in the forms of `EnvArguments.of`.

    Attributes
    ----------
    family : EnvArguments
        The arguments; after `change` those of the next episodes.
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
        self.action_space, self.observation_space, self.reward_space = _spaces_of(self.family)
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
        return EpisodeRecorder(sub_envs_of(self._batch), 0, self.family.action_names if actions is None else actions)

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
        picture = self._picture(0)
        if self.render_mode == "human":
            self._renderer.show(picture)
            return None
        return picture

    def close(self) -> None:
        """Close the window of ``render_mode="human"``, if there is one."""
        self._renderer.close()


# The native vector environment: the plants of all sub-environments run in one compiled call.

# A sub-environment of a vector environment as the single environment that it stands for.

_OF_VECTORS = "num_envs", "vectorization_mode", "autoreset_mode", "threads", "max_episode_steps"


class SubEnvView:
    """What a single `EdmEnv` has, of a sub-environment; all step, end and close together, in one vector environment.

    Other attributes may be set, and are the sub-environment's own. The seed is -1 if the generator was set, as
    Gymnasium has it.
    """

    def __init__(self, env: EdmVectorEnv, index: int) -> None:
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
        """Specification of a single environment like it."""
        spec = copy.deepcopy(self._env.spec)
        if spec is not None:
            spec.kwargs = {name: value for name, value in spec.kwargs.items() if name not in _OF_VECTORS}
            spec.max_episode_steps = self._env.max_episode_steps
        return spec

    def take(self, name: str, value: Any) -> None:
        """Set an attribute; refuse what all sub-environments share."""
        shared = getattr(type(self), name, None)
        fixed = isinstance(shared, property) and shared.fset is None
        if fixed or callable(shared) or name in {f.name for f in fields(self.family)}:
            raise InputError(
                f"{name} cannot be set: the sub-environments share it; give it when making them, or change an "
                "argument of the next episodes by change(...), env_method('change', ...) in stable-baselines3"
            )
        setattr(self, name, value)

    def begin_draws(self, seed: int | None) -> None:
        """Seed the sub-environment's draws; without a seed, at random."""
        self._random, self._seed = seeding.np_random(seed)

    @property
    def np_random(self) -> np.random.Generator:
        """Generator of what is drawn."""
        if self._random is None:
            self.begin_draws(None)
        assert self._random is not None
        return self._random

    @np_random.setter
    def np_random(self, generator: np.random.Generator) -> None:
        self._random, self._seed = generator, -1

    @property
    def np_random_seed(self) -> int:
        """Seed of that generator."""
        _ = self.np_random  # it begins if it has not
        return self._seed

    def attach_controller(self, controller: FeedController) -> AttachedController:
        """Return a feed controller's place at the sub-environment: see `AttachedController`."""
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


class EdmVectorEnv(_Common, VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
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
        Its arguments, in the forms of `EnvArguments.of`.

    Attributes
    ----------
    watch : callable or None
        Called after every step with actions, infos and a mask of ended episodes, before new episodes begin.

    Raises
    ------
    InputError
        If a value cannot be used.
    TypeError
        If an argument is unknown.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium has it
        "render_modes": list(RENDER_MODES), "render_fps": RENDER_FPS, "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self, task: str | type[EnvArguments], num_envs: int = 1, *, max_episode_steps: int | None = None,
        render_mode: str | None = None, autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int | None = None, **options: Any,
    ) -> None:
        num_envs = whole_from("num_envs", num_envs, 1)
        if max_episode_steps is not None:
            max_episode_steps = whole_from("max_episode_steps", max_episode_steps, 1)
        if threads is not None:
            threads = whole_from("threads", threads, 1)
        self.family: EnvArguments = arguments_with(task, **options)
        self.render_mode = check_render_mode(render_mode)
        refuse_unknown("autoreset_mode", plain(autoreset_mode), [m.value for m in AutoresetMode])
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps
        self.single_action_space, self.single_observation_space, self.reward_space = _spaces_of(self.family)
        self._action_shape = (num_envs, *(self.single_action_space.shape or ()))
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._batch = engine_of(self.family, num_envs, threads or os.cpu_count() or 1)
        self._elapsed = np.zeros(num_envs, np.int64)
        self._started: Flags = np.zeros(num_envs, np.bool_)
        self._ended: Flags = np.zeros(num_envs, np.bool_)
        self._renderer = Renderer()
        self._views = tuple(SubEnvView(self, index) for index in range(num_envs))
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
        mask = self._mask(checked.get("reset_mask"))
        first = seeds[0]
        if first is not None:
            super().reset(seed=first)
        for index in np.flatnonzero(mask):
            if seeds[index] is not None:
                self._views[index].begin_draws(seeds[index])
        infos = self._begin(mask, checked.get("machine"), np.array([s is not None for s in seeds]))
        return self._batch.observations(), infos

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, str) or not isinstance(seed, Sequence | np.ndarray) or getattr(seed, "ndim", 1) == 0:
            first = whole_from("seed", seed, 0)
            return [first + index for index in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise InputError(f"{len(seed)} seeds were given for {self.num_envs} environments: give one each")
        return [None if one is None else whole_from("seed", one, 0) for one in seed]

    def _mask(self, mask: Any) -> Flags:
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        try:
            array = np.asarray(mask)
        except ValueError:  # lists of several lengths
            array = np.array(None)
        if array.shape != (self.num_envs,) or array.dtype != np.bool_ or not array.any():
            raise InputError(f"reset_mask must be {self.num_envs} truth values, at least one of them true")
        return array

    def _begin(self, mask: Flags, machine: Any = None, redraw: Flags | None = None) -> dict[str, Any]:
        infos: dict[str, Any] = {}
        for index in np.flatnonzero(mask):
            random, again = self._views[index].np_random, redraw is not None and bool(redraw[index])
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
            raise ResetNeeded("not every environment has begun an episode: call reset() before step()")
        actions = checked_actions(actions, self._action_shape)
        running = ~self._ended
        active = running.nonzero()[0]
        others = ~running if len(active) < self.num_envs else None
        if others is not None and self.autoreset_mode is AutoresetMode.DISABLED:
            ended = np.flatnonzero(others).tolist()
            raise ResetNeeded(f"sub-environments {ended} have ended: reset them with options['reset_mask']")
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
            infos.update(self._begin(others))  # the names of resets' infos are other than those of steps
        elif self._ended.any() and self.autoreset_mode is AutoresetMode.SAME_STEP:
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
        names = self.family.action_names if actions is None else actions
        return EpisodeRecorder(sub_envs_of(self._batch), self._checked(index), names)

    def _checked(self, index: int) -> int:
        """Return the number of a sub-environment, checked."""
        return whole_within("index", index, 0, self.num_envs - 1)

    @property
    def views(self) -> tuple[SubEnvView, ...]:
        """The sub-environments as single environments."""
        return self._views

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of every environment, or return an attribute of each, as Gymnasium's `SyncVectorEnv` does.

        `change` changes all, and is called once.
        """
        if name == "change":
            self.change(*args, **kwargs)
            return (None,) * self.num_envs
        found = (getattr(view, name) for view in self._views)
        return tuple(value(*args, **kwargs) if callable(value) else value for value in found)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return an attribute of every sub-environment: spaces, generator and so on are a single environment's."""
        return tuple(getattr(view, name) for view in self._views)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of every sub-environment; a list or tuple has a value for each.

        Raises
        ------
        InputError
            If the attribute is shared, or the number of values is wrong.
        """
        each = values if isinstance(values, list | tuple) else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise InputError(f"{len(each)} values were given for {self.num_envs} environments: give one each")
        for view, value in zip(self._views, each, strict=True):
            view.take(name, value)

    def _begin_at_once(self, infos: dict[str, Any], ended: Flags) -> dict[str, Any]:
        """Begin the next episodes in the same step; final_obs and final_info keep what the last ones showed."""
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
            raise ResetNeeded("not every environment has begun an episode: call reset() before render()")
        return self._picture(self._checked(index))

    def close_extras(self, **_: Any) -> None:
        """Shut down the threads and close the window."""
        self._batch.close()
        self._renderer.close()


def _masked(values: dict[str, Any], mask: Flags, others: Flags | None) -> dict[str, Any]:
    """Return infos, each with the sub-environments that have it; the others, if any, have 0 or None."""
    infos: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            value = _masked(value, mask, others)
        elif others is not None:
            value[others] = None if value.dtype == object else 0
        infos[name], infos[f"_{name}"] = value, mask
    return infos


def _only(infos: dict[str, Any], mask: Flags) -> dict[str, Any]:
    """Return infos of which only some sub-environments' values count; the arrays of values are shared."""
    masked: dict[str, Any] = {}
    for name, values in infos.items():
        if not name.startswith("_"):
            masked[name] = _only(values, mask) if isinstance(values, dict) else values
            masked[f"_{name}"] = infos[f"_{name}"] & mask
    return masked
