"""A plant's drives: their records in the memory of the pulse loop, their part of snapshots, stops, and faults."""

import copy
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled import axis_rows
from edmsim.compiled.random import key_of
from edmsim.errors import InputError, one_of
from edmsim.plant.axes.advance import apply_geometric_errors, indicate, take_line
from edmsim.plant.axes.board import NEVER, NOWHERE_UM, hold_in_reset
from edmsim.plant.axes.encoder import LONG_AGO_NS, draw_pause, mark_below, watch_cam
from edmsim.plant.axes.feed_drive import check_motor, longest_step_ns
from edmsim.plant.axes.geometric_errors import no_errors, taken_up
from edmsim.plant.axes.steps import MOVE, rapid_constants, run_moves, straight_moves, time_left_s
from edmsim.plant.kernel.state import ArraySizes, Axes, allocate

AXIS_NAMES = ("x", "y", "u", "v")
"""The machine's axes: x and y of the lower guide, u and v of the upper guide relative to it."""

_ROWS = "edmsim.compiled.axis_rows"
_TIMERS = "output_ns", "duty_ns", "alarm_ns"
_LOOK_NS = 10_000_000  # interval of checks whether a rapid is over (ours)


class AxisDrive(Protocol):
    """Interface of a drive for the plant (see `edmsim.controllers.axis.drive.Drive`)."""

    name: str
    record: NDArray[np.void]
    motor: NDArray[np.void] | None

    @property
    def sample(self) -> axis_rows.SampleFunction | None:
        """The compiled sample; None for a stepper."""


class Drives:
    """The drives of one plant by axis. They are copied, so several plants can use one; other axes have a stepper.

    `errors` are those of screws and ways of x and y; `screws` are constants of axes whose screw and table belong
    to the machine and not to the drive. The machine stops an axis that is `stray_um` from its setpoint.
    """

    def __init__(
        self, drives: Mapping[str, AxisDrive], travel_um: float, sizes: ArraySizes,
        screws: Mapping[int, Mapping[str, float]] | None = None, errors: NDArray[np.void] | None = None,
        stray_um: float = np.inf,
    ) -> None:
        for name in drives:
            if name not in AXIS_NAMES:
                raise InputError(f"there is no axis {name!r} to drive; there are: {one_of(name, AXIS_NAMES)}")
        self.options = dict(drives)
        self.by_axis: dict[str, AxisDrive] = {name: copy.deepcopy(drive) for name, drive in drives.items()}
        made = allocate(Axes, sizes, loops=0, errs=0)
        made.geometric_errors[:] = no_errors() if errors is None else errors
        self._looped: list[int] = []
        for k, name in enumerate(AXIS_NAMES):
            drive = self.by_axis.get(name)
            if drive is None:
                continue
            if not hasattr(drive, "record"):
                raise InputError(f"the drive of {name} is {drive!r}: give one of edmsim.controllers.axis.make")
            if not axis_rows.is_row(drive.record, axis_rows.DRIVE):
                raise InputError(f"the record of the {name} drive is not one row of {_ROWS}.DRIVE")
            made.drives[k] = drive.record[0]
            drive.record = made.drives[k : k + 1]
            if drive.sample is None or drive.motor is None:
                continue
            if not axis_rows.is_row(drive.motor, axis_rows.MOTOR):
                raise InputError(f"the motor of the {name} drive is not one row of {_ROWS}.MOTOR")
            if not hasattr(drive.sample, "address"):
                raise InputError(f"the sample of the {name} drive lacks the decorator {_ROWS}.sample")
            _check_period(name, drive.record)
            motor = made.motors[k : k + 1]
            motor[:] = drive.motor
            for constant, value in (screws or {}).get(k, {}).items():
                motor[constant] = value
            check_motor(motor)
            made.step_ns[k] = longest_step_ns(motor)
            self._looped.append(k)
        self._initial, self._initial_rows = made.drives.copy(), _initial_rows(travel_um, stray_um)
        for name in _TIMERS:
            self._initial[name] = NEVER
        self._stray_um = stray_um
        errs = made.geometric_errors.tobytes() != no_errors().tobytes()
        self.axes = made._replace(loops=len(self._looped), errs=int(errs))

    def reset(self, state: NDArray[np.void], seed: int) -> None:
        """Switch the drives on at time 0, with the axes at rest at the positions in a record of `STATE`."""
        self.switch_on(state["axis_um"][0], seed)
        self._apply_errors(state)

    def switch_on(self, axis_um: NDArray[np.float64], seed: int) -> None:
        """Switch the drives on at time 0, with the axes at rest; the seed is that of the encoders' noise."""
        rows, drives = self.axes.rows, self.axes.drives
        rows[:], drives[:] = self._initial_rows, self._initial
        for name in ("place_um", "zero_um", "least_um", "most_um", "rotor_um"):
            rows[name] = axis_um
        rows["link_V"] = self.axes.motors["supply_V"]
        self._connect()
        for k in self._looped:
            drives["index"][k] = 1
            drives["due_ns"][k] = int(drives["num"][k]) // int(drives["den"][k])
            rows["noise_key"][k] = key_of(-1 - axis_rows.N_AXES * int(seed) - k)  # unlike those of plants
            if self.axes.motors["spike_rate_Hz"][k] > 0:
                rows["spike_ns"][k] = draw_pause(rows[k], self.axes.motors[k])
        self._find_marks()

    def carry(
        self, state: NDArray[np.void], position_um: Sequence[float], duration_ns: int, step_um: float,
        rapid_um_s: float,
    ) -> tuple[int, float]:
        """Move the first axes to a position without the wire, within `duration_ns`; the others stay."""
        # Servo drives receive whole steps, all at once if they make their own ramps; stepper axes are moved at once.
        # Returns the duration (ns), and the time (s) after which axes would be within a step of their position: 0 if
        # they are, or were stopped.
        moved_um = np.zeros(axis_rows.N_AXES)
        moved_um[: len(position_um)] = position_um - state["commanded_um"][0, : len(position_um)]
        counts = [round(float(um) / step_um) if self.has_loop(k) else 0 for k, um in enumerate(moved_um)]
        for k in self._looped:
            moved_um[k] = counts[k] * step_um
        if self.axes.errs:
            indicate(state)
            play_um = 0.5 * self.axes.geometric_errors["backlash_um"]
            state["slack_um"] = np.clip(state["slack_um"] + moved_um[:2], -play_um, play_um)
        state["commanded_um"] += moved_um
        for axis in range(axis_rows.N_AXES):
            if not self.has_loop(axis):
                slack_um = state["slack_um"][0, axis] if axis < 2 else 0.0
                state["axis_um"][0, axis] = state["commanded_um"][0, axis] - slack_um
        late_s = 0.0
        if self._looped:
            duration_ns, late_s = self._travel(state, counts, duration_ns, step_um, rapid_um_s)
        self._apply_errors(state)
        return duration_ns, late_s

    def _travel(
        self, state: NDArray[np.void], counts: list[int], duration_ns: int, step_um: float, rapid_um_s: float
    ) -> tuple[int, float]:
        """Move the servo axes by a number of steps; return the same as `carry`."""
        # in a rapid an axis may be anywhere between its old and new position
        rows, start_ns, to_um = self.axes.rows, int(state["time_ns"][0]), state["commanded_um"][0]
        at_once = [getattr(self.by_axis.get(name), "makes_ramps", False) for name in AXIS_NAMES]
        moves = straight_moves(counts, start_ns, rapid_um_s / step_um, at_once)
        rows["least_um"], rows["most_um"] = np.minimum(rows["least_um"], to_um), np.maximum(rows["most_um"], to_um)
        until_ns, late_s = start_ns + duration_ns, 0.0
        check_ns, before_um = until_ns, np.inf * np.ones(axis_rows.N_AXES)
        while run_moves(self.axes, moves, until_ns) and not self.faults():
            away_um = self.away_um(state)
            if np.all(away_um <= step_um):
                break
            if until_ns >= check_ns:
                late_s = time_left_s(before_um, away_um, rapid_constants()["settled_s"], step_um)
                if late_s > rapid_constants()["longest_s"]:
                    break
                check_ns, before_um, late_s = until_ns + round(rapid_constants()["settled_s"] * 1e9), away_um, 0.0
            until_ns += _LOOK_NS
        rows["least_um"] = rows["most_um"] = to_um
        self._publish_places(state)
        return until_ns - start_ns, late_s

    def away_um(self, state: NDArray[np.void]) -> NDArray[np.float64]:
        """Return the distance of every axis from its setpoint; 0 under a stepper, which is not monitored."""
        away_um = np.zeros(axis_rows.N_AXES)
        away_um[self._looped] = np.abs(self.axes.rows["place_um"] - state["commanded_um"][0])[self._looped]
        return away_um

    def is_moving_fast(self, step_um: float) -> bool:
        """Return whether a servo axis moves too fast to be settling."""
        speeds_um_s = self.axes.rows["speed_um_s"][self._looped]
        return bool(np.any(np.abs(speeds_um_s) * rapid_constants()["step_s"] > step_um))

    def _publish_places(self, state: NDArray[np.void]) -> None:
        """Set the servo axes to the positions of their tables, unless these are out of range."""
        places_um = self.axes.rows["place_um"]
        there = [k for k in self._looped if abs(places_um[k]) < NOWHERE_UM]
        state["axis_um"][0, there] = places_um[there]

    def follow(self, state: NDArray[np.void], events: NDArray[np.int64], until_ns: int, step_um: float) -> None:
        """Process events without the wire, each at its time, and advance the axes to a time."""
        if self.axes.errs:
            indicate(state)
        for time_ns, channel, value in events.tolist():
            self._run_to(time_ns)
            if channel >= axis_rows.N_AXES:
                take_line(self.axes, channel, value)
                continue
            state["commanded_um"][0, channel] += value * step_um
            if self.has_loop(channel):
                self.axes.drives["setpoint"][channel] += value
                self.axes.rows["least_um"][channel] += value * step_um
                self.axes.rows["most_um"][channel] += value * step_um
            else:
                state["axis_um"][0, channel] += self._after_backlash(state, channel, value * step_um)
        self._run_to(until_ns)
        self._publish_places(state)
        self._apply_errors(state)

    def _after_backlash(self, state: NDArray[np.void], axis: int, travel_um: float) -> float:
        """Return the travel of a stepper's axis at a step, after the backlash of its nut."""
        if not self.axes.errs or axis >= 2:
            return travel_um
        slack_um = float(state["slack_um"][0, axis])
        now_um = taken_up(slack_um, travel_um, float(self.axes.geometric_errors["backlash_um"][axis]))
        state["slack_um"][0, axis] = now_um
        return travel_um - (now_um - slack_um)

    def _run_to(self, time_ns: int) -> None:
        """Run the servo drives without steps up to a time, or until an axis must be stopped."""
        if self._looped:
            run_moves(self.axes, np.zeros(0, MOVE), time_ns)

    def _apply_errors(self, state: NDArray[np.void]) -> None:
        if self.axes.errs:
            apply_geometric_errors(state, self.axes)

    def has_loop(self, axis: int) -> bool:
        """Return whether an axis, by its number, has a servo drive."""
        return axis in self._looped

    def faults(self) -> int:
        """Return the axes that must stop, bit k for axis k: its drive reports a fault, or the machine stops it."""
        lines, trips = self.axes.drives["lines"].tolist(), self.axes.rows["trip"].tolist()
        return sum(1 << k for k in range(axis_rows.N_AXES) if lines[k] & axis_rows.FAULT or trips[k])

    @property
    def reach_um(self) -> float:
        """Greatest distance of the wire from its setpoint at either guide."""
        return 2.0 * self._stray_um if self._looped else 0.0

    def step_um(self, axis: int) -> float:
        """Return the travel per step edge that a servo drive commands, by its screw and encoder."""
        motor, name = self.axes.motors[axis], AXIS_NAMES[axis]
        counts = getattr(self.by_axis[name], "counts_per_step", None)
        if counts is None:
            own = self.by_axis[name].name
            raise InputError(f"the drive of {name} ({own}) lacks counts_per_step, the encoder counts of a step edge")
        return float(counts * motor["um_per_rad"] / motor["counts_per_rad"])

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the state without addresses; `restore` continues bit for bit."""
        drives = self.axes.drives.copy()
        drives["sample"] = 0
        return {"drives": drives, "axes": self.axes.rows.copy()}

    def check(self, state: Mapping[str, NDArray[Any]], now_ns: int) -> None:
        """Refuse a snapshot with clocks by which samples would never come, or never end."""
        for k in self._looped:
            name, drive = AXIS_NAMES[k], state["drives"][k : k + 1]
            _check_period(name, drive)
            num, den = int(drive["num"][0]), int(drive["den"][0])
            due_ns = int(drive["epoch_ns"][0]) + int(drive["index"][0]) * num // den
            if due_ns != drive["due_ns"][0] or due_ns < now_ns - num // den:
                raise InputError(f"the {name} drive's next sample is due at {drive['due_ns'][0]} ns, which cannot be")

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Load a `snapshot` of drives of the same kinds."""
        self.axes.rows[:] = state["axes"]
        self.axes.drives[:] = state["drives"]
        self._connect()

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Finish a copy: let each drive's record be a view of the copied axes."""
        vars(self).update(state)
        for k, name in enumerate(AXIS_NAMES):
            drive = self.by_axis.get(name)
            if drive is not None:
                drive.record = self.axes.drives[k : k + 1]
        self._connect()

    def _find_marks(self) -> None:
        """Initialise index marks and home cams at the axes' positions."""
        for k in self._looped:
            row, motor = self.axes.rows[k], self.axes.motors[k]
            row["mark"] = mark_below(row, motor)
            watch_cam(row, motor, 0.0)
            row["cam_ns"] = LONG_AGO_NS

    def _connect(self) -> None:
        """Set the addresses of the sample functions, which differ between processes."""
        self.axes.drives["sample"] = 0
        for k in self._looped:
            sample = self.by_axis[AXIS_NAMES[k]].sample
            assert sample is not None
            self.axes.drives["sample"][k] = sample.address


def _initial_rows(travel_um: float, stray_um: float) -> NDArray[np.void]:
    """Return the records of axes at switch-on, without their positions."""
    rows = np.zeros(axis_rows.N_AXES, axis_rows.AXIS)
    rows["spike_ns"], rows["stray_um"] = np.inf, stray_um
    rows["low_um"], rows["high_um"] = (0.0, 0.0, -np.inf, -np.inf), (travel_um, travel_um, np.inf, np.inf)
    rows["pins"], rows["wiring"] = axis_rows.FREEWHEEL, axis_rows.NET_IN | axis_rows.NET_OUT
    return rows


def _check_period(name: str, record: NDArray[np.void]) -> None:
    num, den = int(record["num"][0]), int(record["den"][0])
    if den < 1 or num < 1000 * den:
        raise InputError(f"the {name} drive's period is {num}/{den} ns; it must be 1 us or more")


# The reasons why axes stopped, as text: from the drives, and from table and wire.

def reason(drives: Drives) -> str:
    """Return why axes have stopped, in order of time: what stopped each, and its effect on the others."""
    rows, lines = drives.axes.rows, drives.axes.drives["lines"]
    stopped = [k for k, name in enumerate(AXIS_NAMES) if name in drives.by_axis and drives.faults() >> k & 1]
    fault = axis_rows.FAULT
    by_line = [k for k in stopped if lines[k] & fault and not _own_words(drives, k) and _line_low(drives, k)]
    stopped.sort(key=lambda k: (k in by_line, int(rows["trip_ns"][k])))
    return "; ".join(_of_axis(drives, k) for k in stopped)


def _of_axis(drives: Drives, k: int) -> str:
    row, name = drives.axes.rows[k], AXIS_NAMES[k]
    why = _own_words(drives, k)
    off_um = float(max(row["place_um"] - row["most_um"], row["least_um"] - row["place_um"], 0.0))
    if row["trip"] & axis_rows.NO_COMMAND:
        drive = drives.axes.drives[k]
        what = "commanded what is not a share of its supply"
        if drive["due_ns"] == NEVER:
            what = f"set its period to {drive['num']}/{drive['den']} ns"
        text = f"the drive of {name} is out of service: it {what}"
    elif drives.axes.drives["lines"][k] & axis_rows.FAULT and not why and (pulled_by := _line_low(drives, k)):
        return f"the drive of {name} was stopped by its fault line, pulled low {pulled_by}"
    elif drives.axes.drives["lines"][k] & axis_rows.FAULT:
        text = f"the drive of {name} has shut off its motor, {off_um:.1f} um from its path{': ' + why if why else ''}"
    else:
        why = why or ("its drive is held in reset" if row["in_reset"] else "")
        text = (
            f"{name} is {off_um:.1f} um from its path, more than the {row['stray_um']:g} um of the wire's radius"
            f"{': ' + why if why else ''}"
        )
    return text + _of_supply(drives, k)


def _own_words(drives: Drives, k: int) -> str:
    explain = getattr(drives.by_axis[AXIS_NAMES[k]], "why_stopped", None)
    return str(explain()) if explain is not None else ""


def _line_low(drives: Drives, k: int) -> str:
    """Return what pulls the fault line of an axis low; empty if nothing does."""
    rows, lines = drives.axes.rows, drives.axes.drives["lines"]
    others = [
        name for j, name in enumerate(AXIS_NAMES)
        if j != k and drives.has_loop(j) and rows["wiring"][j] & axis_rows.NET_OUT and lines[j] & axis_rows.FAULT_OUT
    ]
    if others and rows["wiring"][k] & axis_rows.NET_IN:
        return f"by {' and '.join(others)}"
    return "from outside" if rows["hand_lines"][k] & axis_rows.FAULT_IN else ""


def _of_supply(drives: Drives, k: int) -> str:
    """Return the fault of the supply of an axis' motor; empty without a fault."""
    name = AXIS_NAMES[k]
    row, motor, own = drives.axes.rows[k], drives.axes.motors[k], drives.by_axis[name].motor
    assert own is not None
    if motor["supply_V"] < own["supply_V"][0]:
        return f"; its supply gives {motor['supply_V']:g} V in place of {own['supply_V'][0]:g} V"
    # a supply's voltage is lower than this only at its current limit
    if row["link_V"] < motor["supply_V"] - motor["supply_A"] * motor["supply_ohm"]:
        return f"; its supply is at its limit of {motor['supply_A']:g} A and gives {row['link_V']:.1f} V"
    return ""


def reason_of_delay(drives: Drives, away_um: NDArray[np.float64], near_um: float, late_s: float) -> str:
    """Return which axes (at least one) are not near their positions, and the time (s) that they would need."""
    far = [k for k, name in enumerate(AXIS_NAMES) if away_um[k] > near_um]
    texts = []
    for k in far:
        why = _own_words(drives, k)
        texts.append(f"{AXIS_NAMES[k]} is {away_um[k]:.1f} um from its place{f' ({why})' if why else ''}")
    rest = "not coming nearer" if math.isinf(late_s) else f"{late_s:.0f} s more until within {near_um:g} um"
    return f"{' and '.join(texts)}, {rest}" + "".join(_of_supply(drives, k) for k in far)


# Faults of a servo axis while the machine runs.

class AxisFault(NamedTuple):
    """A fault of an axis that begins at a time."""

    axis: str  # ``x`` or ``y``
    fault: str  # one of `FAULTS`
    at_s: float  # machine time at which it begins; 0 for the beginning of the cut


FAULTS = ("stuck", "swapped", "unplugged", "supply-off", "logic-off", "fault-line", "stalled")
"""The rotor is blocked; the encoder's phases are exchanged, so the feedback has the wrong sign; they are unplugged;
the motor has no supply, and the capacitor at its bridge is discharged; the drive's logic has no supply; its fault
input is pulled low; its processor hangs."""


def break_axis(axes: Axes, k: int, fault: str) -> None:
    """Apply one of `FAULTS` to an axis; repeating it has no effect."""
    row = axes.rows[k : k + 1]
    match fault:
        case "stuck":
            row["locked"] = 1
        case "swapped":
            row["swapped"] = 1
        case "unplugged":
            row["unplugged"] |= axis_rows.PHASE_A | axis_rows.PHASE_B
        case "supply-off":
            axes.motors["supply_V"][k] = row["link_V"] = 0.0
        case "logic-off":
            hold_in_reset(axes, k)
        case "fault-line":
            row["hand_lines"] |= axis_rows.FAULT_IN
        case "stalled":
            axes.drives["stalled_until_ns"][k] = NEVER


_FORM = "an axis' fault is AXIS:FAULT@SECONDS, x:stuck@2.5 say"


def parse_fault(text: str) -> AxisFault:
    """Parse a fault; raises `InputError` if it is invalid.

    >>> parse_fault("x:stuck@2.5")
    AxisFault(axis='x', fault='stuck', at_s=2.5)
    """
    where, _, at = text.partition("@")
    axis, _, fault = where.partition(":")
    if axis not in ("x", "y"):
        raise InputError(f"{text!r} names no axis x or y; {_FORM}")
    if fault not in FAULTS:
        raise InputError(f"{text!r} names no fault; choose one of {', '.join(FAULTS)}; {_FORM}")
    try:
        at_s = float(at)
    except ValueError:
        at_s = math.nan
    if not 0 <= at_s < math.inf:
        raise InputError(f"{text!r} has no time of 0 s or more behind @; {_FORM}")
    return AxisFault(axis, fault, at_s)
