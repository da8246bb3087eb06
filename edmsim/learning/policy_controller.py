"""Trained policies as feed controllers, or deciding on passes of parts, as in their environments."""

import math
from contextlib import suppress
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.feed.counts import CountsController
from edmsim.controllers.mcu.firmware.timers import SPEED_UNIT_NM_S
from edmsim.controllers.protocols import FeedCommand, WindowObservation, next_wire, set_up_controller
from edmsim.envs import gap_servo, part_task, path_follower, sub_envs
from edmsim.envs.observation import EXACT, SETUP_ENTRIES, window_of
from edmsim.errors import InputError
from edmsim.geometry import Floats, path_corners
from edmsim.learning import bandit, policy_file
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES, ignition_wait_us, open_V
from edmsim.snapshots import Snapshots

_ONLY = np.zeros(1, np.int64)
FAR_DEVIATIONS = 3.0
"""Limit of a setting's distance from the training's mean, in standard deviations (ours; a uniform draw has 1.7)."""


class PolicyController(Snapshots):
    """Runs a trained policy as in its environment.

    It raises the alarm if a short lasts long enough to end an episode of the environment. In a cut, a policy that
    commands the feed begins where the first pulses find metal; before, the wire approaches it.

    Parameters
    ----------
    policy : Policy
        See `edmsim.learning.policy_file.load`.
    """

    name: ClassVar[str] = "policy"
    STATE: ClassVar[tuple[str, ...]] = (
        "_law", "_law_um_s", "_feed_um_s", "_limit_um_s", "_path_um", "_setting_us", "_rows", "_builder", "_servo",
        "_memory", "_approaching",
    )  # fmt: skip

    def __init__(self, policy: policy_file.Policy) -> None:
        self.policy = policy
        self._family = policy.family()
        self._builder = sub_envs.ObservationBuilder(self._family, 1, EXACT)  # the machine's sensors add their errors
        self._rows: NDArray[np.void] = np.zeros(1, path_follower.SUB_ENV)  # the state of a sub-environment
        self._servo: NDArray[np.void] = np.zeros(1, gap_servo.SERVO)
        self._memory: Floats = policy.fresh_memory()
        residual = policy.card.residual
        self._law = None if residual is None else residual.make()
        self._law_um_s = 0.0
        self._approaching = False
        self._first_us: Floats = np.zeros(2)
        self._machine: Machine | None = None
        self._corner_um: Floats = np.full((1, 1), np.inf)
        self._corner_deg: Floats = np.zeros((1, 1))
        self._feed_um_s = self._limit_um_s = self._start_um = self._path_um = 0.0

    def set_up(self, machine: Machine, points_um: Floats, start_um: float) -> None:
        """Set the machine and the path; called before every leg of the cut."""
        self._start_um = start_um
        corners_um, turns_deg = path_corners(points_um)
        # a corner at infinity is added, so there is always a next one
        self._corner_um = np.append(corners_um, np.inf)[None]
        self._corner_deg = np.append(turns_deg, 0.0)[None]
        self._first_us = np.array([machine.t_on_us, machine.t_period_us])
        self._machine = machine
        if self._law is not None:
            set_up_controller(self._law, machine, points_um, start_um)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a leg, before its first window.

        Raises
        ------
        InputError
            If `set_up` has not been called.
        """
        if self._machine is None:
            raise InputError("the policy controller needs machine and path: call set_up() before reset()")
        self._limit_um_s = max_feed_um_s
        self._approaching = False
        if self._law is not None:
            self._law_um_s = self._law.reset(max_feed_um_s).feed_um_s
        return self._begin(self._start_um)

    def reset_in_air(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a leg of a cut, with an approach if no servo or law moves the wire."""
        first = self.reset(max_feed_um_s)
        self._approaching = self._family.action != "servo" and self._law is None
        return FeedCommand(self._family.first_feed_um_s) if self._approaching else first

    def _begin(self, path_um: float) -> FeedCommand:
        """Begin as at the start of an episode, at a place of the path."""
        assert self._machine is not None
        self._setting_us = tuple(self._first_us.tolist())
        self._feed_um_s = self._family.first_feed_um_s
        self._path_um = path_um
        self._rows[:] = np.zeros((), path_follower.SUB_ENV)
        self._rows[0]["path_um"] = path_um - self._start_um
        self._builder.begin(0, self._rows[0], self._machine)
        gap_servo.begin(self._servo[0], self._feed_um_s)
        self._memory = self.policy.fresh_memory()
        self._decide()
        return self._command()

    def update(self, window: WindowObservation) -> FeedCommand:
        """Return the feed after a window, and the setting if it is among the environment's actions."""
        if self._approaching:
            if window.open >= CountsController.air_share * WINDOW_PULSES:  # as in the law `counts`: no metal is near
                return FeedCommand(min(self._family.max_feed_um_s, self._limit_um_s))
            self._approaching = False
            return self._begin(window.path_um)
        row = self._look(window)
        if abs(window.feed_um_s - self._feed_um_s) > SPEED_UNIT_NM_S * 1e-3:
            self._feed_um_s = window.feed_um_s  # the machine's own, in a dwell for example: actions change that one
        shorted = window.short >= path_follower.SHORTED_SHARE * WINDOW_PULSES
        row["shorted_s"] = row["shorted_s"] + window.duration_s if shorted else 0.0
        if row["shorted_s"] > path_follower.SHORTED_S:
            return FeedCommand(0.0, "persistent short")
        if self._family.action == "servo":
            gap_servo.respond(_ONLY, self._servo, window_of(window), self._limit_um_s, *self._family.servo_gains)
        if self._law is not None:
            self._law_um_s = self._law.update(window).feed_um_s
        if self._builder.sums[0]["duration_ns"] >= round((self._family.decision_s or 0.0) * 1e9):
            self._end_step()
            self._decide()
        return self._command()

    def _end_step(self) -> None:
        """Update the observation with the step's measurements, and begin the next step."""
        self._builder.end_step(_ONLY)
        self._builder.begin_step()

    def wire_lost(self) -> FeedCommand:
        """Continue with the next wire, at the first setting again."""
        row = self._rows[0]
        row["wires_lost"] += 1
        row["shorted_s"] = 0.0
        if self._family.counts_threading and self._machine is not None:
            row["elapsed_ns"] += round(self._machine.base.table.threading_s.value * 1e9)
        self._builder.lose_wire(0, row, self._setting_us)
        self._setting_us = tuple(self._first_us.tolist())
        self._feed_um_s = self._family.first_feed_um_s
        gap_servo.begin(self._servo[0], self._feed_um_s)
        if self._law is not None:
            self._law_um_s = next_wire(self._law, self._limit_um_s).feed_um_s
        if self._family.counts_threading or self._family.decision_s is None:  # a step of the environment ends
            if self._builder.sums[0]["duration_ns"]:
                self._end_step()
            self._decide()
        return self._command()

    def beyond_training(self, machine: Machine) -> list[str]:
        """Name the operator's settings that are far from those of the training."""
        card, texts = self.policy.card, []
        trained = {entry.name: entry for entry in card.observation}
        for setting in SETUP_ENTRIES:
            if (entry := trained.get(setting.name)) is None:  # a policy made in code may name no entries
                continue
            assert setting.value is not None
            value = float(setting.value(machine))
            deviation = math.sqrt(entry.variance + card.epsilon)
            if abs(value - entry.mean) > FAR_DEVIATIONS * deviation:
                size, unit = setting.divisor.split()
                here, mean, spread = (float(size) * each for each in (value, entry.mean, deviation))
                texts.append(
                    f"the {setting.quantity.partition(',')[0]} is {here:.3g} {unit}, but the policy was trained at "
                    f"{mean:.3g} {unit} (standard deviation {spread:.1g}): what it does here was not learned"
                )
        return texts

    @property
    def observation(self) -> NDArray[np.float32]:
        """The policy's observation, the same as in its environment."""
        rows = self._builder.observations(self._rows, self._corner_um, self._corner_deg)
        return np.asarray(rows[0], np.float32)

    @property
    def _setting_us(self) -> tuple[float, float]:
        """On-time and period in force."""
        assert self._machine is not None
        return self._machine.t_on_us, self._machine.t_period_us

    @_setting_us.setter
    def _setting_us(self, setting_us: tuple[float, float]) -> None:
        assert self._machine is not None
        t_on_us, t_period_us = setting_us
        self._machine = self._machine.with_(t_on_us=t_on_us, t_period_us=t_period_us)

    def _look(self, window: WindowObservation) -> np.void:
        """Add a window to the step; return the row that a sub-environment would have."""
        assert self._machine is not None
        row: np.void = self._rows[0]
        row["travel_um"], self._path_um = window.path_um - self._path_um, window.path_um
        row["path_um"] = window.path_um - self._start_um
        row["feed_um_s"], row["setting_us"] = window.feed_um_s, self._setting_us
        row["open_V"], row["wait_us"] = open_V(self._machine), ignition_wait_us(self._machine)
        row["limit_A"] = self._machine.generator.mean_current_limit_A.value
        record = window_of(window)
        row["elapsed_ns"] += record[0]["duration_ns"]
        self._builder.take_scale(0, row)
        self._builder.add(_ONLY, self._rows, record)
        return row

    def _decide(self) -> None:
        """Evaluate the policy, and apply its action."""
        assert self._machine is not None
        action, self._memory = self.policy.act(self.observation, self._memory)
        if self.policy.card.residual is not None:
            action[0] = self.policy.card.residual.action(self._family, self._law_um_s, float(np.float32(action[0])))
        if self._family.action == "servo":
            self._servo["target"] = gap_servo.target_of(action[0], self._family.servo_target_share)
        else:
            feed = float(self._family.next_feed_um_s(np.array([self._feed_um_s]), action[:1])[0])
            self._feed_um_s = min(max(feed, -self._limit_um_s), self._limit_um_s)
        if self._family.knobs:
            self._turn(self._family.setting_us(self._first_us, action[1 : 1 + len(self._family.knobs)]))
        if self._family.offset_um is not None:
            self._rows[0]["offset_um"] = float(np.float32(action[-1])) * self._family.offset_um

    def _command(self) -> FeedCommand:
        """Return the feed in force, and the setting if the policy changes it."""
        if self._family.action == "servo":
            self._feed_um_s = float(self._servo["feed_um_s"][0])
        command = FeedCommand(self._feed_um_s, offset_um=float(self._rows[0]["offset_um"]))
        if not self._family.knobs:
            return command
        t_on_us, t_period_us = self._setting_us
        return command._replace(t_on_us=t_on_us, t_period_us=t_period_us)

    def _turn(self, requested_us: tuple[float, float]) -> None:
        """Apply a setting as the environment would; skip settings that the generator cannot run."""
        assert self._machine is not None
        rounded = self._family.to_detents(*requested_us)
        for setting_us in (rounded, self._family.least_setting_us(self._machine, rounded[0])):
            if setting_us == self._setting_us:
                break
            with suppress(InputError):
                self._setting_us = setting_us
                break


def from_name(name: str) -> bandit.BanditController | PolicyController:
    """Make the controller of a policy from its file or its name under ``models/policies``."""
    file = bandit.find(name)
    return PolicyController(policy_file.load(name)) if file is None else bandit.BanditController(bandit.load(file))


class PassPolicy:
    """Decides on the passes of a part as a policy trained in Part does; see `edmsim.envs.pass_laws.PassLaw`."""

    def __init__(self, policy: policy_file.Policy) -> None:
        self.policy = policy
        self._memory = policy.fresh_memory()

    def begin(self) -> None:
        """Begin a part."""
        self._memory = self.policy.fresh_memory()

    def act(self, observation: NDArray[np.float32]) -> Floats:
        """Return the policy's action for an observation."""
        action, self._memory = self.policy.act(observation, self._memory)
        return action


def passes_from_name(name: str) -> PassPolicy:
    """Make a `PassPolicy` from a policy's file or its name under ``models/policies``."""
    policy = policy_file.load(name)
    if not isinstance(policy.arguments(), part_task.Part):
        raise InputError(f"the policy {name} was trained in {policy.card.env_id}: it decides on windows, not passes")
    return PassPolicy(policy)
