"""Rules for the pulse period: constant, by the count of normal pulses, or by the heat of the wire.

Source of `NormalPulses`: Sato et al. Normal pulses are counted every 100 ms, and the off-time holds the count below a
threshold that rises less than proportionally with the workpiece's thickness. The thickness is estimated as mean
current over speed, because removal is proportional to the mean current. They report 24 % more speed. Their off-time
may also fall below the operator's; on the laboratory machine it may not, because the generator's limit of 2 A leaves
no shorter period. The threshold's numbers were not published; ours come from a search.

`RisingPeriod` is the setting of an operator who wants no broken wire. `HeatFluxHold` uses an estimated heat flux, or
the wire's true temperature. The hotter a wire is, the better water cools it, up to the critical heat flux. Above
that, steam covers the wire, and it heats up and breaks within some 20 ms. No law can react so fast. So the law
controls how far the hottest place of the wire is from this limit.

`Climb` searches: more power until a wire breaks, then less. So an operator finds the setting for a wire and a height
that no table has (ours). Its pace was chosen among five in the first version of ThinWire on 64 training machines. The
default earned 1,336 and lost 23 wires; the others earned 1,100 to 1,359 and lost 20 to 27.

Some rules estimate, while they cut, the heat flux at which this machine's wires break. They hold a flux as
`HeatFluxHold` does, and change it. `ClimbingHold` raises it until a wire breaks, then lowers it and raises it more
slowly. `AdaptiveHold` has a probability distribution of the flux at which wires of this machine break. It updates it
by Bayes' rule with every second without a break and with every lost wire, and holds the flux with the largest
expected return. Their numbers are ours: in ramps of the flux on training machines, the breaks of one machine were
within some 10 % of one flux, and those of different machines within a factor of 3 (docs/tasks/max-rate-shift.md).
"""

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.feed.law import Gauge, PeriodRule, ServoLaw, low_pass_weight, shorted
from edmsim.controllers.protocols import WindowObservation
from edmsim.machine.components import BOILING_K
from edmsim.machine.machine import Machine
from edmsim.machine.pulse_window import PulseWindow
from edmsim.machine.setting import WINDOW_PULSES, discharge_current_A, flushing_Pa, least_period_us, pulse_form

COUNT_S = 0.1  # time over which normal pulses are counted: 100 ms (Sato et al.)
STEP_SHARE = 0.1  # largest change of the period per count (ours: off-times change smoothly, not from pulse to pulse)
STEP_US = 5  # the shortest period is rounded up to whole multiples of this (ours: knobs have steps)
MOST_ERROR = 1.0  # limit of the error (ours: one window with few sparks means little)
USUAL_S = 20.0  # time constant of the usual share of opens (ours: many retracts, a tenth of a workpiece)
WIDER = 0.1  # share of opens above the usual one from which a gap counts as wider (ours: of one window, 0.03)
_Setting = tuple[float | None, float | None]


@dataclass
class NormalPulses(PeriodRule):
    """Holds the count of normal pulses by the off-time."""

    normal_at_10mm: float = 600.0  # threshold at 10 mm of thickness: normal pulses per 100 ms
    exponent_share: float = 0.5  # power of the thickness with which the threshold rises: below 1
    # thickness in mm per ampere and s/um of mean current over speed. Ours: with the default set-up tool steel 20 mm
    # high takes 46 um/s and 1.63 A (562), with the production machine 40 mm high 35 um/s and 8.1 A (176).
    height_factor: float = 562.0
    height_filter_s: float = 0.5  # time constant of the low-pass filter on the thickness
    # shortest_factor, longest_factor: shortest and longest period, divided by the operator's: 1 or less, 1 or more
    shortest_factor: float = 1.0
    longest_factor: float = 5.0

    # sums since the last count, the thickness, and the setting; 0 means unknown
    seconds: float = field(default=0.0, init=False)
    normal: float = field(default=0.0, init=False)
    charge: float = field(default=0.0, init=False)
    travel_um: float = field(default=0.0, init=False)
    height_mm: float = field(default=0.0, init=False)
    base_us: float = field(default=0.0, init=False)
    period_us: float = field(default=0.0, init=False)

    def next_setting_us(self, window: WindowObservation, law: ServoLaw) -> _Setting:
        """Add a window; every 100 ms compare with the threshold and set the period."""
        if not self.base_us:  # without a set-up the first window has the operator's period
            usual_us = self.operator_us or round(window.duration_s * 1e6 / WINDOW_PULSES, 6)
            self.base_us = self.period_us = usual_us
        self.seconds += window.duration_s
        self.normal += WINDOW_PULSES - window.short - window.open
        if math.isfinite(window.mean_current_A):
            self.charge += window.mean_current_A * window.duration_s
        self.travel_um += window.feed_um_s * window.duration_s
        if self.seconds >= COUNT_S:
            self._take_count()
        return None, self.period_us

    def _take_count(self) -> None:
        self._estimate_height()
        threshold = self.normal_at_10mm * (self.height_mm / 10.0) ** self.exponent_share
        # before the wire has moved the thickness is unknown, and the period stays
        excess = self.normal / self.seconds * COUNT_S / threshold if threshold else 1.0
        change = min(max(excess, 1.0 - STEP_SHARE), 1.0 + STEP_SHARE)
        shortest, longest = self.shortest_factor * self.base_us, self.longest_factor * self.base_us
        # whole us, as timers count them
        self.period_us = max(float(round(min(max(self.period_us * change, shortest), longest))), shortest)
        self.seconds = self.normal = self.charge = self.travel_um = 0.0

    def _estimate_height(self) -> None:
        """Estimate the thickness as mean current over speed, unless the wire rests or runs back."""
        if self.travel_um <= 0:
            return
        h_mm = self.height_factor * self.charge / self.travel_um
        weight = low_pass_weight(self.seconds, self.height_filter_s)
        self.height_mm = h_mm if not self.height_mm else self.height_mm + weight * (h_mm - self.height_mm)


@dataclass
class FreshNormalPulses(NormalPulses):
    """`NormalPulses`, but every wire begins with a longer period."""

    slow_factor: float = 2.5  # first period of every wire, divided by the operator's, 1 or more (ours)

    fresh: bool = field(default=True, init=False)

    def fresh_wire(self) -> None:
        """Keep the estimate of the thickness."""
        self.fresh = True

    def next_setting_us(self, window: WindowObservation, law: ServoLaw) -> _Setting:
        """Return the period of the next window."""
        super().next_setting_us(window, law)
        if self.fresh:
            self.fresh = False
            self.period_us = self.base_us * self.slow_factor
        return None, self.period_us


@dataclass
class RisingPeriod(PeriodRule):
    """A period that a new wire reaches slowly."""

    period_us: float = 40.0  # pulse period; 0 for the operator's
    rise_s: float = 1.5  # time in which a new wire reaches it, starting from a period `slow_factor` times as long
    slow_factor: float = 2.0  # first period of a new wire, divided by the final one, 1 or more

    cutting_s: float = field(default=0.0, init=False)  # since the wire was threaded

    @property
    def usual_us(self) -> float:
        """Period after the slow approach; 0 where neither a period nor a set-up is known."""
        return self.period_us or self.operator_us

    def fresh_wire(self) -> None:
        """Begin the slow approach to the period again, with the next wire."""
        self.cutting_s = 0.0

    def next_setting_us(self, window: WindowObservation, law: ServoLaw) -> _Setting:
        """Return the period of the next window."""
        self.cutting_s += window.duration_s
        left = max(1.0 - self.cutting_s / self.rise_s, 0.0) if self.rise_s else 0.0
        return None, self.next_us(window, law) * float(self.slow_factor**left) or None

    def next_us(self, window: WindowObservation, law: ServoLaw) -> float:
        """Period after the slow approach."""
        return self.usual_us


@dataclass
class HeatFluxHold(RisingPeriod):
    """Holds a gauge's measure of how near the wire is to boiling dry; ``period_us`` is the first period of a cut."""

    hold_share: float = 0.6  # target of the measure, which is 1 where the wire boils dry
    break_hold_share: float = 0.8  # factor on the target after every lost wire (ours)
    # proportional_share, integral_per_s: change of the period's logarithm, and its growth per second, per unit of the
    # difference from the target
    proportional_share: float = 0.3
    integral_per_s: float = 1.0
    # shortest_us, longest_us: limits of the period (ours); the proportional part and the slow start of a wire may
    # exceed the longest. If hardly a pulse ignites there is no heat to hold, and the period falls to the shortest
    # one.
    shortest_us: float = 25.0
    longest_us: float = 150.0
    # if above 0, shorts do not shorten the period (the discharges that clear a short could break the wire at the
    # shortest period), and for this time after a retract the period is longer, as in `rise_s` after a new wire
    recovery_s: float = 0.0
    # time after a retract, and of a new wire, in which the period is not shortened while more pulses than usual are
    # open: it would be too short when the gap has closed again
    refill_s: float = 0.0

    log_us: float = field(default=0.0, init=False)  # the period's regulated part
    hold: float = field(default=0.0, init=False)
    usual_open: float = field(default=0.0, init=False)  # slow mean of the share of opens
    refilling_s: float = field(default=0.0, init=False)  # time left in which an open gap does not shorten the period

    def begin(self) -> None:
        """Begin a leg."""
        super().begin()
        self.log_us, self.hold = math.log(max(self.usual_us, 1.0)), self.hold_share

    def fresh_wire(self) -> None:
        """Lower the target after a break."""
        super().fresh_wire()
        self.log_us = min(self.log_us + math.log(self.slow_factor), self._longest)
        self.hold *= self.break_hold_share
        self.refilling_s = self.refill_s

    @property
    def _longest(self) -> float:
        return math.log(max(self.longest_us, self.shortest_us, 1.0))

    def next_us(self, window: WindowObservation, law: ServoLaw) -> float:
        """Period that brings the measure to its target."""
        error = min(max(self.excess(law.gauge.near(window)), -MOST_ERROR), MOST_ERROR)
        if self.recovery_s and shorted(window):  # or the sparks that clear a short would find the shortest period
            error = max(error, 0.0)
        if self.recovery_s and law.servo.retracting:
            self.cutting_s = min(self.cutting_s, max(self.rise_s - self.recovery_s, 0.0))
            self.refilling_s = self.refill_s
        if self._refills(window):  # otherwise the period would be at its shortest when the gap has closed again
            error = max(error, 0.0)
        grown = self.log_us + self.integral_per_s * error * window.duration_s
        self.log_us = min(max(grown, math.log(max(self.shortest_us, 1.0))), self._longest)
        return max(math.exp(self.log_us + self.proportional_share * error), self.shortest_us)

    def excess(self, near: float) -> float:
        """Return how far a measure is above the target."""
        return near - self.hold

    def _refills(self, window: WindowObservation) -> bool:
        """Return whether the gap is still wider than usual after a retract or a break."""
        share = window.open / WINDOW_PULSES
        self.usual_open += low_pass_weight(window.duration_s, USUAL_S) * (share - self.usual_open)
        self.refilling_s = max(self.refilling_s - window.duration_s, 0.0)
        return self.refilling_s > 0.0 and share > self.usual_open + WIDER


@dataclass
class FluxGauge(Gauge):
    """The highest local heat flux divided by the critical one, estimated from located sparks.

    It knows what an operator knows: the names of the set-up's files, wire, height and pulse. It uses the constants of
    those files, because a real controller cannot know the machine's true ones.
    """

    flux_filter_s: float = 0.05  # time constant of the low-pass filter on the flux of each fifth of the height

    flux: NDArray[np.float64] = field(default_factory=lambda: np.zeros(5), init=False)
    """Filtered heat flux of each fifth of the height over the critical one, (5,), from below."""

    def __post_init__(self) -> None:
        self._per_ignition: NDArray[np.float64] = np.zeros((5, 5))

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Read the set-up; see `heat_per_ignition_s`."""
        self._per_ignition = heat_per_ignition_s(machine)

    def near(self, window: WindowObservation) -> float:
        """Return the greatest flux of a fifth over the critical one."""
        flux = self._per_ignition @ np.array(window.fifths, np.float64) / window.duration_s
        self.flux += low_pass_weight(window.duration_s, self.flux_filter_s) * (flux - self.flux)
        return float(self.flux.max())


def heat_per_ignition_s(machine: Machine) -> NDArray[np.float64]:
    """Return what an ignition in each fifth adds to each fifth's flux over the critical one: (5, 5), in s."""
    files = Machine.load(
        machine.name, material=machine.material_name, wire=machine.wire_name, generator=machine.generator_name
    )
    cooling, wire, burning_V = files.base.cooling, files.wire, files.material.burning_voltage_V.value
    on_s, height_m = machine.t_on_us * 1e-6, machine.height_mm * 1e-3
    pulse = ("t_on_us", "t_period_us", "peak_current_A", "resistance_ohm", "pulse_shape")
    current_A = discharge_current_A(files.with_(**{name: getattr(machine, name) for name in pulse}))
    diameter_m = machine.wire_diameter_um * 1e-6
    clearance_m = files.base.guides.clearance_mm.value * 1e-3
    ohm_m = wire.resistivity_Ohm_m.value / (math.pi / 4 * diameter_m**2)
    place = (clearance_m + (np.arange(5) + 0.5) / 5 * height_m) / (height_m + 2 * clearance_m)
    below = np.arange(5)[:, None] < np.arange(5)  # the place heated below the spark
    share = np.where(below, (1 - place) ** 2, np.where(below.T, place**2, ((1 - place) ** 2 + place**2) / 2))
    joule_J = share * pulse_form(machine).square * current_A**2 * on_s * ohm_m * height_m / 5
    spark_J = np.eye(5) * cooling.wire_heat_share.value * current_A * burning_V * on_s
    return np.asarray((joule_J + spark_J) / (math.pi * diameter_m * height_m / 5 * cooling.critical_W_m2.value))


@dataclass
class HeatGauge(Gauge):
    """The true superheat: 0 at the boiling point, 1 where the wire of this machine boils dry."""

    superheat: float = field(default=0.0, init=False)
    _superheat_K = 30.0  # if no set-up is known

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Read the superheat at which this machine's wire boils dry."""
        self._superheat_K = machine.base.cooling.superheat_K.value

    def see(self, truth: PulseWindow) -> None:
        """Read the true temperature of a window."""
        self.superheat = (truth.wire_temperature_K - BOILING_K) / self._superheat_K

    def near(self, window: WindowObservation) -> float:
        """Return the superheat over the one at which the wire boils dry; it is negative below the boiling point."""
        return self.superheat


@dataclass
class CornerPeriod(PeriodRule):
    """The operator's period, longer where the rule for corners says so."""

    slower: bool = field(default=False, init=False)  # whether the period is longer than the operator's

    def first_setting_us(self, law: ServoLaw) -> _Setting:
        """Return the setting at the start of a leg."""
        return self._at(law.corner.start_um, law)

    def next_setting_us(self, window: WindowObservation, law: ServoLaw) -> _Setting:
        """Return the setting of the next window."""
        return self._at(window.path_um, law)

    def _at(self, path_um: float, law: ServoLaw) -> _Setting:
        factor, before = law.corner.slowing(path_um), self.slower
        self.slower = factor > 1.0
        return None, self.operator_us * factor if self.slower or before else None


@dataclass
class SetPoint(PeriodRule):
    """A setting in proportion to the operator's, and a longer period at corners.

    When the period changes, the feed changes at once in the same proportion as the removal: a servo alone would run
    into the metal for a second.
    """

    on_factor: float = 1.0  # on_factor, period_factor: on-time and pulse period, divided by the operator's
    period_factor: float = 1.0

    slowing: float = field(default=1.0, init=False)  # period away from corners, divided by the operator's
    factor: float = field(default=1.0, init=False)  # present period, divided by the operator's
    _on_us, _least_us = 1.0, 0.0

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Read the operator's setting and the shortest period of the supply."""
        super().set_up(machine, points_um, start_um)
        self._on_us = machine.t_on_us * self.on_factor
        self._least_us = float(math.ceil(least_period_us(machine, self._on_us) / STEP_US) * STEP_US)

    def begin(self) -> None:
        """Begin at the present period."""
        super().begin()
        self.slowing = self.period_factor

    def fresh_wire(self) -> None:
        """Keep the period."""

    @property
    def least_factor(self) -> float:
        """Shortest period of the supply, divided by the operator's; 0 if no set-up is known."""
        return self._least_us / self.operator_us if self.operator_us else 0.0

    def factor_at(self, path_um: float, law: ServoLaw) -> float:
        """Return the period at a place of the path over the operator's, at least the shortest of the supply."""
        return max(self.slowing * law.corner.slowing(path_um), self.least_factor)

    def first_setting_us(self, law: ServoLaw) -> _Setting:
        """Return the setting at the start of a leg."""
        self.factor = self.factor_at(law.corner.start_um, law)
        return self._whole_us()

    def next_setting_us(self, window: WindowObservation, law: ServoLaw) -> _Setting:
        """Return the setting of the next window; the feed changes with the period."""
        factor = self.factor_at(window.path_um, law)
        law.servo.integral_um_s *= self.factor / factor
        self.factor = factor
        return self._whole_us()

    def _whole_us(self) -> _Setting:
        if not self.operator_us:
            return None, None
        return self._on_us, float(round(self.operator_us * self.factor))


@dataclass
class Climb(SetPoint):
    """Shortens the period step by step until the wire breaks; ``period_factor`` is that of the first wire."""

    climb_s: float = 5.0  # cutting time between two steps, retracts not counted
    step_share: float = 0.13  # share by which a step shortens the period
    # factor on the period after a break, 1 or more. The period is then held; a further break lengthens it again.
    back_factor: float = 1.41

    held_s: float = field(default=0.0, init=False)
    broken: bool = field(default=False, init=False)

    def fresh_wire(self) -> None:
        """Continue at a longer period, without a further climb."""
        self.slowing, self.held_s, self.broken = self.slowing * self.back_factor, 0.0, True

    def next_setting_us(self, window: WindowObservation, law: ServoLaw) -> _Setting:
        """Return the setting of the next window, with a shorter period if a step is due."""
        if not (law.servo.retracting or self.broken):
            self.held_s += window.duration_s
        if self.held_s >= self.climb_s:
            self.held_s = 0.0
            self.slowing = max(self.slowing * (1.0 - self.step_share), self.least_factor)
        return super().next_setting_us(window, law)


LEAST_HOLD, MOST_HOLD = 0.02, 3.0
"""Range of the held flux over the critical one by the files' constants (ours: wider than all limits seen)."""
MOST_GROWTH = 50.0  # limit of the growth of its logarithm (ours: wider than the range, so the exponential is finite)
LEVELS = np.linspace(math.log(LEAST_HOLD), math.log(MOST_HOLD), 168)
"""Logarithms of the fluxes that can be held, and at which wires can break, 3 % apart."""
HAZARD_PER_S = 1.0 / 60.0  # hazard at the wire's limit, which defines the limit
SLOW_S = 0.1
"""Time constant of the mean flux before a break (ours: a wire breaks some 20 ms after it boils dry)."""
DECISION_S = 1.0  # time between two decisions (ours: some hundred windows)
RAMP_SHARE = 0.02  # chance that the wire's limit lies below the first flux of a ramp (ours)


@lru_cache(maxsize=8)
def hazards_per_s(steepness: float) -> NDArray[np.float64]:
    """Return the hazard for each held flux (rows) and each limit (columns), without breaks by chance."""
    return np.asarray(HAZARD_PER_S * np.exp(np.clip(steepness * (LEVELS[:, None] - LEVELS), -50.0, 12.0)))


@dataclass
class ClimbingHold(HeatFluxHold):
    """Raises the held share of the critical flux until a wire breaks; then lowers it and raises it more slowly.

    Further parameters: see `HeatFluxHold`; ``hold_share`` is the first value, ``break_hold_share`` the factor on it
    after a break.
    """

    climb_per_s: float = 0.01  # growth of the logarithm of the held flux, per second
    patience_factor: float = 2.0  # divisor of the growth at every break, 1 or more

    pace_per_s: float = field(default=0.0, init=False)

    def begin(self) -> None:
        """Begin a leg without knowledge of the machine."""
        super().begin()
        self.pace_per_s = self.climb_per_s

    def next_us(self, window: WindowObservation, law: ServoLaw) -> float:
        """Period that brings the flux to what is held; the hold stays where the period is at its shortest."""
        if self.log_us > math.log(max(1.05 * self.shortest_us, 1.0)) or self.hold < 1.2 * _near(law):
            self.hold = _grown(self.hold, self.pace_per_s * window.duration_s)
        return super().next_us(window, law)

    def fresh_wire(self) -> None:
        """Lower the held flux for the next wire."""
        super().fresh_wire()
        self.pace_per_s /= self.patience_factor


@dataclass
class AdaptiveHold(HeatFluxHold):
    """Holds the flux with the largest expected return under the present estimate of the machine's limit.

    Further parameters: see `HeatFluxHold`.
    """

    # limit_share, limit_spread: prior of the flux at which wires break: its median, and the standard deviation of its
    # logarithm
    limit_share: float = 0.8
    limit_spread: float = 0.5
    # drift_per_s, fall_per_s: growth of the variance of that logarithm with time, and fall of its mean: water, wear
    # and pressure change the limit
    drift_per_s: float = 2e-5
    fall_per_s: float = 0.0
    # growth of the logarithm of the hazard with that of the flux (breaks of a machine within some 10 %)
    steepness: float = 15.0
    # hazard at any flux (a wire in a shift), for breaks far below a flux that the wire has borne
    by_chance_per_s: float = 1.0 / 1200.0
    rate_exponent: float = 0.8  # growth of the logarithm of the cutting rate with that of the flux
    # factor on the time that a lost wire costs: threading plus the slow start of a new wire
    break_weight: float = 1.0

    chance: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(LEVELS)), init=False)
    seconds: float = field(default=0.0, init=False)  # since the last decision
    level_s: float = field(default=0.0, init=False)  # mean logarithm of the flux over that time
    level: float | None = field(default=None, init=False)  # its present slow mean; None for a wire without windows
    _threading_s = 0.0

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Read the machine's threading time."""
        super().set_up(machine, points_um, start_um)
        self._threading_s = machine.base.table.threading_s.value

    def begin(self) -> None:
        """Begin a leg without knowledge of the machine."""
        super().begin()
        middle, spread = math.log(min(max(self.limit_share, LEAST_HOLD), MOST_HOLD)), max(self.limit_spread, 0.01)
        chance = np.exp(-0.5 * ((LEVELS - middle) / spread) ** 2)
        self.chance = chance / chance.sum()
        self.hold = self.best_hold()

    def limit(self, share: float) -> float:
        """Return the quantile of the machine's limit for a probability from 0 to 1."""
        return float(math.exp(np.interp(share, np.cumsum(self.chance), LEVELS)))

    def best_hold(self) -> float:
        """Return the flux u with the greatest mean of ``u^rate_exponent / (1 + hazard lost_s)`` over the limits."""
        lost_s = self.break_weight * (self._threading_s + self.rise_s)
        cutting = 1.0 / (1.0 + (self.by_chance_per_s + hazards_per_s(self.steepness)) * lost_s)
        rates = np.exp(self.rate_exponent * LEVELS) * (cutting @ self.chance)
        return float(np.exp(LEVELS[int(np.argmax(rates))]))

    def next_us(self, window: WindowObservation, law: ServoLaw) -> float:
        """Period that brings the flux to what is held; then decide what is."""
        period_us = super().next_us(window, law)
        level = math.log(min(max(_near(law), LEAST_HOLD), MOST_HOLD))
        last = level if self.level is None else self.level
        self.level = last + low_pass_weight(window.duration_s, SLOW_S) * (level - last)
        self.seconds += window.duration_s
        self.level_s += self.level * window.duration_s
        if self.seconds >= DECISION_S:
            self._learn(broken=False)
            self.hold = self.best_hold()
        return period_us

    def _learn(self, *, broken: bool) -> None:
        """Update the distribution with the time since the last decision and a break, by Bayes' rule; let it drift."""
        chance = self.chance
        if self.seconds:
            chance = chance * np.exp(-np.minimum(self._hazard(self.level_s / self.seconds) * self.seconds, 500.0))
        if broken and self.level is not None:
            chance = chance * self._hazard(self.level)
        spacing = LEVELS[1] - LEVELS[0]
        moved = min(0.5 * self.drift_per_s * self.seconds / spacing**2, 0.25)
        fallen = min(self.fall_per_s * self.seconds / spacing, 0.25)
        around = np.pad(chance, 1, mode="edge")
        chance = (1.0 - 2.0 * moved - fallen) * chance + moved * (around[:-2] + around[2:]) + fallen * around[2:]
        self.chance = chance / max(chance.sum(), 1e-300)
        self.seconds = self.level_s = 0.0

    def _hazard(self, level: float) -> NDArray[np.float64]:
        """Return the hazard at the logarithm of a flux, for every limit, per s."""
        row = int(np.argmin(np.abs(LEVELS - level)))
        return np.asarray(self.by_chance_per_s + hazards_per_s(self.steepness)[row])

    def fresh_wire(self) -> None:
        """Update the limit with the break."""
        self._learn(broken=True)
        super().fresh_wire()
        self.level = None
        self.hold = self.best_hold()


def _grown(hold: float, by: float) -> float:
    """Return the held flux after its logarithm has grown, at most `MOST_HOLD`."""
    return min(hold * math.exp(min(by, MOST_GROWTH)), MOST_HOLD)


def _near(law: ServoLaw) -> float:
    """Return the greatest flux of a fifth over the critical one after the last window."""
    assert isinstance(law.gauge, FluxGauge)
    return float(law.gauge.flux.max())


# `GuardedHold` relieves a wire before it breaks, so that it can hold a higher heat flux. On training machines, the
# wires that broke had boiled dry 16 to 52 ms before (docs/tasks/max-rate-shift.md). It began with 1.2 to 3 times as
# many discharges as usual in one fifth of the height. Steam then covers the wire, takes hardly any heat from it, and
# leaves it only when the wire has cooled down. A law that holds the mean flux is too slow for that; therefore a
# window of long periods follows a burst.
# Kinoshita, Fukui and Gamo (CIRP Annals 31:111, 1982) saw the frequency of pulses rise 5 to 40 ms before a wire
# broke, and switched the generator off then; later controllers located discharges and reduced the power where they
# concentrated (both after the review of Ho et al., Int. J. Mach. Tools Manuf. 44:1247, 2004).

WATER_KG_M3 = 1000.0
IGNITION_S = 1.0  # time constant of what an ignition adds to the flux (ours: some hundred windows)
FIRST_GUARD, LEAST_GUARD = 1.5, 1.15
"""Flux of a window over the held flux from which it is a burst: first value, and least value (ours: bursts that
dried wires of training machines had 1.2 to 3; counts of 50 ignitions scatter by 0.14)."""
GUARD_STEP = 0.02  # change of its logarithm after a relief (ours: it settles within some minutes)
NEAR_HOLD = 0.8  # share of the held flux above which the guard learns (ours: below, the gap limits the flux)


@dataclass
class StreamGauge(FluxGauge):
    """The highest local heat flux over the critical one at its place, which the flow of the water raises.

    The stream's speed falls linearly from each nozzle to where the jets meet, where eddies remain. It uses pressures
    that the operator set, and constants of the files. Losses of the jets are left out.
    """

    now: float = field(default=0.0, init=False)  # highest flux of the last window, unfiltered

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Read the set-up."""
        super().set_up(machine, points_um, start_um)
        self._per_ignition /= stream_share(machine)[:, None]

    def near(self, window: WindowObservation) -> float:
        """Return the greatest flux of a fifth over the critical one."""
        fifths = np.array(window.fifths, np.float64)
        self.now = float((self._per_ignition @ fifths).max() / window.duration_s)
        return super().near(window)


def stream_share(machine: Machine) -> NDArray[np.float64]:
    """Return the critical heat flux of each fifth of the height over that of still water, by the files: (5,)."""
    files = Machine.load(
        machine.name, flushing_lower_Pa=machine.flushing_lower_Pa, flushing_upper_Pa=machine.flushing_upper_Pa
    )
    water, cooling = files.base.dielectric, files.base.cooling
    lower_m_s, upper_m_s = np.sqrt(2.0 * np.array(flushing_Pa(files)) / WATER_KG_M3)
    meet = lower_m_s / (lower_m_s + upper_m_s) if lower_m_s + upper_m_s else 0.5
    place = (np.arange(5) + 0.5) / 5
    down_m_s = np.interp(place, (0.0, meet, 1.0), (lower_m_s, 0.0, upper_m_s))
    speed_m_s = np.hypot(down_m_s, water.turbulence.value * max(lower_m_s, upper_m_s))
    stream = cooling.critical_stream.value * np.sqrt(speed_m_s) * (BOILING_K - water.temperature_K.value)
    return np.asarray(np.maximum(stream / cooling.critical_W_m2.value, 1.0))


@dataclass
class GuardedHold(AdaptiveHold):
    """Holds a flux as `AdaptiveHold` does, and relieves the wire after bursts of discharges.

    Further parameters: see `AdaptiveHold`; here they count the flux over the critical one of its place, and
    ``proportional_share`` and ``integral_per_s`` are per unit of the flux over what is held.
    """

    # bursts per second: the threshold rises while there are more, and falls while there are fewer. 0: no guard.
    reliefs_per_s: float = 0.25
    relief_us: float = 200.0  # period of the window that follows a burst; the feed falls as the period grows
    # held flux over the greatest one that is possible in the window after a short: the period of this window is so
    # long that the flux would not be greater if every pulse ignited. 0: no such limit.
    restart_share: float = 0.7
    # gentle_s, gentle_share: time in which a new wire reaches what is held, and the share of it to begin with. Its
    # kerf holds clean water, in which the gap is unsteady and bursts are larger, until debris has gathered.
    gentle_s: float = 20.0
    gentle_share: float = 0.65
    # ramp_s, ramp_per_s: time in which the first wire finds its limit, before Bayes' rule decides, and growth of
    # the logarithm of what is held there
    ramp_s: float = 0.0
    ramp_per_s: float = 0.05

    log_guard: float = field(default=math.log(FIRST_GUARD), init=False)
    relieving: bool = field(default=False, init=False)  # whether the present window is a relief
    ignition_s: float = field(default=0.0, init=False)  # flux of one ignition per second
    wire_s: float = field(default=0.0, init=False)  # cutting time of the wire
    ramp_hold: float = field(default=0.0, init=False)  # flux at the ramp's beginning; 0 without or after a ramp

    def begin(self) -> None:
        """Begin a leg, with a ramp."""
        super().begin()
        self.ramp_hold = self.limit(RAMP_SHARE) if self.ramp_s else 0.0
        self.hold = self.best_hold()

    def best_hold(self) -> float:
        """Return the present flux of the ramp, or else the one with the largest expected return."""
        if self.ramp_hold and self.wire_s < self.ramp_s:
            return _grown(self.ramp_hold, self.ramp_per_s * self.wire_s)
        return super().best_hold()

    def excess(self, near: float) -> float:
        """Return the flux above that of this wire, as a share of it."""
        left = max(1.0 - self.wire_s / self.gentle_s, 0.0) if self.gentle_s else 0.0
        return near / (self.hold * (1.0 - (1.0 - self.gentle_share) * left)) - 1.0

    def next_us(self, window: WindowObservation, law: ServoLaw) -> float:
        """Period that brings the flux to the held one, or that of a relief."""
        self.wire_s += window.duration_s
        if self.relieving:  # a relief says nothing about other windows
            self.relieving = False
            return math.exp(self.log_us)
        period_us = super().next_us(window, law)
        gauge = law.gauge
        assert isinstance(gauge, StreamGauge)
        if any(window.fifths):
            new_s = gauge.now * window.duration_s / sum(window.fifths)
            self.ignition_s += low_pass_weight(window.duration_s, IGNITION_S) * (new_s - self.ignition_s)
        if shorted(window):
            period_us = max(period_us, 1e6 * self.restart_share * self.ignition_s / self.hold)
        self.relieving = self.reliefs_per_s > 0.0 and gauge.now > self.hold * math.exp(self.log_guard)
        if gauge.flux.max() > NEAR_HOLD * self.hold:
            self.log_guard += GUARD_STEP * (self.relieving - self.reliefs_per_s * window.duration_s)
            self.log_guard = max(self.log_guard, math.log(LEAST_GUARD))
        return max(period_us, self.relief_us) if self.relieving else period_us

    def fresh_wire(self) -> None:
        """Update the limit with the break; the guard keeps its threshold."""
        self.relieving, self.wire_s, self.ramp_hold = False, 0.0, 0.0
        super().fresh_wire()
