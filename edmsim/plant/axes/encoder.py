"""The encoder of an axis: its phases, the count in the drive, index marks, home cam, end switches.

The phases follow the position of rotor or table edge by edge. After reading, an input is not read again for
``1 / rate``; after faster edges it reads the phases as they are then. A change by one of the four states is a count,
a change by two is illegal and not counted, and a change by three is a count backwards.

Noise spikes come on A, on B or on both wires, with equal probability, at exponential intervals and with exponential
durations (ours: no source). Spikes shorter than ``1 / rate`` do not pass the input; longer ones invert the phases.
"""

import math
from typing import Any

import numpy as np

from edmsim.compiled.axis_rows import HIGH_END, INDEX_WIRE, LOW_END, PHASE_A, PHASE_B
from edmsim.compiled.jit import compiled
from edmsim.compiled.random import uniform
from edmsim.plant.kernel.state import Axes


@compiled
def position(row: Any, motor: Any) -> float:
    """Return the encoder's position in counts since it was switched on."""
    place_um = row.place_um if motor.on_table != 0.0 else row.rotor_um
    return float((place_um - row.zero_um) * motor.counts_per_rad / motor.um_per_rad)


@compiled
def _count_at(position: float, phase_error: float) -> int:
    """Return the true count at a position; every other edge is displaced by `phase_error`."""
    count = math.floor(position + 0.5)
    within = position + 0.5 - count
    if count % 2 != 0 and within < phase_error:
        return count - 1
    if count % 2 == 0 and within > 1.0 + phase_error:
        return count + 1
    return count


@compiled
def _phases_at_input(row: Any) -> Any:
    phases = row.state ^ row.disturbed
    if row.swapped != 0:
        phases = (phases & PHASE_A) << 1 | (phases & PHASE_B) >> 1
    return phases | row.unplugged & (PHASE_A | PHASE_B)


@compiled
def read_phases(row: Any) -> None:
    """Count the phases that the input reads."""
    phases = _phases_at_input(row)
    step = ((phases ^ phases >> 1) - (row.latched_state ^ row.latched_state >> 1)) & 3
    row.latched_state = phases
    if step == 2:
        row.illegal += 1
    elif step != 0:
        row.count += 1 if step == 1 else -1
        row.edges += 1


@compiled
def _catch_up(row: Any, now_ns: float, hold_ns: float) -> None:
    """Read the phases if they changed before the input was ready."""
    if row.ready_ns <= now_ns and row.latched_state != _phases_at_input(row):
        read_phases(row)
        row.ready_ns += hold_ns


@compiled
def _look(row: Any, now_ns: float, hold_ns: float) -> None:
    """Read the phases after a change, if the input is ready."""
    if row.ready_ns <= now_ns:
        read_phases(row)
        row.ready_ns = now_ns + hold_ns


@compiled
def _hold_ns(drive: Any, motor: Any) -> float:
    rate_Hz = motor.edge_rate_Hz
    if drive.count_rate_Hz > 0.0:
        rate_Hz = min(rate_Hz, drive.count_rate_Hz)
    return float(1e9 / rate_Hz)


@compiled
def _draw(row: Any) -> float:
    row.noise_draws += 1
    return float(uniform(row.noise_key, np.uint64(row.noise_draws)))


@compiled
def draw_pause(row: Any, motor: Any) -> float:
    """Return the time (ns) from one spike to the next."""
    return -1e9 * math.log(_draw(row)) / float(motor.spike_rate_Hz)


@compiled
def _take_spikes(row: Any, motor: Any, hold_ns: float, until_ns: float) -> None:
    """Process noise spikes on the encoder's wires before a time."""
    while row.spike_ns < until_ns:
        at_ns = row.spike_ns
        _catch_up(row, at_ns, hold_ns)
        if row.disturbed != 0:
            row.disturbed = 0
            row.spike_ns += draw_pause(row, motor)
        else:
            width_ns = -1e9 * math.log(_draw(row)) * motor.spike_s
            if width_ns < hold_ns:
                row.spike_ns += draw_pause(row, motor)
                continue
            row.disturbed = 1 + int(3.0 * _draw(row))
            row.spike_ns += width_ns
        _look(row, at_ns, hold_ns)


@compiled
def see_edges(drive: Any, row: Any, motor: Any, before: float, from_ns: float, to_ns: float) -> None:
    """Count the edges of a short motion at constant speed, from a `position` in counts."""
    after = position(row, motor)
    count = _count_at(after, motor.phase_error)
    if count == row.true_count and row.spike_ns >= to_ns:
        return
    hold_ns, span = _hold_ns(drive, motor), after - before
    direction = 1 if count > row.true_count else -1
    while row.true_count != count:
        share = 1.0 if span == 0.0 else min(max((row.true_count + 0.5 * direction - before) / span, 0.0), 1.0)
        at_ns = from_ns + share * (to_ns - from_ns)
        _take_spikes(row, motor, hold_ns, at_ns)
        _catch_up(row, at_ns, hold_ns)
        row.true_count += direction
        row.state = row.true_count & 3 ^ (row.true_count & 3) >> 1
        _look(row, at_ns, hold_ns)
    _take_spikes(row, motor, hold_ns, to_ns)


@compiled
def read_axis(axes: Axes, axis: int, now_ns: int) -> None:
    """Read encoder, index mark, end switches and home cam of an axis at a time."""
    row, motor = axes.rows[axis], axes.motors[axis]
    _catch_up(row, float(now_ns), 0.0)
    row.missed = row.true_count - row.count
    pass_marks(row, motor, axes.drives[axis].index_ns)
    row.home = home_level(row, motor, float(now_ns))
    row.ends = (LOW_END if row.place_um < row.low_um else 0) | (HIGH_END if row.place_um > row.high_um else 0)
    row.time_ns = now_ns


BOUNCES = 8  # number of changes of a bouncing contact, at equal intervals (ours)
LONG_AGO_NS = -(1 << 61)  # time of the last change of a switch that has never changed


@compiled
def mark_below(row: Any, motor: Any) -> int:
    """Return the number of the index mark that begins at or below the encoder's position."""
    place_um = row.place_um if motor.on_table != 0.0 else row.rotor_um
    mark: int = math.floor((place_um - motor.index_phase_um) / motor.index_um)
    return mark


@compiled
def pass_marks(row: Any, motor: Any, least_ns: int) -> None:
    """Count the index marks passed since the last call, except pulses shorter than `least_ns` or a broken wire."""
    on_table = motor.on_table != 0.0
    place_um = row.place_um if on_table else row.rotor_um
    speed_um_s = abs(row.speed_um_s if on_table else row.speed_rad_s * motor.um_per_rad)
    mark, before = mark_below(row, motor), row.mark
    row.mark = mark
    begin_um = mark * motor.index_um + motor.index_phase_um
    plugged = row.unplugged & INDEX_WIRE == 0
    row.index_on = 1 if plugged and place_um - begin_um < motor.index_width_um else 0
    if mark == before or not plugged or speed_um_s * least_ns * 1e-9 > motor.index_width_um:
        return
    row.indexes += abs(mark - before)
    passed_um = begin_um if mark > before else begin_um + motor.index_um
    per_um = motor.counts_per_rad / motor.um_per_rad
    row.index_at = row.count - np.int64(math.floor((place_um - passed_um) * per_um + 0.5))


@compiled
def home_level(row: Any, motor: Any, now_ns: float) -> int:
    """Return the home input at a time; until its bouncing switch has settled, it keeps its level ``AXIS.home``."""
    since_ns, pulse_ns = now_ns - row.cam_ns, motor.cam_bounce_ns / BOUNCES
    new: int = row.cam
    before: int = row.home
    settled_ns = motor.cam_filter_ns
    if motor.cam_filter_ns >= pulse_ns:
        settled_ns += motor.cam_bounce_ns
    elif since_ns < motor.cam_bounce_ns and since_ns >= motor.cam_filter_ns:
        return new if math.floor((since_ns - motor.cam_filter_ns) / pulse_ns) % 2 == 0 else 1 - new
    return new if since_ns >= settled_ns else before


@compiled
def watch_cam(row: Any, motor: Any, now_ns: float) -> None:
    """Update the home switch for the table's position at a time."""
    place_um, slack_um = row.place_um, motor.cam_hysteresis_um if row.cam != 0 else 0.0
    on = 1 if motor.cam_low_um - slack_um <= place_um <= motor.cam_high_um + slack_um else 0
    if on != row.cam and motor.cam_low_um != motor.cam_high_um:
        row.home = home_level(row, motor, now_ns)
        row.cam = on
        row.cam_ns = np.int64(now_ns)
