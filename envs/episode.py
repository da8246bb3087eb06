"""One episode of an environment without Gymnasium, for controllers that command feeds and settings."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from gymnasium.utils import seeding

from edmsim.controllers import FeedController, WindowObservation
from edmsim.cosim.stops import WORDS, StopCause
from edmsim.envs.arguments import checked_options
from edmsim.envs.environment import AttachedController
from edmsim.envs.recorder import EpisodeRecorder
from edmsim.envs.registry import make_family
from edmsim.envs.reward import StepRewards
from edmsim.envs.sub_envs import SubEnvs
from edmsim.envs.task import Family, Scenario
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.machine.pulse_window import PulseWindow
from edmsim.numeric import finite, whole_from
from edmsim.plant.plant import Plant

_ONLY = np.zeros(1, np.int64)


class StepResult(NamedTuple):
    """Result of a window."""

    observation: WindowObservation  # observation for the controller
    truth: PulseWindow  # true state of the gap, beyond what a real machine measures
    progress_um: float  # length of path cut in the window (see `path_follower.SUB_ENV`)
    area_mm2: float  # this length times the local height
    error_um: float  # distance of the wire's true position from the path
    near: bool  # whether the error counts: with ``near_corner_um`` only near corners
    cause: StopCause  # reason for the episode's end; `StopCause.RUNNING` if it has not ended
    refused: str | None  # reason why the generator refused the setting
    reward: float  # reward, cost: the environment's reward and cost for the window
    cost: float
    late: bool  # whether the episode's time is over

    @property
    def done(self) -> bool:
        """Whether the path's end was reached."""
        return self.cause is StopCause.FINISHED

    @property
    def broken(self) -> bool:
        """Whether the wire broke."""
        return self.cause is StopCause.WIRE_BREAK

    @property
    def limit(self) -> str | None:
        """Another reason for the stop, as in an environment's ``info``."""
        ended = self.over and not (self.done or self.broken)
        return WORDS[self.cause].info if ended else None

    @property
    def over(self) -> bool:
        """Whether the episode has ended."""
        return self.cause is not StopCause.RUNNING


class Task:
    """Run one episode at a time of an environment, bit for bit the same as with Gymnasium's API.

    Parameters
    ----------
    name : str or type
        ``"GapFeed"`` or ``"edmsim/GapFeed-v2"``, and so on; or your own family.
    **options
        Arguments of the environment (see `Family`). Those of action, decision and observation have no effect: a
        controller commands window by window, from a `WindowObservation`.

    Raises
    ------
    InputError
        If a name is unknown or a value cannot be used.

    Examples
    --------
    >>> import edmsim
    >>> task = Task("GapFeed", resolution="fast")
    >>> controller = edmsim.controllers.make("fixed", feed_um_s=20.0)
    >>> seen, command = task.reset(seed=1), controller.reset(task.max_feed_um_s)
    >>> result = task.advance(command.feed_um_s)
    >>> command = controller.update(result.observation)
    """

    def __init__(self, name: str | type[Family], **options: Any) -> None:
        self.family = make_family(name, **options)
        self.max_feed_um_s = self.family.greatest_feed_um_s
        self._sub_envs = SubEnvs(self.family, 1)
        family, self._account = self.family, StepRewards(1)
        self._account.weigh(0, family.reward_weights, family.error_bound_um, family.energy_bound_mJ)
        self._random = np.random.Generator(np.random.PCG64())

    def reset(self, seed: int | None = None, options: Mapping[str, Any] | None = None) -> WindowObservation:
        """Begin the episode of an environment reset with this seed and these options.

        Returns
        -------
        WindowObservation
            An empty one, without pulses.
        """
        checked = checked_options(options, ("machine",))
        if seed is not None:
            self._random = seeding.np_random(whole_from("seed", seed, 0))[0]
        self._sub_envs.begin(0, self.family.draw(self._random, checked.get("machine")))
        return WindowObservation(0.0, 0.0, 0, 0, 0.0, 0.0, math.nan, 0.0, 0.0)

    @property
    def scenario(self) -> Scenario:
        """The present episode: machine, stock, path, what was drawn.

        Raises
        ------
        InputError
            Before the first `reset`.
        """
        return self._sub_envs.scenario(0)

    @property
    def wires_lost(self) -> int:
        """Number of lost wires in the present episode."""
        return int(self._sub_envs.rows[0]["wires_lost"])

    @property
    def machine(self) -> Machine:
        """The set-up, with the generator's setting in force."""
        return self._sub_envs.fleet.plants[0].machine

    @property
    def plant(self) -> Plant:
        """The plant with the remaining metal; a controller must not read it."""
        return self._sub_envs.fleet.plants[0]

    @property
    def total_um(self) -> float:
        """Length of the whole path."""
        return float(self._sub_envs.rows[0]["total_um"])

    @property
    def path_um(self) -> float:
        """Path length the wire has travelled."""
        return float(self._sub_envs.path_um[0])

    @property
    def leg(self) -> tuple[int, float]:
        """Number of the leg the wire is on, from 0, and the length of the legs before it."""
        return self._sub_envs.leg[0], float(self._sub_envs.rows[0]["before_um"])

    @property
    def reward_terms(self) -> dict[str, float]:
        """Terms of the last window's reward by name."""
        return {name: float(values[0]) for name, values in self._account.terms.items()}

    def attach_controller(self, controller: FeedController) -> AttachedController:
        """Attach a feed controller to the episodes: see `edmsim.envs.environment.AttachedController`."""
        return AttachedController(self._sub_envs, 0, controller)

    def recorder(self) -> EpisodeRecorder:
        """Return a recorder of the episode that has just begun; actions are the commands."""
        return EpisodeRecorder(self._sub_envs, 0, ("feed_um_s", "t_on_us", "t_period_us", "offset_um"))

    def advance(
        self, feed_um_s: float, t_on_us: float | None = None, t_period_us: float | None = None, offset_um: float = 0.0
    ) -> StepResult:
        """Run one window.

        Parameters
        ----------
        feed_um_s : float
            Speed along the path, negative backwards; clamped to `max_feed_um_s` in both directions.
        t_on_us, t_period_us : float, optional
            New setting of the generator, rounded to the knobs' detents; a refused setting has no effect.
        offset_um : float
            Offset of the guides to the left of the path.

        Raises
        ------
        InputError
            If a feed, setting or offset is no finite number, before `reset`, or after the episode's end.
        """
        self.scenario  # noqa: B018 - refuses to go on before the first reset
        sub_envs = self._sub_envs
        cause = StopCause(sub_envs.rows[0]["cause"])
        if cause is not StopCause.RUNNING:
            raise InputError(f"the episode has ended ({WORDS[cause].info}): call reset() first")
        feed_um_s, offset_um = finite("feed_um_s", feed_um_s), finite("offset_um", offset_um)
        t_on_us = None if t_on_us is None else finite("t_on_us", t_on_us)
        t_period_us = None if t_period_us is None else finite("t_period_us", t_period_us)
        sub_envs.refused[0] = ""
        if t_on_us is not None or t_period_us is not None:
            now = sub_envs.fleet.plants[0].machine
            on, period = (old if new is None else new
                          for new, old in ((t_on_us, now.t_on_us), (t_period_us, now.t_period_us)))
            sub_envs.set_generator(0, on, period)
        feed = min(max(feed_um_s, -self.max_feed_um_s), self.max_feed_um_s)
        sub_envs.rows[0]["offset_um"] = offset_um
        sub_envs.advance(_ONLY, np.array([feed]))
        return self._result()

    def _result(self) -> StepResult:
        sub_envs, plant = self._sub_envs, self._sub_envs.fleet.plants[0]
        window = plant.window()
        row = sub_envs.rows[0]
        self._account.begin()
        self._account.add(_ONLY, sub_envs.rows, sub_envs.near, sub_envs.fleet.windows)
        return StepResult(
            sub_envs.observation(0), window, float(row["progress_um"]), float(row["area_mm2"]),
            float(row["error_um"]), bool(sub_envs.near[0]), StopCause(row["cause"]), sub_envs.refused[0] or None,
            float(self._account.total[0]), float(self._account.cost[0]), bool(sub_envs.out_of_time[0]),
        )
