"""A servo of pulse counts at one pulse period: what an operator sets who wants no broken wire on any workpiece."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar, cast

from edmsim.controllers.feed.gap_servo import Gains, ServoController
from edmsim.controllers.protocols import ControllerState, FeedCommand, WindowObservation
from edmsim.controllers.pulse_counters import WINDOW_PULSES


@dataclass
class Rise:
    """How far a fresh wire has come.

    Attributes
    ----------
    cutting_s : float
        Time since the wire was threaded.
    first_us : float
        Period with which the leg began; 0 before the first window.
    """

    cutting_s: float = 0.0
    first_us: float = 0.0


@dataclass
class FixedPeriodController(ServoController):
    """Holds the share of opens less shorts by the feed, at a period that a fresh wire reaches slowly.

    Further parameters: see `ServoController`.

    Parameters
    ----------
    open_target_share : float
        Share of open pulses less that of short ones that is held.
    proportional_um_s, integral_um_s2 : float
        Feed, and its growth per second, per unit of the difference from the target.
    short_weight : float
        How many open pulses one short pulse outweighs.
    period_us : float
        Pulse period; 0 for the one that the operator has set.
    rise_s : float
        Time in which a fresh wire comes to it, from `slow_factor` times as long a period.
    slow_factor : float
        Period with which a fresh wire begins, over the one it comes to.
    """

    name: ClassVar[str] = "fixed-period"

    filter_s: float = 0.05
    start_feed_um_s: float = 5.0
    open_target_share: float = 0.0
    short_weight: float = 1.0
    proportional_um_s: float = 30.0
    integral_um_s2: float = 100.0
    period_us: float = 110.0
    rise_s: float = 1.5
    slow_factor: float = 2.0

    _rise: Rise = field(default_factory=Rise, init=False, repr=False)

    def gains(self) -> Gains:
        """How the servo answers."""
        return Gains(self.proportional_um_s, self.integral_um_s2, self.filter_s)

    def error(self, window: WindowObservation) -> float:
        """Share of opens less weighted shorts above the target."""
        return (window.open - self.short_weight * window.short) / WINDOW_PULSES - self.open_target_share

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut."""
        self._rise = Rise()
        return super().reset(max_feed_um_s)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed and period for the next window."""
        self._rise.cutting_s += window.duration_s
        command = super().update(window)
        return command._replace(t_period_us=self.wanted_us(window) * self._slower())

    def wire_lost(self) -> FeedCommand:
        """Begin with a fresh wire where the last one broke: it comes to its period slowly, as the first one did."""
        self._rise.cutting_s = 0.0
        return ServoController.reset(self, self._servo.max_feed_um_s)

    def wanted_us(self, window: WindowObservation) -> float:
        """Period of a wire that has come to it."""
        if not self._rise.first_us:
            self._rise.first_us = round(window.duration_s * 1e6 / WINDOW_PULSES, 1)
        return self.period_us or self._rise.first_us

    def _slower(self) -> float:
        """By what the period is longer while a fresh wire comes to it."""
        left = max(1.0 - self._rise.cutting_s / self.rise_s, 0.0) if self.rise_s else 0.0
        return float(max(self.slow_factor, 1.0) ** left)

    def snapshot(self) -> ControllerState:
        """Everything that changes while cutting."""
        return {**super().snapshot(), **{f"rise.{name}": value for name, value in asdict(self._rise).items()}}

    def restore(self, state: ControllerState) -> None:
        """Continue where `snapshot` was taken."""
        values = cast(dict[str, Any], state)
        super().restore({k: v for k, v in values.items() if not k.startswith("rise.")})
        self._rise = Rise(**{k.removeprefix("rise."): v for k, v in values.items() if k.startswith("rise.")})
