"""An exact planner: it accumulates the length of path in whole attometres, without rounding errors.

It has no clock and no 16-bit counters. A feed is any whole number of nm/s; a step or a corner is any number of um.
An axis steps when the path crosses the middle between two of its steps. The steps of both axes are in time order.
"""

from __future__ import annotations

import math

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.planner.record import Floats, Ints, Row

FINE_PER_UM = 10**12  # attometres (nm/s times ns) in a um: the unit of the length behind the wire


@exactly_compiled
def segment_at(along: Floats, last: int, place_um: float, start: int) -> int:
    """Segment of the path, 0 to the last, in which a length lies, looked for from another on."""
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
    end = min(max(place + feed * (end_ns - start_ns) * 1e-9, 0.0), along[row.last_move + 1])
    made = _steps(row, points, along, place, end, feed, start_ns, end_ns, out)
    behind = row.along + speed * (end_ns - start_ns)
    row.along = min(max(behind, 0), path_end(row, along))
    row.move = segment_at(along, row.last_move, row.along / FINE_PER_UM, row.move)
    return made


@exactly_compiled
def path_end(row: Row, along: Floats) -> int:
    """Length of the whole path in attometres."""
    end: float = along[row.last_move + 1] * FINE_PER_UM
    return math.floor(end)


@exactly_compiled
def _steps(
    row: Row, points: Floats, along: Floats, place_um: float, end_um: float, feed_um_s: float, start_ns: int,
    end_ns: int, out: Ints,
) -> int:
    """Count the steps from one length of the path to another, but those not due yet; return their number."""
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
            on_way = min(min(at_x, at_y), abs(there - here)) + abs(here - place_um)
            at_ns = start_ns + (math.ceil(on_way / abs(feed_um_s) * 1e9) if feed_um_s != 0.0 else 0)
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
