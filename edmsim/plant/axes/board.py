"""The boards of the drives: sampling instants, inputs, and the times at which outputs take effect."""

from edmsim.compiled import axis_rows
from edmsim.compiled.jit import compiled
from edmsim.compiled.memory_views import call_with_two
from edmsim.plant.axes.encoder import read_axis
from edmsim.plant.kernel.state import Axes

NEVER = 1 << 62  # a time (ns) later than all others
NOBODY = -1  # nothing is due
NOWHERE_UM = 1e9  # limit of valid positions: beyond it, or not finite, the axis has run away
_OUTPUT, _DUTY, _SAMPLE, _ALARM = (kind * axis_rows.N_AXES for kind in range(4))
"""What is due: one of these plus the number of the axis."""


@compiled
def first_due(axes: Axes, until_ns: int) -> tuple[int, int]:
    """Return what is due first before a time, and when: at equal times outputs first, then in order of the axes."""
    who, due_ns = NOBODY, until_ns
    for axis in range(axis_rows.N_AXES):
        drive = axes.drives[axis]
        if drive.sample == 0:
            continue
        if drive.output_ns < due_ns:
            who, due_ns = _OUTPUT + axis, drive.output_ns
        if drive.duty_ns < due_ns:
            who, due_ns = _DUTY + axis, drive.duty_ns
        if drive.due_ns < due_ns:
            who, due_ns = _SAMPLE + axis, drive.due_ns
        if drive.alarm_ns < due_ns:
            who, due_ns = _ALARM + axis, drive.alarm_ns
    return who, due_ns


@compiled
def fault_net_low(axes: Axes) -> bool:
    """Return whether a drive pulls the fault net low through its diode."""
    for axis in range(axis_rows.N_AXES):
        row = axes.rows[axis]
        if axes.drives[axis].sample != 0 and row.wiring & axis_rows.NET_OUT and row.pins & axis_rows.FAULT_OUT:
            return True
    return False


@compiled
def _is_shared(axes: Axes, axis: int) -> bool:
    """Return whether another drive is writing to the shared output."""
    for other in range(axis_rows.N_AXES):
        writes = axes.drives[other].sample != 0 and not axes.drives[other].lines & axis_rows.HOLDS_OUTPUT
        if other != axis and writes and axes.rows[other].shares == axes.rows[axis].shares:
            return True
    return False


@compiled
def _put_command(axes: Axes, axis: int) -> None:
    """Let a command take effect; a shared output moves all its axes."""
    group = axes.rows[axis].shares
    if group == 0:
        axes.rows[axis].duty = axes.drives[axis].command
    elif not axes.drives[axis].lines & axis_rows.HOLDS_OUTPUT:
        for other in range(axis_rows.N_AXES):
            if axes.rows[other].shares == group:
                axes.rows[other].duty = axes.drives[axis].command


@compiled
def _call(axes: Axes, axis: int, event: int, now_ns: int) -> bool:
    """Call a drive's sample function; return whether its command is within -1..1."""
    drive, row = axes.drives[axis], axes.rows[axis]
    row.lines = row.hand_lines
    if row.wiring & axis_rows.NET_IN and fault_net_low(axes):
        row.lines |= axis_rows.FAULT_IN
    if row.shares != 0 and _is_shared(axes, axis):
        row.lines |= axis_rows.SHARED_IN
    read_axis(axes, axis, now_ns)
    drive.now_ns, drive.event = now_ns, event
    size_of_drive, size_of_row = axes.drives.itemsize, axes.rows.itemsize
    call_with_two(
        drive.sample, axes.drives.ctypes.data + axis * size_of_drive, axes.rows.ctypes.data + axis * size_of_row
    )
    drive.output_ns = now_ns + drive.delay_ns
    return bool(abs(drive.command) <= 1.0)


@compiled
def _take_sample(axes: Axes, axis: int) -> bool:
    """Take a drive's sample; return False like `serve`."""
    drive, row = axes.drives[axis], axes.rows[axis]
    now_ns, fine, ready_ns = drive.due_ns, True, drive.due_ns
    if row.in_reset == 0 and now_ns >= drive.stalled_until_ns:
        fine = _call(axes, axis, axis_rows.SAMPLE, now_ns)
        drive.alarm_ns = now_ns + drive.watchdog_ns if drive.watchdog_ns > 0 else NEVER
        ready_ns = now_ns + drive.busy_ns
    drive.index += 1
    drive.due_ns = drive.epoch_ns + drive.index * drive.num // drive.den
    if drive.due_ns < ready_ns:
        drive.epoch_ns, drive.index = ready_ns, 0
        drive.due_ns = ready_ns
    if drive.due_ns <= now_ns:
        drive.due_ns, fine = NEVER, False
    return fine


@compiled
def serve(axes: Axes, who: int, now_ns: int) -> bool:
    """Do what `first_due` found.

    Returns False if a drive's command is not within -1..1, or its next sample is not later.
    """
    axis = who % axis_rows.N_AXES
    drive, row = axes.drives[axis], axes.rows[axis]
    if who >= _ALARM:
        drive.alarm_ns = NEVER
        return row.in_reset != 0 or _call(axes, axis, axis_rows.WATCHDOG, now_ns)
    if who >= _SAMPLE:
        return _take_sample(axes, axis)
    if who >= _DUTY:
        drive.duty_ns = NEVER
        _put_command(axes, axis)
        return True
    drive.output_ns = NEVER
    row.pins = drive.lines if row.apart == 0 else drive.lines | axis_rows.FREEWHEEL
    if drive.pwm_ns > 0:
        drive.duty_ns = -(-now_ns // drive.pwm_ns) * drive.pwm_ns
    else:
        _put_command(axes, axis)
    return True


@compiled
def shut_off(axes: Axes, axis: int, now_ns: int) -> None:
    """Shut off a drive whose command or period is invalid."""
    hold_in_reset(axes, axis)
    axes.drives[axis].command = axes.rows[axis].duty = 0.0
    axes.rows[axis].trip |= axis_rows.NO_COMMAND
    axes.rows[axis].trip_ns = now_ns


@compiled
def tripped(axes: Axes) -> int:
    """Return the axes that the machine must stop, as bits."""
    found = 0
    for axis in range(axis_rows.N_AXES):
        if axes.drives[axis].sample != 0 and axes.rows[axis].trip != 0:
            found |= 1 << axis
    return found


@compiled
def watch(axes: Axes, now_ns: int) -> None:
    """Check which axes are too far from the planner's position, or have a position that is not finite."""
    for axis in range(axis_rows.N_AXES):
        row = axes.rows[axis]
        if axes.drives[axis].sample == 0:
            continue
        place, most = row.place_um, row.stray_um
        if abs(place) < NOWHERE_UM and place - row.most_um <= most and row.least_um - place <= most:
            row.trip &= ~axis_rows.FOLLOWING_ERROR
        elif row.trip & axis_rows.FOLLOWING_ERROR == 0:
            row.trip |= axis_rows.FOLLOWING_ERROR
            row.trip_ns = now_ns


@compiled
def hold_in_reset(axes: Axes, axis: int) -> None:
    """Reset a drive: its pins float, and the board pulls the bridge's enable low."""
    axes.rows[axis].in_reset = 1
    axes.rows[axis].pins = axis_rows.FREEWHEEL
    axes.drives[axis].output_ns = axes.drives[axis].duty_ns = NEVER
