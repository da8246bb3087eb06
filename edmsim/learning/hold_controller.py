"""Feed controller of a trained policy above a law: the law cuts, and the policy sets the heat flux that it holds."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.protocols import FeedCommand, WindowObservation, tell
from edmsim.envs import servo
from edmsim.errors import InputError
from edmsim.learning.held import HeldLaw, flux_law
from edmsim.learning.policy_controller import PolicyController
from edmsim.learning.policy_file import Policy
from edmsim.machine.machine import Machine


class HoldController(PolicyController):
    """Cuts with a law whose heat flux a policy sets after every step of its environment.

    Parameters
    ----------
    policy : Policy
        A policy with a `Card.hold`.
    """

    name: ClassVar[str] = "policy"
    STATE = (*PolicyController.STATE, "_below", "_now_us")

    def __init__(self, policy: Policy) -> None:
        super().__init__(policy)
        if policy.card.hold is None:
            raise InputError("the policy acts by itself: it has no law below it")
        self._hold = policy.card.hold
        self._below = HeldLaw(flux_law(self._hold.law))
        self._now_us = (0.0, 0.0)
        self._law_command = FeedCommand(0.0)

    def set_up(self, machine: Machine, points_um: NDArray[np.float64], start_um: float) -> None:
        """Set the machine and the path; called before every leg of the cut."""
        super().set_up(machine, points_um, start_um)
        tell(self._below.law, machine, points_um, start_um)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a leg, before its first window."""
        self._law_command = self._below.reset(max_feed_um_s)
        return super().reset(max_feed_um_s)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Return the law's command after a window; at the end of a step the policy decides."""
        self._look(window)
        self._law_command = self._below.update(window)
        if self._builder.sums[0]["duration_ns"] >= round((self._family.decision_s or 0.0) * 1e9):
            self._end_step()
            self._decide()
        return self._command()

    def wire_lost(self) -> FeedCommand:
        """Go on with the next wire."""
        self._law_command = self._below.wire_lost()
        return super().wire_lost()

    @property
    def observation(self) -> NDArray[np.float32]:
        """The policy's observation: its environment's, and the law's fluxes."""
        return np.concatenate([super().observation, self._below.shown]).astype(np.float32)

    @property
    def _setting_us(self) -> tuple[float, float]:
        """On-time and period in force; a new machine for every window's period would take most of the time."""
        return self._now_us

    @_setting_us.setter
    def _setting_us(self, setting_us: tuple[float, float]) -> None:
        self._now_us = setting_us

    def _end_step(self) -> None:
        super()._end_step()
        self._below.end_step()

    def _decide(self) -> None:
        """Let the policy set the flux to hold."""
        action, self._memory = self.policy.act(self.observation, self._memory)
        target = float(servo.target_of(action[0], self._family.servo_target_share))
        self._below.hold(self._hold.flux(float(action[1])), target)

    def _command(self) -> FeedCommand:
        """Return the law's command, and note the setting."""
        command, (on_us, period_us) = self._law_command, self._now_us
        self._now_us = command.t_on_us or on_us, command.t_period_us or period_us
        return command
