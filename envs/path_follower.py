"""Sub-environments along their paths, compiled: steps by their planners, and where each wire has come.

Nothing here knows the plant; sub-environments do not touch each other, so that their order and number do not matter.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.planner.kinds import LIMIT, advance, done, path_um, segment_at, travel_um
from edmsim.controllers.planner.lateral_offset import next_steps
from edmsim.cosim.stops import StopCause, judge, switches_open

_SEARCH_UM = 300.0
"""How far along the path, either way, the nearest place of it is looked for (ours: deflections stay below)."""
SHORTED_SHARE = 0.9  # share of short pulses from which on a window counts as shorted (ours)
SHORTED_S = 2.0
"""Time of nothing but shorted windows after which the machine stops (ours: a retract at 10 um/s has led 20 um away by
then, more than a gap)."""

SETTLING_NS = 250_000_000
"""Time after threading for which nothing counts as cut (ours): the field pulls a wire 6 to 9 um towards the metal in
its first windows, whatever is commanded."""

RUNNING, DONE, WIRE_BREAK, OUT_OF_RANGE = (
    int(cause) for cause in (StopCause.RUNNING, StopCause.FINISHED, StopCause.WIRE_BREAK, StopCause.OUT_OF_RANGE)
)
"""Why an episode ended, if it did, as numbers for compiled code."""

SUB_ENV = np.dtype(
    [
        ("units", "i8"),  # feed in the planner's units, negative backwards
        ("units_before", "i8"),  # feed until the new one counts
        ("latency_ns", "i8"),  # a new feed counts so long after the window's begin
        ("longest_ns", "i8"),  # longest window of the setting
        ("elapsed_ns", "i8"),  # time of cutting in the episode
        ("step_ns", "i8"),  # time since the last action
        ("settling_ns", "i8"),  # for how long a fresh wire settles yet
        ("steps", "i8"),  # motor steps planned
        ("beside", "i8", 2),  # steps by which the motors are beside the path, where offset_um leads them
        ("cause", "i8"),  # why the episode ended
        ("broke", "i8"),  # whether the wire broke in the window
        ("wires_lost", "i8"),
        ("step_um", "f8"),  # travel of a motor step
        ("table_um", "f8"),  # the table's travel
        ("feed_um_s", "f8"),  # feed commanded
        ("offset_um", "f8"),  # of the guides, to the left of the path
        ("path_um", "f8"),  # length of the leg behind the sub-environment by its planner
        ("travel_um", "f8"),  # of the last window, along the path
        ("reached_um", "f8"),  # length of the leg up to where the wire really is: metal bends it and holds it back
        # the length of the leg that was cut follows the wire by the share of pulses that ignite, so that a wire
        # pushed into metal, or led through air, cuts nothing until it sparks
        ("cut_um", "f8"),
        ("progress_um", "f8"),  # of the cut, in the last window
        ("area_mm2", "f8"),  # that, times the local height
        ("error_um", "f8"),  # distance of the wire's true place from the path
        ("before_um", "f8"),  # length of the legs before
        ("total_um", "f8"),  # length of all legs
        ("shorted_s", "f8"),  # for how long there have been nothing but shorts
        ("setting_us", "f8", 2),  # on-time and period
        ("first_setting_us", "f8", 2),  # those at the begin
        ("open_V", "f8"),  # the generator's open voltage
        ("limit_A", "f8"),  # its limit of the mean current
        ("wait_us", "f8"),  # longest wait for an ignition
        ("energy_mJ", "f8"),  # of a discharge of the setting
        ("threading_s", "f8"),  # what a lost wire costs the machine
    ]
)
"""Numbers of one sub-environment."""


@exactly_compiled
def take_feeds(
    indices: NDArray[np.int64], rows: NDArray[np.void], feeds_um_s: NDArray[np.float64], limit_um_s: float,
    unit_nm_s: float, counts: bool,
) -> None:
    """Command feeds, negative backwards, in the planners' units; with `counts` a feed is shown as it is counted."""
    for j in range(indices.shape[0]):
        i = indices[j]
        units = np.rint(min(max(feeds_um_s[i], -limit_um_s), limit_um_s) * 1e3 / unit_nm_s)
        rows[i].units_before = rows[i].units
        rows[i].units = int(units)
        rows[i].feed_um_s = units * unit_nm_s * 1e-3 if counts else feeds_um_s[i]


@exactly_compiled
def _run(
    planner: Any, points: NDArray[np.float64], along: NDArray[np.float64], lengths: NDArray[np.int64],
    start_ns: int, end_ns: int, row: Any, out: NDArray[np.int64],
) -> int:
    """Run a planner through a window: at the feed before until the new one counts; see `run.advance`."""
    if row.latency_ns == 0:
        return advance(planner, points, along, lengths, start_ns, end_ns, row.units, out)
    turn_ns = min(start_ns + row.latency_ns, end_ns)
    made = advance(planner, points, along, lengths, start_ns, turn_ns, row.units_before, out)
    if made == LIMIT or turn_ns == end_ns:
        return int(made)
    room = out[min(made, out.shape[0]):]
    more = advance(planner, points, along, lengths, turn_ns, end_ns, row.units, room)
    return LIMIT if more == LIMIT else made + more


@exactly_compiled
def plan(
    indices: NDArray[np.int64], rows: NDArray[np.void], planners: NDArray[np.void], ahead: NDArray[np.void],
    points: NDArray[np.float64], along: NDArray[np.float64], lengths: NDArray[np.int64], states: NDArray[np.void],
    out: NDArray[np.int64],
) -> int:
    """Plan motor steps (n, room, 3) for the longest window there can be; the planners themselves stay, `ahead` runs.

    Returns the most steps of a sub-environment; if `out` has too little room for them, plan again with more.
    """
    most = 0
    for j in range(indices.shape[0]):
        i = indices[j]
        ahead[0] = planners[i]
        now = states[i].time_ns
        made = _run(ahead[0], points[i], along[i], lengths[i], now, now + rows[i].longest_ns, rows[i], out[i])
        rows[i].steps = max(made, 0)
        most = max(most, made)
    return most


@exactly_compiled
def lead_sideways(
    indices: NDArray[np.int64], rows: NDArray[np.void], planners: NDArray[np.void], points: NDArray[np.float64],
    along: NDArray[np.float64], states: NDArray[np.void], out: NDArray[np.int64],
) -> None:
    """Put steps that lead sub-environments beside their paths before the planned ones; see `next_steps`."""
    for j in range(indices.shape[0]):
        i = indices[j]
        more = next_steps(
            points[i], along[i], planners[i].last_move, rows[i].path_um, rows[i].offset_um, rows[i].step_um,
            rows[i].beside,
        )
        for axis in range(2):
            if more[axis] != 0:
                for k in range(rows[i].steps, 0, -1):
                    for field in range(3):
                        out[i, k, field] = out[i, k - 1, field]
                out[i, 0, 0], out[i, 0, 1], out[i, 0, 2] = states[i].time_ns, axis, more[axis]
                rows[i].steps += 1
                rows[i].beside[axis] += more[axis]


@exactly_compiled
def _nearest(points: NDArray[np.float64], k: int, x: float, y: float) -> tuple[float, float]:
    """Share of segment `k` of a path at which it comes nearest to a place, and the square of the distance there."""
    dx, dy = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
    share = ((x - points[k, 0]) * dx + (y - points[k, 1]) * dy) / (dx * dx + dy * dy)
    share = min(max(share, 0.0), 1.0)
    ax, ay = points[k, 0] + share * dx - x, points[k, 1] + share * dy - y
    return share, ax * ax + ay * ay


@exactly_compiled
def _look(
    rows: NDArray[np.void], i: int, start: int, last: int, points: NDArray[np.float64], along: NDArray[np.float64],
    x: float, y: float,
) -> None:
    """Find the point of an environment's path that is nearest to its wire, looking near the environment's place."""
    here = rows[i].path_um
    k = segment_at(along, last, here, start)
    while k > 0 and along[k] > here - _SEARCH_UM:
        k -= 1
    nearest = math.inf
    while k <= last and along[k] < here + _SEARCH_UM:
        share, distance2 = _nearest(points, k, x, y)
        if distance2 < nearest:
            nearest = distance2
            rows[i].reached_um = along[k] + share * (along[k + 1] - along[k])
        k += 1
    rows[i].error_um = math.sqrt(nearest)


@exactly_compiled
def _height_mm(height_from: NDArray[np.float64], heights: NDArray[np.float64], path_um: float) -> float:
    """Height of the workpiece at a length of path."""
    k = 0
    while k + 1 < height_from.shape[0] and height_from[k + 1] <= path_um:
        k += 1
    return float(heights[k])


@exactly_compiled
def follow(
    indices: NDArray[np.int64], rows: NDArray[np.void], planners: NDArray[np.void], before: NDArray[np.void],
    points: NDArray[np.float64], along: NDArray[np.float64], lengths: NDArray[np.int64],
    height_from: NDArray[np.float64], heights: NDArray[np.float64], states: NDArray[np.void],
    windows: NDArray[np.void], nowhere: NDArray[np.int64],
) -> None:
    """Move every environment on by the window it has had: its place, where its wire is, whether it has ended.

    ``cause`` tells `DONE` at the end of a leg, and knows nothing of `OUT_OF_RANGE`. `before` is room for one planner
    as it was, `nowhere` (0, 3) room for no steps: those of the window are made. `heights` hold from `height_from` on.
    """
    for j in range(indices.shape[0]):
        i = indices[j]
        before[0] = planners[i]
        now, planner = states[i].time_ns, planners[i]
        spent_ns = windows[i].duration_ns
        made = _run(planner, points[i], along[i], lengths[i], now - spent_ns, now, rows[i], nowhere)
        rows[i].path_um = path_um(planner, points[i], along[i])
        rows[i].travel_um = travel_um(before[0], planner, points[i], along[i])
        pulses = 0
        for kind in range(4):
            pulses += windows[i].counts[kind]
        x, y = states[i].commanded_um[0], states[i].commanded_um[1]
        _look(
            rows, i, planner.move, planner.last_move, points[i], along[i],
            states[i].axis_um[0] + windows[i].deflection_um[0] / pulses,
            states[i].axis_um[1] + windows[i].deflection_um[1] / pulses,
        )
        if rows[i].settling_ns > 0:
            rows[i].cut_um = max(rows[i].cut_um, rows[i].reached_um)
        ignited = (windows[i].counts[1] + windows[i].counts[2]) / pulses
        rows[i].progress_um = ignited * max(rows[i].reached_um - rows[i].cut_um, 0.0)
        height = _height_mm(height_from[i], heights[i], rows[i].before_um + rows[i].cut_um)
        rows[i].cut_um += rows[i].progress_um
        rows[i].area_mm2 = rows[i].progress_um * 1e-3 * height
        rows[i].elapsed_ns += spent_ns
        rows[i].step_ns += spent_ns
        rows[i].settling_ns = max(rows[i].settling_ns - spent_ns, 0)
        rows[i].broke = windows[i].broken != 0
        if windows[i].counts[3] >= SHORTED_SHARE * pulses:
            rows[i].shorted_s += spent_ns * 1e-9
        else:
            rows[i].shorted_s = 0.0
        limit_um, slack_um = rows[i].table_um, rows[i].step_um
        switch = switches_open(x, limit_um, slack_um) != 0 or switches_open(y, limit_um, slack_um) != 0
        shorted, at_end = rows[i].shorted_s > SHORTED_S, done(planner, points[i], along[i], lengths[i])
        rows[i].cause = judge(windows[i].broken != 0, False, switch or made == LIMIT, False, shorted, False, at_end)
