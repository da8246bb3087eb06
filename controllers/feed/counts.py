"""The feed law the 1982 machine was meant to have: from the counts of short and open pulses alone.

The thesis states the aim, to keep both percentages per 255 pulses small by changing the cutting speed (row
T-15), and leaves the law open. This one is ours: the share of open pulses, less a weighted share of shorts,
is held at a small target by a proportional and integrating feed; a short that stays is met by running back
along the path.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, fields
from typing import Any, ClassVar, cast

from edmsim.analyser import WINDOW_PULSES
from edmsim.controllers.feed.base import (
    ControllerState,
    FeedCommand,
    WindowObservation,
    check_feed,
    check_parameter,
)

PERSISTENT_SHORT = "persistent short"
"""The alarm's text."""


@dataclass
class _State:
    """What changes while cutting; phase is cut, retract, dwell or alarm."""

    max_feed_um_s: float = 0.0
    phase: str = "cut"
    phase_s: float = 0.0
    short: float = 0.0
    open: float = 0.0
    shorted_s: float = 0.0
    integral_um_s: float = 0.0
    place_um: float = 0.0
    tries: int = 0

    def enter(self, phase: str) -> None:
        self.phase, self.phase_s = phase, 0.0


@dataclass
class CountsController:
    """Feed from short and open counts; retracts from shorts, and gives up where one never clears.

    All constants are ours. Shares are fractions of the 255 pulses of a window.

    Parameters
    ----------
    open_target_share : float
        Share of open pulses held when nothing shorts. More is safer and slower.
    short_weight : float
        How many open pulses one short pulse outweighs.
    proportional_um_s : float
        Feed per unit of the difference from the target, um/s.
    integral_um_s2 : float
        Growth of the feed per unit of that difference, um/s per s.
    filter_s : float
        Time constant of the low-pass filter on both shares.
    start_feed_um_s : float
        Feed the integrator starts from, at the beginning and, if it was not lower, after a retract.
    air_share : float
        From this share of open pulses on there is no metal near: the wire runs at full feed.
    shorted_share : float
        From this share of short pulses on a window counts as shorted.
    patience_s : float
        Shorted time after which the wire retracts.
    clear_share : float
        Below this share of short pulses the short has cleared.
    retract_feed_um_s : float
        Speed of the retract.
    retract_um : float
        Longest retract.
    dwell_s : float
        Wait at the end of a retract that did not clear the short.
    return_feed_um_s : float
        Largest feed until the place of the short is reached again.
    progress_um : float
        A short further along the path than this is a new one.
    max_tries : int
        Retracts and dwells for one short before the alarm.
    """

    name: ClassVar[str] = "counts"

    open_target_share: float = 0.06
    short_weight: float = 1.0
    proportional_um_s: float = 10.0
    integral_um_s2: float = 30.0
    filter_s: float = 0.1
    start_feed_um_s: float = 10.0
    air_share: float = 0.98
    shorted_share: float = 0.5
    patience_s: float = 0.15
    clear_share: float = 0.1
    retract_feed_um_s: float = 20.0
    retract_um: float = 60.0
    dwell_s: float = 1.0
    return_feed_um_s: float = 10.0
    progress_um: float = 20.0
    max_tries: int = 8

    _state: _State = field(default_factory=_State, init=False, repr=False)

    def __post_init__(self) -> None:
        for parameter in fields(self):
            if parameter.init:
                check_parameter(self.name, parameter.name, getattr(self, parameter.name))

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut; refuses feeds the machine cannot run."""
        for name in ("start_feed_um_s", "retract_feed_um_s", "return_feed_um_s"):
            check_feed(self.name, name, getattr(self, name), max_feed_um_s)
        self._state = _State(max_feed_um_s=max_feed_um_s, integral_um_s=self.start_feed_um_s)
        return FeedCommand(self.start_feed_um_s)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed for the next window, from the counts and the position along the path."""
        self._look(window)
        phase = self._state.phase
        if phase == "cut" and self._state.shorted_s >= self.patience_s:
            self._begin_retract(window.path_um)
        elif phase in ("retract", "dwell") and window.short < self.clear_share * WINDOW_PULSES:
            self._resume(window)
        elif phase == "retract" and self._retract_left_um() <= 0:
            self._state.enter("dwell")
        elif phase == "dwell" and self._state.phase_s >= self.dwell_s:
            self._state.enter("dwell")
            self._count_try()
        return self._command(window)

    def snapshot(self) -> ControllerState:
        """Everything that changes while cutting."""
        return asdict(self._state)

    def restore(self, state: ControllerState) -> None:
        """Continue where `snapshot` was taken."""
        self._state = _State(**cast(dict[str, Any], state))

    def _look(self, window: WindowObservation) -> None:
        """Low-pass both shares and add up the time in this phase and the time shorted."""
        state = self._state
        weight = -math.expm1(-window.duration_s / self.filter_s) if self.filter_s else 1.0
        state.short += weight * (window.short / WINDOW_PULSES - state.short)
        state.open += weight * (window.open / WINDOW_PULSES - state.open)
        state.phase_s += window.duration_s
        shorted = window.short >= self.shorted_share * WINDOW_PULSES
        state.shorted_s = state.shorted_s + window.duration_s if shorted else 0.0

    def _begin_retract(self, path_um: float) -> None:
        state = self._state
        state.enter("retract")
        if state.tries == 0 or path_um > state.place_um + self.progress_um:
            state.place_um, state.tries = path_um, 0
        self._count_try()

    def _count_try(self) -> None:
        self._state.tries += 1
        if self._state.tries > self.max_tries:
            self._state.enter("alarm")

    def _resume(self, window: WindowObservation) -> None:
        """Cut again from where the short cleared, with the filter forgetting the short."""
        state = self._state
        state.enter("cut")
        state.short, state.open = window.short / WINDOW_PULSES, window.open / WINDOW_PULSES
        state.integral_um_s = min(state.integral_um_s, self.start_feed_um_s)

    def _retract_left_um(self) -> float:
        return self.retract_um - self.retract_feed_um_s * self._state.phase_s

    def _command(self, window: WindowObservation) -> FeedCommand:
        phase = self._state.phase
        if phase == "alarm":
            return FeedCommand(0.0, PERSISTENT_SHORT)
        if phase == "dwell":
            return FeedCommand(0.0)
        if phase == "retract":
            # The last window of a retract is slower, so that the wire never goes back further than allowed.
            return FeedCommand(-min(self.retract_feed_um_s, self._retract_left_um() / window.duration_s))
        return FeedCommand(self._cut(window))

    def _cut(self, window: WindowObservation) -> float:
        """Proportional and integral feed; full feed in air, reduced up to the place of the last short."""
        state = self._state
        returning = state.tries > 0 and window.path_um < state.place_um
        limit = self.return_feed_um_s if returning else state.max_feed_um_s
        if state.open >= self.air_share:
            return limit
        error = state.open - self.open_target_share - self.short_weight * state.short
        if state.shorted_s == 0:
            growth = self.integral_um_s2 * error * window.duration_s
            state.integral_um_s = min(max(state.integral_um_s + growth, 0.0), limit)
        return min(max(state.integral_um_s + self.proportional_um_s * error, 0.0), limit)
