"""Compiled motion of sub-environments: motor steps from their planners, and the wire's position along its path.

This module does not use the plant. Sub-environments are independent, so their order and number do not matter.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.closed_loop.stops import StopCause, stop_cause, switches_open
from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.planner.kinds import EXACT, FINE_PER_UM, LIMIT, advance_at, done_at, path_um_at, segment_at
from edmsim.controllers.planner.registry import next_steps

_SEARCH_UM = 300.0
"""Length of path, either way, in which the point nearest to the wire is searched (ours: more than deflections)."""
SHORTED_SHARE = 0.9  # share of short pulses from which a window counts as shorted (ours)
SHORTED_S = 2.0
"""Time with shorted windows only after which the machine stops (ours: a retract at 10 um/s moves the wire by 20 um in
it, more than a gap)."""

SETTLING_NS = 250_000_000
"""Time after threading for which nothing counts as cut (ours): the field pulls a wire 6 to 9 um towards the metal in
its first windows, whatever is commanded."""

RUNNING, DONE, WIRE_BREAK, OUT_OF_RANGE = (
    int(cause) for cause in (StopCause.RUNNING, StopCause.FINISHED, StopCause.WIRE_BREAK, StopCause.OUT_OF_RANGE)
)
"""Causes of an episode's end, as numbers for compiled code."""

SUB_ENV = np.dtype(
    [
        ("units", "i8"),  # feed in the planner's units, negative backwards
        ("units_before", "i8"),  # feed until the new one takes effect
        ("latency_ns", "i8"),  # delay of a new feed from the window's start
        ("longest_ns", "i8"),  # longest possible window with the setting
        ("elapsed_ns", "i8"),  # time of cutting in the episode
        ("step_ns", "i8"),  # time since the last action
        ("drifts_ns", "i8"),  # elapsed time of the machine's next change by drift
        ("scrap_ns", "i8"),  # elapsed time up to which the cut is scrap
        ("ends_ns", "i8"),  # elapsed time at which the episode is truncated
        ("settling_ns", "i8"),  # remaining time for which a new wire settles
        ("steps", "i8"),  # motor steps planned
        ("beside", "i8", 2),  # steps by which the motors are off the path because of `offset_um`
        ("cause", "i8"),  # why the episode ended
        ("broke", "i8"),  # whether the wire broke in the window
        # whether the window's path error counts (`Family.near_corner_um`); if a wall is finished, whether its
        # finished part is long enough to measure
        ("near", "i8"),
        ("wires_lost", "i8"),
        ("step_um", "f8"),  # travel of a motor step
        ("table_um", "f8"),  # the table's travel
        ("feed_um_s", "f8"),  # feed commanded
        ("offset_um", "f8"),  # offset of the guides to the left of the path
        ("path_um", "f8"),  # length of the leg travelled, by the planner
        ("travel_um", "f8"),  # travel along the path in the last window
        ("reached_um", "f8"),  # length of the leg up to the wire's true position: metal bends it and holds it back
        # length of the leg that was cut: it follows `reached_um` by the share of pulses that ignite, so a wire pushed
        # into metal, or moved through air, cuts nothing until it sparks
        ("cut_um", "f8"),
        ("progress_um", "f8"),  # length cut in the last window
        ("area_mm2", "f8"),  # `progress_um` times the local height
        ("error_um", "f8"),  # distance of the wire's true position from the path
        ("before_um", "f8"),  # length of the legs before
        ("total_um", "f8"),  # length of all legs
        ("shorted_s", "f8"),  # time of the shorted windows since the last other one
        ("setting_us", "f8", 2),  # on-time and period
        ("first_setting_us", "f8", 2),  # on-time and period at the start
        ("open_V", "f8"),  # the generator's open voltage
        ("limit_A", "f8"),  # its limit of the mean current
        ("wait_us", "f8"),  # longest wait for an ignition
        ("energy_mJ", "f8"),  # energy of a discharge with the setting
        ("threading_s", "f8"),  # time to thread another wire
        ("near_um", "f8"),  # distance along the path from a corner up to which errors count
    ]
)
"""State of one sub-environment."""


@exactly_compiled
def _run(
    advance: int, planner: Any, points: NDArray[np.float64], along: NDArray[np.float64], lengths: NDArray[np.int64],
    start_ns: int, end_ns: int, row: Any, out: NDArray[np.int64],
) -> int:
    """Run a planner through a window: at the previous feed until the new one takes effect; see `kinds.advance`."""
    turn_ns, made = start_ns + row.latency_ns, 0
    if turn_ns > end_ns:
        turn_ns = end_ns
    if turn_ns > start_ns:
        made = advance_at(advance, (planner, points, along, lengths, start_ns, turn_ns, row.units_before, out))
        if made == LIMIT or turn_ns == end_ns:
            return made
    room = out[made:] if made < out.shape[0] else out[out.shape[0]:]
    more = advance_at(advance, (planner, points, along, lengths, turn_ns, end_ns, row.units, room))
    return LIMIT if more == LIMIT else made + more


@exactly_compiled
def plan(
    indices: NDArray[np.int64], rows: NDArray[np.void], feeds_um_s: NDArray[np.float64], limit_um_s: float,
    unit_nm_s: float, counts: bool, advance: int, planners: NDArray[np.void], ahead: NDArray[np.void],
    points: NDArray[np.float64], along: NDArray[np.float64], lengths: NDArray[np.int64], states: NDArray[np.void],
    out: NDArray[np.int64],
) -> tuple[int, bool]:
    """Set feeds, negative backwards, and plan motor steps `out` (n, room, 3) for the longest possible window.

    Feeds are rounded to the planners' units; with `counts` the recorded feed is rounded, too. The planners do not
    change: their copy in `ahead` runs. Returns the greatest number of steps of a sub-environment, and whether any is
    or will be off its path; if `out` is too small for the steps, call again with a larger one.
    """
    most, sideways = 0, False
    for j in range(indices.shape[0]):
        i = indices[j]
        row, feed = rows[i], feeds_um_s[i]
        limited = -limit_um_s if feed < -limit_um_s else (limit_um_s if feed > limit_um_s else feed)
        units = np.rint(limited * 1e3 / unit_nm_s)
        row.units = np.int64(units)
        row.feed_um_s = units * unit_nm_s * 1e-3 if counts else feed
        ahead[0] = planners[i]
        now = states[i].time_ns
        made = _run(advance, ahead[0], points[i], along[i], lengths[i], now, now + row.longest_ns, row, out[i])
        row.steps = made if made > 0 else 0
        if made > most:
            most = made
        sideways = sideways or row.offset_um != 0.0 or row.beside[0] != 0 or row.beside[1] != 0
    return most, sideways


@exactly_compiled
def lead_sideways(
    indices: NDArray[np.int64], rows: NDArray[np.void], planners: NDArray[np.void], points: NDArray[np.float64],
    along: NDArray[np.float64], states: NDArray[np.void], out: NDArray[np.int64],
) -> None:
    """Insert steps to the offsets of sub-environments before the planned ones; see `next_steps`."""
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
def _look(
    row: Any, start: int, last: int, points: NDArray[np.float64], along: NDArray[np.float64], x: float, y: float
) -> None:
    """Find the point of a sub-environment's path that is nearest to its wire, near the planner's position."""
    here = row.path_um
    k = segment_at(along, last, here, start)
    while k > 0 and along[k] > here - _SEARCH_UM:
        k -= 1
    nearest = math.inf
    while k <= last and along[k] < here + _SEARCH_UM:
        x0, y0 = points[k, 0], points[k, 1]
        dx, dy = points[k + 1, 0] - x0, points[k + 1, 1] - y0
        share = ((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy)
        share = 0.0 if share < 0.0 else (1.0 if share > 1.0 else share)
        ax, ay = x0 + share * dx - x, y0 + share * dy - y
        distance2 = ax * ax + ay * ay
        if distance2 < nearest:
            nearest = distance2
            row.reached_um = along[k] + share * (along[k + 1] - along[k])
        k += 1
    row.error_um = math.sqrt(nearest)


@exactly_compiled
def follow(
    indices: NDArray[np.int64], rows: NDArray[np.void], advance: int, path_um: int, done: int,
    planners: NDArray[np.void], points: NDArray[np.float64], along: NDArray[np.float64], lengths: NDArray[np.int64],
    height_from: NDArray[np.float64], heights: NDArray[np.float64], corner_um: NDArray[np.float64],
    states: NDArray[np.void], windows: NDArray[np.void], nowhere: NDArray[np.int64],
) -> bool:
    """Update every sub-environment after a window: its planner, the position of its wire, and why it ended.

    Returns whether any leg or episode has ended, or a drift is due. ``cause`` is `DONE` at the end of a leg, never
    `OUT_OF_RANGE`. `nowhere` (0, 3) has no room for steps: those of the window were already made. `heights`
    begin at the path lengths `height_from`, corners are at `corner_um`. For `advance`, `path_um` and `done` see
    `kinds.Addresses`.
    """
    due = False
    for j in range(indices.shape[0]):
        i = indices[j]
        row, planner, state, window, path, on = rows[i], planners[i], states[i], windows[i], points[i], along[i]
        spent_ns, counts, exact, begin = window.duration_ns, window.counts, planner.kind == EXACT, planner.along
        was_um = 0.0 if exact else path_um_at(path_um, (planner, path, on))
        made = _run(advance, planner, path, on, lengths[i], state.time_ns - spent_ns, state.time_ns, row, nowhere)
        row.units_before = row.units
        row.path_um = path_um_at(path_um, (planner, path, on))
        row.travel_um = (planner.along - begin) / FINE_PER_UM if exact else row.path_um - was_um
        pulses = counts[0] + counts[1] + counts[2] + counts[3]
        x, y = state.commanded_um[0], state.commanded_um[1]
        _look(
            row, planner.move, planner.last_move, path, on,
            state.axis_um[0] + window.deflection_um[0] / pulses, state.axis_um[1] + window.deflection_um[1] / pulses,
        )
        row.near = 0
        for k in range(corner_um.shape[1]):
            if abs(corner_um[i, k] - row.reached_um) <= row.near_um:
                row.near = 1
        ahead_um = row.reached_um - row.cut_um
        if row.settling_ns > 0 and ahead_um > 0.0:
            row.cut_um, ahead_um = row.reached_um, 0.0
        progress_um = (counts[1] + counts[2]) / pulses * ahead_um if ahead_um > 0.0 else 0.0
        # height of the workpiece at the wire
        k, here = 0, row.before_um + row.cut_um
        while k + 1 < height_from.shape[1] and height_from[i, k + 1] <= here:
            k += 1
        row.progress_um = progress_um
        row.cut_um += progress_um
        row.elapsed_ns += spent_ns
        row.area_mm2 = 0.0 if row.elapsed_ns <= row.scrap_ns else progress_um * 1e-3 * heights[i, k]
        row.step_ns += spent_ns
        row.settling_ns = row.settling_ns - spent_ns if row.settling_ns > spent_ns else 0
        row.broke = window.broken != 0
        row.shorted_s = row.shorted_s + spent_ns * 1e-9 if counts[3] >= SHORTED_SHARE * pulses else 0.0
        limit_um, slack_um = row.table_um, row.step_um
        switch = switches_open(x, limit_um, slack_um) != 0 or switches_open(y, limit_um, slack_um) != 0
        shorted, at_end = row.shorted_s > SHORTED_S, done_at(done, (planner, path, on, lengths[i]))
        row.cause = stop_cause(window.broken != 0, switch or made == LIMIT, False, shorted, False, at_end)
        due = due or row.cause != RUNNING or row.elapsed_ns >= row.drifts_ns
    return due
