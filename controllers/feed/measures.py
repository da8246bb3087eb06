"""Measures of the gap laws: mean voltage, mean ignition delay, the share of opens, fuzzy rules, the true gap.

Sources of `MeanVoltage`: US 4296302 (servo on average gap voltage and power), CA 1049621 (servo of a wire machine,
1976); the law is the simplest of the classic machines.

Sources of `MeanDelay` (a wide gap ignites late): ETH's open wire-EDM simulator SPARC, whose machines are
controlled in proportion to the mean voltage or the mean ignition delay; a monitor of wire-EDM turning that replaces
the voltage by the mean delay over 200 ms (doi:10.1177/0954405414543488). The counting of shorts and opens is ours.

Source of `FuzzyRules`, the field's classic: Lin, Chung, Huang, J. Mater. Process. Technol. 113 (2001) 324-330, fuzzy
control of a wire-EDM machine from what its pulses show. Their memberships and rule table could not be read; those
here are ours, after the usual scheme: a Sugeno controller of order zero, triangular memberships, product and
weighted mean.

====================  =========  =====  =====
open ratio            low        right  high
====================  =========  =====  =====
falling               -1         -0.5   +0.5
steady                -1          0     +1
rising                -0.5       +0.5   +1
short ratio is high   -2, whatever the open ratio
====================  =========  =====  =====
"""

import math
from dataclasses import dataclass, field
from typing import ClassVar

from edmsim.controllers.feed.law import Gains, GapServo, Measure
from edmsim.controllers.protocols import WindowObservation
from edmsim.errors import InputError
from edmsim.machine.pulse_window import PulseWindow
from edmsim.machine.setting import WINDOW_PULSES

_RULES = ((-1.0, -0.5, 0.5), (-1.0, 0.0, 1.0), (-0.5, 0.5, 1.0))
"""Change of feed by the open ratio's change (falling, steady, rising) and by the ratio (low, right, high)."""
_ON_SHORTS = -2.0


@dataclass
class MeanVoltage(Measure):
    """The mean gap voltage.

    It is averaged over whole periods, pauses included, as by a moving-coil meter: the reference is for one duty
    factor.
    """

    GAINS: ClassVar[tuple[str, str]] = ("proportional_um_s_V", "integral_um_s2_V")

    reference_V: float = 15.0  # target of the mean gap voltage
    proportional_um_s_V: float = 1.0  # feed per volt above the reference, um/s
    integral_um_s2_V: float = 1.0  # growth of the feed per volt above the reference, um/s per s

    def error(self, window: WindowObservation, servo: GapServo) -> float:
        """Volts above the reference."""
        return window.mean_voltage_V - self.reference_V


@dataclass
class MeanDelay(Measure):
    """The mean ignition delay of all pulses.

    A short counts with a delay of 0, an open pulse with `open_delay_us`: there is a mean even if nothing ignites.
    """

    GAINS: ClassVar[tuple[str, str]] = ("proportional_um_s_us", "integral_um_s2_us")

    reference_us: float = 12.0  # target of the mean delay
    proportional_um_s_us: float = 1.0  # feed per us above the reference, um/s
    integral_um_s2_us: float = 1.0  # growth of the feed per us above the reference, um/s per s
    # delay of an open pulse (ours: the on-time of the default setting, its shortest possible wait)
    open_delay_us: float = 30.0

    def error(self, window: WindowObservation, servo: GapServo) -> float:
        """Microseconds above the reference."""
        ignited = WINDOW_PULSES - window.short - window.open
        waited = window.open * self.open_delay_us
        if ignited:  # without any there is no mean delay
            waited += ignited * window.mean_delay_us
        return waited / WINDOW_PULSES - self.reference_us


@dataclass
class OpenShare(Measure):
    """The share of open pulses minus that of weighted shorts."""

    GAINS: ClassVar[tuple[str, str]] = ("proportional_um_s", "integral_um_s2")

    open_target_share: float = 0.1  # target share of open pulses without shorts
    short_weight: float = 1.0  # number of open pulses that one short pulse cancels
    # proportional_um_s, integral_um_s2: feed, and its growth per second, per unit of the difference from the target
    proportional_um_s: float = 10.0
    integral_um_s2: float = 30.0

    def error(self, window: WindowObservation, servo: GapServo) -> float:
        """Share of opens above the target, less the weighted shorts."""
        return (window.open - self.short_weight * window.short) / WINDOW_PULSES - self.open_target_share


@dataclass
class FuzzyRules(Measure):
    """Fuzzy rules on the filtered ratios of short and open pulses; the feed is the sum of their outputs."""

    open_target_share: float = 0.2  # target share of open pulses
    open_width_share: float = 0.2  # difference from the target at which the ratio is fully low or high
    # change of the open ratio per second, as a share of all pulses, that is fully falling or rising
    change_share_s: float = 1.0
    # short_begin_share, short_high_share: short ratios at which membership in "high" begins and is full
    short_begin_share: float = 0.1
    short_high_share: float = 0.4
    rate_um_s2: float = 10.0  # change of feed per second at an output of 1

    short: float = field(default=0.0, init=False)
    open: float = field(default=0.0, init=False)

    def begin(self) -> None:
        """Begin at the right share."""
        self.short, self.open = 0.0, self.open_target_share

    def gains(self, servo: GapServo) -> Gains:
        """The feed is the sum of its changes."""
        return Gains(0.0, self.rate_um_s2, 0.0)

    def error(self, window: WindowObservation, servo: GapServo) -> float:
        """Return the output of the rules for a window's ratios, from -2 to 1."""
        before, weight = self.open, servo.weight(window.duration_s)
        self.open += weight * (window.open / WINDOW_PULSES - self.open)
        self.short += weight * (window.short / WINDOW_PULSES - self.short)
        return self._infer((self.open - before) / window.duration_s)

    def _infer(self, open_change_s: float) -> float:
        span = max(self.short_high_share - self.short_begin_share, 1e-9)
        high = min(max((self.short - self.short_begin_share) / span, 0.0), 1.0)
        ratio = _memberships((self.open - self.open_target_share) / max(self.open_width_share, 1e-9))
        change = _memberships(open_change_s / max(self.change_share_s, 1e-9))
        free = sum(
            c * r * out
            for c, row in zip(change, _RULES, strict=True)
            for r, out in zip(ratio, row, strict=True)
        )
        return (1.0 - high) * free + high * _ON_SHORTS


def _memberships(value: float) -> tuple[float, float, float]:
    """Degrees of low, right and high; they add up to 1."""
    low, high = min(max(-value, 0.0), 1.0), min(max(value, 0.0), 1.0)
    return low, 1.0 - low - high, high


@dataclass
class ShortShare(Measure):
    """A constant feed that falls with the share of shorts, without the servo's integral."""

    FEEDS: ClassVar[tuple[str, ...]] = ("feed_um_s",)

    feed_um_s: float = 30.0  # the feed without shorts
    stop_share: float = 0.3  # share of shorts at which the wire stops; the feed falls linearly up to it (ours)

    shorts: float = field(default=0.0, init=False)

    def gains(self, servo: GapServo) -> Gains:
        """Return gains of 0: the servo adds nothing."""
        return Gains(0.0, 0.0, servo.filter_s)

    def error(self, window: WindowObservation, servo: GapServo) -> float:
        """Return the share of shorts, negative."""
        self.shorts += servo.weight(window.duration_s) * (window.short / WINDOW_PULSES - self.shorts)
        return -window.short / WINDOW_PULSES

    def first_feed_um_s(self, servo: GapServo) -> float:
        """Return the feed without shorts."""
        return self.feed_um_s

    @property
    def slowed_um_s(self) -> float:
        """Feed at the present share of shorts."""
        share = self.shorts / self.stop_share if self.stop_share else float(self.shorts > 0)
        return self.feed_um_s * max(1.0 - share, 0.0)


@dataclass
class TrueGap(Measure):
    """The true gap, or the excess temperature of the wire; a real machine measures neither."""

    GAINS: ClassVar[tuple[str, str]] = ("proportional_um_s_um", "integral_um_s2_um")

    gap_target_um: float = 16.0  # target of the mean gap at the places of ignition
    proportional_um_s_um: float = 1.0  # feed per um above the target, um/s
    integral_um_s2_um: float = 2.0  # growth of the feed per um above the target, um/s per s
    # reduction of the measured gap in a window full of shorts (ours: the target, which makes the gap 0)
    short_um: float = 16.0
    hot_K: float = 560.0  # wire temperature above which the wire slows down
    kelvin_per_um: float = 10.0  # excess temperature that counts as much as a gap 1 um too narrow

    gap_um: float = field(default=0.0, init=False)
    temperature_K: float = field(default=-1.0, init=False)  # below 0 before anything was seen

    def see(self, truth: PulseWindow) -> None:
        """Read the true gap and temperature of a window."""
        self.gap_um, self.temperature_K = truth.gap_um, truth.wire_temperature_K
        if math.isnan(self.gap_um):  # nothing ignited: all open, or all short
            self.gap_um = 2.0 * self.gap_target_um if truth.open > truth.short else 0.0

    def error(self, window: WindowObservation, servo: GapServo) -> float:
        """Return um above the target or the excess temperature in um, whichever gives less feed."""
        if self.temperature_K < 0:
            raise InputError("the oracle was shown nothing of the gap: call see() before update()")
        wide = self.gap_um - self.gap_target_um - self.short_um * window.short / WINDOW_PULSES
        return min(wide, (self.hot_K - self.temperature_K) / max(self.kelvin_per_um, 1e-9))
