"""The servo that the gap controllers share, and its two classic measures: mean gap voltage, mean ignition delay.

The classic machines feed in proportion to how far a mean of the gap is from its reference, ``v = K (U - U_ref)``,
and so run backwards by themselves when the gap shorts. An integral part (ours) holds the reference at any height
and material.

Sources of `VoltageController`: US 4296302 (servo on average gap voltage and power), CA 1049621 (servo of a wire
machine, 1976); the law is the simplest of the classic machines.

Sources of `DelayController`, for a wide gap ignites late: ETH's open wire-EDM simulator SPARC, whose machines are
controlled in proportion to the mean voltage or the mean ignition delay; a monitor of wire-EDM turning that replaces
the voltage by the mean delay over 200 ms (doi:10.1177/0954405414543488). The counting of shorts and opens is ours.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

from edmsim.controllers.protocols import FeedCommand, WindowObservation, check_feed, check_parameters
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.snapshots import Snapshots

PERSISTENT_SHORT = "persistent short"
"""The alarm's text."""
SHORTED_SHARE = 0.5
"""From this share of short pulses on a window counts as shorted (ours, as the counts controller has it)."""


class Gains(NamedTuple):
    """How a servo answers.

    Attributes
    ----------
    proportional, integral : float
        Feed in um/s, and its growth in um/s per s, per unit of the error.
    filter_s : float
        Time constant of the low-pass filter on the error.
    """

    proportional: float
    integral: float
    filter_s: float


@dataclass
class ServoState:
    """What changes while cutting."""

    max_feed_um_s: float = 0.0
    error: float = 0.0
    integral_um_s: float = 0.0
    shorted_s: float = 0.0
    retracting: bool = False

    def look(self, window: WindowObservation) -> bool:
        """Add up the time shorted; whether the window was shorted."""
        shorted = window.short >= SHORTED_SHARE * WINDOW_PULSES
        self.shorted_s = self.shorted_s + window.duration_s if shorted else 0.0
        return shorted

    def feed(self, error: float, duration_s: float, gains: Gains) -> float:
        """Feed that the gap asks for in um/s, 0 or more; `error` is positive where the gap is too wide."""
        weight = -math.expm1(-duration_s / gains.filter_s) if gains.filter_s else 1.0
        self.error += weight * (error - self.error)
        growth = gains.integral * self.error * duration_s
        self.integral_um_s = min(max(self.integral_um_s + growth, 0.0), self.max_feed_um_s)
        return self.integral_um_s + gains.proportional * self.error


@dataclass
class ServoController(Snapshots, ABC):
    """What controllers with a servo share; `error` and `gains` are theirs.

    Parameters
    ----------
    filter_s : float
        Time constant of the low-pass filter on the measured mean.
    start_feed_um_s : float
        Feed the integral starts from.
    retract_feed_um_s : float
        Largest speed backwards; a short that stays is met with it.
    patience_s : float
        Shorted time after which the wire retracts (ours, as the counts controller has it).
    integral_share : float
        What is left of the integral after a retract (ours: half, so that a feed that was too fast is soon found).
    give_up_s : float
        Time shorted without a break after which the machine is stopped (ours: at 20 um/s a way back of 0.4 mm,
        longer than any short this wire leaves behind it).
    """

    name: ClassVar[str]

    filter_s: float = 0.1
    start_feed_um_s: float = 10.0
    retract_feed_um_s: float = 20.0
    patience_s: float = 0.15
    integral_share: float = 0.5
    give_up_s: float = 20.0

    _servo: ServoState = field(default_factory=ServoState, init=False, repr=False)

    def __post_init__(self) -> None:
        check_parameters(self)

    @abstractmethod
    def gains(self) -> Gains:
        """How the servo answers."""

    @abstractmethod
    def error(self, window: WindowObservation) -> float:
        """How much too wide the gap is; NaN if the window does not tell."""

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut; refuses feeds the machine cannot run."""
        for name in ("start_feed_um_s", "retract_feed_um_s"):
            check_feed(self.name, name, getattr(self, name), max_feed_um_s)
        self._servo = ServoState(max_feed_um_s=max_feed_um_s, integral_um_s=self.start_feed_um_s)
        return FeedCommand(self.start_feed_um_s)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed for the next window: the servo's, backwards while a short stays."""
        servo = self._servo
        error = self.error(window)
        if math.isnan(error):
            error = servo.error
        shorted = servo.look(window)
        if servo.shorted_s >= self.give_up_s:
            return FeedCommand(0.0, PERSISTENT_SHORT)
        if shorted and servo.shorted_s >= self.patience_s:
            servo.retracting = True
            return FeedCommand(-self.retract_feed_um_s)
        if servo.retracting:  # cleared: the filter forgets the short
            servo.retracting = False
            servo.error = error
            servo.integral_um_s *= self.integral_share
        feed = servo.feed(error, window.duration_s, self.gains())
        return FeedCommand(min(max(feed, -self.retract_feed_um_s), servo.max_feed_um_s))


@dataclass
class VoltageController(ServoController):
    """Holds the mean gap voltage at a reference.

    The voltage is averaged over whole periods, pauses included, as a moving-coil meter would: the reference belongs
    to a duty factor. Further parameters: see `ServoController`.

    Parameters
    ----------
    reference_V : float
        Mean gap voltage held.
    proportional_um_s_V : float
        Feed per volt above the reference, um/s.
    integral_um_s2_V : float
        Growth of the feed per volt above the reference, um/s per s.
    """

    name: ClassVar[str] = "voltage"

    reference_V: float = 15.0
    proportional_um_s_V: float = 1.0
    integral_um_s2_V: float = 1.0

    def gains(self) -> Gains:
        """How the servo answers."""
        return Gains(self.proportional_um_s_V, self.integral_um_s2_V, self.filter_s)

    def error(self, window: WindowObservation) -> float:
        """Volts above the reference."""
        return window.mean_voltage_V - self.reference_V


@dataclass
class DelayController(ServoController):
    """Holds the mean ignition delay of all pulses at a reference.

    A short counts as ignited at once, an open pulse as one that waited `open_delay_us`; so the mean is there even
    where nothing ignites. Further parameters: see `ServoController`.

    Parameters
    ----------
    reference_us : float
        Mean delay held.
    proportional_um_s_us : float
        Feed per us above the reference, um/s.
    integral_um_s2_us : float
        Growth of the feed per us above the reference, um/s per s.
    open_delay_us : float
        What an open pulse counts as (ours: the on-time of the default setting, the least it can have waited).
    """

    name: ClassVar[str] = "delay"

    reference_us: float = 12.0
    proportional_um_s_us: float = 1.0
    integral_um_s2_us: float = 1.0
    open_delay_us: float = 30.0

    def gains(self) -> Gains:
        """How the servo answers."""
        return Gains(self.proportional_um_s_us, self.integral_um_s2_us, self.filter_s)

    def error(self, window: WindowObservation) -> float:
        """Microseconds above the reference."""
        ignited = WINDOW_PULSES - window.short - window.open
        waited = window.open * self.open_delay_us
        if ignited:  # without any there is no mean delay
            waited += ignited * window.mean_delay_us
        return waited / WINDOW_PULSES - self.reference_us
