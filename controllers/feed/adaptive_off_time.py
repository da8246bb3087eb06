"""Off-time from the count of normal pulses: Sato's guard against wire breaks, on a servo of pulse counts.

Source: Sato et al. (physics notes of the project, sections 5 and 6): normal pulses are counted per 100 ms and held
below a threshold curve over the workpiece's thickness by the off-time; the thickness is known on-line from mean
current over speed, for removal goes with the mean current; the threshold rises less than proportionally with
thickness. Reported: 24 % more speed. There the off-time is also shortened below the operator's; at the laboratory
machine the operator's period is the shortest, because its generator's limit of 2 A leaves no shorter one. The curve's
numbers were not published: they come from a search.

`SatoController` is the law as published: the off-time is lengthened and shortened about the operator's. Its servo
and its threshold are those of a production machine, where `adaptive-off-time` has a laboratory machine's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

from edmsim.controllers.feed.gap_servo import Gains, ServoController
from edmsim.controllers.protocols import FeedCommand, WindowObservation
from edmsim.machine.setting import WINDOW_PULSES

COUNT_S = 0.1
"""Time over which normal pulses are counted: 100 ms (Sato et al.)."""
STEP_SHARE = 0.1
"""Largest change of the period per count (ours: off-times change smoothly, not from pulse to pulse)."""


@dataclass
class _Counter:
    """Sums since the last count, the thickness, and the setting; 0 where nothing is known yet."""

    seconds: float = 0.0
    normal: float = 0.0
    charge: float = 0.0
    travel_um: float = 0.0
    height_mm: float = 0.0
    base_us: float = 0.0
    period_us: float = 0.0


@dataclass
class AdaptiveOffTimeController(ServoController):
    """Holds the share of opens less shorts by the feed, and the count of normal pulses by the off-time.

    Further parameters: see `ServoController`.

    Parameters
    ----------
    open_target_share : float
        Share of open pulses held when nothing shorts.
    short_weight : float
        How many open pulses one short pulse outweighs.
    proportional_um_s, integral_um_s2 : float
        Feed, and its growth per second, per unit of the difference from the target.
    normal_at_10mm : float
        Threshold at 10 mm of thickness: normal pulses per 100 ms.
    exponent_share : float
        Power of the thickness with which the threshold rises: below 1.
    height_factor : float
        Thickness in mm per ampere and s/um of mean current over speed. Ours: tool steel 20 mm high at 46 um/s
        and 1.63 A with the default set-up.
    height_filter_s : float
        Time constant of the low-pass filter on the thickness.
    shortest_factor, longest_factor : float
        Shortest and longest period, in periods as the operator set it.
    """

    name: ClassVar[str] = "adaptive-off-time"

    open_target_share: float = 0.1
    short_weight: float = 1.0
    proportional_um_s: float = 10.0
    integral_um_s2: float = 30.0
    normal_at_10mm: float = 600.0
    exponent_share: float = 0.5
    height_factor: float = 562.0
    height_filter_s: float = 0.5
    shortest_factor: float = 1.0
    longest_factor: float = 5.0

    _counter: _Counter = field(default_factory=_Counter, init=False, repr=False)

    def gains(self) -> Gains:
        """How the servo answers."""
        return Gains(self.proportional_um_s, self.integral_um_s2, self.filter_s)

    def error(self, window: WindowObservation) -> float:
        """Share of opens above the target, less the weighted shorts."""
        return (window.open - self.short_weight * window.short) / WINDOW_PULSES - self.open_target_share

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut; the first window tells the operator's period."""
        self._counter = _Counter()
        return super().reset(max_feed_um_s)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed and period for the next window."""
        command = super().update(window)
        self._count(window)
        return command._replace(t_period_us=self._counter.period_us)

    def _count(self, window: WindowObservation) -> None:
        """Add a window; every 100 ms compare with the threshold and set the period."""
        counter = self._counter
        if not counter.base_us:
            counter.base_us = counter.period_us = round(window.duration_s * 1e6 / WINDOW_PULSES, 6)
        counter.seconds += window.duration_s
        counter.normal += WINDOW_PULSES - window.short - window.open
        if math.isfinite(window.mean_current_A):
            counter.charge += window.mean_current_A * window.duration_s
        counter.travel_um += window.feed_um_s * window.duration_s
        if counter.seconds < COUNT_S:
            return
        self._estimate_height()
        threshold = self.normal_at_10mm * (counter.height_mm / 10.0) ** self.exponent_share
        # before the wire has moved nothing is known of the thickness: the period stays
        excess = counter.normal / counter.seconds * COUNT_S / threshold if threshold else 1.0
        change = min(max(excess, 1.0 - STEP_SHARE), 1.0 + STEP_SHARE)
        shortest = min(self.shortest_factor, 1.0) * counter.base_us
        longest = max(self.longest_factor, 1.0) * counter.base_us
        # whole us, as timers count them
        counter.period_us = max(float(round(min(max(counter.period_us * change, shortest), longest))), shortest)
        counter.seconds = counter.normal = counter.charge = counter.travel_um = 0.0

    def _estimate_height(self) -> None:
        """Thickness from mean current over speed; standing still or running back tells nothing."""
        counter = self._counter
        if counter.travel_um <= 0:
            return
        h_mm = self.height_factor * counter.charge / counter.travel_um
        weight = -math.expm1(-counter.seconds / self.height_filter_s) if self.height_filter_s else 1.0
        counter.height_mm = h_mm if not counter.height_mm else counter.height_mm + weight * (h_mm - counter.height_mm)


@dataclass
class SatoController(AdaptiveOffTimeController):
    """Holds the count of normal pulses per thickness by an off-time that also falls below the operator's.

    Further parameters: see `AdaptiveOffTimeController`, of which these have other defaults. Its `height_factor` is of
    tool steel 40 mm high at 35 um/s and 8.1 A with the production machine and generator (ours).

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
    normal_at_10mm: float = 600.0
    height_factor: float = 176.0
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
