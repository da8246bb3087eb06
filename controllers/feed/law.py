"""Parts of the gap laws: a servo that sets the feed, a measure of the gap, a rule for the period, one for corners.

The classic machines feed in proportion to the difference between a mean of the gap and its reference,
``v = K (U - U_ref)``, and so run backwards when the gap shorts. An integral part (ours) holds the reference at any
height and material.

A law names its parts and its own defaults; its parameters are those of its parts, in one list:

>>> from edmsim.controllers.feed.measures import MeanVoltage
>>> class Slow(ServoLaw, measure=MeanVoltage, start_feed_um_s=2.0):
...     name = "slow"
>>> Slow(reference_V=12.0).reset(33.0)
FeedCommand(feed_um_s=2.0, alarm=None, t_on_us=None, t_period_us=None, latency_s=0.0, offset_um=0.0)
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from numpy.typing import NDArray

from edmsim.controllers import protocols
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
class Part(Snapshots):
    """A part of a law. Its arguments are parameters of the law; its other fields are its state."""

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
class GapServo(Part):
    """Servo of all gap laws: it turns an error into a feed, retracts from shorts and raises the alarm."""

    filter_s: float = 0.1  # time constant of the low-pass filter on the measured mean
    start_feed_um_s: float = 10.0  # start value of the integral
    # largest speed backwards; the speed of a retract. A law's own default is limited to what the machine runs.
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
        if self.shorted_s >= self.give_up_s:
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


class Measure(Part, ABC):
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


class PeriodRule(Part):
    """Chooses the setting of the generator; by default the operator's."""

    def first_setting_us(self, law: "ServoLaw") -> tuple[float | None, float | None]:
        """Return on-time and period for the beginning of a leg or wire; None keeps the present ones."""
        return None, None

    def next_setting_us(
        self, window: protocols.WindowObservation, law: "ServoLaw"
    ) -> tuple[float | None, float | None]:
        """Return on-time and period of the next window; called before the servo's update."""
        return None, None


class CornerRule(Part):
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


class Gauge(Part, ABC):
    """Estimates how near the wire is to boiling dry."""

    @abstractmethod
    def near(self, window: protocols.WindowObservation) -> float:
        """Return the measure: 1 where the wire boils dry, 0 far from it."""


@dataclass
class ServoLaw(Snapshots):
    """A gap law of parts: `GapServo`, a measure, and rules for period and corners.

    The class keywords ``measure``, ``period``, ``corner`` and ``gauge`` name the parts. ``fixed`` names parameters of
    parts that the law does not offer; other keywords are the law's own defaults.
    """

    name: ClassVar[str]
    PARTS: ClassVar[dict[str, type[Part]]] = {
        "servo": GapServo, "measure": Measure, "period": PeriodRule, "corner": CornerRule, "gauge": Part,
    }  # fmt: skip
    STATE = tuple(PARTS)
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
        """Give a law the parameters of its parts."""
        super().__init_subclass__()
        own = {"measure": measure, "period": period, "corner": corner, "gauge": gauge}
        cls.PARTS = {**cls.PARTS, **{slot: kind for slot, kind in own.items() if kind is not None}}
        if measure is None:
            return
        found = {each.name: each.default for each in _parameters(cls.PARTS) if each.name not in fixed}
        cls.__annotations__ = {**vars(cls).get("__annotations__", {}), **dict.fromkeys(found, "float")}
        for parameter, default in {**found, **defaults}.items():
            setattr(cls, parameter, default)
        dataclass(cls)

    def __post_init__(self) -> None:
        protocols.check_parameters(self)
        for slot, kind in self.PARTS.items():
            own = [each.name for each in _arguments(kind) if hasattr(self, each.name)]
            setattr(self, slot, kind(**{parameter: getattr(self, parameter) for parameter in own}))

    @property
    def parts(self) -> tuple[Part, ...]:
        """The servo and all rules."""
        return tuple(getattr(self, slot) for slot in self.PARTS)

    def override(self, values: Mapping[str, float]) -> None:
        """Let the parts have other values of their parameters; those of the law itself stay as they are."""
        for name, value in values.items():
            for part in self.parts:
                if hasattr(part, name):
                    setattr(part, name, value)

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Read the set-up and the next leg."""
        for part in self.parts:
            part.set_up(machine, points_um, start_um)

    def reset(self, max_feed_um_s: float) -> protocols.FeedCommand:
        """Begin a leg; refuses feeds above the machine's largest."""
        for parameter in ("start_feed_um_s", "retract_feed_um_s", *self.measure.FEEDS):
            feed_um_s = getattr(self, parameter)
            if parameter != "retract_feed_um_s" or feed_um_s != getattr(type(self), parameter):
                protocols.check_feed(self.name, parameter, feed_um_s, max_feed_um_s)
        for part in self.parts:
            part.begin()
        return self._first(max_feed_um_s)

    def wire_lost(self) -> protocols.FeedCommand:
        """Begin with a new wire at the place of a break."""
        limit_um_s = self.servo.max_feed_um_s
        for part in self.parts:
            part.fresh_wire()
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
    """A law with parts that read the true state of the gap: a bound for comparisons."""

    def see(self, truth: PulseWindow) -> None:
        """Read the true state of the gap."""
        for part in self.parts:
            if isinstance(part, protocols.SeesTruth):
                part.see(truth)


def _arguments(kind: Any) -> list[Any]:
    return [each for each in fields(kind) if each.init]


def _parameters(parts: dict[str, type[Part]]) -> Iterator[Any]:
    """Yield the arguments of parts; those that a rule adds to its base class come last."""
    rules = [kind for slot, kind in parts.items() if slot != "gauge"]
    added: list[Any] = []
    for kind in rules:
        bases = [base for base in reversed(kind.__mro__) if is_dataclass(base)]
        own = next((found for base in bases if (found := _arguments(base))), [])
        yield from own
        added += _arguments(kind)[len(own) :]
    yield from (*added, *_arguments(parts["gauge"]))
