"""The bench: axes with drives, run in compiled code, with access to every wire and shaft."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np

from edmsim.axis_bench.motion import CHANGE_ROW, DONE, LOST, SAMPLE_ROW, Rows, run
from edmsim.axis_bench.serial_link import SerialLink
from edmsim.compiled import axis_rows
from edmsim.controllers.axis.drive import Drive, PowersUp, data_of
from edmsim.errors import EdmsimError, InputError, methods_refuse_wrong_types
from edmsim.machine.machine import Machine
from edmsim.numeric import finite, whole_from
from edmsim.plant.axes import board, encoder
from edmsim.plant.axes.drives import AXIS_NAMES, Drives
from edmsim.plant.axes.steps import DIR_OPEN, MOVE, STEP_OPEN, move
from edmsim.plant.constants import screws, table_mechanics
from edmsim.plant.kernel.state import STATE, sizes_of
from edmsim.plant.mechanics.full_model import TableMechanics

_TURN_NS = 10_000_000  # interval at which a drive's unsolicited bytes are read (ours)
_QUIET_NS, _LONGEST_TALK_NS = 20_000_000, 1_000_000_000
"""A talk ends after this time without a byte, or after this time in total (ours)."""
_CHANGES, _SAMPLES = 64, 4096  # greatest number of records of one compiled run (ours)
_LONGEST_US = 100.0
"""Time step of MuJoCo (ours): 0.2 rad of the oscillation of the DEM-15's carriages on their screws."""
_PHASES = {"A": axis_rows.PHASE_A, "B": axis_rows.PHASE_B, "AB": axis_rows.PHASE_A | axis_rows.PHASE_B}
_WIRES = {**_PHASES, "index": axis_rows.INDEX_WIRE}
_STEP_INPUTS = {"step": STEP_OPEN, "dir": DIR_OPEN}


class Pins(NamedTuple):
    """State of a drive's pins: levels, or whether a LED is lit; ``duty`` is 0 to 1, 0.5 for no voltage."""

    enabled: bool
    fault_out_low: bool
    led: bool
    error_led: bool
    duty: float
    fault_in_low: bool


def _switch(row: np.void, field: str, bits: int, on: bool) -> None:
    row[field] = row[field] | bits if on else row[field] & ~bits


@methods_refuse_wrong_types
class AxisBench:
    """Axes with drives on a bench. A method's optional axis is by default the first one.

    Parameters
    ----------
    drives : mapping of str to drive
        Drives by axis, of ``x y u v``; the bench copies them and switches them on at time 0. Motor, screw and table
        belong to each drive.
    mechanics : {"modal", "mujoco"}
        Model of rotors and tables: edmsim's integrator, or MuJoCo for x and y with a machine's MJCF.
    machine : Machine, optional
        Machine with the screws and table for the motors of x and y; the table starts in mid-travel, as in a plant.
        With MuJoCo it is by default the DEM-15, and only there the ends of travel stop the table.
    seed : int
        Seed of spikes on the encoders' wires, if a motor has some (`edmsim.compiled.axis_rows.MOTOR`).

    Raises
    ------
    InputError
        An axis or the mechanics is unknown, a drive's record, period or motor is invalid, or it has no loop.

    Attributes
    ----------
    trace : bool
        Whether `samples` are recorded.
    """

    def __init__(
        self, drives: Mapping[str, Drive], *, mechanics: str = "modal", machine: Machine | None = None, seed: int = 0
    ) -> None:
        if mechanics not in ("modal", "mujoco"):
            raise InputError(f"there are no mechanics {mechanics!r}; choose modal or mujoco")
        if mechanics == "mujoco":
            machine = machine or Machine.load()
        travel_um = machine.base.table.travel_mm.value * 1e3 if machine else np.inf
        self._drives = Drives(drives, travel_um, sizes_of(1, 8, 1), screws(machine) if machine else None)
        if not drives or self._drives.axes.loops != len(drives):
            raise InputError("a bench needs servo drives, with a motor and a sample function")
        place_um = np.zeros(axis_rows.N_AXES)
        if machine:
            place_um[:2] = machine.base.table.centre_um
        self._drives.switch_on(place_um, whole_from("seed", seed))
        self._state = np.zeros(1, STATE)
        self._state["commanded_um"] = self._state["axis_um"] = place_um
        self._table_of = machine if mechanics == "mujoco" else None
        self._table = self._make_table()
        self._now_ns = 0
        self.trace = False
        self._moves: Rows = np.zeros(0, MOVE)
        self._unplugged = np.zeros(axis_rows.N_AXES, np.int64)  # `STEP_OPEN` and `DIR_OPEN` by axis
        self._notes = np.zeros(_SAMPLES, SAMPLE_ROW), np.zeros(_CHANGES, CHANGE_ROW), np.zeros(2, np.int64)
        self._samples: list[Rows] = []
        self._changes: list[Rows] = []
        self.names = tuple(name for name in AXIS_NAMES if name in drives)
        self._lines = {name: SerialLink(self.drive(name)) for name in self.names}
        for name in self.names:
            self._power_up(name)

    def _make_table(self) -> TableMechanics | None:
        """Make MuJoCo's model, if any, with the motors; an axis without a motor is held by its stepper."""
        if self._table_of is None:
            return None
        table = table_mechanics(self._table_of, _LONGEST_US)
        for axis, place_um in enumerate(self._state["axis_um"][0, :2]):
            table.link.qpos[table.link.carriage[axis]] = place_um * 1e-6
            table.link.qpos[table.link.rotor[axis]] = place_um * table.link.rad_per_um[axis]
            if self._drives.has_loop(axis):
                table.set_motor(axis, self._drives.axes.motors[axis : axis + 1])
        return table

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for a pickle or copy, without MuJoCo's model, which contains addresses."""
        return {**vars(self), "_table": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the copied state."""
        vars(self).update(state)
        self._table = self._make_table()

    @property
    def time_s(self) -> float:
        """Simulated time in s."""
        return self._now_ns * 1e-9

    def run(self, seconds: float) -> None:
        """Run for a time.

        Raises
        ------
        EdmsimError
            A drive commands more than its supply, or an axis is out of range or not finite.
        """
        self.run_to(self._now_ns + _ns("seconds", seconds))

    def run_to(self, end_ns: int) -> None:
        """Run until a time; see `run`."""
        end_ns = round(finite("end_ns", end_ns))
        while self._now_ns < end_ns:
            coming = [ns for line in self._lines.values() if (ns := line.to_drive.next_ns) is not None]
            stop_ns = min(end_ns, (self._now_ns // _TURN_NS + 1) * _TURN_NS, *coming)
            self._advance(max(stop_ns, self._now_ns))
            for name in self.names:
                running = not self.axis(name)["in_reset"]
                self._lines[name].exchange(self._now_ns, running, self._now_ns % _TURN_NS == 0)

    def _advance(self, until_ns: int) -> None:
        """Run the axes to a time without their serial lines."""
        samples, changes, noted = self._notes
        traced = samples if self.trace else samples[:0]
        axes, link = self._drives.axes, self._table.link if self._table else None
        self._state["time_ns"] = self._now_ns
        end = None
        while end != DONE:
            end = run(self._state, axes, link, self._moves, self._unplugged, until_ns, traced, changes, noted)
            if self.trace:
                self._samples.append(samples[: noted[0]].copy())
            if noted[1]:
                self._changes.append(changes[: noted[1]].copy())
            if end == LOST:
                raise EdmsimError(
                    "a drive commands what is not a share of its supply, or set its period to 0, or its axis has run "
                    "away"
                )
        self._now_ns = until_ns
        if len(self._moves):
            self._moves = self._moves[self._moves["made"] < np.abs(self._moves["count"])]

    def send(self, data: bytes, axis: str = "") -> None:
        """Send bytes to a drive at the terminal's baud, after those still in transmission."""
        self._line(axis).to_drive.put(bytes(memoryview(data)), self._now_ns)  # raises for text, a number or a list

    def sending(self, axis: str = "") -> bool:
        """Return whether bytes to a drive are in transmission."""
        return self._line(axis).to_drive.next_ns is not None

    def received(self, axis: str = "") -> bytes:
        """Return a drive's bytes since the last call."""
        return bytes(value for value, _ in self.received_at(axis))

    def received_at(self, axis: str = "") -> list[tuple[int, float]]:
        """Return a drive's bytes since the last call, each with its time of arrival in s."""
        return self._line(axis).received_at()

    def talk(self, data: bytes, axis: str = "") -> bytes:
        """Send bytes and return the drive's answer, until it is quiet or 1 s is over."""
        line = self._line(axis)
        line.received_at()
        self.send(data, axis)
        quiet_ns, end_ns, heard = self._now_ns, self._now_ns + _LONGEST_TALK_NS, 0
        while self._now_ns < min(end_ns, quiet_ns + _QUIET_NS):
            self.run_to(self._now_ns + _TURN_NS // 2)
            if line.busy or len(line.heard) != heard:
                quiet_ns, heard = self._now_ns, len(line.heard)
        return self.received(axis)

    def host_baud(self, baud: float, axis: str = "") -> None:
        """Set the terminal's baud; by default it is the drive's."""
        self._line(axis).set_host_baud(finite("baud", baud, 1.0))

    def open_terminal(self, is_open: bool, axis: str = "") -> None:
        """Open or close the terminal; a closed one loses the drive's bytes."""
        self._line(axis).to_host.open = is_open

    def steps(self, axis: str, count: int, rate_Hz: float = 0.0, accel_Hz_s: float = 0.0) -> None:
        """Send step pulses after those still pending.

        Parameters
        ----------
        axis : str
        count : int
            Number of pulses; its sign is the direction.
        rate_Hz : float
            Rate; 0 sends all at once.
        accel_Hz_s : float
            Slope of the ramps at both ends; 0 for no ramps.
        """
        count, rate_Hz = whole_from("count", count), finite("rate_Hz", rate_Hz, 0.0)
        accel_Hz_s = finite("accel_Hz_s", accel_Hz_s, 0.0)
        k = self._number(axis)
        ends = self._moves["end_ns"][self._moves["axis"] == k]
        start_ns = max(self._now_ns, int(ends.max(initial=0)))
        self._moves = np.concatenate([self._moves, move(k, start_ns, count, rate_Hz, accel_Hz_s)])

    def step_times(self, axis: str, times_ns: Sequence[int], direction: int) -> None:
        """Send step pulses at listed times."""
        k = self._number(axis)
        if whole_from("direction", direction) not in (1, -1):
            raise InputError(f"direction is {direction!r}: give 1 or -1")
        rows = [move(k, round(finite("times_ns", at_ns)), direction, 0.0, 0.0) for at_ns in times_ns]
        self._moves = np.concatenate([self._moves, *rows])

    def unplug(self, axis: str, wire: str, plugged: bool = False) -> None:
        """Unplug a wire (or plug it in, if `plugged`): A, B, index, step, dir or fault (the input's net)."""
        row = self.axis(axis)
        if wire in _STEP_INPUTS:
            k, bit, open_ = self._number(axis), _STEP_INPUTS[wire], self._unplugged
            open_[k] = open_[k] & ~bit if plugged else open_[k] | bit
        elif wire == "fault":
            _switch(row, "wiring", axis_rows.NET_IN, plugged)
            if not plugged:
                _switch(row, "hand_lines", axis_rows.FAULT_IN, False)
        elif wire in _WIRES:
            _switch(row, "unplugged", _WIRES[wire], not plugged)
        else:
            raise InputError(f"there is no wire {wire!r} to unplug; there are: A, B, index, step, dir, fault")

    def swap_phases(self, axis: str) -> None:
        """Exchange the encoder's wires A and B."""
        self.axis(axis)["swapped"] ^= 1

    def pulse_encoder(self, axis: str, phases: str, width_s: float) -> None:
        """Disturb A, B or AB by a pulse; the drive's input misses it if it is too short for an edge."""
        if phases not in _PHASES:
            raise InputError(f"there are no phases {phases!r}; choose one of {', '.join(_PHASES)}")
        drive, motor = self.drive(axis).record[0], self.motor(axis)
        rate_Hz = min(rate for rate in (float(motor["edge_rate_Hz"]), float(drive["count_rate_Hz"])) if rate > 0)
        if finite("width_s", width_s, 0.0) * rate_Hz >= 1.0:
            row = self.axis(axis)
            for row["disturbed"] in (_PHASES[phases], 0):
                encoder.read_phases(row)

    def slip_encoder(self, axis: str, counts: int) -> None:
        """Slip the encoder's disc by counts at once; at 2 counts both phases change together."""
        row, motor, counts = self.axis(axis), self.motor(axis), whole_from("counts", counts)
        row["zero_um"] -= counts * motor["um_per_rad"] / motor["counts_per_rad"]
        row["true_count"] += counts
        row["state"] = row["true_count"] & 3 ^ (row["true_count"] & 3) >> 1
        encoder.read_phases(row)

    def wire(self, axis: str, *, fault_in: bool = True, fault_out: bool = True) -> None:
        """Set a drive's connections to the fault net: input, and output diode."""
        self.axis(axis)["wiring"] = (axis_rows.NET_IN if fault_in else 0) | (axis_rows.NET_OUT if fault_out else 0)

    def pull_fault_net(self, low: bool) -> None:
        """Pull the fault net low, or release it."""
        for name in self.names:
            row = self.axis(name)
            if row["wiring"] & axis_rows.NET_IN:
                _switch(row, "hand_lines", axis_rows.FAULT_IN, low)

    @property
    def fault_net_low(self) -> bool:
        """Whether the fault net is low."""
        by_hand = any(self.axis(name)["hand_lines"] & axis_rows.FAULT_IN for name in self.names)
        return bool(by_hand or board.fault_net_low(self._drives.axes))

    def supply(self, axis: str, volts: float) -> None:
        """Set the motor supply's voltage, 0 or more."""
        self.motor(axis)["supply_V"] = finite("volts", volts, 0.0)

    def rail(self, axis: str, volts: float) -> None:
        """Set the logic supply; below the reset controller's voltage the drive is in reset, above it restarts."""
        self.reset_pin(axis, finite("volts", volts, 0.0) < data_of("board")["logic"]["reset_V"])

    def reset_pin(self, axis: str, low: bool) -> None:
        """Pull a drive's reset pin low; on release the drive restarts."""
        held = bool(self.axis(axis)["in_reset"])
        if low and not held:
            k, before = self._number(axis), int(self.axis(axis)["pins"])
            board.hold_in_reset(self._drives.axes, k)
            pins = int(self.axis(axis)["pins"])
            if pins != before:
                self._changes.append(np.array([(k, self._now_ns, pins)], CHANGE_ROW))
        elif held and not low:
            self._power_up(axis)

    def power_cycle(self, axis: str, off_s: float = 0.1) -> None:
        """Switch the logic supply off for a time."""
        off_s = finite("off_s", off_s)
        self.rail(axis, 0.0)
        self.run(off_s)
        self.rail(axis, data_of("board")["logic"]["rail_V"])

    def _power_up(self, name: str) -> None:
        drive, row = self.drive(name), self.axis(name)
        record = drive.record
        record["now_ns"] = self._now_ns
        row["in_reset"] = 0
        text = drive.power_up() if isinstance(drive, PowersUp) else b""
        if record["watchdog_ns"][0] > 0:
            record["alarm_ns"] = self._now_ns + record["watchdog_ns"]
        self._lines[name].to_host.put(text, int(record["due_ns"][0]))

    def hold(self, axis: str, held: bool) -> None:
        """Lock or release the rotor."""
        self.axis(axis)["locked"] = held

    def torque(self, axis: str, torque_Nm: float) -> None:
        """Apply a torque to the shaft, until you set another."""
        self.axis(axis)["hand_Nm"] = finite("torque_Nm", torque_Nm)

    def force(self, axis: str, force_N: float) -> None:
        """Push the table with a force, until you set another."""
        self.axis(axis)["hand_N"] = finite("force_N", force_N)

    def home_cam(
        self, axis: str, low_um: float, high_um: float, *, hysteresis_um: float = 0.0, bounce_s: float = 0.0,
        filter_s: float = 0.0,
    ) -> None:
        """Put a home cam under the table between two positions; see `edmsim.compiled.axis_rows.MOTOR`."""
        motor, row = self.motor(axis), self.axis(axis)
        low_um = finite("low_um", low_um)
        high_um = finite("high_um", high_um, low_um)
        times_ns = finite("bounce_s", bounce_s, 0.0) * 1e9, finite("filter_s", filter_s, 0.0) * 1e9
        motor["cam_hysteresis_um"] = finite("hysteresis_um", hysteresis_um, 0.0)
        motor["cam_low_um"], motor["cam_high_um"] = low_um, high_um
        motor["cam_bounce_ns"], motor["cam_filter_ns"] = times_ns
        row["cam"], row["cam_ns"] = low_um <= row["place_um"] <= high_um, encoder.LONG_AGO_NS

    def press_home(self, axis: str, closed: bool) -> None:
        """Close or open the home input of an axis without a cam."""
        row = self.axis(axis)
        row["cam"], row["cam_ns"] = closed, self._now_ns

    def share_output(self, axes: str | Sequence[str], connected: str | None = None) -> None:
        """Let drives share an analogue output; a contactor connects it to the motor of one axis, or of none."""
        for name in axes:
            row = self.axis(name)
            row["shares"], row["apart"] = 1 + AXIS_NAMES.index(axes[0]), name != connected
            _switch(row, "pins", axis_rows.FREEWHEEL, name != connected)

    def stall(self, axis: str, seconds: float) -> None:
        """Stop a drive's computation for a time; its interrupts still count."""
        self.drive(axis).record["stalled_until_ns"] = self._now_ns + _ns("seconds", seconds)

    def flip_bits(self, axis: str, bits: Sequence[int]) -> None:
        """Flip bits of a drive's EEPROM: bit `b` of byte `k` is number ``8 k + b``."""
        eeprom = self.drive(axis).record["eeprom"][0]
        for bit in bits:
            if whole_from("bits", bit, 0) >= 8 * len(eeprom):
                raise InputError(f"bit {bit} is beyond the EEPROM, whose last one is {8 * len(eeprom) - 1}")
            eeprom[bit // 8] ^= 1 << bit % 8

    def drive(self, axis: str = "") -> Drive:
        """Return the bench's copy of a drive."""
        return cast(Drive, self._drives.by_axis[AXIS_NAMES[self._number(axis)]])

    def axis(self, axis: str = "") -> np.void:
        """Return an axis' row (`edmsim.compiled.axis_rows.AXIS`); you can write it."""
        row: np.void = self._drives.axes.rows[self._number(axis)]
        return row

    def motor(self, axis: str = "") -> np.void:
        """Return the row of an axis' motor (`edmsim.compiled.axis_rows.MOTOR`); you can write it."""
        row: np.void = self._drives.axes.motors[self._number(axis)]
        return row

    def _number(self, axis: str) -> int:
        name = axis or self.names[0]
        if name not in self.names:
            raise InputError(f"there is no axis {name!r} on this bench; there are: {', '.join(self.names)}")
        return AXIS_NAMES.index(name)

    def _line(self, axis: str) -> SerialLink:
        return self._lines[AXIS_NAMES[self._number(axis)]]

    def pins(self, axis: str = "") -> Pins:
        """Return the state of a drive's pins."""
        row = self.axis(axis)
        pins, net = int(row["pins"]), bool(row["wiring"] & axis_rows.NET_IN) and self.fault_net_low
        return Pins(
            not pins & axis_rows.FREEWHEEL, bool(pins & axis_rows.FAULT_OUT), bool(pins & axis_rows.LED),
            bool(pins & axis_rows.ERROR_LED), (1 + float(row["duty"])) / 2,
            bool(net or row["hand_lines"] & axis_rows.FAULT_IN),
        )

    def samples(self, axis: str = "") -> Rows:
        """Return an axis' samples since the last call (`edmsim.axis_bench.motion.SAMPLE_ROW`)."""
        return _taken(self._samples, SAMPLE_ROW, self._number(axis))

    def changes(self, axis: str = "") -> Rows:
        """Return the changes of an axis' pins since the last call (`edmsim.axis_bench.motion.CHANGE_ROW`)."""
        return _taken(self._changes, CHANGE_ROW, self._number(axis))

    def snapshot(self) -> dict[str, Any]:
        """Return the state: drives, axes, pending steps and time. The serial lines must be idle."""
        return {
            **self._drives.snapshot(), "motors": self._drives.axes.motors.copy(), "moves": self._moves.copy(),
            "unplugged": self._unplugged.copy(), "time_ns": self._now_ns, "drives_of": self._drive_names(),
        }

    def _drive_names(self) -> dict[str, str]:
        return {name: self.drive(name).name for name in self.names}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a `snapshot` of the same drives; it continues bit for bit. Others raise `InputError`."""
        own, theirs = self._drive_names(), state.get("drives_of")
        if theirs != own:
            raise InputError(f"this is not a snapshot of a bench with the drives {own}, but with {theirs}")
        self._drives.restore(state)
        self._drives.axes.motors[:] = state["motors"]
        self._moves, self._now_ns = state["moves"].copy(), state["time_ns"]
        self._unplugged[:] = state["unplugged"]
        for line in self._lines.values():
            line.forget()


def _ns(name: str, seconds: float) -> int:
    """Return a time in whole nanoseconds; raises `InputError` unless it is finite and 0 or more."""
    return round(finite(name, seconds, 0.0) * 1e9)


def _taken(parts: list[Rows], kind: np.dtype[np.void], axis: int) -> Rows:
    """Remove an axis' rows from the records and return them."""
    rows: Rows = np.concatenate([np.zeros(0, kind), *parts])
    own: np.typing.NDArray[np.bool_] = rows["axis"] == axis
    found: Rows = rows[own]
    parts[:] = [rows[~own]]
    return found
