"""Sato's off-time law as published: the off-time is lengthened and shortened about the operator's.

Its servo and its threshold are those of a production machine, where `adaptive-off-time` has a laboratory machine's.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from edmsim.controllers.feed.adaptive_off_time import AdaptiveOffTimeController
from edmsim.controllers.feed.fixed_period import THREADING_S
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

    _end_s: float = field(default=-THREADING_S, init=False, repr=False)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut."""
        self._end_s = -THREADING_S
        return super().reset(max_feed_um_s)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed and period for the next window."""
        fresh = window.time_s - window.duration_s >= self._end_s + THREADING_S
        self._end_s = window.time_s
        command = super().update(window)
        if not fresh:
            return command
        self._counter.period_us = self._counter.base_us * max(self.slow_factor, 1.0)
        return command._replace(t_period_us=self._counter.period_us)

    def snapshot(self) -> ControllerState:
        """Everything that changes while cutting."""
        return {**super().snapshot(), "end_s": self._end_s}

    def restore(self, state: ControllerState) -> None:
        """Continue where `snapshot` was taken."""
        super().restore({k: v for k, v in state.items() if k != "end_s"})
        self._end_s = float(state["end_s"])
