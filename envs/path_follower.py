"""Motor steps along a polyline, compiled: an exact accumulator per lane, no Python per step.

A lane's place is the length of path behind it, counted in whole attometres (nm/s times ns), so that no rounding
ever gathers. An axis steps when the path crosses the middle between two of its steps; both axes' steps come out in
order of time. Nothing here knows the plant; lanes do not touch each other, so that their order and number do not
matter.

A window has one feed here: a controller's latency (`FeedCommand.latency_s`) is simulated by `edmsim cut` alone.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from edmsim.cosim.stops import StopCause, judge, switches_open

FINE_PER_UM = 10**12
"""Attometres in a um: the unit of a lane's place."""
_SEARCH_UM = 300.0
"""How far along the path, either way, the nearest place of it is looked for (ours: deflections stay below)."""
SHORTED_SHARE = 0.9
"""Share of short pulses from which on a window counts as shorted (ours)."""
SHORTED_S = 2.0
"""Time of nothing but shorted windows after which the machine stops (ours: a retract at 10 um/s has led 20 um away by
then, more than a gap)."""

RUNNING, DONE, WIRE_BREAK, OUT_OF_RANGE = (
    int(cause) for cause in (StopCause.RUNNING, StopCause.FINISHED, StopCause.WIRE_BREAK, StopCause.OUT_OF_RANGE)
)
"""Why an episode ended, if it did, as numbers for compiled code."""

LANE = np.dtype(
    [
        ("place", "i8"),
        ("end", "i8"),
        ("feed_nm_s", "i8"),
        ("segment", "i8"),
        ("corners", "i8"),
        ("longest_ns", "i8"),
        ("steps", "i8"),
        ("cause", "i8"),
        ("step_um", "f8"),
        ("table_um", "f8"),
        ("feed_um_s", "f8"),
        ("travel_um", "f8"),
        ("reached_um", "f8"),
        ("cut_um", "f8"),
        ("progress_um", "f8"),
        ("area_mm2", "f8"),
        ("error_um", "f8"),
        ("before_um", "f8"),
        ("total_um", "f8"),
        ("shorted_s", "f8"),
        ("setting_us", "f8", 2),
        ("first_setting_us", "f8", 2),
        ("open_V", "f8"),
        ("limit_A", "f8"),
        ("wait_us", "f8"),
    ]
)
"""Numbers of one lane.

``place, end`` are lengths of path behind the lane and of the whole leg in 1 / `FINE_PER_UM` um; ``feed_nm_s`` is
the feed, negative backwards; ``segment`` the one the lane is in, of ``corners`` points; ``longest_ns`` the longest
window; ``steps`` how many motor steps are planned; ``cause`` why the episode ended. ``step_um, table_um`` are the
motor step and the table's travel. Of the last window: ``feed_um_s`` commanded, ``travel_um`` along the path by the
counters, ``progress_um`` of the cut and ``area_mm2``, that times the local height. ``reached_um`` is the length of
the leg up to where the wire really is, ``error_um`` its distance from there: a wire pushed against metal bends and
stays behind its counters. ``cut_um`` is the length of the leg that was cut: it follows the wire by the share of
pulses that ignite, so that a wire pushed into metal, or led through air, cuts nothing until it sparks. ``before_um``
is the length of the legs before, ``total_um`` of all; ``shorted_s`` for how long there have been nothing but shorts;
``setting_us`` on-time and period, now and at first; ``open_V, limit_A, wait_us`` the generator's open voltage, limit
of mean current, and longest wait for an ignition.
"""

_jit = numba.njit(cache=True, nogil=True, error_model="numpy")


@_jit
def _segment_at(along: NDArray[np.float64], count: int, place_um: float, start: int) -> int:
    """Segment of the path in which a place lies, looked for from the last one on."""
    k = min(max(start, 0), count - 2)
    while k < count - 2 and place_um > along[k + 1]:
        k += 1
    while k > 0 and place_um < along[k]:
        k -= 1
    return k


@_jit
def _steps_of_lane(
    points: NDArray[np.float64], along: NDArray[np.float64], count: int, segment: int, place_um: float, end_um: float,
    feed_um_s: float, step_um: float, commanded: NDArray[np.float64], now_ns: int, out: NDArray[np.int64],
) -> int:
    """Write the steps that lead from one place of the path to another; return their number."""
    forward = end_um >= place_um
    counter = (math.floor(commanded[0] / step_um + 0.5), math.floor(commanded[1] / step_um + 0.5))
    x, y = counter
    made, here, before = 0, place_um, now_ns
    k = _segment_at(along, count, place_um, segment)
    while True:
        there = min(end_um, along[k + 1]) if forward else max(end_um, along[k])
        length = along[k + 1] - along[k]
        dx, dy = (points[k + 1, 0] - points[k, 0]) / length, (points[k + 1, 1] - points[k, 1]) / length
        x1 = math.floor((points[k, 0] + dx * (there - along[k])) / step_um + 0.5)
        y1 = math.floor((points[k, 1] + dy * (there - along[k])) / step_um + 0.5)
        while (x != x1 or y != y1) and made < out.shape[0]:
            at_x = at_y = math.inf
            if x != x1:
                edge = (x + (0.5 if x1 > x else -0.5)) * step_um
                at_x = abs((edge - points[k, 0]) / dx + along[k] - here) if dx != 0.0 else 0.0
            if y != y1:
                edge = (y + (0.5 if y1 > y else -0.5)) * step_um
                at_y = abs((edge - points[k, 1]) / dy + along[k] - here) if dy != 0.0 else 0.0
            axis = 0 if at_x <= at_y else 1
            on_way = min(min(at_x, at_y), abs(there - here)) + abs(here - place_um)
            at_ns = now_ns + (math.ceil(on_way / abs(feed_um_s) * 1e9) if feed_um_s != 0.0 else 0)
            before = max(before, at_ns)
            if axis == 0:
                direction = 1 if x1 > x else -1
                x += direction
            else:
                direction = 1 if y1 > y else -1
                y += direction
            out[made, 0], out[made, 1], out[made, 2] = before, axis, direction
            made += 1
        here = there
        if here == end_um or (forward and k == count - 2) or (not forward and k == 0):
            return made
        k += 1 if forward else -1


@_jit
def plan(
    lanes: NDArray[np.int64], rows: NDArray[np.void], points: NDArray[np.float64], along: NDArray[np.float64],
    states: NDArray[np.void], out: NDArray[np.int64],
) -> None:
    """Plan every lane's motor steps for the longest window there can be.

    Parameters
    ----------
    lanes : (m,)
        Lanes that move; of the other arguments, row i belongs to lane i.
    rows : (n,) `LANE`
        ``steps`` is written.
    points, along : (n, most, 2), (n, most)
        Corners of the paths in um, and the length of path up to each.
    states : (n,) `edmsim.plant.kernel.state.STATE`
        Position counters and time of the plants.
    out : (n, room, 3)
        Written: time in ns, axis and direction of each step.
    """
    for j in range(lanes.shape[0]):
        i = lanes[j]
        row = rows[i]
        place = row.place / FINE_PER_UM
        feed = row.feed_nm_s * 1e-3
        end = min(max(place + feed * row.longest_ns * 1e-9, 0.0), along[i, row.corners - 1])
        rows[i].steps = _steps_of_lane(
            points[i], along[i], row.corners, row.segment, place, end, feed, row.step_um, states[i].commanded_um,
            states[i].time_ns, out[i],
        )


@_jit
def _nearest(points: NDArray[np.float64], k: int, x: float, y: float) -> tuple[float, float]:
    """Share of segment `k` of a path at which it comes nearest to a place, and the square of the distance there."""
    dx, dy = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
    share = ((x - points[k, 0]) * dx + (y - points[k, 1]) * dy) / (dx * dx + dy * dy)
    share = min(max(share, 0.0), 1.0)
    ax, ay = points[k, 0] + share * dx - x, points[k, 1] + share * dy - y
    return share, ax * ax + ay * ay


@_jit
def _look(
    rows: NDArray[np.void], i: int, points: NDArray[np.float64], along: NDArray[np.float64], x: float, y: float
) -> None:
    """Find the point of a lane's path that is nearest to its wire, looking near the lane's place."""
    here = rows[i].place / FINE_PER_UM
    count = rows[i].corners
    k = _segment_at(along, count, here, rows[i].segment)
    rows[i].segment = k
    while k > 0 and along[k] > here - _SEARCH_UM:
        k -= 1
    nearest = math.inf
    while k < count - 1 and along[k] < here + _SEARCH_UM:
        share, distance2 = _nearest(points, k, x, y)
        if distance2 < nearest:
            nearest = distance2
            rows[i].reached_um = along[k] + share * (along[k + 1] - along[k])
        k += 1
    rows[i].error_um = math.sqrt(nearest)


@_jit
def _height_mm(height_from: NDArray[np.float64], heights: NDArray[np.float64], path_um: float) -> float:
    """Height of the workpiece at a length of path."""
    k = 0
    while k + 1 < height_from.shape[0] and height_from[k + 1] <= path_um:
        k += 1
    return float(heights[k])


@_jit
def follow(
    lanes: NDArray[np.int64], rows: NDArray[np.void], points: NDArray[np.float64], along: NDArray[np.float64],
    height_from: NDArray[np.float64], heights: NDArray[np.float64], states: NDArray[np.void],
    windows: NDArray[np.void],
) -> None:
    """Move every lane on by the window it has had: its place, where its wire is, and whether it has come to an end.

    Parameters
    ----------
    lanes, points, along
        As in `plan`.
    rows : (n,) `LANE`
        Brought up to date; ``cause`` tells `DONE` at the end of a leg, and knows nothing of `OUT_OF_RANGE`.
    height_from, heights : (n, most)
        Lengths of path from which on the workpiece has another height, and these, in mm.
    states, windows : (n,)
        Of the plants, after the window.
    """
    for j in range(lanes.shape[0]):
        i = lanes[j]
        before = rows[i].place
        place = before + rows[i].feed_nm_s * windows[i].duration_ns
        rows[i].place = min(max(place, 0), rows[i].end)
        rows[i].travel_um = (rows[i].place - before) / FINE_PER_UM
        pulses = 0
        for kind in range(4):
            pulses += windows[i].counts[kind]
        x, y = states[i].commanded_um[0], states[i].commanded_um[1]
        _look(
            rows, i, points[i], along[i], x + windows[i].deflection_um[0] / pulses,
            y + windows[i].deflection_um[1] / pulses,
        )
        ignited = (windows[i].counts[1] + windows[i].counts[2]) / pulses
        rows[i].progress_um = ignited * max(rows[i].reached_um - rows[i].cut_um, 0.0)
        height = _height_mm(height_from[i], heights[i], rows[i].before_um + rows[i].cut_um)
        rows[i].cut_um += rows[i].progress_um
        rows[i].area_mm2 = rows[i].progress_um * 1e-3 * height
        if windows[i].counts[3] >= SHORTED_SHARE * pulses:
            rows[i].shorted_s += windows[i].duration_ns * 1e-9
        else:
            rows[i].shorted_s = 0.0
        travel_um, slack_um = rows[i].table_um, rows[i].step_um
        switch = switches_open(x, travel_um, slack_um) != 0 or switches_open(y, travel_um, slack_um) != 0
        shorted, done = rows[i].shorted_s > SHORTED_S, rows[i].place >= rows[i].end
        rows[i].cause = judge(windows[i].broken != 0, False, switch, shorted, False, done)
