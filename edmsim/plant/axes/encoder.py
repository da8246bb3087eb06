"""The encoder: its two phases as the axis moves, how a drive's inputs count them, index mark and end switches.

The phases follow the place of rotor or table edge by edge. An input is not read again for ``1 / rate`` after it was
read: of edges that come faster it sees what the phases are by then. One step of the four states is a count, two at
once are illegal and move none, three look like one back.
"""

from __future__ import annotations

import math
from typing import Any

from edmsim.compiled.axis_rows import HIGH_END, LOW_END, PHASE_A, PHASE_B
from edmsim.compiled.jit import compiled
from edmsim.plant.axes.marks import home_level, pass_marks
from edmsim.plant.kernel.state import Axes


@compiled
def position(row: Any, motor: Any) -> float:
    """Place of what the encoder sits on, in counts since it was switched on."""
    place_um = row.place_um if motor.on_table != 0.0 else row.rotor_um
    return float((place_um - row.zero_um) * motor.counts_per_rad / motor.um_per_rad)


@compiled
def _count_at(position: float, phase_error: float) -> int:
    """True count at a position; the edges of every other count are off by `phase_error`."""
    count = math.floor(position + 0.5)
    within = position + 0.5 - count
    if count % 2 != 0 and within < phase_error:
        return count - 1
    if count % 2 == 0 and within > 1.0 + phase_error:
        return count + 1
    return count


@compiled
def read_phases(row: Any, disturbed: int) -> None:
    """Let the input count what it sees now, some phases turned over by a disturbance."""
    phases = row.state ^ disturbed
    if row.swapped != 0:
        phases = (phases & PHASE_A) << 1 | (phases & PHASE_B) >> 1
    phases |= row.unplugged & (PHASE_A | PHASE_B)
    step = ((phases ^ phases >> 1) - (row.seen_state ^ row.seen_state >> 1)) & 3
    row.seen_state = phases
    if step == 2:
        row.illegal += 1
    elif step != 0:
        row.count += 1 if step == 1 else -1
        row.edges += 1


@compiled
def _catch_up(row: Any, now_ns: float, hold_ns: float) -> None:
    """Read the phases if an edge has waited for the input to be ready."""
    if row.ready_ns <= now_ns:
        read_phases(row, 0)
        row.ready_ns += hold_ns


@compiled
def _hold_ns(drive: Any, motor: Any) -> float:
    rate_Hz = motor.edge_rate_Hz
    if drive.count_rate_Hz > 0.0:
        rate_Hz = min(rate_Hz, drive.count_rate_Hz)
    return float(1e9 / rate_Hz)


@compiled
def see_edges(drive: Any, row: Any, motor: Any, before: float, from_ns: float, to_ns: float) -> None:
    """Count the edges of a short motion at constant speed.

    Parameters
    ----------
    before : float
        Position (counts) at its begin, `position` of the same rows.
    from_ns, to_ns : float
        Begin and end.
    """
    after = position(row, motor)
    count = _count_at(after, motor.phase_error)
    if count == row.true_count:
        return
    way = 1 if count > row.true_count else -1
    hold_ns, span = _hold_ns(drive, motor), after - before
    while row.true_count != count:
        share = 1.0 if span == 0.0 else min(max((row.true_count + 0.5 * way - before) / span, 0.0), 1.0)
        at_ns = from_ns + share * (to_ns - from_ns)
        if row.seen_state != row.state:
            _catch_up(row, at_ns, hold_ns)
        row.true_count += way
        row.state = row.true_count & 3 ^ (row.true_count & 3) >> 1
        if row.ready_ns <= at_ns:
            read_phases(row, 0)
            row.ready_ns = at_ns + hold_ns


@compiled
def read_axis(axes: Axes, axis: int, now_ns: int) -> None:
    """Read encoder, index mark, end switches and home cam of an axis at a time."""
    row, motor = axes.rows[axis], axes.motors[axis]
    _catch_up(row, float(now_ns), 0.0)
    row.missed = row.true_count - row.count
    pass_marks(row, motor, axes.drives[axis].index_ns)
    row.home = home_level(row, motor, now_ns)
    row.ends = (LOW_END if row.place_um < row.low_um else 0) | (HIGH_END if row.place_um > row.high_um else 0)
    row.time_ns = now_ns
