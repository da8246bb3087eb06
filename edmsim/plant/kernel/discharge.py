"""Effects of a discharge: crater, heat, debris, and whether the wire breaks."""

import math

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.elementary import exponential
from edmsim.compiled.jit import compiled, compiled_apart
from edmsim.compiled.random import normal, uniform
from edmsim.plant.gap.gas import REFERENCE_GAP_UM, BubbleLaw, bubble_impulse_Ns
from edmsim.plant.gap.pulse_outcome import draw, draw_normal
from edmsim.plant.gap.rays import closed_side, gap_of, ray_at
from edmsim.plant.gap.water import EINSTEIN, flush, mean_of_slices
from edmsim.plant.kernel.state import ARC, OPEN, Array, Arrays, Constants, Timing
from edmsim.plant.mechanics.modal import project
from edmsim.plant.wire import HeatLaw, add_currents, heat_step, spot_K, strength_share
from edmsim.plant.workpiece.craters import distribute_crater

KERF_SHARE = 0.5  # a wire is in a kerf, not along a wall, if metal faces this share of it (ours)
PLACE_SD_UM = 2000.0
"""Standard deviation of the measured height of a discharge (ours). The method is that of Shoda, Kaneko, Nishimura,
Kunieda and Fan (ISEM X, 1992): the current divides between the two contacts by the resistances of the wire."""
_HEIGHT_STREAM, _ERROR_STREAM = np.uint64(0x5BD1E995A1B2C3D5), np.uint64(0xC2B2AE3D27D4EB4F)
"""Keys of draws that only concern the measurement, so they do not change the plant's own draws."""


@compiled
def _within(state: NDArray[np.void]) -> float:
    """Return the height of this pulse's discharge in the metal of its slice, as a share of the metal's height."""
    return uniform(state[0].key ^ _HEIGHT_STREAM, np.uint64(state[0].pulses))


@compiled
def _wire_at(a: Arrays, s: int, within: float) -> int:
    """Return the slice of the wire at a discharge: the next one if the metal of the slice reaches up to it."""
    return s + 1 if within * a.metal[s] >= 1.0 and s + 1 < a.shape.shape[0] else s


@compiled
def locate(state: NDArray[np.void], window: NDArray[np.void], a: Arrays, c: Constants, s: int, within: float) -> None:
    """Count a discharge in the fifth of the height that its currents indicate, with their error."""
    key, count = state[0].key, np.uint64(state[0].pulses)
    height_um = (s + within * a.metal[s]) * c.slice_um
    height_um += PLACE_SD_UM * normal(key ^ _ERROR_STREAM, count)
    fifth = int(5.0 * height_um / (a.shape.shape[0] * c.slice_um))
    window[0].fifths[min(max(fifth, 0), 4)] += 1


@compiled
def erode(
    state: NDArray[np.void], window: NDArray[np.void], a: Arrays, c: Constants, position: Array, s: int, k: int,
    volume: float,
) -> float:
    """Remove a crater of `volume` um3 at a ray; return the volume that becomes debris, 0 if there is no metal."""
    state[0].crater_um3 += volume
    if distribute_crater(a, c, position, s, k, volume, draw(state) - 0.5):
        state[0].wear_wait_um3 += volume
        window[0].crater_um3 += volume
        return volume
    state[0].missed_um3 += volume
    return 0.0


@compiled
def check_strength(state: NDArray[np.void], a: Arrays, c: Constants, s: int, spot: float = 0.0) -> None:
    """Break the wire if its strength in a slice, at a spot hotter than the slice by `spot`, is below its tension."""
    share = strength_share(a.temperature_K[s] + spot, c.half_strength_K, c.water_K)
    if state[0].broken == 0 and c.strength_N * share * (1.0 - state[0].worn_share) < c.tension_N:
        state[0].broken = 1
        state[0].broken_slice = s


@compiled
def divide_current(a: Arrays, s: int, current2_us: float) -> None:
    """Divide a discharge's current between the two contacts (see `wire.add_currents`)."""
    z = a.height_share[s]
    a.current2_us[0, s] += (1.0 - z) * (1.0 - z) * current2_us
    a.current2_us[1, s] += z * z * current2_us


@compiled
def warm(
    state: NDArray[np.void], window: NDArray[np.void], a: Arrays, c: Constants, heat: HeatLaw, s: int,
    energy_J: float, spot: float = 0.0,
) -> None:
    """Heat the wire of a slice by its share of a discharge's energy, and check whether it breaks."""
    a.temperature_K[s] = min(a.temperature_K[s] + c.wire_heat_share * energy_J * heat.kelvin_per_J, heat.melting_K)
    window[0].temperature_max_K = max(window[0].temperature_max_K, a.temperature_K[s])
    check_strength(state, a, c, s, spot)


@compiled
def _update_spot(state: NDArray[np.void], c: Constants, outcome: int, energy_J: float, burn_us: float) -> None:
    """Update the heat of the spot: an arc adds to that of the discharge before, a spark begins a new spot."""
    left = 0.0
    if outcome == ARC:
        left = state[0].spot * exponential(-state[0].since_discharge_us / c.spot_us)
        state[0].chain_us += state[0].since_discharge_us + burn_us
    else:
        state[0].chain_J = state[0].chain_us = 0.0
    state[0].spot = left + c.spot_gain
    state[0].chain_J += c.wire_heat_share * energy_J


@compiled
def _wet(a: Arrays, c: Constants, outcome: int, s: int) -> float:
    """Return the chance that a discharge is in water: sparks rarely strike in gas, arcs burn in gas."""
    if outcome == ARC:
        return 0.0
    return float((1.0 - a.covered[s]) / (1.0 - c.dryness * a.covered[s]))


@compiled
def discharge(
    state: NDArray[np.void], window: NDArray[np.void], a: Arrays, c: Constants, t: Timing, heat: HeatLaw,
    bubble: BubbleLaw, position: Array, outcome: int, s: int, k: int, burn_us: float,
) -> tuple[float, float, float]:
    """Apply crater and heat of a spark or arc that burns for `burn_us`; return energy, impulse and debris in um3."""
    power = t.burning_V * t.current_A
    energy = power * burn_us * 1e-6
    gap, wet = gap_of(a, position, s, k), _wet(a, c, outcome, s)
    volume = t.removal_um3_J * energy * (1.0 - c.ejection * (1.0 - wet))
    volume *= max(0.0, 1.0 + c.crater_cv * draw_normal(state))
    window[0].gap_um += gap
    window[0].energy_J += energy
    window[0].charge_A_us += t.current_A * burn_us
    within = _within(state)
    locate(state, window, a, c, s, within)
    heated = _wire_at(a, s, within)
    divide_current(a, heated, t.current_form * t.current_A**2 * burn_us)
    _update_spot(state, c, outcome, energy, burn_us)
    state[0].last_slice = s
    state[0].last_ray = ray_at(a, s, k)
    warm(state, window, a, c, heat, heated, energy, spot_K(heat, state[0].chain_J, state[0].chain_us))
    removed = erode(state, window, a, c, position, s, k, volume)
    return energy, bubble_impulse_Ns(power, burn_us, gap, bubble) * wet, removed


@compiled_apart
def short_circuit(
    state: NDArray[np.void], window: NDArray[np.void], a: Arrays, c: Constants, t: Timing, heat: HeatLaw,
    bubble: BubbleLaw, position: Array, s: int, k: int,
) -> float:
    """Apply a short circuit of the on-time; if metal touches (`s` >= 0), it melts a part of the bridge."""
    # Returns the impulse of the melting metal: a share of that of a bubble of the same energy at 20 um.
    window[0].charge_A_us += t.short_A * t.on_us
    divide_current(a, s if s >= 0 else a.shape.shape[0] // 2, t.current_form * t.short_A**2 * t.on_us)
    if s < 0:
        return 0.0
    power = c.short_removal_share * t.burning_V * t.short_A
    energy = power * t.on_us * 1e-6
    warm(state, window, a, c, heat, s, energy)
    removed = erode(state, window, a, c, position, s, k, t.removal_um3_J * energy)
    a.debris[s] += removed / (c.cavity_um3 * a.metal[s])
    return c.short_push_share * bubble_impulse_Ns(power, t.on_us, REFERENCE_GAP_UM, bubble)


@compiled_apart
def log_pulse(
    pulses: NDArray[np.void], n: int, a: Arrays, position: Array, start_us: float, open_V: float, outcome: int,
    delay: float, s: int, k: int,
) -> None:
    """Log the beginning of pulse `n` of the window, before its crater changes the gap."""
    p = pulses[n]
    p.start_us, p.delay_us, p.open_V, p.kind = start_us, delay, open_V, outcome
    if outcome == OPEN or s < 0:
        p.slice = p.ray = -1
        p.gap_um = p.x_um = p.y_um = math.nan
        return
    p.slice, p.ray = s, ray_at(a, s, k)
    p.gap_um, p.x_um, p.y_um = gap_of(a, position, s, k), position[0, s], position[1, s]


@compiled
def _set_steady_loads(a: Arrays, c: Constants, sums: Array, current2_us: Array, dt_us: float, forces: Array) -> None:
    """Set the loads that are constant for many pulses: the mean magnetic force since the last time, and the jets."""
    # The magnetic force has the direction of the electrostatic pull on the slice. The jets push the wire to the open
    # side of the kerf. Along a wall there are no jets, and the water behind the wire is that of the bath.
    per_A2_us = c.magnetic_N_A2 * 1e6 / dt_us
    for s in range(sums.shape[0]):
        pull = math.sqrt(sums[s, 2] ** 2 + sums[s, 3] ** 2)
        force = per_A2_us * a.metal[s] * current2_us[s] / pull if pull > 0.0 else 0.0
        facing, x, y = closed_side(a, s)
        jet = a.jet_um_kg_s2[s] * a.metal[s]
        if facing < KERF_SHARE:
            jet = a.wake_debris[s] = a.wake_gas[s] = 0.0
        forces[s, 2], forces[s, 3] = force * sums[s, 2] - jet * x, force * sums[s, 3] - jet * y
    project(a, forces, a.steady)


@compiled_apart
def propagate_heat(
    state: NDArray[np.void], a: Arrays, c: Constants, heat: HeatLaw, sums: Array, current2_us: Array, forces: Array
) -> None:
    """Propagate heat and debris over the time since the last call, wear the wire, and check whether it breaks."""
    # `current2_us` and `forces` are buffers, for the currents, and for the steady forces in columns 2 and 3.
    dt = state[0].heat_wait_us
    add_currents(a, current2_us)
    heat_step(a, heat, current2_us, dt)
    _set_steady_loads(a, c, sums, current2_us, dt, forces)
    for s in range(a.shape.shape[0]):
        a.current2_us[0, s] = a.current2_us[1, s] = 0.0
    # debris over the whole height slows the water down
    flowing = dt / (1.0 + EINSTEIN * mean_of_slices(a.debris, a.shape.shape[0]))
    flush(a.debris, c.lower_flow_us * flowing, c.upper_flow_us * flowing, a.entering)
    flush(a.wake_debris, c.lower_wake_us * dt, c.upper_wake_us * dt, a.entering)
    flush(a.wake_gas, c.lower_wake_us * dt, c.upper_wake_us * dt, a.entering)
    passed = 1.0 - exponential(-heat.run_per_us / a.temperature_K.shape[0] * dt)
    worn = c.worn_share_per_um3_us * state[0].wear_wait_um3 / dt
    state[0].worn_share += (worn - state[0].worn_share) * passed
    state[0].heat_wait_us = 0.0
    state[0].wear_wait_um3 = 0.0
    for s in range(a.temperature_K.shape[0]):
        check_strength(state, a, c, s)
