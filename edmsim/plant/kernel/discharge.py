"""What a discharge does: crater, heat and debris, and whether the wire still holds its tension."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import compiled
from edmsim.compiled.random import normal
from edmsim.plant.gap.debris import flush
from edmsim.plant.gap.pulse_outcome import draw
from edmsim.plant.gap.ray_trace import gap_of, ray_at
from edmsim.plant.kernel.state import OPEN, Array, Arrays, Constants, Timing
from edmsim.plant.wire import HeatLaw, heat_step, strength_share
from edmsim.plant.workpiece.craters import share_crater


@compiled
def erode(
    state: NDArray[np.void], window: NDArray[np.void], a: Arrays, c: Constants, position: Array, s: int, k: int,
    volume: float,
) -> None:
    """Remove a crater of `volume` um3 at the ray at a place and feed the debris."""
    state[0].crater_um3 += volume
    if share_crater(a, c, position, s, k, volume, draw(state) - 0.5):
        state[0].wear_wait_um3 += volume
        window[0].crater_um3 += volume
        a.debris[s] += volume / c.cavity_um3
    else:
        state[0].missed_um3 += volume


@compiled
def check_strength(state: NDArray[np.void], a: Arrays, c: Constants, s: int) -> None:
    """Break the wire if what is left of its strength in a slice does not hold its tension."""
    share = strength_share(a.temperature_K[s], c.half_strength_K, c.water_K)
    if state[0].broken == 0 and c.strength_N * share * (1.0 - state[0].worn_share) < c.tension_N:
        state[0].broken = 1
        state[0].broken_slice = s


@compiled
def discharge(
    state: NDArray[np.void], window: NDArray[np.void], a: Arrays, c: Constants, t: Timing, heat: HeatLaw,
    position: Array, s: int, k: int, burn_us: float,
) -> float:
    """One spark or arc burning for `burn_us`: crater, heat, debris. Returns the energy in joule."""
    energy = t.burning_V * t.current_A * burn_us * 1e-6
    volume = c.removal_um3_J * energy * max(0.0, 1.0 + c.crater_cv * normal(draw(state)))
    window[0].gap_um += gap_of(a, position, s, k)
    window[0].energy_J += energy
    window[0].charge_A_us += t.current_A * burn_us
    state[0].current2_us += t.current_form * t.current_A**2 * burn_us
    state[0].last_slice = s
    state[0].last_ray = ray_at(a, s, k)
    a.temperature_K[s] += c.wire_heat_share * energy * heat.kelvin_per_J
    window[0].temperature_max_K = max(window[0].temperature_max_K, a.temperature_K[s])
    check_strength(state, a, c, s)
    erode(state, window, a, c, position, s, k, volume)
    return energy


@compiled
def short_circuit(
    state: NDArray[np.void], window: NDArray[np.void], a: Arrays, c: Constants, t: Timing, position: Array, s: int,
    k: int,
) -> None:
    """Short-circuit current for the on-time; where metal touches (`s` >= 0), it melts a little of the bridge."""
    window[0].charge_A_us += t.short_A * t.on_us
    state[0].current2_us += t.current_form * t.short_A**2 * t.on_us
    if s >= 0:
        volume = c.short_removal_share * c.removal_um3_J * t.burning_V * t.short_A * t.on_us * 1e-6
        erode(state, window, a, c, position, s, k, volume)


@compiled
def log_pulse(
    pulses: NDArray[np.void], n: int, a: Arrays, position: Array, start_us: float, open_V: float, outcome: int,
    delay: float, s: int, k: int,
) -> None:
    """Write down how pulse `n` of the window began, before its crater changes the gap."""
    p = pulses[n]
    p.start_us, p.delay_us, p.open_V, p.kind = start_us, delay, open_V, outcome
    if outcome == OPEN or s < 0:
        p.slice = -1
        return
    p.slice, p.ray = s, ray_at(a, s, k)
    p.gap_um, p.x_um, p.y_um = gap_of(a, position, s, k), position[0, s], position[1, s]


@compiled
def propagate_heat(state: NDArray[np.void], a: Arrays, c: Constants, heat: HeatLaw) -> None:
    """Propagate heat and debris over the time that has gathered, wear the wire, and see whether it breaks."""
    dt = state[0].heat_wait_us
    heat_step(a.temperature_K, heat, dt, state[0].current2_us)
    flush(a.debris, c.lower_flow_us * dt, c.upper_flow_us * dt, a.flow_share)
    passed = 1.0 - math.exp(-heat.run_per_us / a.temperature_K.shape[0] * dt)
    worn = c.worn_share_per_um3_us * state[0].wear_wait_um3 / dt
    state[0].worn_share += (worn - state[0].worn_share) * passed
    state[0].heat_wait_us = 0.0
    state[0].current2_us = 0.0
    state[0].wear_wait_um3 = 0.0
    for s in range(a.temperature_K.shape[0]):
        check_strength(state, a, c, s)
