"""Sato's off-time law as published: the off-time is lengthened and shortened about the operator's.

Its servo and its threshold are those of a production machine, where `adaptive-off-time` has a laboratory machine's.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from edmsim.controllers.feed.adaptive_off_time import AdaptiveOffTimeController
from edmsim.controllers.feed.gap_servo import ServoController
from edmsim.controllers.protocols import ControllerState, FeedCommand, WindowObservation


@dataclass
class SatoController(AdaptiveOffTimeController):
    """Holds the count of normal pulses per thickness by an off-time that also falls below the operator's.

    Further parameters: see `AdaptiveOffTimeController`, of which these have other defaults.

    Parameters
    ----------
    slow_factor : float
        Period with which every wire begins, over the operator's (ours).
    """

    name: ClassVar[str] = "sato"

    filter_s: float = 0.05
    start_feed_um_s: float = 5.0
    open_target_share: float = 0.0
    proportional_um_s: float = 30.0
    integral_um_s2: float = 100.0
    normal_at_10mm: float = 150.0
    height_factor: float = 200.0
    shortest_factor: float = 0.3
    slow_factor: float = 2.5

    _fresh: bool = field(default=True, init=False, repr=False)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut."""
        self._fresh = True
        return super().reset(max_feed_um_s)

    def wire_lost(self) -> FeedCommand:
        """Begin with a fresh wire; what was found of the thickness stays."""
        self._fresh = True
        return ServoController.reset(self, self._servo.max_feed_um_s)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed and period for the next window."""
        command = super().update(window)
        if not self._fresh:
            return command
        self._fresh = False
        self._counter.period_us = self._counter.base_us * max(self.slow_factor, 1.0)
        return command._replace(t_period_us=self._counter.period_us)

    def snapshot(self) -> ControllerState:
        """Everything that changes while cutting."""
        return {**super().snapshot(), "fresh": float(self._fresh)}

    def restore(self, state: ControllerState) -> None:
        """Continue where `snapshot` was taken."""
        super().restore({k: v for k, v in state.items() if k != "fresh"})
        self._fresh = bool(state["fresh"])
