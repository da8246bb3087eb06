"""Advance the axes over a span of time, with step edges, input lines and samples of drives in order of time.

Both integrators call `advance_axes` with the indicated positions of x and y: the modal one after every pulse for the
pulse's period, the full one before every time step of MuJoCo for that step. An axis under a stepper is at its
setpoint, and rings.
"""

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import N_AXES
from edmsim.compiled.jit import compiled, compiled_apart
from edmsim.plant.axes.board import NOBODY, NOWHERE_UM, first_due, serve, shut_off, tripped, watch
from edmsim.plant.axes.feed_drive import coast_all
from edmsim.plant.axes.geometric_errors import errors_um, taken_up
from edmsim.plant.kernel.state import TILED_UM, Arrays, Axes, Propagators, Timing
from edmsim.plant.mechanics.modal import step_table

LOST, TRIPPED = -1, -2
"""Results in place of the next event: the state is out of range or not finite; the machine stops an axis."""


@compiled
def _take_step(
    state: NDArray[np.void], a: Arrays, axes: Axes, p: Propagators, t: Timing, k_period: int, step_um: float,
    time_ns: int, axis: int, direction: int, until_ns: int, full: bool,
) -> None:
    """Make one step of a stepper: in MuJoCo its magnets pull the rotor; in the modal model the axis rings."""
    travel = direction * step_um
    state[0].commanded_um[axis] += travel
    if full or axis >= 2:
        state[0].axis_um[axis] += travel
        return
    if axes.errs != 0:
        slack = state[0].slack_um[axis]
        state[0].slack_um[axis] = taken_up(slack, travel, axes.geometric_errors[axis].backlash_um)
        travel -= state[0].slack_um[axis] - slack
        if travel == 0.0:
            return
    since = (until_ns - time_ns) * 1e-3 / t.grid_us
    step_table(state, a, p, axis, travel, max(min(int(since + 0.5), k_period), 0))


@compiled
def indicate(state: NDArray[np.void]) -> None:
    """Set x and y to their positions without the errors of screws and ways."""
    for axis in range(2):
        state[0].axis_um[axis] = state[0].indicated_um[axis]


@compiled
def apply_geometric_errors(state: NDArray[np.void], axes: Axes) -> None:
    """Set x and y to their positions with the errors of screws and ways."""
    places = state[0].axis_um
    x, y = errors_um(axes.geometric_errors, places[0], places[1], places[2])
    for axis in range(2):
        state[0].indicated_um[axis] = state[0].axis_um[axis]
    state[0].axis_um[0] -= x
    state[0].axis_um[1] -= y


@compiled
def take_line(axes: Axes, channel: int, level: int) -> None:
    """Set an input line of the drives."""
    bit = 1 << (channel - N_AXES)
    for axis in range(N_AXES):
        lines = axes.rows[axis].hand_lines
        axes.rows[axis].hand_lines = lines | bit if level != 0 else lines & ~bit


@compiled
def in_reach(state: NDArray[np.void], axes: Axes) -> bool:
    """Return whether the kerf field has tiles for the wire at both guides; False if its position is not finite."""
    fine = True
    for d in range(2):
        low = state[0].axis_um[d] + state[0].deflection_um[d]
        high = low + state[0].axis_um[2 + d]
        # a servo axis may be this far from its setpoint
        reach = 2.0 * TILED_UM + axes.rows[d].stray_um
        fine = fine and bool(abs(low - state[0].tiled_um[d]) < reach)
        fine = fine and bool(abs(high - state[0].tiled_um[2 + d]) < reach + axes.rows[2 + d].stray_um)
    return fine


@compiled
def _place_axes(state: NDArray[np.void], axes: Axes) -> None:
    """Set the servo axes to the positions of their tables, unless these are out of range."""
    for axis in range(N_AXES):
        if axes.drives[axis].sample != 0 and abs(axes.rows[axis].place_um) < NOWHERE_UM:
            state[0].axis_um[axis] = axes.rows[axis].place_um


@compiled_apart
def _run_drives(
    state: NDArray[np.void], a: Arrays, axes: Axes, p: Propagators, t: Timing, k_period: int, step_um: float,
    events: NDArray[np.int64], next_event: int, until_ns: int, full: bool,
) -> int:
    """Do `advance_axes` if there are servo drives: events and samples in order of time."""
    before = tripped(axes)
    while True:
        who, due_ns = first_due(axes, until_ns)
        event = next_event < events.shape[0] and events[next_event, 0] <= due_ns and events[next_event, 0] < until_ns
        if event:
            due_ns = events[next_event, 0]
        fine = coast_all(axes, 2 if full else 0, due_ns)
        _place_axes(state, axes)
        watch(axes, due_ns)
        if tripped(axes) & ~before:
            return TRIPPED
        if not (fine and in_reach(state, axes)):
            return LOST
        if event:
            channel, value = events[next_event, 1], events[next_event, 2]
            if channel >= N_AXES:
                take_line(axes, channel, value)
            elif axes.drives[channel].sample == 0:
                _take_step(state, a, axes, p, t, k_period, step_um, due_ns, channel, value, until_ns, full)
            else:
                axes.drives[channel].setpoint += value
                state[0].commanded_um[channel] += value * step_um
                axes.rows[channel].least_um += value * step_um
                axes.rows[channel].most_um += value * step_um
            next_event += 1
        elif who == NOBODY:
            return next_event
        elif not serve(axes, who, due_ns):
            shut_off(axes, who % N_AXES, due_ns)


@compiled
def advance_axes(
    state: NDArray[np.void], a: Arrays, axes: Axes, p: Propagators, t: Timing, k_period: int, step_um: float,
    events: NDArray[np.int64], next_event: int, until_ns: int, full: bool,
) -> int:
    """Process the events (time in ns, channel, value) and samples before a time; return the first event after it."""
    # Returns `LOST` if an axis left the tiles of the field, or `TRIPPED` if the machine must stop another axis; in
    # this case the axes are not advanced to the end of the span. `k_period` is the number of time-grid steps since
    # the last call, for the steppers of the modal model.
    if axes.loops == 0:
        while next_event < events.shape[0] and events[next_event, 0] < until_ns:
            time_ns, axis, direction = events[next_event, 0], events[next_event, 1], events[next_event, 2]
            _take_step(state, a, axes, p, t, k_period, step_um, time_ns, axis, direction, until_ns, full)
            next_event += 1
        return next_event
    return _run_drives(state, a, axes, p, t, k_period, step_um, events, next_event, until_ns, full)
