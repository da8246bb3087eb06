"""Arcs for the 1982 controller: a walk around the circle in whole um, by additions and comparisons.

The thesis mentions a path whose tangent changes at every step (5.2). A sine table of 8 bits is too coarse for a large
circle: half a unit of 255 is 64 um at 32 mm. The walk works for any radius: of two neighbouring points it takes the
one whose ``x^2 + y^2`` is nearer to that of the start. The planners receive chords between the best points of the
walk, within 0.3 um of the arc.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.mcu.firmware.poscal import STEP_UM, WORD, resolve, sqrt, subsgn
from edmsim.errors import InputError

Point = tuple[int, int]

MOST_EXCESS = 2 * WORD  # more than any point of a walk has: the longest radius on the table is ``sqrt(2) * 65535``

RADIUS_TOLERANCE_UM = STEP_UM  # largest difference of start and end radius in um (ours): one motor step


def arc_points(start_um: Point, centre_um: Point, end_um: Point, clockwise: bool) -> NDArray[np.int64]:
    """Return the corners (n, 2) of an arc's chords in whole um, within 1 um of the circle, from start to end.

    If start and end have the same direction from the centre, the arc is a full circle. With a planner that stays on
    the line (all but ``poscal-literal``) the steps are within 2 um, one step, of the circle. On a table that counts
    steps, pass points in steps and double the result.
    """
    for name, point in (("start", start_um), ("centre", centre_um), ("end", end_um)):
        if not all(0 <= word <= WORD for word in point):
            raise InputError(f"the arc's {name} lies at {point} um, outside the table's 0..{WORD} um")
    if start_um == centre_um:
        raise InputError(f"the arc starts on its centre {centre_um} um: it has no radius")
    turn = -1 if clockwise else 1
    # a clockwise arc is a counter-clockwise one seen from below
    first, last = ((point[0] - centre_um[0], turn * (point[1] - centre_um[1])) for point in (start_um, end_um))
    radii = [float(np.hypot(*point)) for point in (first, last)]
    if abs(radii[0] - radii[1]) > RADIUS_TOLERANCE_UM:
        raise InputError(
            f"the arc's start is {radii[0]:.1f} um from its centre and its end {radii[1]:.1f} um: "
            f"they must agree within {RADIUS_TOLERANCE_UM} um"
        )
    points = [first, *_corners(first, last)]
    placed = [(centre_um[0] + x, centre_um[1] + turn * y) for x, y in points]
    return np.array([*placed, end_um], dtype=np.int64)


def chord_walk(x: int, y: int) -> int:
    """Return the points of the walk per chord: SQRT of the radius r, for a sagitta of ``2 r / 8 r``, a quarter um."""
    vector = resolve(subsgn(x, 0)[0], subsgn(y, 0)[0], 1, 1)
    return max(sqrt(min(vector.length << vector.halvings, WORD - 1)), 1)


def _corners(first: Point, last: Point) -> Iterator[Point]:
    """Return the corners between the ends: the point nearest to the circle in the last half of every chord."""
    length = chord_walk(*first)
    since, best, best_since, least = 0, first, 0, MOST_EXCESS
    for x, y, excess in _walk_to(first, last):
        since += 1
        if since > length // 2 and abs(excess) <= least:
            best, best_since, least = (x, y), since, abs(excess)
        if since == length:
            yield best
            since, least = since - best_since, MOST_EXCESS


def _walk_to(first: Point, last: Point) -> Iterator[tuple[int, int, int]]:
    """Return the points of the walk between two directions, without these, and their excess."""
    ahead = _across(first, last) > 0
    for x, y, excess in _walk(*first):
        # the end is reached when it is no longer within the next half turn
        left = _across((x, y), last)
        if ahead and left <= 0:
            return
        ahead = left > 0
        yield x, y, excess


def _across(a: Point, b: Point) -> int:
    """Return the cross product: positive if b is less than half a turn counter-clockwise from a."""
    return a[0] * b[1] - a[1] * b[0]


def _walk(x: int, y: int) -> Iterator[tuple[int, int, int]]:
    """Yield points counter-clockwise around zero without end, one for every um along the faster axis.

    The third number, the excess, is ``x^2 + y^2`` minus its value at the start. It is at most the radius (twice that
    below 4 um), so it needs a sign and 17 bits: three bytes.
    """
    excess = 0
    while True:
        if abs(x) >= abs(y):
            step = 1 if x > 0 else -1
            excess += 2 * y * step + 1
            y += step
            step = (y < 0) - (y > 0)
            moved = excess + 2 * x * step + 1
            if step and abs(moved) < abs(excess):
                x, excess = x + step, moved
        else:
            step = 1 if y < 0 else -1
            excess += 2 * x * step + 1
            x += step
            step = (x > 0) - (x < 0)
            moved = excess + 2 * y * step + 1
            if step and abs(moved) < abs(excess):
                y, excess = y + step, moved
        yield x, y, excess
