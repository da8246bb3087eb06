"""Rules for the period that estimate, while they cut, the heat flux at which this machine's wires break.

All hold the highest local flux as `heat-flux` does and change the held value. `ClimbingHold` raises it until a wire
breaks, then lowers it and raises it more slowly. `AdaptiveHold` has a probability for every flux at which wires of
this machine may break, updates it by Bayes' rule with every second without a break and every lost wire, and holds the
flux with the largest expected return.

Their numbers are ours. In ramps of the flux on training machines, breaks of one machine were within some 10 %
of one flux, and those of drawn machines within a factor of 3 (docs/tasks/max-rate-shift.md).
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.feed.law import ServoLaw, low_pass_weight, shorted
from edmsim.controllers.feed.periods import BOILING_K, FluxGauge, HoldHeat
from edmsim.controllers.protocols import WindowObservation
from edmsim.machine.machine import Machine
from edmsim.machine.setting import flushing_Pa

LEAST_HOLD, MOST_HOLD = 0.02, 3.0
"""Ends of what is held, in parts of the critical flux by the files' constants (ours: beyond any limit seen)."""
LEVELS = np.linspace(math.log(LEAST_HOLD), math.log(MOST_HOLD), 168)
"""Logarithms of the fluxes that may be held, and at which wires may break: 3 % apart."""
STEEPNESS = 15.0
"""Growth of the logarithm of the hazard with that of the flux (ours: breaks of a machine within some 10 %)."""
HAZARD_PER_S = 1.0 / 60.0  # hazard at the flux that is called the wire's limit
BY_CHANCE_PER_S = 1.0 / 1200.0
"""Hazard at any flux (ours: a wire in a shift), so that one break far below what was borne is no limit yet."""
HAZARD = BY_CHANCE_PER_S + HAZARD_PER_S * np.exp(np.clip(STEEPNESS * (LEVELS[:, None] - LEVELS), -50.0, 12.0))
"""Of a flux held (rows) where the limit is another (columns), per s."""
SLOW_S = 0.1
"""Time constant of the flux that a break is put down to (ours: a wire breaks some 20 ms after it boils dry)."""
DECISION_S = 1.0  # time between two looks at what was held (ours: some hundred windows)


@dataclass
class ClimbingHold(HoldHeat):
    """Raises the held share of the critical flux until a wire breaks; then lowers it and raises it more slowly.

    Further parameters: see `HoldHeat`; ``hold_share`` is the first value, ``break_hold_share`` the factor on it after
    a break.
    """

    climb_per_s: float = 0.01  # growth of the logarithm of the held flux, per second
    patience_factor: float = 2.0  # divisor of the growth at every break

    pace_per_s: float = field(default=0.0, init=False)

    def begin(self) -> None:
        """Begin a leg, with nothing known of the machine."""
        super().begin()
        self.pace_per_s = self.climb_per_s

    def next_us(self, window: WindowObservation, law: ServoLaw) -> float:
        """Period that brings the flux to what is held; the hold stays where the period is at its shortest."""
        if self.log_us > math.log(max(1.05 * self.shortest_us, 1.0)) or self.hold < 1.2 * _near(law):
            self.hold = min(self.hold * math.exp(self.pace_per_s * window.duration_s), MOST_HOLD)
        return super().next_us(window, law)

    def fresh_wire(self) -> None:
        """Ask less of the next wire."""
        super().fresh_wire()
        self.pace_per_s /= max(self.patience_factor, 1.0)


@dataclass
class AdaptiveHold(HoldHeat):
    """Holds the flux with the largest expected return under the present estimate of the machine's limit.

    Further parameters: see `HoldHeat`.
    """

    # limit_share, limit_spread: prior of the flux at which wires break: its median, and the standard deviation of its
    # logarithm
    limit_share: float = 0.8
    limit_spread: float = 0.5
    drift_per_s: float = 2e-5  # growth of the variance of that logarithm with time: water and wear change the limit
    rate_exponent: float = 0.8  # growth of the logarithm of the cutting rate with that of the flux
    # factor on the time that a lost wire costs: threading plus the slow start of a new wire
    break_weight: float = 1.0

    chance: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(LEVELS)), init=False)
    seconds: float = field(default=0.0, init=False)  # since the last decision
    level_s: float = field(default=0.0, init=False)  # the logarithm of the flux over that time
    level: float | None = field(default=None, init=False)  # its slow mean now; None where nothing was seen of a wire

    def __post_init__(self) -> None:
        self._threading_s = 0.0

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Take in how long the machine threads."""
        self._threading_s = machine.base.table.threading_s.value

    def begin(self) -> None:
        """Begin a leg, with nothing known of the machine."""
        super().begin()
        middle, spread = math.log(min(max(self.limit_share, LEAST_HOLD), MOST_HOLD)), max(self.limit_spread, 0.01)
        chance = np.exp(-0.5 * ((LEVELS - middle) / spread) ** 2)
        self.chance = chance / chance.sum()
        self.hold = self.best_hold()

    def limit(self, share: float) -> float:
        """Return the flux below which the machine's limit lies with a probability, 0 to 1, by what is known."""
        return float(math.exp(np.interp(share, np.cumsum(self.chance), LEVELS)))

    def best_hold(self) -> float:
        """Return the flux u of the most ``u^rate_exponent / (1 + hazard lost_s)`` over what the limit may be."""
        lost_s = self.break_weight * (self._threading_s + self.rise_s)
        cutting = 1.0 / (1.0 + HAZARD * lost_s)
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
        """Take in the time since the last decision, and a break, by Bayes' rule; let the limit drift."""
        chance = self.chance
        if self.seconds:
            chance = chance * np.exp(-np.minimum(_hazard(self.level_s / self.seconds) * self.seconds, 500.0))
        if broken and self.level is not None:
            chance = chance * _hazard(self.level)
        spacing = LEVELS[1] - LEVELS[0]
        moved = min(0.5 * self.drift_per_s * self.seconds / spacing**2, 0.25)
        around = np.pad(chance, 1, mode="edge")
        chance = (1.0 - 2.0 * moved) * chance + moved * (around[:-2] + around[2:])
        self.chance = chance / max(chance.sum(), 1e-300)
        self.seconds = self.level_s = 0.0

    def fresh_wire(self) -> None:
        """Take in what the break said of the limit."""
        self._learn(broken=True)
        super().fresh_wire()
        self.level = None
        self.hold = self.best_hold()


def _near(law: ServoLaw) -> float:
    """Return the greatest flux of a fifth over the critical one, as the last window left it."""
    assert isinstance(law.gauge, FluxGauge)
    return float(law.gauge.flux.max())


def _hazard(level: float) -> NDArray[np.float64]:
    """Return the hazard of a flux, given by its logarithm, for every limit there may be, per s."""
    return np.asarray(HAZARD[int(np.argmin(np.abs(LEVELS - level)))])


# `GuardedHold` relieves a wire before it breaks, so that it can hold a higher heat flux. On training machines, most
# wires that broke had boiled dry 10 to 270 ms before (docs/tasks/max-rate-shift.md). It began with 1.4 to 4 times as
# many discharges as usual in one fifth of the height, often as a short cleared. Steam then covers the wire, takes
# hardly any heat from it, and leaves it only when the wire has cooled down. A law that holds the mean flux is too
# slow for that; therefore a window of long periods follows a burst.
# Kinoshita, Fukui and Gamo (CIRP Annals 31:111, 1982) saw the frequency of pulses rise 5 to 40 ms before a wire
# broke, and switched the generator off then; later controllers located discharges and reduced the power where they
# concentrated (both after the review of Ho et al., Int. J. Mach. Tools Manuf. 44:1247, 2004).

WATER_KG_M3 = 1000.0
USUAL_S = 1.0  # time constant of what an ignition adds to the flux (ours: some hundred windows)
FIRST_GUARD, LEAST_GUARD = 1.5, 1.15
"""Flux of a window, over what is held, that is a burst: at first, and at the least (ours: two thirds of those that
dried wires of training machines were above 1.5; counts of 50 ignitions scatter by 0.14)."""
GUARD_STEP = 0.02  # change of its logarithm after a relief (ours: it settles within some minutes)
NEAR_HOLD = 0.8  # share of what is held above which the guard learns (ours: below, the gap limits the flux)


@dataclass
class StreamGauge(FluxGauge):
    """The highest local heat flux over the critical one of its place, where the water's stream raises it.

    The stream's speed falls linearly from each nozzle to where the jets meet, where eddies remain. It uses pressures
    that the operator set, and constants of the files. Losses of the jets are left out.
    """

    now: float = field(default=0.0, init=False)  # the highest of the last window, not filtered

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Take in the dials."""
        super().set_up(machine, points_um, start_um)
        self._per_ignition /= stream_share(machine)[:, None]

    def near(self, window: WindowObservation) -> float:
        """Return the greatest flux of a fifth over the critical one."""
        fifths = np.array(window.fifths, np.float64)
        self.now = float((self._per_ignition @ fifths).max() / window.duration_s)
        return super().near(window)


def stream_share(machine: Machine) -> NDArray[np.float64]:
    """Return the critical heat flux in each fifth of the height over that of still water, by the files: (5,)."""
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
    # what is held over the greatest flux in the window after a short: its period is so long that no more could be
    # reached if every pulse ignited. 0: no such limit.
    restart_share: float = 0.7

    log_guard: float = field(default=math.log(FIRST_GUARD), init=False)
    relieving: bool = field(default=False, init=False)  # whether the present window is a relief
    ignition_s: float = field(default=0.0, init=False)  # flux of one ignition per second

    def excess(self, near: float) -> float:
        """Return how far the flux is above what is held, in parts of it."""
        return near / self.hold - 1.0

    def next_us(self, window: WindowObservation, law: ServoLaw) -> float:
        """Period that brings the flux to what is held, or the one of a relief."""
        if self.relieving:  # such a window says nothing about the others
            self.relieving = False
            return math.exp(self.log_us)
        period_us = super().next_us(window, law)
        gauge = law.gauge
        assert isinstance(gauge, StreamGauge)
        if any(window.fifths):
            new_s = gauge.now * window.duration_s / sum(window.fifths)
            self.ignition_s += low_pass_weight(window.duration_s, USUAL_S) * (new_s - self.ignition_s)
        if shorted(window):
            period_us = max(period_us, 1e6 * self.restart_share * self.ignition_s / self.hold)
        self.relieving = self.reliefs_per_s > 0.0 and gauge.now > self.hold * math.exp(self.log_guard)
        if gauge.flux.max() > NEAR_HOLD * self.hold:
            self.log_guard += GUARD_STEP * (self.relieving - self.reliefs_per_s * window.duration_s)
            self.log_guard = max(self.log_guard, math.log(LEAST_GUARD))
        return max(period_us, self.relief_us) if self.relieving else period_us

    def fresh_wire(self) -> None:
        """Take in what the break said of the limit; the guard stays."""
        super().fresh_wire()
        self.relieving = False
