"""The planner of 1982: POSCAL once per move and a reload counter per axis, with all their faults.

POSCAL computes the direction once, at the start of a move, and each axis stops at its own target. A component that
REDUC drops never moves (row T-G11), axis speeds are whole units (row T-G9), and the sum of squares wraps at 16 bits
(row T-G6), so the wire leaves the line (row T-G12). A change of speed repeats VELOCM alone; the timers use it from
their next interrupt on. A backward move runs the same vector in reverse.
"""

from __future__ import annotations

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.mcu.firmware.arithmetic import subsgn
from edmsim.controllers.mcu.firmware.poscal import resolve, velocm
from edmsim.controllers.mcu.firmware.timers import loaded
from edmsim.controllers.planner.record import Floats, Ints, Row, aim_at, aimed, count, note, place_um


@exactly_compiled
def begin_literal(row: Row, points: Floats) -> None:
    """Stand at the path's start and aim at the end of its first move."""
    _aim(row, points, 1)


@exactly_compiled
def run_literal(row: Row, points: Floats, tick: int, last: int, speed: int, out: Ints) -> int:
    """Run from one tick to another; return the number of steps."""
    made, heading = 0, 1 if speed > 0 else -1
    while tick < last and _begin_move(row, points, heading):
        _set_rates(row, points, abs(speed), heading)
        due = last - tick
        for axis in range(2):
            if row.rate[axis] != 0:
                row.timer[axis] = loaded(row.timer[axis], row.rate[axis])
                due = min(due, row.timer[axis])
        tick += due
        for axis in range(2):
            if row.rate[axis] != 0:
                row.timer[axis] -= due
                if row.timer[axis] == 0:
                    direction = heading * row.aim[3 + axis]
                    count(row, axis, direction)
                    made = note(row, out, made, tick, axis, direction)
    return made


@exactly_compiled
def literal_done(row: Row, points: Floats) -> bool:
    """Whether the last move is over: each axis at its target, or lost by REDUC."""
    return row.move == row.last_move and not (_to_go(row, points, 0, 1) or _to_go(row, points, 1, 1))


@exactly_compiled
def _aim(row: Row, points: Floats, heading: int) -> None:
    """POSCAL's vector from here to the end of a move, turned to point forwards along the path."""
    target, unit = row.move + (heading > 0), row.unit_um
    x, x_direction = subsgn(int(points[target, 0]) // unit, place_um(row, 0) // unit)
    y, y_direction = subsgn(int(points[target, 1]) // unit, place_um(row, 1) // unit)
    aim_at(row, resolve(x, y, x_direction * heading, y_direction * heading, True))


@exactly_compiled
def _begin_move(row: Row, points: Floats, heading: int) -> bool:
    """Pass to the next moves while this one is over; False where the path ends."""
    while not (_to_go(row, points, 0, heading) or _to_go(row, points, 1, heading)):
        if not 0 <= row.move + heading <= row.last_move:
            return False
        row.move += heading
        _aim(row, points, heading)
    return True


@exactly_compiled
def _to_go(row: Row, points: Floats, axis: int, heading: int) -> bool:
    """Whether an axis still moves: its component survived REDUC, its target is over half a step ahead."""
    left = (int(points[row.move + (heading > 0), axis]) - place_um(row, axis)) * row.aim[3 + axis] * heading
    return bool(row.aim[axis] > 0 and 2 * left > row.step_um)


@exactly_compiled
def _set_rates(row: Row, points: Floats, speed: int, heading: int) -> None:
    """VELOCM with the stored vector, in whole units; an axis that has arrived stops and its counter is unloaded."""
    x, y = velocm(aimed(row), speed)
    row.rate[0], row.rate[1] = abs(x), abs(y)
    for axis in range(2):
        if not _to_go(row, points, axis, heading):
            row.rate[axis] = row.timer[axis] = 0
