"""The default planner: POSCAL re-aimed at every step at a point a little ahead on the present move.

The thesis computes POSCAL once per move and leaves the line by up to hundreds of um (rows T-G11, T-G12).
Here the same integer routines aim at a point a little ahead, as its text foresees ("the tangent may
change at every step"). Three things are ours: this point, the vector in quarter um, for a precise
length (row T-G10), and the path speed doubled up to 128..255 for VELOCM, which makes directions at
low speed as precise as at high speed (rows T-G9, T-A4).

The planner with the sine table aims at the same point, with directions from the table instead of a square root (row
T-72). A direction is right to half an entry plus the rounding of sine and cosine, 0.3 degrees. As each step aims
again, the path is as accurate as with POSCAL.
"""

from __future__ import annotations

import math

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.mcu.firmware.arithmetic import subsgn
from edmsim.controllers.mcu.firmware.poscal import look_up, resolve, velocm
from edmsim.controllers.mcu.firmware.timers import NEVER, STEP_PHASE, loaded, run_phase, ticks_to_overflow
from edmsim.controllers.planner.record import (
    LIMIT,
    SINE_TABLE,
    Floats,
    Ints,
    Row,
    aim_at,
    aimed,
    count,
    note,
    place_um,
)

# The planner of 1982: POSCAL once per move and a reload counter per axis, with all their faults.
# POSCAL computes the direction once, at the start of a move, and each axis stops at its own target. A component
# that REDUC drops never moves (row T-G11), axis speeds are whole units (row T-G9), and the sum of squares wraps at
# 16 bits (row T-G6), so the wire leaves the line (row T-G12). A change of speed repeats VELOCM alone; the timers
# use it from their next interrupt on. A backward move runs the same vector in reverse.


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


QUARTER = 4  # vectors are aimed in quarters of 1 um

CARROT_UM = 32  # distance of the carrot ahead of the wire in um (ours): 128 quarters, which suits POSCAL's 8 bits

SMALLEST_VECTOR = 91  # vectors with a shorter longer component are doubled before their length is taken (row T-G10)


@exactly_compiled
def begin_poscal(row: Row, points: Floats) -> None:
    """Stand at the path's start and aim along it."""
    row.heading = 1
    _steer(row, points)


@exactly_compiled
def run_poscal(row: Row, points: Floats, tick: int, last: int, speed: int, out: Ints) -> int:
    """Run from one tick to another; return the number of steps, or `LIMIT`."""
    made = 0
    _command(row, points, speed)
    while tick < last and not at_end(row, points):
        to_step = min(ticks_to_overflow(row.timer[0], row.rate[0]), ticks_to_overflow(row.timer[1], row.rate[1]))
        to_steer = min(to_step, _ticks_to_arrival(row, points))
        due = min(to_steer, last - tick)
        tick += due
        for axis in range(2):
            row.timer[axis], direction = run_phase(row.timer[axis], row.rate[axis], due)
            if direction != 0:
                if not count(row, axis, direction):
                    return LIMIT
                made = note(row, out, made, tick, axis, direction)
        if due == to_steer:
            _steer(row, points)
    return made


@exactly_compiled
def at_end(row: Row, points: Floats) -> bool:
    """Whether the counters have come to the path's end in the present heading, as near as an axis steps."""
    return _on_last_move(row) and near(row, points, row.move + (row.heading > 0))


@exactly_compiled
def near(row: Row, points: Floats, point: int) -> bool:
    """Whether either counter is as near to a corner as it comes: half of a 2 um step (row T-18)."""
    for axis in range(2):
        away = abs(place_um(row, axis) - int(points[point, axis]))
        if 8 * away > 5 * row.step_um + 2:
            return False
    return True


@exactly_compiled
def lengthened(x: int, y: int) -> tuple[int, int, int, int]:
    """Magnitudes of a signed displacement in quarter um, doubled while it is short, and their directions."""
    x, x_direction = subsgn(x, 0)
    y, y_direction = subsgn(y, 0)
    while 0 < max(x, y) < SMALLEST_VECTOR:
        x, y = 2 * x, 2 * y
    return x, y, x_direction, y_direction


@exactly_compiled
def _command(row: Row, points: Floats, speed: int) -> None:
    """Take a commanded speed; a change of sign turns the wire round where it is."""
    heading = 1 if speed > 0 else -1
    if heading != row.heading:
        row.heading, row.speed = heading, abs(speed)
        _steer(row, points)
    elif abs(speed) != row.speed:
        _set_speed(row, abs(speed))


@exactly_compiled
def _set_speed(row: Row, speed: int) -> None:
    """VELOCM for the present aim, at the speed doubled to fill 8 bits; rates are in units / 128."""
    row.speed = speed
    row.rate[0] = row.rate[1] = 0
    if speed > 0:
        doublings = 0
        while speed << doublings < 128:
            doublings += 1
        x, y = velocm(aimed(row), speed << doublings)
        row.rate[0], row.rate[1] = x << 7 - doublings, y << 7 - doublings


@exactly_compiled
def _steer(row: Row, points: Floats) -> None:
    """Pass to the next move where the commanded point has reached the end of this one, and aim again."""
    x, y = _find_carrot(row, points)
    while row.carrot_is_end and max(abs(x), abs(y)) <= 1 and not _on_last_move(row):
        row.move += row.heading
        x, y = _find_carrot(row, points)
    x, y, x_direction, y_direction = lengthened(x, y)
    if row.kind == SINE_TABLE:
        aim_at(row, look_up(x, y, x_direction, y_direction))
    else:
        aim_at(row, resolve(x, y, x_direction, y_direction, False))
    _set_speed(row, row.speed)


@exactly_compiled
def _ticks_to_arrival(row: Row, points: Floats) -> int:
    """Ticks until the commanded point reaches the end of the move along its longer component."""
    axis = 0 if row.aim[0] >= row.aim[1] else 1
    if not row.carrot_is_end or row.rate[axis] == 0:
        return NEVER
    target = int(points[row.move + (row.heading > 0), axis])
    left = (target - place_um(row, axis)) * STEP_PHASE // int(row.step_um)
    return int(-(-(left - row.timer[axis]) // row.rate[axis]))


@exactly_compiled
def _on_last_move(row: Row) -> bool:
    """Whether no move follows in the present heading."""
    return bool(row.move == (row.last_move if row.heading > 0 else 0))


@exactly_compiled
def _find_carrot(row: Row, points: Floats) -> tuple[int, int]:
    """Vector in quarter um from the commanded point, counters and phases together, to the carrot."""
    end, origin = row.move + (row.heading > 0), row.move + (row.heading < 0)
    run_x = QUARTER * int(points[end, 0] - points[origin, 0])
    run_y = QUARTER * int(points[end, 1] - points[origin, 1])
    x = QUARTER * (place_um(row, 0) - int(points[origin, 0])) + _quarters(row, 0)
    y = QUARTER * (place_um(row, 1) - int(points[origin, 1])) + _quarters(row, 1)
    length = _root(run_x * run_x + run_y * run_y)
    ahead = max((x * run_x + y * run_y) // length, 0) + QUARTER * CARROT_UM
    row.carrot_is_end = ahead >= length
    if row.carrot_is_end:
        return run_x - x, run_y - y
    return run_x * ahead // length - x, run_y * ahead // length - y


@exactly_compiled
def _quarters(row: Row, axis: int) -> int:
    """Lead of the commanded position over an axis' counter in quarter um, rounded."""
    return int((row.timer[axis] * QUARTER * int(row.step_um) + STEP_PHASE // 2) // STEP_PHASE)


@exactly_compiled
def _root(n: int) -> int:
    """Whole root of a number below 2^53, rounded down."""
    root = int(math.sqrt(n))
    while root * root > n:
        root -= 1
    while (root + 1) * (root + 1) <= n:
        root += 1
    return root
