"""The compiled pulse loop: one call advances a plant by one window of 255 pulses.

Lengths are um, times us, and SI otherwise; modal coordinates are um sqrt(kg).
"""

import math

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import N_AXES, N_CHANNELS
from edmsim.compiled.jit import compiled, compiled_apart
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.plant.axes.advance import LOST, advance_axes, apply_geometric_errors, indicate
from edmsim.plant.gap.breakdown import GapLaw
from edmsim.plant.gap.gas import BubbleLaw, GasLaw, blow, fade
from edmsim.plant.gap.pulse_outcome import decide, deepest_contact, draw, leak_conductance, resolve_contact, sum_rays
from edmsim.plant.gap.rays import OVERLAP_UM, pack_rays, rays_of, retrace, tilt_rays, weigh
from edmsim.plant.gap.water import mean_of_slices
from edmsim.plant.kernel import state as loop
from edmsim.plant.kernel.discharge import discharge, log_pulse, propagate_heat, short_circuit
from edmsim.plant.kernel.state import Array, Arrays, Axes, Constants, Propagators, Scratch, Timing
from edmsim.plant.mechanics.full_model import FullLink, move_full
from edmsim.plant.mechanics.modal import copy, kick, lean, mean_deflection, move, place_wire, project, ring, ringing
from edmsim.plant.mechanics.squeeze_film import find_films, is_narrow, mean_film, mean_resistance, scale_film, squeeze
from edmsim.plant.wire import HeatLaw
from edmsim.plant.workpiece.craters import carve

HEAT_INTERVAL_US = 1500.0  # longest interval of heat and debris steps, well below their time scale of 10 ms
DEEPEST_UM = 0.75 * OVERLAP_UM  # greatest depth in the metal at a window's end; no push moves the wire further
TRACED_MOVE_UM = 2.0  # movement of an axis after which rays are traced again
LOST_UM = -1e9  # depth that marks a wire whose position is not finite
FINITE = 1e15  # greater than any valid sum of lengths, times or temperatures
MOST_DEFLECTION_UM = 2000.0  # limit of the model's validity


@compiled_apart
def _carve(
    state: NDArray[np.void], window: NDArray[np.void], a: Arrays, tiles: NDArray[np.uint16],
    index: NDArray[np.int32], c: Constants, rows: Array,
) -> None:
    """Carve the rays' craters from the field; volume without metal counts as missed."""
    missed = carve(a, tiles, index, c, draw(state) - 0.5, rows)
    state[0].carved_pulses = state[0].pulses
    state[0].missed_um3 += missed
    state[0].wear_wait_um3 = max(0.0, state[0].wear_wait_um3 - missed)
    window[0].crater_um3 -= missed


@compiled
def _is_due(state: NDArray[np.void], c: Constants) -> bool:
    """Return whether the rays must be traced again: after a number of pulses, or if an axis has moved."""
    if state[0].traces == 0 or state[0].pulses - state[0].traced_pulses >= c.trace_pulses:
        return True
    moved = 0.0
    for axis in range(N_AXES):
        moved = max(moved, abs(state[0].axis_um[axis] - state[0].traced_um[axis]))
    return moved > TRACED_MOVE_UM


@compiled_apart
def _renew_rays(
    state: NDArray[np.void], window: NDArray[np.void], a: Arrays, tiles: NDArray[np.uint16],
    index: NDArray[np.int32], levels: NDArray[np.float32], c: Constants, position: Array, rows: Array,
) -> None:
    """Trace the rays from the wire's present position, after carving the craters of a former wire."""
    if state[0].carved_pulses < state[0].pulses:
        _carve(state, window, a, tiles, index, c, rows)
    # the rays of a tilted wire, or of one that was tilted before, are in the plane perpendicular to it
    u, v = state[0].axis_um[2], state[0].axis_um[3]
    if u != 0.0 or v != 0.0 or a.upright[0] != 1.0:
        slope_x, slope_y = lean(a, c, u, v)
        tilt_rays(a, slope_x, slope_y)
        place_wire(state, a, position)  # it bends elsewhere
    retrace(a, tiles, index, c, position, state[0].traces)
    if levels.shape[0] != 0:
        weigh(a, index, levels, c)
    state[0].traces += 1
    state[0].traced_pulses = state[0].pulses
    for axis in range(N_AXES):
        state[0].traced_um[axis] = state[0].axis_um[axis]


@compiled_apart
def _pack_rays(a: Arrays) -> None:
    """Pack the rays of all slices for a window."""
    pack_rays(rays_of(a))


@compiled
def _add_deflection(window: NDArray[np.void], a: Arrays) -> None:
    """Add the wire's mean deflection over the height to the window's sums."""
    for axis in range(2):
        mean = mean_deflection(a, axis)
        window[0].deflection_um[axis] += mean
        window[0].deflection2_um2[axis] += mean * mean


@compiled_apart
def _lacks_tiles(state: NDArray[np.void]) -> bool:
    """Return whether the wire, at either guide, is too far from the place around which the field has tiles."""
    far = False
    for d in range(2):
        low = state[0].axis_um[d] + state[0].deflection_um[d]
        high = low + state[0].axis_um[2 + d]
        far = far or abs(low - state[0].tiled_um[d]) > loop.TILED_UM
        far = far or abs(high - state[0].tiled_um[2 + d]) > loop.TILED_UM
    return far


@compiled_apart
def _begin(state: NDArray[np.void], window: NDArray[np.void], a: Arrays) -> None:
    """Reset the window's sums."""
    w = window[0]
    w.start_ns, w.duration_ns, w.ignitions = state[0].time_ns, 0, 0
    for k in range(4):
        w.counts[k] = 0
    for k in range(5):
        w.fifths[k] = 0
    w.voltage_us = w.charge_A_us = w.energy_J = w.delay_us = w.gap_um = w.crater_um3 = 0.0
    w.temperature_max_K = 0.0
    for axis in range(2):
        w.deflection_um[axis] = w.deflection2_um2[axis] = 0.0
    for s in range(a.temperature_K.shape[0]):
        w.temperature_max_K = max(w.temperature_max_K, a.temperature_K[s])
    # added here because NaN in the gas may have faded at the window's end
    slices = a.shape.shape[0]
    w.coverage = mean_of_slices(a.steam, slices) + mean_of_slices(a.gas, slices) + mean_of_slices(a.wake_gas, slices)


@compiled_apart
def _end(state: NDArray[np.void], window: NDArray[np.void], a: Arrays, deepest_um: float) -> int:
    """Compute the window's means, and check whether the model is still valid."""
    w = window[0]
    gas = w.coverage  # as it was at the window's beginning
    warmth = 0.0
    for s in range(a.shape.shape[0]):
        warmth += a.temperature_K[s]
    w.debris = mean_of_slices(a.debris, a.shape.shape[0])
    w.coverage = mean_of_slices(a.covered, a.shape.shape[0])
    w.broken = state[0].broken
    pulses = w.counts[0] + w.counts[1] + w.counts[2] + w.counts[3]
    x, y = w.deflection_um[0] / pulses, w.deflection_um[1] / pulses
    state[0].deflection_um[0], state[0].deflection_um[1] = x, y
    # fastmath may remove math.isfinite, but not a comparison
    places = ringing(a, 0) + ringing(a, 1)
    for axis in range(N_AXES):
        places += state[0].axis_um[axis]
    if not abs(x + y + places + warmth + w.debris + w.voltage_us + gas) < FINITE:
        return loop.NOT_FINITE
    if math.hypot(x, y) > MOST_DEFLECTION_UM:
        return loop.OUTSIDE
    if deepest_um == LOST_UM:
        return loop.OUTSIDE
    return loop.INSIDE if deepest_um < -DEEPEST_UM else loop.FINE


@compiled_apart
def _check_events(events: NDArray[np.int64], now_ns: int, drives: bool) -> int:
    """Check that a window's events are motor steps, or with `drives` also input lines, in order of time."""
    before = now_ns
    for k in range(events.shape[0]):
        channel, value = events[k, 1], events[k, 2]
        step = 0 <= channel < N_AXES and (value == 1 or value == -1)
        line = drives and N_AXES <= channel < N_CHANNELS and (value == 0 or value == 1)
        if not (step or line):
            return loop.STEP_WRONG
        if events[k, 0] < before:
            return loop.STEP_EARLY
        before = events[k, 0]
    return loop.FINE


@compiled
def _grid_steps(spans: float, most: int) -> int:
    """Round to whole steps of the time grid, 0 to `most`; they are indices of tables."""
    return max(min(int(spans + 0.5), most), 0)


@compiled
def _move_wire(
    a: Arrays, c: Constants, t: Timing, p: Propagators, loads: Array, held: Array, k: int, scale: float, film: float,
    resistance: float, narrow: bool, upward: bool, films: Array,
) -> None:
    """Move the wire over `k` grid steps under the scaled pull; `narrow`: against the films near the metal."""
    if k == 0:
        return
    span_us = k * t.grid_us
    braking = resistance * span_us * 1e-6
    if narrow:
        copy(held, a.wire_q)
    move(a, p, loads, scale, k, braking)
    if narrow:
        slow = 1.0 / (1.0 + braking * a.mobility[0] / 3.0)
        squeeze(a, c, p, held, k, span_us, scale, film, slow, upward, films)


@compiled
def fire_window(
    state: NDArray[np.void],
    window: NDArray[np.void],
    a: Arrays,
    tiles: NDArray[np.uint16],
    index: NDArray[np.int32],
    levels: NDArray[np.float32],
    c: Constants,
    law: GapLaw,
    heat: HeatLaw,
    bubble: BubbleLaw,
    gas: GasLaw,
    t: Timing,
    p: Propagators,
    scratch: Scratch,
    axes: Axes,
    link: FullLink | None,
    events: NDArray[np.int64],
    log: NDArray[np.void],
    count: int,
) -> int:
    """Fire `count` pulses, with motor steps at their times; stop early if the wire breaks or an axis must stop."""
    # As many pulses are logged as fit into `log`, which may be empty. With a `link`, MuJoCo moves wire and table;
    # without one, the modes move by `p`. numba omits the code of the other case. Returns how the window ended (`FINE`
    # and the following constants of `state`).
    if state[0].broken != 0:
        return loop.BROKEN
    if _lacks_tiles(state):
        return loop.NO_TILES
    status = _check_events(events, state[0].time_ns, axes.loops != 0)
    if status != loop.FINE:
        return status
    position, load, held = scratch.position, scratch.load, scratch.held
    sums, contact, films = scratch.sums, scratch.contact, scratch.films
    _begin(state, window, a)
    place_wire(state, a, position)
    if _is_due(state, c):
        _renew_rays(state, window, a, tiles, index, levels, c, position, scratch.rows)
    _pack_rays(a)
    # leakage through the water and the supply's resistance form a voltage divider
    open_V = t.open_V / (1.0 + c.supply_ohm * leak_conductance(a, c))
    # pressure eps V^2 / 2 on a ray's patch, per 1/um^2 of its summed inverse square gaps, in um kg/s^2
    open_scale = 0.5 * c.permittivity_F_m * open_V**2 * c.patch_m2 * 1e12 * 1e6
    # while a discharge burns, the pull is proportional to the square of its lower voltage
    burn_scale = open_scale * (t.burning_V / open_V) ** 2
    per_grid = 1.0 / t.grid_us
    next_event = 0
    for n in range(WINDOW_PULSES):
        place_wire(state, a, position)
        totals = sum_rays(a, c, law, position, sums, contact)
        # the ratio of film to pull is kept until the next tracing
        if state[0].traced_pulses == state[0].pulses:
            scale_film(state, a, c, position, sums)
        _add_deflection(window, a)
        # class of the pulse, its ignition delay in us, and slice and ray of its place
        outcome, delay, s, k = decide(state, a, c, law, t, position, sums, contact, totals)

        if log.shape[0] > n:
            since_us = (state[0].time_ns - window[0].start_ns) * 1e-3
            log_pulse(log, n, a, position, since_us, open_V, outcome, delay, s, k)
        burn = energy = impulse = removed = 0.0
        if outcome == loop.SHORT:
            impulse = short_circuit(state, window, a, c, t, heat, bubble, position, s, k)
        elif outcome != loop.OPEN:
            # an iso-pulse ends at a fixed time, so the delay shortens its discharge
            burn = t.on_us - delay if t.mode == loop.ISO_PULSE else t.on_us
            burn *= t.arc_share if outcome == loop.ARC else 1.0
            energy, impulse, removed = discharge(state, window, a, c, t, heat, bubble, position, outcome, s, k, burn)
            window[0].delay_us += delay
            window[0].ignitions += 1
        at = max(s, 0)
        # the bubble pushes the wire away from the metal, against the ray of the discharge
        kick_x, kick_y = -impulse * a.cosine[at, k], -impulse * a.sine[at, k]
        window[0].counts[outcome] += 1
        window[0].voltage_us += open_V * delay + t.burning_V * burn

        conducting = t.on_us if outcome == loop.SHORT else burn
        if log.shape[0] > n:
            log[n].conducting_us = conducting
        period_ns, k_period = t.period_ns, loop.GRID
        if t.mode == loop.ISO_ENERGETIC:
            # delay and discharge stretch the period, which ends on a step of the time grid
            k_period = _grid_steps((delay + conducting + t.pause_us) * per_grid, loop.GRID)
            period_ns = int(k_period * t.grid_us * 1e3 + 0.5)
        period_us = period_ns * 1e-3
        film = mean_film(state, totals[3], totals[4], sums.shape[0])
        resistance = mean_resistance(a, c, gas, film)
        project(a, sums, load)
        if axes.errs != 0:
            indicate(state)
        if link is not None:
            find_films(state, a, c, sums, film, films)
            next_event = move_full(
                state, a, c, axes, link, p, t, load, films, film, resistance, open_scale, burn_scale,
                delay, delay + burn, period_ns, at, kick_x, kick_y, events, next_event,
            )
            state[0].time_ns += period_ns
        else:
            narrow = is_narrow(a, c, sums)
            if narrow:
                find_films(state, a, c, sums, film, films)
            # first span: the voltage pulls the wire, with its mean square over delay and discharge
            k_end = _grid_steps((delay + burn) * per_grid, k_period)
            pulled = (open_scale * delay + burn_scale * burn) / max(delay + burn, t.grid_us)
            # the direction of sweeps over the slices alternates, to favour neither end of the wire
            upward = state[0].pulses % 2 == 0
            _move_wire(a, c, t, p, load, held, k_end, pulled, film, resistance, narrow, upward, films)
            # the push of the bubble comes at the end of the discharge
            if impulse != 0.0:
                kick(a, at, kick_x, kick_y)
            # second span, without pull: in several parts if a film is narrow, because it changes with the motion
            spans, k_before = c.film_spans if narrow else 1, k_end
            for n_span in range(1, spans + 1):
                k_now = k_period if n_span == spans else k_end + (k_period - k_end) * n_span // spans
                upward = not upward
                _move_wire(a, c, t, p, load, held, k_now - k_before, 0.0, film, resistance, narrow, upward, films)
                k_before = k_now
            ring(a, p, k_period)
            state[0].time_ns += period_ns
            next_event = advance_axes(
                state, a, axes, p, t, k_period, c.step_um, events, next_event, state[0].time_ns, False
            )
        if axes.errs != 0:
            apply_geometric_errors(state, axes)
        # first the gas of earlier discharges fades; the new gas acts from the next pulse on
        quiet = period_us - delay - conducting
        fade(a, gas, k_period)
        if energy > 0.0:
            k_quiet = _grid_steps(quiet * per_grid, k_period)
            blow(a, c, gas, s, draw(state), energy, k_quiet, removed)
        # a short leaves no channel, so deionisation of the last one continues
        state[0].since_discharge_us = state[0].since_discharge_us + period_us if energy == 0.0 else quiet
        state[0].pulses += 1
        state[0].heat_wait_us += period_us
        window[0].duration_ns += period_ns
        # heat and debris change slowly, so they are propagated once in several pulses
        if state[0].heat_wait_us >= HEAT_INTERVAL_US:
            propagate_heat(state, a, c, heat, sums, contact, films)
        # the window ends if an axis was stopped or the state left its range
        if next_event < 0:
            return _end(state, window, a, LOST_UM if next_event == LOST else 0.0)
        if state[0].broken != 0 or n + 1 == count:
            break
    # carve before the next tracing or reading of the field
    if state[0].broken != 0 or count < WINDOW_PULSES or _is_due(state, c):
        _carve(state, window, a, tiles, index, c, scratch.rows)
    # push the wire out of the metal before the rays are traced again
    place_wire(state, a, position)
    deepest = 0.0
    if sum_rays(a, c, law, position, sums, contact)[2] > 0.0:
        resolve_contact(state, a, position, contact)
        deepest = deepest_contact(a, position, contact)[0]
    return _end(state, window, a, deepest)
