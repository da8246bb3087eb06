"""A constant feed for trims that shorts slow down: what most machines do once the rough pass is cut."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

from edmsim.controllers.feed.gap_servo import Gains, ServoController
from edmsim.controllers.protocols import FeedCommand, WindowObservation, check_feed
from edmsim.machine.setting import WINDOW_PULSES


@dataclass
class TrimController(ServoController):
    """Runs at a constant feed, slower the more pulses short, and back along its path from a short that stays.

    Further parameters, of the retract and its end: see `ServoController`. The servo's integral has no part in it.

    Parameters
    ----------
    feed_um_s : float
        The feed where nothing shorts.
    stop_share : float
        Share of shorts at which the wire stops; between none and that many the feed falls evenly (ours).
    """

    name: ClassVar[str] = "trim"

    feed_um_s: float = 30.0
    stop_share: float = 0.3

    _shorts: float = field(default=0.0, init=False, repr=False)

    def gains(self) -> Gains:
        """How the servo answers: not at all."""
        return Gains(0.0, 0.0, self.filter_s)

    def error(self, window: WindowObservation) -> float:
        """Share of shorts, against none."""
        return -window.short / WINDOW_PULSES

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new leg; refuses a feed the machine cannot run."""
        check_feed(self.name, "feed_um_s", self.feed_um_s, max_feed_um_s)
        super().reset(max_feed_um_s)
        self._shorts = 0.0
        return FeedCommand(self.feed_um_s)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed for the next window."""
        command = super().update(window)
        weight = -math.expm1(-window.duration_s / self.filter_s) if self.filter_s else 1.0
        self._shorts += weight * (window.short / WINDOW_PULSES - self._shorts)
        if command.alarm is not None or self._servo.retracting:
            return command
        share = self._shorts / self.stop_share if self.stop_share else float(self._shorts > 0)
        return FeedCommand(self.feed_um_s * max(1.0 - share, 0.0))
