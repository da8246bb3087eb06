"""The bound: a servo on the true gap and the true wire temperature, which no machine shows.

It only scales the others' figures. It runs as fast as the gap allows and slows down where the wire grows hot; it is
no proof of the fastest cut, so `edmsim evaluate` lets it rehearse every cut with several gaps and keeps the best.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar, cast

from edmsim.controllers.feed.gap_servo import Gains, ServoController
from edmsim.controllers.protocols import ControllerState, FeedCommand, GapWindow, WindowObservation
from edmsim.controllers.pulse_counters import WINDOW_PULSES
from edmsim.errors import InputError


@dataclass
class _Truth:
    """What was seen of the last window; a temperature below 0 where nothing was."""

    gap_um: float = 0.0
    temperature_K: float = -1.0


@dataclass
class OracleController(ServoController):
    """Holds the true gap at a target unless the wire is too hot.

    Further parameters: see `ServoController`.

    Parameters
    ----------
    gap_target_um : float
        Mean gap at the places of ignition that is held.
    proportional_um_s_um : float
        Feed per um above the target, um/s.
    integral_um_s2_um : float
        Growth of the feed per um above the target, um/s per s.
    short_um : float
        By how many um a window full of shorts is closer than its few sparks show (ours).
    hot_K : float
        Wire temperature above which the wire slows down.
    kelvin_per_um : float
        How far above it costs as much as a gap 1 um too narrow.
    """

    name: ClassVar[str] = "oracle"

    gap_target_um: float = 12.0
    proportional_um_s_um: float = 1.0
    integral_um_s2_um: float = 2.0
    short_um: float = 10.0
    hot_K: float = 560.0
    kelvin_per_um: float = 10.0

    _truth: _Truth = field(default_factory=_Truth, init=False, repr=False)

    def gains(self) -> Gains:
        """How the servo answers."""
        return Gains(self.proportional_um_s_um, self.integral_um_s2_um, self.filter_s)

    def see(self, truth: GapWindow) -> None:
        """Take in the true gap and temperature of a window."""
        gap = truth.gap_um
        if math.isnan(gap):  # nothing ignited: all open, or all short
            gap = 2.0 * self.gap_target_um if truth.open > truth.short else 0.0
        self._truth = _Truth(gap, truth.wire_temperature_K)

    def error(self, window: WindowObservation) -> float:
        """Micrometres above the target, or how much too hot the wire is, whichever asks for less feed."""
        if self._truth.temperature_K < 0:
            raise InputError("the oracle was shown nothing of the gap: call see() before update()")
        wide = self._truth.gap_um - self.gap_target_um - self.short_um * window.short / WINDOW_PULSES
        return min(wide, (self.hot_K - self._truth.temperature_K) / max(self.kelvin_per_um, 1e-9))

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut."""
        self._truth = _Truth()
        return super().reset(max_feed_um_s)

    def snapshot(self) -> ControllerState:
        """Everything that changes while cutting."""
        truth = {f"truth.{name}": value for name, value in asdict(self._truth).items()}
        return {**super().snapshot(), **truth}

    def restore(self, state: ControllerState) -> None:
        """Continue where `snapshot` was taken."""
        values = cast(dict[str, Any], state)
        truth = {k.removeprefix("truth."): v for k, v in values.items() if k.startswith("truth.")}
        super().restore({k: v for k, v in values.items() if not k.startswith("truth.")})
        self._truth = _Truth(**truth)
