"""The gap laws that are made of parts: their measures, rules and defaults."""

from __future__ import annotations

from typing import ClassVar

from edmsim.controllers.feed.adaptive_hold import AdaptiveHold, ClimbingHold
from edmsim.controllers.feed.corners import Corners, TrueBend
from edmsim.controllers.feed.law import ServoLaw, TruthLaw
from edmsim.controllers.feed.measures import FuzzyRules, MeanDelay, MeanVoltage, OpenShare, ShortShare, TrueGap
from edmsim.controllers.feed.periods import (
    Climb,
    FluxGauge,
    FreshNormalPulses,
    HeatGauge,
    HoldHeat,
    NormalPulses,
    RisingPeriod,
    SetPoint,
)
from edmsim.controllers.protocols import FeedCommand, WindowObservation

PRODUCTION = {
    "filter_s": 0.05, "start_feed_um_s": 5.0, "open_target_share": 0.0, "proportional_um_s": 30.0,
    "integral_um_s2": 100.0,
}  # fmt: skip
"""Servo and target of laws for a production machine, where the others have a laboratory machine's."""
HEAT = {**PRODUCTION, "period_us": 90.0}
FINDING = {
    **HEAT, "proportional_share": 0.6, "integral_per_s": 4.0, "shortest_us": 18.0, "recovery_s": 0.5,
    "retract_feed_um_s": 80.0,
}  # fmt: skip
"""Of laws that find out what a machine's wires bear: they go to the shortest period that the supply gives."""


class VoltageController(ServoLaw, measure=MeanVoltage):
    """Holds the mean gap voltage at a reference."""

    name: ClassVar[str] = "voltage"


class DelayController(ServoLaw, measure=MeanDelay):
    """Holds the mean ignition delay of all pulses at a reference."""

    name: ClassVar[str] = "delay"


class FuzzyController(ServoLaw, measure=FuzzyRules):
    """Changes the feed by fuzzy rules from the ratios of short and open pulses."""

    name: ClassVar[str] = "fuzzy"


class AdaptiveOffTimeController(ServoLaw, measure=OpenShare, period=NormalPulses):
    """Holds the share of opens less shorts by the feed, and the count of normal pulses by the off-time."""

    name: ClassVar[str] = "adaptive-off-time"


class SatoController(
    ServoLaw, measure=OpenShare, period=FreshNormalPulses, height_factor=176.0, shortest_factor=0.3, **PRODUCTION
):
    """Holds the count of normal pulses per thickness by an off-time that also falls below the operator's.

    That is the law as published. Its `height_factor` is of tool steel 40 mm high at 35 um/s and 8.1 A with the
    production machine and generator (ours).
    """

    name: ClassVar[str] = "sato"


class OracleController(TruthLaw, measure=TrueGap):
    """Holds the true gap at a target unless the wire is too hot: a bound that only scales the others' figures.

    It runs as fast as the gap allows and slows down where the wire grows hot; it is no proof of the fastest cut, so
    `edmsim evaluate` lets it rehearse every cut with several gaps and keeps the best.
    """

    name: ClassVar[str] = "oracle"


class FixedPeriodController(ServoLaw, measure=OpenShare, period=RisingPeriod, **PRODUCTION):
    """Holds the share of opens less shorts by the feed, at a period that a fresh wire reaches slowly."""

    name: ClassVar[str] = "fixed-period"


class HeatFluxController(
    ServoLaw, measure=OpenShare, period=HoldHeat, gauge=FluxGauge, hold_share=0.4, proportional_share=0.6,
    integral_per_s=4.0, **HEAT,
):  # fmt: skip
    """Holds the greatest local heat flux, as located sparks and the files' constants give it, by the period."""

    name: ClassVar[str] = "heat-flux"


class ClimbingHoldController(
    ServoLaw, measure=OpenShare, period=ClimbingHold, gauge=FluxGauge, hold_share=0.3, break_hold_share=0.85,
    **FINDING,
):  # fmt: skip
    """Holds the greatest local heat flux, more and more of it until a wire breaks; then less, and climbs slower."""

    name: ClassVar[str] = "climbing-hold"


class AdaptiveHoldController(
    ServoLaw, measure=OpenShare, period=AdaptiveHold, gauge=FluxGauge, fixed=("hold_share", "break_hold_share"),
    **FINDING,
):  # fmt: skip
    """Holds the greatest local heat flux, as much of it as earns most by what is known of what these wires bear."""

    name: ClassVar[str] = "adaptive-hold"


class HeatOracleController(
    TruthLaw, measure=OpenShare, period=HoldHeat, gauge=HeatGauge, hold_share=0.2, proportional_share=0.8,
    integral_per_s=2.0, shortest_us=18.0, **HEAT,
):  # fmt: skip
    """Holds the wire's true highest temperature by the period: the bound that `heat-flux` is compared with."""

    name: ClassVar[str] = "heat-oracle"


class SetPointController(ServoLaw, measure=OpenShare, period=SetPoint, corner=Corners, fixed=("short_weight",)):
    """Holds the share of opens less shorts by the feed, at a setting in proportion to the operator's.

    It does what an operator does with knobs and a table of settings, and what machines do at corners.
    """

    name: ClassVar[str] = "set-point"


class ClimbController(ServoLaw, measure=OpenShare, period=Climb, corner=Corners, fixed=("short_weight",)):
    """Shortens the period step by step until the wire breaks, and stays below what broke it."""

    name: ClassVar[str] = "climb"


class LeadOracleController(TruthLaw, measure=OpenShare, period=SetPoint, corner=TrueBend, fixed=("short_weight",)):
    """Cuts as `SetPointController` does, and leads the guides so that the bent wire is on the path."""

    name: ClassVar[str] = "lead-oracle"


class TrimController(ServoLaw, measure=ShortShare):
    """Runs at a constant feed, slower the more pulses short, and back along its path from a short that stays.

    That is what most machines do once the rough pass is cut.
    """

    name: ClassVar[str] = "trim"

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed for the next window."""
        command = super().update(window)
        if command.alarm is not None or self.servo.retracting:
            return command
        assert isinstance(self.measure, ShortShare)
        return command._replace(feed_um_s=self.measure.slowed_um_s)
