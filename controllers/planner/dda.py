"""An ideal line generator: each axis stays within half a step of a point that runs along the path.

Lengths along the path are whole numbers of 65 536ths of a motor step. At every tick of the clock, the point moves by
the speed in units. An axis steps when it is over half a step behind.
"""

from __future__ import annotations

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.mcu.firmware.timers import NEVER, TIMER_COUNT
from edmsim.controllers.planner.record import LIMIT, Floats, Ints, Row, count, note

NM = 1000  # nanometres in a um: steps and corners of this planner are whole numbers of them
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
        way = min(ahead, room)
        if way > budget - travelled:
            row.along += heading * (budget - travelled)
            return made
        row.along += heading * way
        travelled += way
        if ahead <= room:
            direction = heading if points[row.move + 1, axis] > points[row.move, axis] else -heading
            if not count(row, axis, direction):
                return LIMIT
            # The point passes the threshold between two ticks; the motor hears of it at the later one.
            made = note(row, out, made, tick - (-travelled // abs(speed)), axis, direction)
        elif 0 <= row.move + heading <= row.last_move:
            row.move += heading
            row.along = 0 if heading > 0 else lengths[row.move]
        else:
            return made


@exactly_compiled
def dda_path_um(row: Row, along: Floats) -> float:
    """Length run, in um."""
    return float(along[row.move] + row.along * row.step_um / TIMER_COUNT)


@exactly_compiled
def _nm(um: float) -> int:
    return round(um * NM)


@exactly_compiled
def _until_step(row: Row, points: Floats, lengths: Ints, axis: int, heading: int) -> int:
    """Length until the running point is more than half a step ahead of an axis."""
    run = _nm(points[row.move + 1, axis] - points[row.move, axis]) * heading
    if run == 0:
        return NEVER
    # Measured from the end the point comes from, in the axis' own direction of travel.
    length, step = lengths[row.move], _nm(row.step_um)
    origin = _nm(points[row.move, axis] if heading > 0 else points[row.move + 1, axis])
    behind = (_nm(row.from_um[axis]) + step * row.counter[axis] - origin) * (1 if run > 0 else -1)
    passed = row.along if heading > 0 else length - row.along
    return int(max(_scaled(length, 2 * behind + step, 2 * abs(run)) + 1 - passed, 0))


@exactly_compiled
def _scaled(length: int, share: int, of: int) -> int:
    """A length times a share of a whole, rounded down; the product alone would not fit 64 bits."""
    whole = share // of
    rest = share - whole * of
    high, low = length // _HALF_WORD, length % _HALF_WORD
    part = rest * high // of
    return whole * length + part * _HALF_WORD + ((rest * high - part * of) * _HALF_WORD + rest * low) // of
