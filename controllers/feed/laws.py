"""The gap laws: their measures, rules and defaults."""

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

from edmsim.controllers.feed import law, periods
from edmsim.controllers.feed.law import OpenShare, ServoLaw, TruthLaw
from edmsim.controllers.protocols import FeedCommand, WindowObservation, check_feed, check_parameters
from edmsim.snapshots import Snapshots

PRODUCTION = {
    "filter_s": 0.05, "start_feed_um_s": 5.0, "open_target_share": 0.0, "proportional_um_s": 30.0,
    "integral_um_s2": 100.0,
}  # fmt: skip
"""Servo and target of laws for a production machine; the defaults are for a laboratory machine."""
HEAT = {**PRODUCTION, "period_us": 90.0}
FINDING = {
    **HEAT, "proportional_share": 0.6, "integral_per_s": 4.0, "shortest_us": 18.0, "recovery_s": 0.5,
    "refill_s": 5.0, "retract_feed_um_s": 80.0,
}  # fmt: skip
"""Defaults of laws that search for the heat flux at which wires break: down to the supply's shortest period."""


class VoltageController(ServoLaw, measure=law.MeanVoltage):
    """Holds the mean gap voltage at a reference."""

    name: ClassVar[str] = "voltage"


class DelayController(ServoLaw, measure=law.MeanDelay):
    """Holds the mean ignition delay of all pulses at a reference."""

    name: ClassVar[str] = "delay"


class FuzzyController(ServoLaw, measure=law.FuzzyRules):
    """Changes the feed by fuzzy rules from the ratios of short and open pulses."""

    name: ClassVar[str] = "fuzzy"


class AdaptiveOffTimeController(ServoLaw, measure=OpenShare, period=periods.NormalPulses):
    """Holds the share of opens minus shorts with the feed, and the count of normal pulses with the off-time."""

    name: ClassVar[str] = "adaptive-off-time"


class SatoController(
    ServoLaw, measure=OpenShare, period=periods.FreshNormalPulses, height_factor=176.0, shortest_factor=0.3,
    **PRODUCTION,
):  # fmt: skip
    """Holds the count of normal pulses with an off-time that may fall below the operator's.

    This is the law as published. Its `height_factor` comes from tool steel 40 mm high at 35 um/s and 8.1 A with the
    production machine and generator (ours).
    """

    name: ClassVar[str] = "sato"


class OracleController(TruthLaw, measure=law.TrueGap):
    """Holds the true gap at a target and slows down if the wire is too hot: a bound for comparisons.

    It is not proved to be the fastest: `edmsim evaluate` therefore tries several gaps for every cut and keeps the
    best.
    """

    name: ClassVar[str] = "oracle"


class FixedPeriodController(ServoLaw, measure=OpenShare, period=periods.RisingPeriod, **PRODUCTION):
    """Holds the share of opens minus shorts with the feed, at a period that a new wire reaches slowly."""

    name: ClassVar[str] = "fixed-period"


class HeatFluxController(
    ServoLaw, measure=OpenShare, period=periods.HeatFluxHold, gauge=periods.FluxGauge, hold_share=0.4,
    proportional_share=0.6, integral_per_s=4.0, **HEAT,
):  # fmt: skip
    """Holds the highest local heat flux, estimated from located sparks and the files' constants, with the period."""

    name: ClassVar[str] = "heat-flux"


class ClimbingHoldController(
    ServoLaw, measure=OpenShare, period=periods.ClimbingHold, gauge=periods.FluxGauge, hold_share=0.3,
    break_hold_share=0.85, **FINDING,
):  # fmt: skip
    """Raises the held local heat flux until a wire breaks; then lowers it and raises it more slowly."""

    name: ClassVar[str] = "climbing-hold"


class AdaptiveHoldController(
    ServoLaw, measure=OpenShare, period=periods.AdaptiveHold, gauge=periods.FluxGauge,
    fixed=("hold_share", "break_hold_share"), **FINDING,
):  # fmt: skip
    """Holds the local heat flux with the largest expected return, estimated from the breaks so far."""

    name: ClassVar[str] = "adaptive-hold"


class GuardedHoldController(
    ServoLaw, measure=OpenShare, period=periods.GuardedHold, gauge=periods.StreamGauge,
    fixed=("hold_share", "break_hold_share"),
    **{**FINDING, "proportional_share": 0.4, "integral_per_s": 2.5, "limit_share": 0.16, "limit_spread": 0.2},
):  # fmt: skip
    """Holds the heat flux as `adaptive-hold` does, and relieves the wire after bursts of discharges."""

    name: ClassVar[str] = "guarded-hold"

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed for the next window; in a relief it falls as the period grows."""
        command = super().update(window)
        assert isinstance(self.period, periods.GuardedHold)
        if not self.period.relieving or command.t_period_us is None:
            return command
        usual_us = math.exp(self.period.log_us)
        return command._replace(feed_um_s=command.feed_um_s * min(usual_us / command.t_period_us, 1.0))


class HeatOracleController(
    TruthLaw, measure=OpenShare, period=periods.HeatFluxHold, gauge=periods.HeatGauge, hold_share=0.2,
    proportional_share=0.8, integral_per_s=2.0, shortest_us=18.0, **HEAT,
):  # fmt: skip
    """Holds the wire's true highest temperature with the period: the bound for `heat-flux`."""

    name: ClassVar[str] = "heat-oracle"


class SetPointController(
    ServoLaw, measure=OpenShare, period=periods.SetPoint, corner=law.Corners, fixed=("short_weight",)
):
    """Holds the share of opens minus shorts with the feed, at a setting in proportion to the operator's.

    It corresponds to an operator with a table of settings, and to the corner functions of machines.
    """

    name: ClassVar[str] = "set-point"


class ClimbController(ServoLaw, measure=OpenShare, period=periods.Climb, corner=law.Corners, fixed=("short_weight",)):
    """Shortens the period step by step until the wire breaks, then stays at a longer one."""

    name: ClassVar[str] = "climb"


class LeadOracleController(
    TruthLaw, measure=OpenShare, period=periods.SetPoint, corner=law.TrueBend,
    fixed=("short_weight", "pull_N_m", "fade_um"),
):  # fmt: skip
    """Cuts like `SetPointController`, with an offset that keeps the bent wire on the path."""

    name: ClassVar[str] = "lead-oracle"


class TrimController(
    ServoLaw, measure=law.ShortShare, period=periods.CornerPeriod, corner=law.OuterCorners,
    fixed=("start_feed_um_s", "integral_share"),
):  # fmt: skip
    """Runs at a constant feed, slower with more shorts, retracts from a short that lasts, and spares outer corners.

    Most machines do this in trim cuts.
    """

    name: ClassVar[str] = "trim"

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed for the next window."""
        command = super().update(window)
        if command.alarm is not None or self.servo.retracting:
            return command
        assert isinstance(self.measure, law.ShortShare)
        return command._replace(feed_um_s=self.measure.slowed_um_s)

    def see_part(self, side: Literal["left", "right"] | None) -> None:
        """Read on which side of the next leg the part lies."""
        assert isinstance(self.corner, law.OuterCorners)
        self.corner.part_side = side


@dataclass
class FixedController(Snapshots):
    """Commands the same feed for every window."""

    name: ClassVar[str] = "fixed"

    # the feed in um/s, 0 or more (ours: at 20 um/s six of ten pulses are open in 20 mm of steel)
    feed_um_s: float = 20.0
    offset_um: float = 0.0  # offset to the left of the path, for example for a finishing pass

    def __post_init__(self) -> None:
        check_parameters(self)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut; refuses a feed the machine cannot run."""
        check_feed(self.name, "feed_um_s", self.feed_um_s, max_feed_um_s)
        return FeedCommand(self.feed_um_s, offset_um=self.offset_um)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Return the same feed for every window."""
        return FeedCommand(self.feed_um_s, offset_um=self.offset_um)
