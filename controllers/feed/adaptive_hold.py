"""Heat-flux laws that find out while they cut how much this machine's wire bears.

Both hold the greatest local flux as `heat-flux` does, and change how much of it they hold. `ClimbingHoldController`
is the simple way: more until a wire breaks, then less, and more again ever more slowly. `AdaptiveHoldController` has
a probability for every flux at which wires of this machine may break, which every second without a break and every
lost wire changes by Bayes' rule, and holds what earns most under it.

The numbers of both are ours. That breaks of one machine lie within some 10 % of one flux, and those of drawn machines
within a factor of 3, was seen in ramps of the flux on training machines (docs/tasks/max-rate-shift.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.feed.wire_heat import HeatFluxController
from edmsim.controllers.protocols import FeedCommand, WindowObservation
from edmsim.machine.machine import Machine

LEAST_HOLD, MOST_HOLD = 0.02, 3.0
"""Ends of what is held, in parts of the critical flux by the files' constants (ours: beyond any limit seen)."""
LEVELS = np.linspace(math.log(LEAST_HOLD), math.log(MOST_HOLD), 168)
"""Logarithms of the fluxes that may be held, and at which wires may break: 3 % apart."""
STEEPNESS = 15.0
"""Growth of the logarithm of the hazard with that of the flux (ours: breaks of a machine within some 10 %)."""
HAZARD_PER_S = 1.0 / 60.0
"""Hazard at the flux that is called the wire's limit."""
BY_CHANCE_PER_S = 1.0 / 1200.0
"""Hazard at any flux (ours: a wire in a shift), so that one break far below what was borne is no limit yet."""
HAZARD = BY_CHANCE_PER_S + HAZARD_PER_S * np.exp(np.clip(STEEPNESS * (LEVELS[:, None] - LEVELS), -50.0, 12.0))
"""Of a flux held (rows) where the limit is another (columns), per s."""
SLOW_S = 0.1
"""Time constant of the flux that a break is put down to (ours: a wire breaks some 20 ms after it boils dry)."""
DECISION_S = 1.0
"""Time between two looks at what was held (ours: some hundred windows)."""


@dataclass
class ClimbingHoldController(HeatFluxController):
    """Holds more and more of the critical flux until a wire breaks, then less, and climbs more slowly.

    Further parameters: see `HeatFluxController`; ``hold_share`` is where it begins, ``break_hold_share`` what is held
    after a break over what broke the wire.

    Parameters
    ----------
    climb_per_s : float
        Growth of the logarithm of what is held.
    patience_factor : float
        By what the growth is divided at every break: what broke a wire is come to later and later.
    """

    name: ClassVar[str] = "climbing-hold"

    shortest_us: float = 18.0
    hold_share: float = 0.3
    break_hold_share: float = 0.85
    climb_per_s: float = 0.01
    patience_factor: float = 2.0

    _climb_per_s: float = field(default=0.0, init=False, repr=False)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut, with nothing known of the machine."""
        self._climb_per_s = self.climb_per_s
        return super().reset(max_feed_um_s)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed and period for the next window."""
        held = self._held
        if held.hold < 1.2 * held.near or held.log_us > math.log(max(1.05 * self.shortest_us, 1.0)):
            held.hold = min(held.hold * math.exp(self._climb_per_s * window.duration_s), MOST_HOLD)
        return super().update(window)

    def wire_lost(self) -> FeedCommand:
        """Begin with a fresh wire, which is asked for less."""
        self._climb_per_s /= max(self.patience_factor, 1.0)
        return super().wire_lost()


@dataclass
class _Seen:
    """What was held since the last decision: time, and the logarithm of the flux over it; its slow mean now."""

    seconds: float = 0.0
    level_s: float = 0.0
    level: float | None = None


@dataclass
class AdaptiveHoldController(HeatFluxController):
    """Holds the flux that earns most by what is known so far of the machine's limit.

    Further parameters: see `HeatFluxController`; ``hold_share`` and ``break_hold_share`` have no effect.

    Parameters
    ----------
    limit_share, limit_spread : float
        The flux at which wires break, before anything is known: its median, and the standard deviation of its
        logarithm.
    drift_per_s : float
        Growth of the variance of that logarithm with time: water and wear change the limit.
    rate_exponent : float
        Growth of the logarithm of the cutting rate with that of the flux.
    break_s : float
        Time that a lost wire costs; 0 for the machine's own threading and the rise of a fresh wire.
    """

    name: ClassVar[str] = "adaptive-hold"

    shortest_us: float = 18.0
    limit_share: float = 0.8
    limit_spread: float = 0.5
    drift_per_s: float = 2e-5
    rate_exponent: float = 0.8
    break_s: float = 0.0

    _chance: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(LEVELS)), init=False, repr=False)
    _seen: _Seen = field(default_factory=_Seen, init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._threading_s = 0.0

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Take in the dials, and how long the machine threads."""
        super().set_up(machine, points_um, start_um)
        self._threading_s = machine.base.table.threading_s.value

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut, with nothing known of the machine."""
        middle, spread = math.log(min(max(self.limit_share, LEAST_HOLD), MOST_HOLD)), max(self.limit_spread, 0.01)
        chance = np.exp(-0.5 * ((LEVELS - middle) / spread) ** 2)
        self._chance = chance / chance.sum()
        self._seen = _Seen()
        command = super().reset(max_feed_um_s)
        self._held.hold = self.best_hold()
        return command

    @property
    def held(self) -> float:
        """Flux that is held now, in parts of the critical one."""
        return self._held.hold

    def limit(self, share: float) -> float:
        """Return the flux below which the machine's limit lies with a probability, 0 to 1, by what is known."""
        return float(math.exp(np.interp(share, np.cumsum(self._chance), LEVELS)))

    def best_hold(self) -> float:
        """Return the flux that earns most in the mean over what the limit may be.

        A flux u earns ``u^rate_exponent`` for the share of time that breaks leave, 1 / (1 + hazard break_s).
        """
        lost_s = self.break_s or self._threading_s + self.rise_s
        cutting = 1.0 / (1.0 + HAZARD * lost_s)
        earned = np.exp(self.rate_exponent * LEVELS) * (cutting @ self._chance)
        return float(np.exp(LEVELS[int(np.argmax(earned))]))

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed and period for the next window."""
        command, seen = super().update(window), self._seen
        level = math.log(min(max(self._held.near, LEAST_HOLD), MOST_HOLD))
        last = level if seen.level is None else seen.level
        seen.level = last - math.expm1(-window.duration_s / SLOW_S) * (level - last)
        seen.seconds += window.duration_s
        seen.level_s += seen.level * window.duration_s
        if seen.seconds >= DECISION_S:
            self._learn(broken=False)
            self._held.hold = self.best_hold()
        return command

    def _learn(self, *, broken: bool) -> None:
        """Take in the time since the last decision, and a break, by Bayes' rule; let the limit drift."""
        seen = self._seen
        chance = self._chance
        if seen.seconds:
            chance = chance * np.exp(-np.minimum(_hazard(seen.level_s / seen.seconds) * seen.seconds, 500.0))
        if broken and seen.level is not None:
            chance = chance * _hazard(seen.level)
        spacing = LEVELS[1] - LEVELS[0]
        moved = min(0.5 * self.drift_per_s * seen.seconds / spacing**2, 0.25)
        around = np.pad(chance, 1, mode="edge")
        chance = (1.0 - 2.0 * moved) * chance + moved * (around[:-2] + around[2:])
        self._chance = chance / max(chance.sum(), 1e-300)
        seen.seconds = seen.level_s = 0.0

    def wire_lost(self) -> FeedCommand:
        """Begin with a fresh wire, and with what the break said of the limit."""
        self._learn(broken=True)
        command = super().wire_lost()
        self._seen.level = None
        self._held.hold = self.best_hold()
        return command



def _hazard(level: float) -> NDArray[np.float64]:
    """Return the hazard of a flux, given by its logarithm, for every limit there may be, per s."""
    return np.asarray(HAZARD[int(np.argmin(np.abs(LEVELS - level)))])
