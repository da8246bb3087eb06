"""The planners in compiled code: their record, the steps of each kind, and one call for all kinds."""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import boolean, float64, from_dtype, int64

from edmsim.compiled.jit import exactly_compiled
from edmsim.compiled.numba_internals import address_of, call_returning
from edmsim.controllers.mcu.firmware import timers
from edmsim.controllers.mcu.firmware.poscal import WORD, Displacement, counted, look_up, resolve, subsgn, velocm
from edmsim.geometry import Floats, Ints

# A planner's data in compiled code: a record of numbers, and the corners of its path.

POSCAL, LITERAL, DDA, SINE_TABLE, EXACT = range(5)  # kinds of planners

Row = Any  # one record of `PLANNER`; compiled code writes to it

PLANNER = np.dtype(
    [
        ("kind", "i8"),  # one of the kinds above
        ("last_move", "i8"),  # index of the path's last straight move
        ("unit_um", "i8"),  # unit of position
        ("hertz", "i8"),  # the clock is hertz / per
        ("per", "i8"),
        ("step_um", "f8"),  # travel of a motor step
        ("from_um", "f8", 2),  # start position
        # state, see `CHANGES`
        ("move", "i8"),  # present move
        ("counter", "i8", 2),  # steps made, forward minus backward
        ("along", "i8"),  # length in 1 / 10^12 um (`EXACT`), or within the move in step_um / 65536 (`DDA`)
        ("timer", "i8", 2),  # phase of an accumulator, or remaining ticks of a reload counter (`LITERAL`)
        ("rate", "i8", 2),  # axis speeds in units / 128
        ("aim", "i8", 5),  # fields of the `Displacement` from which they were computed, without its halvings
        ("carrot_is_end", "i8"),  # whether it points to the end of the move
        ("heading", "i8"),  # direction of the last command
        ("speed", "i8"),  # speed of the last command, in units
    ]
)
"""Numbers of one planner."""

CHANGES = ("move", "counter", "along", "timer", "rate", "aim", "carrot_is_end", "heading", "speed")
"""Fields that change while a planner runs."""

LIMIT = -1  # result in place of a number of steps if a counter would overflow


@exactly_compiled
def place_um(row: Row, axis: int) -> int:
    """Return the position counter of an axis in whole um; that of `LITERAL` wraps at 16 bits."""
    place = int(row.from_um[axis]) + int(row.step_um) * row.counter[axis]
    if row.kind == LITERAL:
        return int(counted(place // row.unit_um, 0, True) * row.unit_um)
    return int(place)


@exactly_compiled
def position_um(row: Row, axis: int) -> float:
    """Return the position counter of an axis in um, for any step."""
    if row.kind == LITERAL:
        return float(place_um(row, axis))
    return float(row.from_um[axis] + row.step_um * row.counter[axis])


@exactly_compiled
def count(row: Row, axis: int, direction: int) -> bool:
    """Count a step; return False if a 16-bit counter that does not wrap would overflow."""
    row.counter[axis] += direction
    return bool(row.kind == LITERAL or 0 <= position_um(row, axis) <= WORD * row.unit_um)


@exactly_compiled
def note(row: Row, out: Ints, made: int, tick: int, axis: int, direction: int) -> int:
    """Append a step if there is room; return the number of steps."""
    if made < out.shape[0]:
        out[made, 0], out[made, 1], out[made, 2] = timers.tick_time_ns(tick, row.hertz, row.per), axis, direction
    return made + 1


@exactly_compiled
def aim_at(row: Row, move: Displacement) -> None:
    """Store the vector of the present direction."""
    row.aim[0], row.aim[1], row.aim[2] = move.x, move.y, move.length
    row.aim[3], row.aim[4] = move.x_direction, move.y_direction


@exactly_compiled
def aimed(row: Row) -> Displacement:
    """Return the stored vector."""
    return Displacement(row.aim[0], row.aim[1], row.aim[2], row.aim[3], row.aim[4], 0)


# An ideal line generator: each axis stays within half a step of a point that runs along the path.
# Lengths along the path are integers in 1/65,536 of a motor step. At every tick of the clock, the point moves by the
# speed in units. An axis steps when it is more than half a step behind.

NM = 1000  # nanometres per um: steps and corners of this planner are whole nm
_HALF_WORD = 1 << 16


@exactly_compiled
def run_dda(row: Row, points: Floats, lengths: Ints, tick: int, last: int, speed: int, out: Ints) -> int:
    """Run from one tick to another; return the number of steps, or `LIMIT`."""
    made, heading = 0, 1 if speed > 0 else -1
    budget, travelled = abs(speed) * (last - tick), 0
    while True:
        x, y = _until_step(row, points, lengths, 0, heading), _until_step(row, points, lengths, 1, heading)
        ahead, axis = (x, 0) if x <= y else (y, 1)
        room = lengths[row.move] - row.along if heading > 0 else row.along
        distance = min(ahead, room)
        if distance > budget - travelled:
            row.along += heading * (budget - travelled)
            return made
        row.along += heading * distance
        travelled += distance
        if ahead <= room:
            direction = heading if points[row.move + 1, axis] > points[row.move, axis] else -heading
            if not count(row, axis, direction):
                return LIMIT
            # the point passes the threshold between two ticks; the step is made at the later one
            made = note(row, out, made, tick - (-travelled // abs(speed)), axis, direction)
        elif 0 <= row.move + heading <= row.last_move:
            row.move += heading
            row.along = 0 if heading > 0 else lengths[row.move]
        else:
            return made


@exactly_compiled
def _nm(um: float) -> int:
    return round(um * NM)


@exactly_compiled
def _until_step(row: Row, points: Floats, lengths: Ints, axis: int, heading: int) -> int:
    """Return the length until the running point is more than half a step ahead of an axis."""
    run = _nm(points[row.move + 1, axis] - points[row.move, axis]) * heading
    if run == 0:
        return timers.NEVER
    # measured from the end from which the point comes, in the axis' direction of travel
    length, step = lengths[row.move], _nm(row.step_um)
    origin = _nm(points[row.move, axis] if heading > 0 else points[row.move + 1, axis])
    behind = (_nm(row.from_um[axis]) + step * row.counter[axis] - origin) * (1 if run > 0 else -1)
    passed = row.along if heading > 0 else length - row.along
    return int(max(_scaled(length, 2 * behind + step, 2 * abs(run)) + 1 - passed, 0))


@exactly_compiled
def _scaled(length: int, share: int, of: int) -> int:
    """Return ``length * share / whole`` rounded down; the product alone would overflow 64 bits."""
    whole = share // of
    rest = share - whole * of
    high, low = length // _HALF_WORD, length % _HALF_WORD
    part = rest * high // of
    return whole * length + part * _HALF_WORD + ((rest * high - part * of) * _HALF_WORD + rest * low) // of


# An exact planner: it accumulates the path length in whole attometres, without rounding errors.
# It has no clock and no 16-bit counters. Feeds are whole nm/s; steps and corners are any number of um. An axis steps
# when the path crosses the middle between two of its steps. The steps of both axes are in order of time.

FINE_PER_UM = 10**12  # attometres (nm/s times ns) per um: the unit of the travelled length


@exactly_compiled
def segment_at(along: Floats, last: int, place_um: float, start: int) -> int:
    """Return the segment of the path that contains a length; the search starts at another segment."""
    k = 0 if start < 0 else (last if start > last else start)
    while k < last and place_um > along[k + 1]:
        k += 1
    while k > 0 and place_um < along[k]:
        k -= 1
    return k


@exactly_compiled
def run_exact(row: Row, points: Floats, along: Floats, start_ns: int, end_ns: int, speed: int, out: Ints) -> int:
    """Run for a window of time at a feed in nm/s; return the number of steps."""
    feed, place = speed * 1e-3, row.along / FINE_PER_UM
    end = min(max(place + feed * (end_ns - start_ns) * 1e-9, along[0]), along[row.last_move + 1])
    made = _steps(row, points, along, place, end, feed, start_ns, end_ns, out)
    begin: float = along[0] * FINE_PER_UM  # negative if the planner began at a later point than the first
    row.along = min(max(row.along + speed * (end_ns - start_ns), math.ceil(begin)), path_end(row, along))
    row.move = segment_at(along, row.last_move, row.along / FINE_PER_UM, row.move)
    return made


@exactly_compiled
def path_end(row: Row, along: Floats) -> int:
    """Return the length of the whole path in attometres."""
    end: float = along[row.last_move + 1] * FINE_PER_UM
    return math.floor(end)


@exactly_compiled
def _steps(
    row: Row, points: Floats, along: Floats, place_um: float, end_um: float, feed_um_s: float, start_ns: int,
    end_ns: int, out: Ints,
) -> int:
    """Make the steps between two lengths of the path, except those that are not due yet; return their number."""
    forward = end_um >= place_um
    step, last = row.step_um, row.last_move
    first_x, first_y = math.floor(row.from_um[0] / step + 0.5), math.floor(row.from_um[1] / step + 0.5)
    # the start lies on the grid of steps, whichever that is
    off_x, off_y = row.from_um[0] - first_x * step, row.from_um[1] - first_y * step
    x, y = first_x + row.counter[0], first_y + row.counter[1]
    made, here, before = 0, place_um, start_ns
    k = segment_at(along, last, place_um, row.move)
    while True:
        there = min(end_um, along[k + 1]) if forward else max(end_um, along[k])
        length = along[k + 1] - along[k]
        x0, y0 = points[k, 0] - off_x, points[k, 1] - off_y
        dx, dy = (points[k + 1, 0] - points[k, 0]) / length, (points[k + 1, 1] - points[k, 1]) / length
        x1 = math.floor((x0 + dx * (there - along[k])) / step + 0.5)
        y1 = math.floor((y0 + dy * (there - along[k])) / step + 0.5)
        while x != x1 or y != y1:
            at_x = at_y = math.inf
            if x != x1:
                edge = (x + (0.5 if x1 > x else -0.5)) * step
                at_x = abs((edge - x0) / dx + along[k] - here) if dx != 0.0 else 0.0
            if y != y1:
                edge = (y + (0.5 if y1 > y else -0.5)) * step
                at_y = abs((edge - y0) / dy + along[k] - here) if dy != 0.0 else 0.0
            axis = 0 if at_x <= at_y else 1
            distance = min(min(at_x, at_y), abs(there - here)) + abs(here - place_um)
            at_ns = start_ns + (math.ceil(distance / abs(feed_um_s) * 1e9) if feed_um_s != 0.0 else 0)
            before = max(before, at_ns)
            if before >= end_ns:
                return made  # the next window begins with it
            if axis == 0:
                direction = 1 if x1 > x else -1
                x += direction
            else:
                direction = 1 if y1 > y else -1
                y += direction
            row.counter[axis] += direction
            if made < out.shape[0]:
                out[made, 0], out[made, 1], out[made, 2] = before, axis, direction
            made += 1
        here = there
        if here == end_um or (forward and k == last) or (not forward and k == 0):
            return made
        k += 1 if forward else -1


# The default planner: POSCAL, aimed again at every step at a point ahead on the present move.
# In the thesis POSCAL runs once per move, and the wire leaves the line by up to hundreds of um (rows T-G11, T-G12).
# Here the same integer routines aim at a point ahead, which its text mentions ("the tangent may change at every
# step"). Three things are ours: this point; the vector in quarter um, for a precise length (row T-G10); and the path
# speed doubled until it is 128..255 for VELOCM, which makes directions at low speed as precise as at high speed (rows
# T-G9, T-A4).
# The planner with the sine table aims at the same point, and takes directions from the table instead of a square root
# (row T-72). The error of a direction is up to half an entry plus the rounding of sine and cosine, 0.3 degrees. As it
# aims again at every step, the path is as accurate as with POSCAL.

# The planner of 1982: POSCAL once per move and a reload counter per axis, with all their errors.
# POSCAL computes the direction once, at the beginning of a move, and each axis stops at its own target. A component
# that REDUC reduces to 0 never moves (row T-G11), axis speeds are whole units (row T-G9), and the sum of squares
# wraps at 16 bits (row T-G6), so the wire leaves the line (row T-G12). After a change of speed only VELOCM runs
# again; the timers use the result from their next interrupt on. A backward move runs the same vector in reverse.


@exactly_compiled
def run_literal(row: Row, points: Floats, tick: int, last: int, speed: int, out: Ints) -> int:
    """Run from one tick to another; return the number of steps."""
    made, heading = 0, 1 if speed > 0 else -1
    while tick < last and _begin_move(row, points, heading):
        _set_rates(row, points, abs(speed), heading)
        due = last - tick
        for axis in range(2):
            if row.rate[axis] != 0:
                row.timer[axis] = timers.loaded(row.timer[axis], row.rate[axis])
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
def _aim(row: Row, points: Floats, heading: int) -> None:
    """Store POSCAL's vector to the end of a move, turned to point forwards along the path."""
    target, unit = row.move + (heading > 0), row.unit_um
    x, x_direction = subsgn(int(points[target, 0]) // unit, place_um(row, 0) // unit)
    y, y_direction = subsgn(int(points[target, 1]) // unit, place_um(row, 1) // unit)
    aim_at(row, resolve(x, y, x_direction * heading, y_direction * heading, True))


@exactly_compiled
def _begin_move(row: Row, points: Floats, heading: int) -> bool:
    """Go to the next move while the present one is over; return False at the end of the path."""
    while not (_to_go(row, points, 0, heading) or _to_go(row, points, 1, heading)):
        if not 0 <= row.move + heading <= row.last_move:
            return False
        row.move += heading
        _aim(row, points, heading)
    return True


@exactly_compiled
def _to_go(row: Row, points: Floats, axis: int, heading: int) -> bool:
    """Return whether an axis still moves: its component is not 0, and its target is over half a step away."""
    left = (int(points[row.move + (heading > 0), axis]) - place_um(row, axis)) * row.aim[3 + axis] * heading
    return bool(row.aim[axis] > 0 and 2 * left > row.step_um)


@exactly_compiled
def _set_rates(row: Row, points: Floats, speed: int, heading: int) -> None:
    """Run VELOCM with the stored vector, in whole units; an axis at its target stops, and its counter is unloaded."""
    x, y = velocm(aimed(row), speed)
    row.rate[0], row.rate[1] = abs(x), abs(y)
    for axis in range(2):
        if not _to_go(row, points, axis, heading):
            row.rate[axis] = row.timer[axis] = 0


QUARTER = 4  # vectors are aimed in quarters of 1 um

CARROT_UM = 32  # distance of the carrot, the point aimed at, in um (ours): 128 quarters, for POSCAL's 8 bits

SMALLEST_VECTOR = 91  # vectors with a shorter longer component are doubled (row T-G10)


@exactly_compiled
def run_poscal(row: Row, points: Floats, tick: int, last: int, speed: int, out: Ints) -> int:
    """Run from one tick to another; return the number of steps, or `LIMIT`."""
    made = 0
    _command(row, points, speed)
    while tick < last and not at_end(row, points):
        x_ticks = timers.ticks_to_overflow(row.timer[0], row.rate[0])
        to_step = min(x_ticks, timers.ticks_to_overflow(row.timer[1], row.rate[1]))
        to_steer = min(to_step, _ticks_to_arrival(row, points))
        due = min(to_steer, last - tick)
        tick += due
        for axis in range(2):
            row.timer[axis], direction = timers.run_phase(row.timer[axis], row.rate[axis], due)
            if direction != 0:
                if not count(row, axis, direction):
                    return LIMIT
                made = note(row, out, made, tick, axis, direction)
        if due == to_steer:
            _steer(row, points)
    return made


@exactly_compiled
def at_end(row: Row, points: Floats) -> bool:
    """Return whether the counters are at the path's end in the present direction, within half a step."""
    return _on_last_move(row) and near(row, points, row.move + (row.heading > 0))


@exactly_compiled
def near(row: Row, points: Floats, point: int) -> bool:
    """Return whether both counters are at a corner, within half of a 2 um step (row T-18)."""
    for axis in range(2):
        away = abs(place_um(row, axis) - int(points[point, axis]))
        if 8 * away > 5 * row.step_um + 2:
            return False
    return True


@exactly_compiled
def lengthened(x: int, y: int) -> tuple[int, int, int, int]:
    """Return the magnitudes of a displacement in quarter um, doubled while it is short, and their signs."""
    x, x_direction = subsgn(x, 0)
    y, y_direction = subsgn(y, 0)
    while 0 < max(x, y) < SMALLEST_VECTOR:
        x, y = 2 * x, 2 * y
    return x, y, x_direction, y_direction


@exactly_compiled
def _command(row: Row, points: Floats, speed: int) -> None:
    """Set a commanded speed; a change of sign reverses the motion at once."""
    heading = 1 if speed > 0 else -1
    if heading != row.heading:
        row.heading, row.speed = heading, abs(speed)
        _steer(row, points)
    elif abs(speed) != row.speed:
        _set_speed(row, abs(speed))


@exactly_compiled
def _set_speed(row: Row, speed: int) -> None:
    """Run VELOCM for the present aim at the speed doubled to fill 8 bits; rates are in units / 128."""
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
    """Go to the next move if the commanded point has reached the end of this one, and aim again."""
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
    """Return the ticks until the commanded point reaches the end of the move along its longer component."""
    axis = 0 if row.aim[0] >= row.aim[1] else 1
    if not row.carrot_is_end or row.rate[axis] == 0:
        return timers.NEVER
    target = int(points[row.move + (row.heading > 0), axis])
    left = (target - place_um(row, axis)) * timers.STEP_PHASE // int(row.step_um)
    return int(-(-(left - row.timer[axis]) // row.rate[axis]))


@exactly_compiled
def _on_last_move(row: Row) -> bool:
    """Return whether no move follows in the present direction."""
    return bool(row.move == (row.last_move if row.heading > 0 else 0))


@exactly_compiled
def _find_carrot(row: Row, points: Floats) -> tuple[int, int]:
    """Return the vector in quarter um from the commanded point (counters and phases) to the carrot."""
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
    """Return the lead of the commanded position over an axis' counter in quarter um, rounded."""
    return int((row.timer[axis] * QUARTER * int(row.step_um) + timers.STEP_PHASE // 2) // timers.STEP_PHASE)


@exactly_compiled
def _root(n: int) -> int:
    """Return the square root of a number below 2^53, rounded down."""
    root = int(math.sqrt(n))
    while root * root > n:
        root -= 1
    while (root + 1) * (root + 1) <= n:
        root += 1
    return root


# One compiled call for all kinds of planners.


@exactly_compiled
def begin(row: Row, points: Floats) -> None:
    """Aim along the path at its start."""
    if row.kind in (POSCAL, SINE_TABLE):
        row.heading = 1
        _steer(row, points)
    elif row.kind == LITERAL:
        _aim(row, points, 1)


@exactly_compiled
def advance(
    row: Row, points: Floats, along: Floats, lengths: Ints, start_ns: int, end_ns: int, speed: int, out: Ints
) -> int:
    """Run a planner for a window; writes time in ns, axis and direction of each step to `out` (room, 3).

    Returns the number of steps, even if `out` is too short for all; `LIMIT` if a counter would overflow. `points` and
    `along` may have more rows than the path.
    """
    if row.kind == EXACT:
        return run_exact(row, points, along, start_ns, end_ns, speed, out)
    if speed == 0:
        return 0
    tick, last = timers.tick_before(start_ns, row.hertz, row.per), timers.tick_before(end_ns, row.hertz, row.per)
    if row.kind == LITERAL:
        return run_literal(row, points, tick, last, speed, out)
    if row.kind == DDA:
        return run_dda(row, points, lengths, tick, last, speed, out)
    return run_poscal(row, points, tick, last, speed, out)


@exactly_compiled
def done(row: Row, points: Floats, along: Floats, lengths: Ints) -> bool:
    """Return whether the end of the path is reached."""
    if row.kind == EXACT:
        return bool(row.along >= path_end(row, along))
    if row.move != row.last_move:
        return False
    if row.kind == LITERAL:  # each axis is at its target, or its component is 0 after REDUC
        return not (_to_go(row, points, 0, 1) or _to_go(row, points, 1, 1))
    if row.kind == DDA:
        return bool(row.along == lengths[row.last_move])
    return near(row, points, row.last_move + 1)


@exactly_compiled
def path_um(row: Row, points: Floats, along: Floats) -> float:
    """Return the length travelled along the path; counters off the path are projected onto it."""
    if row.kind == EXACT:
        return float(row.along / FINE_PER_UM)
    if row.kind == DDA:
        return float(along[row.move] + row.along * row.step_um / timers.TIMER_COUNT)
    x0, y0 = int(points[row.move, 0]), int(points[row.move, 1])
    x1, y1 = int(points[row.move + 1, 0]), int(points[row.move + 1, 1])
    length = along[row.move + 1] - along[row.move]
    run = ((place_um(row, 0) - x0) * (x1 - x0) + (place_um(row, 1) - y0) * (y1 - y0)) / length
    return float(along[row.move] + min(max(run, 0.0), length))


class Addresses(NamedTuple):
    """Addresses of the planners' machine code in this process."""

    advance: int
    path_um: int
    done: int


@functools.cache
def addresses() -> Addresses:
    """Return the addresses for `advance_at` and its neighbours."""
    path = from_dtype(PLANNER), float64[:, ::1], float64[::1]
    lengths, ints = int64[::1], int64[:, ::1]
    return Addresses(
        address_of(advance, *path, lengths, int64, int64, int64, ints),
        address_of(path_um, *path),
        address_of(done, *path, lengths),
    )


advance_at: Callable[..., int] = call_returning(int64)
"""In compiled code, call `advance` by its address with a tuple of its arguments. Planners are thousands of lines of
LLVM IR, which are then not compiled again for each function that calls them."""
path_um_at: Callable[..., float] = call_returning(float64)
done_at: Callable[..., bool] = call_returning(boolean)
