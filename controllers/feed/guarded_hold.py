"""A rule for the period that relieves a wire before it breaks, so that it can hold a higher heat flux.

On training machines, most wires that broke had boiled dry 10 to 270 ms before (docs/tasks/max-rate-shift.md). It
began with 1.4 to 4 times as many discharges as usual in one fifth of the height, often as a short cleared. Steam then
covers the wire, takes hardly any heat from it, and leaves it only when the wire has cooled down. A law that holds the
mean flux is too slow for that; therefore a window of long periods follows a burst.

Kinoshita, Fukui and Gamo (CIRP Annals 31:111, 1982) saw the frequency of pulses rise 5 to 40 ms before a wire broke,
and switched the generator off then; later controllers located discharges and reduced the power where they
concentrated (both after the review of Ho et al., Int. J. Mach. Tools Manuf. 44:1247, 2004).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.feed.adaptive_hold import AdaptiveHold
from edmsim.controllers.feed.law import ServoLaw, low_pass_weight, shorted
from edmsim.controllers.feed.periods import BOILING_K, FluxGauge
from edmsim.controllers.protocols import WindowObservation
from edmsim.machine.machine import Machine
from edmsim.machine.setting import flushing_Pa

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
