"""Pulse periods that spare the wire: one for any workpiece, or set from how near the wire is to boiling dry.

`FixedPeriodController` is what an operator sets who wants no broken wire. The others take a measured heat flux, or
the wire's true temperature. Water cools a wire the better the hotter it is, until the heat flux is critical: then
steam covers it, and it grows hot and breaks within some 20 ms. No law is quick enough for that; so the period is
set by how far the hottest place of the wire is from it.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.feed.gap_servo import Gains, ServoController
from edmsim.controllers.protocols import FeedCommand, GapWindow, WindowObservation
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES, discharge_current_A, pulse_form


@dataclass
class FreshWire:
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
    period_us: float = 40.0
    rise_s: float = 1.5
    slow_factor: float = 2.0

    _rise: FreshWire = field(default_factory=FreshWire, init=False, repr=False)

    def gains(self) -> Gains:
        """How the servo answers."""
        return Gains(self.proportional_um_s, self.integral_um_s2, self.filter_s)

    def error(self, window: WindowObservation) -> float:
        """Share of opens less weighted shorts above the target."""
        return (window.open - self.short_weight * window.short) / WINDOW_PULSES - self.open_target_share

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut."""
        self._rise = FreshWire()
        return super().reset(max_feed_um_s)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed and period for the next window."""
        self._rise.cutting_s += window.duration_s
        command = super().update(window)
        return command._replace(t_period_us=self.next_period_us(window) * self._slower())

    def wire_lost(self) -> FeedCommand:
        """Begin with a fresh wire where the last one broke: it comes to its period slowly, as the first one did."""
        self._rise.cutting_s = 0.0
        return ServoController.reset(self, self._servo.max_feed_um_s)

    def next_period_us(self, window: WindowObservation) -> float:
        """Period of a wire that has come to it."""
        if not self._rise.first_us:
            self._rise.first_us = round(window.duration_s * 1e6 / WINDOW_PULSES, 1)
        return self.period_us or self._rise.first_us

    def _slower(self) -> float:
        """By what the period is longer while a fresh wire comes to it."""
        left = max(1.0 - self._rise.cutting_s / self.rise_s, 0.0) if self.rise_s else 0.0
        return float(max(self.slow_factor, 1.0) ** left)


MOST_ERROR = 1.0
"""No larger deviation from what is held counts (ours: one window of few sparks tells little)."""
_BOILING_K = 373.15


@dataclass
class _HeatState:
    """What changes: the period's regulated part, what was last seen of how near the wire is, and what is held."""

    log_us: float = 0.0
    near: float = 0.0
    hold: float = 0.0


@dataclass
class PeriodFromHeat(FixedPeriodController):
    """Holds a measure of how near the wire is to boiling dry by the period.

    Further parameters: see `FixedPeriodController`; ``period_us`` is the one a cut begins with.

    Parameters
    ----------
    hold_share : float
        Of that measure, 1 where the wire boils dry.
    break_hold_share : float
        Of what is held, after every lost wire (ours): what broke one wire breaks the next one.
    proportional_share, integral_per_s : float
        Change of the period's logarithm, and its growth per second, per unit of the difference from it.
    shortest_us, longest_us : float
        Limits of the period (ours): where hardly a pulse ignites there is no heat to hold, the period goes to the
        shortest, and the discharges that ignite next find it there.
    """

    period_us: float = 90.0
    hold_share: float = 0.6
    break_hold_share: float = 0.8
    proportional_share: float = 0.3
    integral_per_s: float = 1.0
    shortest_us: float = 25.0
    longest_us: float = 150.0

    _held: _HeatState = field(default_factory=_HeatState, init=False, repr=False)

    @abstractmethod
    def near(self, window: WindowObservation) -> float:
        """How near the wire is to boiling dry: 1 where it does."""

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut."""
        self._held = _HeatState(math.log(max(self.period_us, 1.0)), hold=self.hold_share)
        return super().reset(max_feed_um_s)

    def wire_lost(self) -> FeedCommand:
        """Begin with a fresh wire, more carefully than with the one that broke."""
        held = self._held
        held.log_us = min(held.log_us + math.log(max(self.slow_factor, 1.0)), self._longest)
        held.near, held.hold = 0.0, held.hold * self.break_hold_share
        return super().wire_lost()

    @property
    def _longest(self) -> float:
        return math.log(max(self.longest_us, self.shortest_us, 1.0))

    def next_period_us(self, window: WindowObservation) -> float:
        """Period that brings the measure to what is held."""
        held = self._held
        error = min(max(self.near(window) - held.hold, -MOST_ERROR), MOST_ERROR)
        grown = held.log_us + self.integral_per_s * error * window.duration_s
        held.log_us = min(max(grown, math.log(max(self.shortest_us, 1.0))), self._longest)
        return max(math.exp(held.log_us + self.proportional_share * error), self.shortest_us)


@dataclass
class HeatFluxController(PeriodFromHeat):
    """Holds the greatest local heat flux, as located sparks and the files' constants give it, by the period.

    It knows what an operator does: names of the set-up's files, wire, height and pulse. It takes the constants of the
    files, as it cannot know those of the machine at work. The measure is the flux over the critical one.

    Further parameters: see `PeriodFromHeat`.

    Parameters
    ----------
    flux_filter_s : float
        Time constant of the low-pass filter on the flux of each fifth of the height.
    """

    name: ClassVar[str] = "heat-flux"

    hold_share: float = 0.4
    proportional_share: float = 0.6
    integral_per_s: float = 4.0
    flux_filter_s: float = 0.05

    _flux: NDArray[np.float64] = field(default_factory=lambda: np.zeros(5), init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._per_ignition: NDArray[np.float64] = np.zeros((5, 5))

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Take in the dials: see `heat_per_ignition_s`."""
        self._per_ignition = heat_per_ignition_s(machine)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut."""
        self._flux = np.zeros(5)
        return super().reset(max_feed_um_s)

    @property
    def flux(self) -> NDArray[np.float64]:
        """Filtered heat flux of each fifth of the height over the critical one, (5,), from below."""
        return self._flux

    def near(self, window: WindowObservation) -> float:
        """Return the greatest flux of a fifth over the critical one."""
        flux = self._per_ignition @ np.array(window.fifths, np.float64) / window.duration_s
        weight = -math.expm1(-window.duration_s / self.flux_filter_s) if self.flux_filter_s else 1.0
        self._flux += weight * (flux - self._flux)
        self._held.near = float(self._flux.max())
        return self._held.near

    def wire_lost(self) -> FeedCommand:
        """Begin with a fresh wire, which is cold."""
        self._flux[:] = 0.0
        return super().wire_lost()


def heat_per_ignition_s(machine: Machine) -> NDArray[np.float64]:
    """Return what an ignition in each fifth adds to each fifth's heat flux, over the critical one: (5, 5), in s.

    A spark heats its own fifth; its current, which comes from both guides and divides as the wire's resistances do,
    heats all of them.
    """
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
class HeatOracleController(PeriodFromHeat):
    """Holds the wire's true highest temperature by the period: the bound that `heat-flux` is compared with.

    The measure is the superheat, 0 at the boiling point and 1 where the wire of this very machine boils dry; it is
    negative below the boiling point.
    """

    name: ClassVar[str] = "heat-oracle"

    hold_share: float = 0.2
    proportional_share: float = 0.8
    integral_per_s: float = 2.0
    shortest_us: float = 18.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._superheat_K = 30.0

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Take in where this machine's wire boils dry."""
        self._superheat_K = machine.base.cooling.superheat_K.value

    def see(self, truth: GapWindow) -> None:
        """Take in the true temperature."""
        self._held.near = (truth.wire_temperature_K - _BOILING_K) / self._superheat_K

    def near(self, window: WindowObservation) -> float:
        """Return the superheat over the one at which the wire boils dry."""
        return self._held.near
