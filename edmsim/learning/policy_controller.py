"""A trained policy as a feed controller: from what its environment would show to what it would do."""

from __future__ import annotations

from contextlib import suppress
from typing import ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.mcu.firmware.timers import SPEED_UNIT_NM_S
from edmsim.controllers.protocols import ControllerState, FeedCommand, WindowObservation
from edmsim.envs import observation
from edmsim.envs.batch import first_feed_um_s, next_feed_um_s, next_setting_us
from edmsim.envs.lanes import least_setting_us, to_detents
from edmsim.envs.path_follower import LANE, SHORTED_S, SHORTED_SHARE
from edmsim.envs.scenarios import CORNER_DEG, Corner
from edmsim.errors import InputError
from edmsim.geometry import Polyline
from edmsim.learning.policy_file import Policy, load
from edmsim.machine.machine import Machine
from edmsim.plant.kernel.state import OPEN, PULSES_PER_WINDOW, SHORT, SPARK, WINDOW

Floats = NDArray[np.float64]

_LANE = np.zeros(1, np.int64)


class PolicyController:
    """Commands what a trained policy would do in its environment.

    Where the environment would end the episode for a short that stays, it raises the alarm.

    Parameters
    ----------
    policy : Policy
        Of `edmsim.learning.policy_file.load`.
    """

    name: ClassVar[str] = "policy"

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self._family = policy.family()
        self._row: NDArray[np.void] = np.zeros(1, LANE)
        self._window: NDArray[np.void] = np.zeros(1, WINDOW)
        self._seen = np.zeros((1, self._family.history, len(observation.MEASURED)), np.float32)
        self._machine: Machine | None = None
        self._corner_um: Floats = np.full((1, 1), np.inf)
        self._corner_deg: Floats = np.zeros((1, 1))
        self._feed_um_s = self._limit_um_s = self._start_um = self._path_um = self._shorted_s = 0.0

    def set_up(self, machine: Machine, points_um: Floats, start_um: float) -> None:
        """Take in the set-up and the path; called before every leg of the cut."""
        self._start_um = start_um
        line = Polyline(points_um * 1e-3, closed=False)
        corners = line.corners(CORNER_DEG)
        # a filling at infinity, so that there is always one to look for
        self._corner_um = np.append(line.s[corners] * 1e3, np.inf)[None]
        self._corner_deg = np.append(line.turn_deg[corners], 0.0)[None]
        generator = machine.generator
        self._row["open_V"] = generator.open_voltage_V.value
        self._row["limit_A"] = generator.mean_current_limit_A.value
        self._row["first_setting_us"] = machine.t_on_us, machine.t_period_us
        self._take_setting(machine)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a leg; of it nothing has been seen yet.

        Raises
        ------
        InputError
            If the controller has not been told the set-up.
        """
        if self._machine is None:
            raise InputError("the policy controller must be told machine and path: call set_up() before reset()")
        first_on_us, first_period_us = (float(us) for us in self._row[0]["first_setting_us"])
        self._take_setting(self._machine.with_(t_on_us=first_on_us, t_period_us=first_period_us))
        self._limit_um_s = max_feed_um_s
        self._feed_um_s = first_feed_um_s(self._family)
        self._path_um, self._shorted_s = self._start_um, 0.0
        self._seen[:] = 0.0
        return self._command()

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed, and setting where the environment has it in its actions, after what a window showed."""
        self._look(window)
        if abs(window.feed_um_s - self._feed_um_s) > SPEED_UNIT_NM_S * 1e-3:
            self._feed_um_s = window.feed_um_s  # the machine ran another one, at a dwell perhaps: change that
        shorted = window.short >= SHORTED_SHARE * PULSES_PER_WINDOW
        self._shorted_s = self._shorted_s + window.duration_s if shorted else 0.0
        if self._shorted_s > SHORTED_S:
            return FeedCommand(0.0, "persistent short")
        return self._command()

    def snapshot(self) -> ControllerState:
        """Everything that changes while cutting."""
        t_on_us, t_period_us = (float(us) for us in self._row[0]["setting_us"])
        return {
            "feed_um_s": self._feed_um_s, "limit_um_s": self._limit_um_s, "path_um": self._path_um,
            "shorted_s": self._shorted_s, "t_on_us": t_on_us, "t_period_us": t_period_us,
            "seen": self._seen.tobytes().hex(),
        }

    def restore(self, state: ControllerState) -> None:
        """Continue where `snapshot` was taken; the set-up must have been told."""
        assert self._machine is not None
        self._feed_um_s, self._limit_um_s, self._path_um, self._shorted_s, t_on_us, t_period_us = (
            float(state[name])
            for name in ("feed_um_s", "limit_um_s", "path_um", "shorted_s", "t_on_us", "t_period_us")
        )
        self._take_setting(self._machine.with_(t_on_us=t_on_us, t_period_us=t_period_us))
        seen = np.frombuffer(bytes.fromhex(cast(str, state["seen"])), np.float32)
        self._seen[:] = seen.reshape(self._seen.shape)

    def _take_setting(self, machine: Machine) -> None:
        """Note the generator's setting in force."""
        wait = machine.generator.ignition_wait_us
        self._machine = machine
        self._row["setting_us"] = machine.t_on_us, machine.t_period_us
        self._row["wait_us"] = machine.t_on_us if wait is None else wait.value

    def _look(self, window: WindowObservation) -> None:
        """Put a window as the environment's own code wants it, and let that see it."""
        us = window.duration_s * 1e6
        ignited = PULSES_PER_WINDOW - window.short - window.open
        one, row = self._window[0], self._row[0]
        one["counts"] = 0
        one["counts"][OPEN], one["counts"][SHORT], one["counts"][SPARK] = window.open, window.short, ignited
        one["duration_ns"] = round(window.duration_s * 1e9)
        one["voltage_us"] = window.mean_voltage_V * us
        one["charge_A_us"] = window.mean_current_A * us
        one["ignitions"] = ignited
        one["delay_us"] = window.mean_delay_us * ignited if ignited else 0.0
        row["feed_um_s"] = window.feed_um_s
        row["travel_um"] = window.path_um - self._path_um
        self._path_um = window.path_um
        observation.see(
            _LANE, self._row, self._window, self._family.max_feed_um_s, observation.LOW, observation.HIGH, self._seen
        )

    def _command(self) -> FeedCommand:
        """Ask the policy."""
        seen = self._seen.reshape(-1)
        if self._family.knows_corners:
            place = np.array([self._path_um - self._start_um])
            seen = np.append(seen, observation.corners(place, self._corner_um, self._corner_deg)[0])
        action = self.policy.action(seen)
        feed = float(next_feed_um_s(self._family, np.array([self._feed_um_s]), action[:1])[0])
        self._feed_um_s = min(max(feed, -self._limit_um_s), self._limit_um_s)
        if not isinstance(self._family, Corner):
            return FeedCommand(self._feed_um_s)
        return FeedCommand(self._feed_um_s, None, *self._setting_us(self._family, action[1:]))

    def _setting_us(self, family: Corner, wanted: Floats) -> tuple[float, float]:
        """Return the setting in force from now on; what the generator refuses is not even asked for."""
        assert self._machine is not None
        asked = to_detents(*next_setting_us(family, self._row[0]["first_setting_us"], wanted))
        for t_on_us, t_period_us in (asked, least_setting_us(self._machine, asked[0])):
            if (t_on_us, t_period_us) == (self._machine.t_on_us, self._machine.t_period_us):
                break
            with suppress(InputError):
                self._take_setting(self._machine.with_(t_on_us=t_on_us, t_period_us=t_period_us))
                break
        return self._machine.t_on_us, self._machine.t_period_us


def from_name(name: str) -> PolicyController:
    """Make the controller of a policy: of its file, or of a name under ``models/policies``.

    Raises
    ------
    InputError
        See `edmsim.learning.policy_file.load`.
    """
    return PolicyController(load(name))
