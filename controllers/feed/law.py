"""Components of the gap laws: a servo that sets the feed, a measure of the gap, rules for the period and for corners.

The classic machines feed in proportion to the difference between a mean of the gap and its reference,
``v = K (U - U_ref)``, and so run backwards when the gap shorts. An integral part (ours) holds the reference at any
height and material.

A law names its components and its own defaults; its parameters are those of its components, in one list:

>>> from edmsim.controllers.feed.law import MeanVoltage
>>> class Slow(ServoLaw, measure=MeanVoltage, start_feed_um_s=2.0):
...     name = "slow"
>>> Slow(reference_V=12.0).reset(33.0)
FeedCommand(feed_um_s=2.0, alarm=None, t_on_us=None, t_period_us=None, latency_s=0.0, offset_um=0.0)
"""

import inspect
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers import protocols
from edmsim.controllers.protocols import WindowObservation
from edmsim.errors import InputError
from edmsim.geometry import Floats, left_of, path_corners
from edmsim.machine.machine import Machine
from edmsim.machine.pulse_window import PulseWindow
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.snapshots import Snapshots

PERSISTENT_SHORT = "persistent short"  # the alarm's text
SHORTED_SHARE = 0.5
"""Share of short pulses from which a window counts as shorted (ours, as in the counts controller)."""


def shorted(window: protocols.WindowObservation) -> bool:
    """Return whether a window counts as shorted."""
    return window.short >= SHORTED_SHARE * WINDOW_PULSES


def low_pass_weight(duration_s: float, time_constant_s: float) -> float:
    """Return the weight of a new value in a low-pass filter after a time; 1 without a filter."""
    return -math.expm1(-duration_s / time_constant_s) if time_constant_s else 1.0


class Gains(NamedTuple):
    """Gains of a servo."""

    proportional: float  # feed in um/s per unit of the error
    integral: float  # growth of the feed in um/s per s, per unit of the error
    filter_s: float  # time constant of the low-pass filter on the error


@dataclass
class LawComponent(Snapshots):
    """A component of a law. Its arguments are parameters of the law; its other fields are its state."""

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Read the set-up and the next leg; see `KnowsSetup.set_up`."""

    def begin(self) -> None:
        """Begin a leg with the initial state."""
        for each in fields(self):
            if not each.init:
                setattr(self, each.name, each.default if each.default_factory is MISSING else each.default_factory())

    def fresh_wire(self) -> None:
        """Begin with a new wire at the place of a break."""
        self.begin()


@dataclass
class GapServo(LawComponent):
    """Servo of all gap laws: it turns an error into a feed, retracts from shorts and raises the alarm."""

    filter_s: float = 0.1  # time constant of the low-pass filter on the measured mean
    start_feed_um_s: float = 10.0  # start value of the integral
    # largest speed backwards; the speed of a retract. If the default is above the machine's greatest feed, that feed
    # applies.
    retract_feed_um_s: float = 20.0
    patience_s: float = 0.15  # time in a short after which the wire retracts (ours, as in the counts controller)
    # factor on the integral after a retract (ours: half, because the feed before the short was too fast)
    integral_share: float = 0.5
    # time in one short after which the machine stops with an alarm (ours: at 20 um/s a retract of 0.4 mm)
    give_up_s: float = 20.0

    max_feed_um_s: float = field(default=0.0, init=False)
    error: float = field(default=0.0, init=False)
    integral_um_s: float = field(default=0.0, init=False)
    shorted_s: float = field(default=0.0, init=False)
    retracting: bool = field(default=False, init=False)

    def start(self, max_feed_um_s: float) -> None:
        """Begin with the start feed."""
        self.begin()
        self.max_feed_um_s, self.integral_um_s = max_feed_um_s, self.start_feed_um_s

    def weight(self, duration_s: float) -> float:
        """Weight of a window in the low-pass filter."""
        return low_pass_weight(duration_s, self.filter_s)

    def update(self, window: protocols.WindowObservation, error: float, gains: Gains) -> protocols.FeedCommand:
        """Return the command for the next window; `error` is positive if the gap is too wide."""
        if math.isnan(error):
            error = self.error
        short = shorted(window)
        self.shorted_s = self.shorted_s + window.duration_s if short else 0.0
        if short and self.shorted_s >= self.give_up_s:
            return protocols.FeedCommand(0.0, PERSISTENT_SHORT)
        if short and self.shorted_s >= self.patience_s:
            self.retracting = True
            return protocols.FeedCommand(-self._back_um_s)
        if self.retracting:  # cleared: the filter forgets the short
            self.retracting = False
            self.error = error
            self.integral_um_s *= self.integral_share
        self.error += low_pass_weight(window.duration_s, gains.filter_s) * (error - self.error)
        growth = gains.integral * self.error * window.duration_s
        self.integral_um_s = min(max(self.integral_um_s + growth, 0.0), self.max_feed_um_s)
        feed = self.integral_um_s + gains.proportional * self.error
        return protocols.FeedCommand(min(max(feed, -self._back_um_s), self.max_feed_um_s))

    @property
    def _back_um_s(self) -> float:
        return min(self.retract_feed_um_s, self.max_feed_um_s)


class Measure(LawComponent, ABC):
    """Measures the difference between the gap and its target."""

    FEEDS: ClassVar[tuple[str, ...]] = ()
    """Parameters that are feeds, which must not exceed the machine's largest."""
    GAINS: ClassVar[tuple[str, str]]
    """Parameters that are gains of the servo: see `Gains`."""

    def gains(self, servo: GapServo) -> Gains:
        """Return the gains of the servo."""
        proportional, integral = self.GAINS
        return Gains(getattr(self, proportional), getattr(self, integral), servo.filter_s)

    @abstractmethod
    def error(self, window: protocols.WindowObservation, servo: GapServo) -> float:
        """Return the error, positive if the gap is too wide; NaN if the window has no measurement."""

    def first_feed_um_s(self, servo: GapServo) -> float:
        """Feed of a leg's first window."""
        return servo.start_feed_um_s


class PeriodRule(LawComponent):
    """Chooses the setting of the generator; by default the operator's."""

    operator_us = 0.0
    """The operator's period; 0 where no set-up is known."""

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Read the operator's period."""
        self.operator_us = machine.t_period_us

    def first_setting_us(self, law: "ServoLaw") -> tuple[float | None, float | None]:
        """Return on-time and period for the beginning of a leg or wire; None keeps the present ones."""
        return None, None

    def next_setting_us(
        self, window: protocols.WindowObservation, law: "ServoLaw"
    ) -> tuple[float | None, float | None]:
        """Return on-time and period of the next window; called before the servo's update."""
        return None, None


class CornerRule(LawComponent):
    """Changes period and offset near corners; by default neither."""

    start_um = 0.0
    """Length of path at which the leg begins."""

    def look(self, window: protocols.WindowObservation) -> None:
        """Read a window."""

    def slowing(self, path_um: float) -> float:
        """Return the factor on the period at a place of the path."""
        return 1.0

    def offset(self, path_um: float) -> float:
        """Return the offset at a place of the path, to its left."""
        return 0.0


class Gauge(LawComponent, ABC):
    """Estimates how near the wire is to boiling dry."""

    @abstractmethod
    def near(self, window: protocols.WindowObservation) -> float:
        """Return the measure: 1 where the wire boils dry, 0 far from it."""


@dataclass
class ServoLaw(Snapshots):
    """A gap law of components: `GapServo`, a measure, and rules for period and corners.

    The class keywords ``measure``, ``period``, ``corner`` and ``gauge`` name the components. ``fixed`` names
    parameters of components that the law does not offer; other keywords are the law's own defaults.
    """

    name: ClassVar[str]
    COMPONENTS: ClassVar[dict[str, type[LawComponent]]] = {
        "servo": GapServo, "measure": Measure, "period": PeriodRule, "corner": CornerRule, "gauge": LawComponent,
    }  # fmt: skip
    STATE = tuple(COMPONENTS)
    if TYPE_CHECKING:
        servo: GapServo
        measure: Measure
        period: PeriodRule
        corner: CornerRule
        gauge: Gauge

    def __init_subclass__(
        cls, measure: type[Measure] | None = None, period: type[PeriodRule] | None = None,
        corner: type[CornerRule] | None = None, gauge: type[Gauge] | None = None, fixed: tuple[str, ...] = (),
        **defaults: float,
    ) -> None:
        """Give a law the parameters of its components."""
        super().__init_subclass__()
        own = {"measure": measure, "period": period, "corner": corner, "gauge": gauge}
        cls.COMPONENTS = {**cls.COMPONENTS, **{slot: kind for slot, kind in own.items() if kind is not None}}
        if measure is None:
            return
        found = {each.name: each.default for each in _parameters(cls.COMPONENTS) if each.name not in fixed}
        cls.__annotations__ = {**inspect.get_annotations(cls), **dict.fromkeys(found, "float")}
        for parameter, default in {**found, **defaults}.items():
            setattr(cls, parameter, default)
        dataclass(cls)

    def __post_init__(self) -> None:
        protocols.check_parameters(self)
        for slot, kind in self.COMPONENTS.items():
            own = [each.name for each in _arguments(kind) if hasattr(self, each.name)]
            setattr(self, slot, kind(**{parameter: getattr(self, parameter) for parameter in own}))

    @property
    def components(self) -> tuple[LawComponent, ...]:
        """The servo and all rules."""
        return tuple(getattr(self, slot) for slot in self.COMPONENTS)

    def override(self, values: Mapping[str, float]) -> None:
        """Let the components have other values of their parameters; those of the law itself stay as they are."""
        for name, value in values.items():
            for component in self.components:
                if hasattr(component, name):
                    setattr(component, name, value)

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Read the set-up and the next leg."""
        for component in self.components:
            component.set_up(machine, points_um, start_um)

    def reset(self, max_feed_um_s: float) -> protocols.FeedCommand:
        """Begin a leg; refuses feeds above the machine's largest."""
        for parameter in ("start_feed_um_s", "retract_feed_um_s", *self.measure.FEEDS):
            feed_um_s = getattr(self, parameter, 0.0)  # 0 where the law does not offer it
            if parameter != "retract_feed_um_s" or feed_um_s != getattr(type(self), parameter):
                protocols.check_feed(self.name, parameter, feed_um_s, max_feed_um_s)
        for component in self.components:
            component.begin()
        return self._first(max_feed_um_s)

    def wire_lost(self) -> protocols.FeedCommand:
        """Begin with a new wire at the place of a break."""
        limit_um_s = self.servo.max_feed_um_s
        for component in self.components:
            component.fresh_wire()
        return self._first(limit_um_s)

    def _first(self, limit_um_s: float) -> protocols.FeedCommand:
        self.servo.start(limit_um_s)
        on_us, period_us = self.period.first_setting_us(self)
        offset_um = self.corner.offset(self.corner.start_um)
        feed_um_s = self.measure.first_feed_um_s(self.servo)
        return protocols.FeedCommand(feed_um_s, t_on_us=on_us, t_period_us=period_us, offset_um=offset_um)

    def update(self, window: protocols.WindowObservation) -> protocols.FeedCommand:
        """Feed, setting and offset for the next window."""
        self.corner.look(window)
        on_us, period_us = self.period.next_setting_us(window, self)
        error, gains = self.measure.error(window, self.servo), self.measure.gains(self.servo)
        offset_um = self.corner.offset(window.path_um)
        command = self.servo.update(window, error, gains)
        return command._replace(t_on_us=on_us, t_period_us=period_us, offset_um=offset_um)


class TruthLaw(ServoLaw):
    """A law with components that read the true state of the gap: a bound for comparisons."""

    def see(self, truth: PulseWindow) -> None:
        """Read the true state of the gap."""
        for component in self.components:
            if isinstance(component, protocols.SeesTruth):
                component.see(truth)


def _arguments(kind: Any) -> list[Any]:
    return [each for each in fields(kind) if each.init]


def _parameters(components: dict[str, type[LawComponent]]) -> Iterator[Any]:
    """Yield the arguments of components; those that a rule adds to its base class come last."""
    rules = [kind for slot, kind in components.items() if slot != "gauge"]
    added: list[Any] = []
    for kind in rules:
        bases = [base for base in reversed(kind.__mro__) if is_dataclass(base)]
        own = next((found for base in bases if (found := _arguments(base))), [])
        yield from own
        added += _arguments(kind)[len(own) :]
    yield from (*added, *_arguments(components["gauge"]))



# Measures of the gap laws: mean voltage, mean ignition delay, the share of opens, fuzzy rules, the true gap.
#
# Sources of `MeanVoltage`: US 4296302 (servo on average gap voltage and power), CA 1049621 (servo of a wire machine,
# 1976); the law is the simplest of the classic machines.
#
# Sources of `MeanDelay` (a wide gap ignites late): ETH's open wire-EDM simulator SPARC, whose machines are
# controlled in proportion to the mean voltage or the mean ignition delay; a monitor of wire-EDM turning that replaces
# the voltage by the mean delay over 200 ms (doi:10.1177/0954405414543488). The counting of shorts and opens is ours.
#
# Source of `FuzzyRules`, the field's classic: Lin, Chung, Huang, J. Mater. Process. Technol. 113 (2001) 324-330,
# fuzzy control of a wire-EDM machine from what its pulses show. Their memberships and rule table could not be read;
# those here are ours, after the usual scheme: a Sugeno controller of order zero, triangular memberships, product and
# weighted mean.
#
# ====================  =========  =====  =====
# open ratio            low        right  high
# ====================  =========  =====  =====
# falling               -1         -0.5   +0.5
# steady                -1          0     +1
# rising                -0.5       +0.5   +1
# short ratio is high   -2, whatever the open ratio
# ====================  =========  =====  =====

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



# Rules of gap laws for corners: a longer pulse period, and an offset of the guides.
#
# Less power bends the wire less. The offset moves the guides off the path by as much as the wire bends. The numbers
# are ours; those of a task's reference lines are in `edmsim.evaluation.episode`.

@dataclass
class Corners(CornerRule):
    """A longer period near corners, and an offset after them."""

    # before_um, behind_um: path before and after a corner on which the period is longer; 0 for none
    before_um: float = 0.0
    behind_um: float = 0.0
    corner_factor: float = 4.0  # period near a corner divided by the period elsewhere, 1 or more
    # 0, or the deflection of a wire under 1 N per m of workpiece for which `corner_factor` is meant. The factor of
    # another wire is scaled with the square root of its deflection divided by this value.
    slack_um: float = 0.0
    offset_um: float = 0.0  # offset to the left of the path
    # force on the wire per height of workpiece, positive forward; negative for a wire that lags. The force bends the
    # wire by `lead_um`, and after a corner this deflection points off the path. The offset compensates it and fades
    # out as the wire turns into the new direction.
    pull_N_m: float = 0.0
    fade_um: float = 100.0  # length of path after a corner on which this compensation falls to 1/e; 0 for none

    def __post_init__(self) -> None:
        self.start_um = self._lead_um = 0.0
        self._at_corner = 1.0
        self._corners_um: Floats = np.zeros(0)
        self._turns_rad: Floats = np.zeros(0)

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Read the corners of the leg, and compute the bend of the wire."""
        along_um, turns_deg = path_corners(points_um)
        self._corners_um = along_um + start_um
        self._turns_rad = np.radians(turns_deg)
        self._lead_um = lead_um(machine, self.pull_N_m)
        slack = math.sqrt(lead_um(machine, 1.0) / self.slack_um) if self.slack_um else 1.0
        self._at_corner = max(self.corner_factor * slack, 1.0)
        self.start_um = start_um

    def slowing(self, path_um: float) -> float:
        """Return the factor on the period at a place of the path."""
        passed_um = path_um - self._corners_um
        near = bool(((-self.before_um < passed_um) & (passed_um < self.behind_um)).any())
        return self._at_corner if near else 1.0

    def offset(self, path_um: float) -> float:
        """Return the offset at a place of the path, to its left."""
        if not self.fade_um:
            return self.offset_um
        behind_um = path_um - self._corners_um
        passed = behind_um >= 0.0
        lateral_um = self._lead_um * np.sin(self._turns_rad[passed]) * np.exp(-behind_um[passed] / self.fade_um)
        return self.offset_um + float(lateral_um.sum())


@dataclass
class OuterCorners(CornerRule):
    """A longer period before outer corners: less and less metal is in front of a trim there."""

    # path before an outer corner of the wire's path on which the period is longer; 0 for none. Trims go straight past
    # the part's corner, by about their offset.
    before_um: float = 0.0
    corner_factor: float = 3.0  # period there divided by the period elsewhere, 1 or more

    def __post_init__(self) -> None:
        self.part_side: Literal["left", "right"] | None = None
        self._corners_um: Floats = np.zeros(0)

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Find where the leg turns to the part."""
        along_um, turns_deg = path_corners(points_um)
        towards = {"left": turns_deg > 0, "right": turns_deg < 0, None: np.zeros(len(turns_deg), bool)}
        self._corners_um = along_um[towards[self.part_side]] + start_um
        self.start_um = start_um

    def slowing(self, path_um: float) -> float:
        """Return the factor on the period at a place of the path."""
        ahead_um = self._corners_um - path_um
        return self.corner_factor if ((ahead_um >= 0.0) & (ahead_um < self.before_um)).any() else 1.0


def lead_um(machine: Machine, force_N_m: float) -> float:
    """Return how far a load q bends a wire: ``q h (2 l - h) / (8 T) - q h**2 / (24 T)`` in the mean over h, in um."""
    height_m, guides_m = machine.height_mm * 1e-3, machine.guide_distance_mm * 1e-3
    bent = height_m * (2 * guides_m - height_m) / 8 - height_m**2 / 24
    return force_N_m * bent / machine.tension * 1e6


@dataclass
class TrueBend(Corners):
    """Offsets the guides by the wire's true deflection, which no sensor of a real machine measures.

    The offset is the opposite of the true mean deflection across the path.
    """

    # time constant of the average of the deflection: the guides must not follow the wire's vibration
    average_s: float = 0.25

    bent_um: tuple[float, float] = field(default=(0.0, 0.0), init=False)
    mean_um: Floats = field(default_factory=lambda: np.zeros(2), init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._ends_um: Floats = np.zeros(0)
        self._left: Floats = np.zeros((1, 2))

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Read the path: the end of each segment and its direction to the left."""
        super().set_up(machine, points_um, start_um)
        pieces = np.diff(np.asarray(points_um, np.float64), axis=0)
        lengths_um = np.hypot(pieces[:, 0], pieces[:, 1])
        self._ends_um = start_um + np.cumsum(lengths_um)
        self._left = left_of(pieces / lengths_um[:, None])

    def begin(self) -> None:
        """Begin with a straight wire."""
        self.mean_um = np.zeros(2)

    def see(self, truth: PulseWindow) -> None:
        """Read the true deflection of a window."""
        self.bent_um = truth.deflection_um

    def look(self, window: WindowObservation) -> None:
        """Average the deflection."""
        weight = low_pass_weight(window.duration_s, self.average_s)
        self.mean_um = self.mean_um + weight * (np.array(self.bent_um) - self.mean_um)

    def offset(self, path_um: float) -> float:
        """Return the offset that brings the wire back onto the path."""
        piece = min(int(np.searchsorted(self._ends_um, path_um, side="right")), len(self._left) - 1)
        return self.offset_um - float(self.mean_um @ self._left[piece])
