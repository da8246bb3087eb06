"""A trained policy as a feed controller: it is shown, and asked for, what it would be in its environment."""

from __future__ import annotations

from contextlib import suppress
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.mcu.firmware.timers import SPEED_UNIT_NM_S
from edmsim.controllers.protocols import FeedCommand, WindowObservation, tell
from edmsim.envs import observation, servo
from edmsim.envs.knobs import least_setting_us, to_detents
from edmsim.envs.path_follower import SHORTED_S, SHORTED_SHARE
from edmsim.errors import InputError
from edmsim.geometry import CORNER_DEG, Polyline
from edmsim.learning.policy_file import Policy, load
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES, ignition_wait_us, open_V
from edmsim.snapshots import Snapshots

Floats = NDArray[np.float64]
_LANE = np.zeros(1, np.int64)


class PolicyController(Snapshots):
    """Commands what a trained policy would do in its environment.

    Where the environment would end the episode for a short that stays, it raises the alarm.

    Parameters
    ----------
    policy : Policy
        Of `edmsim.learning.policy_file.load`.
    """

    name: ClassVar[str] = "policy"
    STATE = (
        "_law", "_law_um_s", "_feed_um_s", "_limit_um_s", "_path_um", "_shorted_s", "_setting_us", "_offset_um",
        "_lost", "_age_s", "_spent_s", "_broke_at", "_history", "_shown", "_servo", "_memory",
    )  # fmt: skip

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self._family = policy.family()
        width = len(observation.of_a_step(self._family.locates_discharges))
        self._history = np.zeros((1, self._family.history, width), np.float32)
        self._shown: NDArray[np.void] = np.zeros(1, observation.SHOWN)
        self._scale: NDArray[np.void] = np.zeros(1, observation.SCALE)
        self._servo: NDArray[np.void] = np.zeros(1, servo.SERVO)
        self._memory: Floats = policy.fresh_memory()
        residual = policy.card.residual
        self._law = None if residual is None else residual.make()
        self._law_um_s = 0.0
        self._first_us: Floats = np.zeros(2)
        self._machine: Machine | None = None
        self._corner_um: Floats = np.full((1, 1), np.inf)
        self._corner_deg: Floats = np.zeros((1, 1))
        self._feed_um_s = self._limit_um_s = self._start_um = self._path_um = self._shorted_s = 0.0
        self._age_s = self._spent_s = self._broke_at = 0.0
        self._offset_um = 0.0
        self._lost = 0

    def set_up(self, machine: Machine, points_um: Floats, start_um: float) -> None:
        """Take in the set-up and the path; called before every leg of the cut."""
        self._start_um = start_um
        line = Polyline(points_um * 1e-3, closed=False)
        corners = line.corners(CORNER_DEG)
        # a filling at infinity, so that there is always one to look for
        self._corner_um = np.append(line.s[corners] * 1e3, np.inf)[None]
        self._corner_deg = np.append(line.turn_deg[corners], 0.0)[None]
        self._first_us = np.array([machine.t_on_us, machine.t_period_us])
        self._machine = machine
        if self._law is not None:
            tell(self._law, machine, points_um, start_um)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a leg; of it nothing has been seen yet.

        Raises
        ------
        InputError
            If `set_up` was not called before.
        """
        if self._machine is None:
            raise InputError("the policy controller needs machine and path: call set_up() before reset()")
        self._setting_us = tuple(self._first_us.tolist())
        self._limit_um_s = max_feed_um_s
        self._feed_um_s = self._family.first_feed_um_s
        self._path_um, self._shorted_s = self._start_um, 0.0
        self._age_s = self._spent_s = self._broke_at = 0.0
        self._offset_um = 0.0
        self._lost = 0
        self._history[:] = 0.0
        self._shown[:] = np.zeros((), observation.SHOWN)
        servo.begin(self._servo[0], self._feed_um_s)
        self._memory = self.policy.fresh_memory()
        if self._law is not None:
            self._law_um_s = self._law.reset(max_feed_um_s).feed_um_s
        self._decide()
        return self._command()

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed, and setting where the environment has it in its actions, after what a window showed."""
        self._look(window)
        if abs(window.feed_um_s - self._feed_um_s) > SPEED_UNIT_NM_S * 1e-3:
            self._feed_um_s = window.feed_um_s  # the machine ran another one, at a dwell perhaps: change that
        shorted = window.short >= SHORTED_SHARE * WINDOW_PULSES
        self._shorted_s = self._shorted_s + window.duration_s if shorted else 0.0
        if self._shorted_s > SHORTED_S:
            return FeedCommand(0.0, "persistent short")
        if self._family.action == "servo":
            self._respond(window)
        if self._law is not None:
            self._law_um_s = self._law.update(window).feed_um_s
        if self._shown[0]["duration_ns"] >= round((self._family.decision_s or 0.0) * 1e9):
            observation.show(_LANE, self._shown, self._scale, self._family.max_feed_um_s, self._history)
            self._shown[:] = np.zeros((), observation.SHOWN)
            self._decide()
        return self._command()

    def wire_lost(self) -> FeedCommand:
        """Go on with the next wire, which begins at the first setting, as the first one did."""
        t_on_us, t_period_us = self._setting_us
        self._lost += 1
        self._broke_at, self._age_s = max(self._broke_at, t_period_us / t_on_us), 0.0
        self._setting_us = tuple(self._first_us.tolist())
        self._feed_um_s, self._shorted_s = self._family.first_feed_um_s, 0.0
        servo.begin(self._servo[0], self._feed_um_s)
        if self._family.counts_threading:
            self._go_on_by_the_clock()
        return self._command()

    def _go_on_by_the_clock(self) -> None:
        """Let the time of threading pass, and decide anew: where it counts, it ends a step of the environment."""
        assert self._machine is not None
        self._spent_s += self._machine.base.table.threading_s.value
        if self._shown[0]["duration_ns"]:
            observation.show(_LANE, self._shown, self._scale, self._family.max_feed_um_s, self._history)
            self._shown[:] = np.zeros((), observation.SHOWN)
        self._decide()

    def _wires(self) -> NDArray[np.float32]:
        """Entries about the wires, as the environment has them."""
        family = self._family
        lost, spent = self._lost / family.wires, self._spent_s / (family.episode_s or np.inf)
        rows = observation.wires(*(np.array([v]) for v in (lost, self._age_s, spent, self._broke_at)))
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

    def _look(self, window: WindowObservation) -> None:
        """Add a window to what the step showed, as the environment does."""
        assert self._machine is not None
        us, shown = window.duration_s * 1e6, self._shown[0]
        ignited = WINDOW_PULSES - window.short - window.open
        for name, value in (
            ("short", window.short), ("open", window.open), ("ignited", ignited), ("ignitions", ignited),
            ("duration_ns", round(window.duration_s * 1e9)),  # the plant counts whole nanoseconds
            ("voltage_V_us", window.mean_voltage_V * us), ("charge_A_us", window.mean_current_A * us),
            ("delay_us", window.mean_delay_us * ignited if ignited else 0.0),
            ("travel_um", window.path_um - self._path_um), ("fifths", window.fifths),
        ):
            shown[name] += value
        shown["feed_um_s"], shown["t_on_us"], shown["t_period_us"] = window.feed_um_s, *self._setting_us
        scale = self._scale[0]
        scale["open_V"], scale["wait_us"] = open_V(self._machine), ignition_wait_us(self._machine)
        scale["limit_A"] = self._machine.generator.mean_current_limit_A.value
        self._path_um = window.path_um
        self._age_s += window.duration_s
        self._spent_s += window.duration_s

    def _respond(self, window: WindowObservation) -> None:
        """Let the servo answer a window."""
        short, open_ = (np.array([count / WINDOW_PULSES]) for count in (window.short, window.open))
        servo.respond(
            _LANE, self._servo, short, open_, np.array([window.duration_s]), self._limit_um_s,
            *self._family.servo_gains,
        )

    def _decide(self) -> None:
        """Ask the policy, and take up what it wants."""
        assert self._machine is not None
        entries = np.concatenate([self._history.reshape(-1), observation.dials(self._machine)])
        if self._family.knows_corners:
            place = np.array([self._path_um - self._start_um])
            entries = np.append(entries, observation.corners(place, self._corner_um, self._corner_deg)[0])
        if self._family.offset_um is not None:
            entries = np.append(entries, np.float32(self._offset_um / self._family.offset_um))
        if self._family.knows_wires:
            entries = np.append(entries, self._wires())
        action, self._memory = self.policy.act(entries, self._memory)
        if self.policy.card.residual is not None:
            action[0] = self.policy.card.residual.action(self._family, self._law_um_s, float(np.float32(action[0])))
        if self._family.action == "servo":
            self._servo["target"] = servo.target_of(action[0], self._family.servo_target_share)
        else:
            feed = float(self._family.next_feed_um_s(np.array([self._feed_um_s]), action[:1])[0])
            self._feed_um_s = min(max(feed, -self._limit_um_s), self._limit_um_s)
        if self._family.knobs:
            self._turn(self._family.setting_us(self._first_us, action[1 : 1 + len(self._family.knobs)]))
        if self._family.offset_um is not None:
            self._offset_um = float(np.float32(action[-1])) * self._family.offset_um

    def _command(self) -> FeedCommand:
        """Return the feed in force, and the setting where the policy turns knobs."""
        if self._family.action == "servo":
            self._feed_um_s = float(self._servo["feed_um_s"][0])
        command = FeedCommand(self._feed_um_s, offset_um=self._offset_um)
        if not self._family.knobs:
            return command
        t_on_us, t_period_us = self._setting_us
        return command._replace(t_on_us=t_on_us, t_period_us=t_period_us)

    def _turn(self, requested_us: tuple[float, float]) -> None:
        """Take the setting that the environment would take; what the generator refuses is not even asked for."""
        assert self._machine is not None
        detents = self._family.detents_us
        rounded = to_detents(*requested_us, detents)
        for setting_us in (rounded, least_setting_us(self._machine, rounded[0], detents)):
            if setting_us == self._setting_us:
                break
            with suppress(InputError):
                self._setting_us = setting_us
                break


def from_name(name: str) -> PolicyController:
    """Make the controller of a policy: of its file, or of a name under ``models/policies``."""
    return PolicyController(load(name))
