"""The boards of open machines, Powercore V2 and V3 of Rack Robotics and PULSER of Spark, and the rig of a board."""

import math
import re
from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any, ClassVar, Protocol

import numpy as np

from edmsim.errors import InputError, methods_refuse_wrong_types, one_of
from edmsim.hil.gap import AXES, Frame, Gap, Output
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.numeric import finite
from edmsim.plant.kernel.state import OPEN, SHORT

Pins = dict[str, float]


class Board(Protocol):
    """Interface of a pulse generator's board to its host; by default without a serial line and pins."""

    name: ClassVar[str]
    generator: ClassVar[str]
    enabled: bool = True

    @property
    def listens(self) -> bool:
        """Whether it reads its serial port now."""
        return True

    @abstractmethod
    def output(self) -> Output:
        """Return the generator command for the next frame."""

    def see(self, frame: Frame) -> None:
        """Read the finished frame."""
        return

    def line(self, text: str) -> str:
        """Answer a line of its serial port."""
        return ""

    def unsolicited(self) -> str:
        """Return its unsolicited output."""
        return ""

    def pins(self) -> Pins:
        """Levels of its outputs: duty as a share, or volts."""
        return {}


class PlainGenerator(Board):
    """The machine's own generator at its own setting: no board, no line, no pins."""

    name: ClassVar[str] = "none"
    generator: ClassVar[str] = "iso-pulse"
    FRAME_US: ClassVar[float] = 10_000.0

    def __init__(self, machine: Machine) -> None:
        self._machine = machine

    def output(self) -> Output:
        """Return a command for about 10 ms of pulses."""
        own = self._machine
        pulses = min(max(int(self.FRAME_US / own.t_period_us), 1), WINDOW_PULSES)
        return Output(pulses, self.enabled, own.t_on_us, own.t_period_us)


# Power supplies of Rack Robotics: the pins of Powercore V2, the serial line and the pins of Powercore V3.
# Their answers and counts follow their manuals and firmware (Powercore-V2.0; V3, 1.0.0-beta).

ALERT_PULSES = 512  # pulses over which the duty of ALRT counts sparks (Powercore V2)
AMP_V_A = 0.012  # volts per ampere on AMP (Powercore V2)


class PowercoreV2(Board):
    """Powercore V2: no serial line; ALRT is the share of sparks among the last 512 pulses, AMP the current."""

    # a current trip marks an ignition, so a short counts as a spark: the current flows in both
    name: ClassVar[str] = "powercore-v2"
    generator: ClassVar[str] = "powercore-v2"

    def __init__(self) -> None:
        self._last: deque[bool] = deque([False] * ALERT_PULSES, ALERT_PULSES)
        self._amps = 0.0

    def output(self) -> Output:
        """Return a command for about 10 ms of pulses."""
        return Output(18, self.enabled, 32.0, 544.0)

    def see(self, frame: Frame) -> None:
        """Count sparks."""
        if frame.on:
            self._last.extend((frame.pulses["kind"] != OPEN).tolist())
        self._amps = frame.window.mean_current_A

    def pins(self) -> Pins:
        """Return duty of ALRT, 0 to 1, and volts of AMP, averaged over a frame."""
        return {"ALRT": sum(self._last) / ALERT_PULSES, "AMP": AMP_V_A * self._amps}


VERSION = "1.0.0-beta"
SUPPLY_V, POWER_LIMIT_W, TRIP_A, MOST_INPUT_A = 48.0, 75.0, 8.0, 7.3
"""Input voltage; power above which pulses are skipped; current of a discharge; input current of a fault."""
INTERVAL_PULSES, MOST_SUCCESS = 10, 0.8  # pulses of a success rate; the rate from which pulses are skipped
SHORTED_SKIP_S, POWER_SKIP_S, TELEMETRY_S, SAMPLE_S, BOOT_S, EDGE_S = 0.25, 0.01, 1.0, 0.01, 2.0, 1.0
_TICK_S = 1e-6  # times are sums of floats
INPUT_SAMPLES = 100  # samples in the average of the input current: 1 s
DUTY, FREQUENCY_HZ, VOLTAGE_V, ON_US, LEAST_OFF_US = (0.01, 0.12), (5e3, 1e4), (64.0, 100.0), (1.0, 25.0), 88.0
_HELP = (
    "ERROR: Unknown command",
    "Accepted commands:",
    "  SEND_TELEMETRY - Send current device status and parameters over serial",
    "  SET_ALL_PARAMETERS <discharges> <dutyCycle> <frequency> <initVoltage> - Set all isopulse parameters at once",
    "  EDGE_DETECTION_MODE - Enter edge detection mode",
    "  RESET_DEVICE - Reset the device",
    "  EDM_ISOFREQUENCY_MODE - Enter EDM Isofrequency Mode",
)
_NUMBER = re.compile(r"\s*([-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?)", re.ASCII)
_WHOLE = re.compile(r"\s*([-+]?\d+)", re.ASCII)  # as in C: only spaces and digits of ASCII


def _number(text: str) -> float:
    """Read the number at the beginning of a text as the board does: 0 if there is none."""
    found = _NUMBER.match(text)
    return float(found[1]) if found else 0.0


def _whole(text: str) -> int:
    """Read a whole number in the same way, clamped to 32 bits."""
    found = _WHOLE.match(text)
    return max(-(2**31), min(2**31 - 1, int(found[1]))) if found else 0


@methods_refuse_wrong_types
class PowercoreV3(Board):
    """Powercore V3: lines at 115,200 baud, FEEDBACK and enable."""

    name: ClassVar[str] = "powercore"
    generator: ClassVar[str] = "powercore-v3"

    def __init__(self) -> None:
        self._time_s = 0.0
        self._power_up()
        self._ready_s = 0.0  # the bench begins after the board's start
        self._send("Setup complete")

    def _power_up(self) -> None:
        self._target, self._duty, self._hertz, self._volts = 0, 0.1, 10_000.0, 80.0
        self._edge_mode = self._edge_detected = self._fault = self._done = False
        self._ready_s, self._ready_line = self._time_s + BOOT_S, "Setup complete"
        self._samples: deque[float] = deque(maxlen=INPUT_SAMPLES)
        self._sample_s = self._telemetry_s = self._time_s
        self._charge_A_s = 0.0
        self._feedback = 0.0
        self._amps = self._volts_burning = self._success = 0.0
        self._discharges = 0
        self._out: list[str] = []

    def _send(self, *lines: str) -> None:
        self._out += [line + "\r\n" for line in lines]

    @property
    def _input_A(self) -> float:
        """Average of the last second; 0 before the first second is over."""
        return sum(self._samples) / INPUT_SAMPLES if len(self._samples) == INPUT_SAMPLES else 0.0

    @property
    def listens(self) -> bool:
        """Whether it reads its serial port now; False while it starts, or waits with its output off."""
        return self._time_s >= self._ready_s

    def output(self) -> Output:
        """Return a command for the pulses of one success rate."""
        off = not self.listens or not self.enabled or self._fault or self._done or self._edge_detected
        if self._edge_mode:
            return Output(INTERVAL_PULSES, not off, 5.0, 100.0, SUPPLY_V)
        period_us = 1e6 / self._hertz
        return Output(INTERVAL_PULSES, not off, period_us * self._duty, period_us, self._volts)

    def see(self, frame: Frame) -> None:
        """Count discharges, take samples of the input current, skip pulses."""
        seconds = frame.window.duration_ns * 1e-9
        waited = not self.listens
        self._time_s += seconds
        self._charge_A_s += frame.window.mean_current_A * seconds
        if waited:
            if self.listens:
                self._end_wait()
            return
        self._do_housekeeping()
        if frame.on:
            self._count(frame)

    def _end_wait(self) -> None:
        if self._edge_detected and self._feedback == 1.0:
            self._feedback, self._ready_s = 0.0, self._time_s + EDGE_S
            return
        if self._ready_line:
            self._send(self._ready_line)
        self._edge_detected = False

    def _do_housekeeping(self) -> None:
        """Run the board's task of every 10 ms, and send telemetry every second."""
        if self._time_s - self._sample_s >= SAMPLE_S - _TICK_S:
            self._samples.append(self._charge_A_s / (self._time_s - self._sample_s))
            self._sample_s, self._charge_A_s = self._time_s, 0.0
            self._fault |= self._input_A > MOST_INPUT_A
            if not self._edge_mode:
                used = min(self._input_A * SUPPLY_V / POWER_LIMIT_W, 1.0)
                operates = self.enabled and not self._fault and not self._done
                self._feedback = 1.0 - used if operates else 0.0
        if not self.enabled:
            self._discharges, self._done = 0, False
        if self._time_s - self._telemetry_s >= TELEMETRY_S - _TICK_S:
            self._telemetry_s = self._time_s
            self._telemetry()

    def _count(self, frame: Frame) -> None:
        timing, kinds = frame.timing, frame.pulses["kind"]
        amps = np.where(kinds == SHORT, timing.short_A, timing.current_A)[kinds != OPEN]
        volts = np.where(kinds == SHORT, 0.0, timing.burning_V)[kinds != OPEN]
        tripped = amps > TRIP_A
        if self._edge_mode:
            if tripped.any():
                self._edge_detected, self._feedback, self._ready_line = True, 1.0, ""
                self._ready_s = self._time_s + EDGE_S
                self._send("EDGE DETECTED")
            return
        for current, voltage in zip(amps[tripped].tolist(), volts[tripped].tolist(), strict=True):
            self._amps = 0.9 * self._amps + 0.1 * current
            self._volts_burning = 0.9 * self._volts_burning + 0.1 * voltage
        count = int(tripped.sum())
        self._discharges += count
        if self._target and self._discharges >= self._target:
            self._done, self._feedback = True, 0.0
            self._send(f"Number of discharges requested reached: {self._discharges}")
            return
        rate = count / INTERVAL_PULSES
        self._success = 0.99 * self._success + 0.01 * rate
        if rate >= MOST_SUCCESS:
            self._skip("discharge success rate threshold exceeded", SHORTED_SKIP_S)
        elif self._input_A * SUPPLY_V > POWER_LIMIT_W:
            self._skip("power setpoint exceeded", POWER_SKIP_S)

    def _skip(self, why: str, seconds: float) -> None:
        self._send(f"Pulse skipping: {why}")
        self._feedback = 0.0
        self._ready_s, self._ready_line = self._time_s + seconds, "Pulse skipping complete"

    def line(self, text: str) -> str:
        """Answer a line at once; a session waits until the board listens."""
        words = text.strip()
        if words == "SEND_TELEMETRY":
            self._telemetry()
        elif words.startswith("SET_ALL_PARAMETERS"):
            self._set(words)
        elif words.startswith("EDGE_DETECTION_MODE"):
            self._edge_mode, self._edge_detected, self._feedback = True, False, 0.0
        elif words == "EDM_ISOFREQUENCY_MODE":
            self._edge_mode = False
            self._send("EDM_ISOFREQUENCY_MODE entered")
        elif words == "RESET_DEVICE":
            self._power_up()
            self._send("Rebooting device")
        else:
            self._send(*_HELP)
        return self.unsolicited()

    def unsolicited(self) -> str:
        """Return the board's output since the last call."""
        said, self._out = "".join(self._out), []
        return said

    def pins(self) -> Pins:
        """Return the duty of FEEDBACK, 0 to 1."""
        return {"FEEDBACK": self._feedback}

    def _set(self, words: str) -> None:
        tokens = words.split(" ", 4)
        if len(tokens) != 5:
            self._send(
                "ERROR: Invalid number of parameters",
                "Expected 4 parameters: <discharges> <dutyCycle> <frequency> <initVoltage>",
            )
            return
        target = _whole(tokens[1])
        duty, hertz, volts = (_number(token) for token in tokens[2:])
        if wrong := _wrong(target, duty, hertz, volts):
            self._send(f"ERROR: {wrong}")
            return
        self._target, self._duty, self._hertz, self._volts = target, duty, float(int(hertz)), float(int(volts))
        self._done = False
        self._send("OK: Parameters set")

    def _telemetry(self) -> None:
        operating = self.enabled and not self._fault
        starts = not self.listens and self._ready_line == "Setup complete"
        state = "STARTUP" if starts else "FAULT" if self._fault else "IDLE"
        # the board sends no end of line after this state
        self._out.append(f"FIRMWARE_VERSION {VERSION}\r\nSTATE " + ("OPERATING: " if operating else f"{state}\r\n"))
        self._send(
            f"FAULT {'POWER_OUT_OF_RANGE_FAULT' if self._fault else 'NONE'}",
            f"INPUT_CURRENT {self._input_A:.2f} A",
            f"INPUT_POWER {int(self._input_A * SUPPLY_V)}W ",
        )
        if self._edge_mode:
            self._send("EDGE DETECTED" if self._edge_detected else "NO EDGE DETECTED YET")
            return
        power_W = int(self._volts_burning * self._amps * self._duty * self._success)
        target = f"Discharges Requested:{self._target}" if self._target else "Infinite Discharges Requested"
        self._send(
            f"AVG_DISCHARGE_CURRENT:{self._amps:.2f} A", f"AVG_DISCHARGE_VOLTAGE:{self._volts_burning:.2f} V",
            f"AVG_OUTPUT_POWER:{power_W} W", f"DISCHARGES_SINCE_OPERATION_STARTED:{self._discharges}",
            f"AVG_DISCHARGE_SUCCESS_RATE:{int(self._success * 100)}%",
            f"DISCHARGE_SUCCESS_RATE_THRESHOLD:{int(MOST_SUCCESS * 100)}%", "ISOPULSE PARAMETERS: ", target,
            f"Machining Duty Cycle:{self._duty:.3f}", f"Machining Frequency:{self._hertz:.0f} Hz",
            f"Initiation Voltage:{self._volts:.0f} V", "-" * 32,
        )  # fmt: skip


def _wrong(target: int, duty: float, hertz: float, volts: float) -> str:
    """Return the board's error for its parameters; empty if they are valid."""
    if target < 0:
        return "Invalid discharges value"
    bounds = (
        ("duty cycle", "", duty, DUTY), ("frequency", " Hz", hertz, FREQUENCY_HZ),
        ("initiation voltage", " V", volts, VOLTAGE_V),
    )  # fmt: skip
    for name, unit, value, (low, high) in bounds:
        if not low <= value <= high or not math.isfinite(value):
            return f"Invalid {name} (must be between {low:.2f} and {high:.2f}{unit})"
    on_us = 1e6 / hertz * duty
    if not ON_US[0] <= on_us <= ON_US[1]:
        return f"Calculated on-time ({on_us:.2f} us) is outside valid range"
    off_us = 1e6 / hertz - on_us
    return f"Calculated off-time ({off_us:.2f} us) is too short" if off_us < LEAST_OFF_US else ""


# PULSER, the discharge board of the Spark project, by its registers (manual of PULSER, its first boards).
# An I2C bus has no lines of text: here a read is ``r REGISTER [COUNT]`` and a write ``w REGISTER VALUE ...``, as for
# a USB bridge; `Pulser.read` and `Pulser.write` are the same without text.

POLARITY, PULSE_CURRENT, TEMPERATURE, PULSE_DUR, MAX_DUTY = range(1, 6)
CKP_N_PULSE, T_IGNITION, T_IGNITION_SD, R_PULSE, R_SHORT, R_OPEN = range(0x10, 0x16)
TEST = 0x80
_RANGES = {PULSE_CURRENT: (1, 80), PULSE_DUR: (5, 100), MAX_DUTY: (1, 95)}
_INVALID = 255
_CURRENT_CHANGE_S, _POLARITY_CHANGE_S = 0.001, 0.02  # time without pulses after a change while active
_IGNITION_UNIT_US, _MOST_IGNITION_US = 5.0, 1000.0
_LEAST_PAUSE_US = 5.0  # shortest pause (manual: "a few us")
_FRAME_US = 5000.0  # approximate length of a frame (ours: hosts poll at 10 Hz to 1 kHz)
_WATER_C = 25  # temperature of the heatsink that the register shows (ours: the board's cooling is not modelled)


@methods_refuse_wrong_types
class Pulser(Board):
    """The board's registers, each of a byte; `enabled` is the level of GATE, without which no current flows."""

    name: ClassVar[str] = "spark"
    generator: ClassVar[str] = "spark-pulser"

    def __init__(self) -> None:
        self._set = {POLARITY: 0, PULSE_CURRENT: 10, PULSE_DUR: 50, MAX_DUTY: 25, TEST: 0}
        self._shown = dict.fromkeys((CKP_N_PULSE, R_PULSE, R_SHORT, R_OPEN), 0)
        self._shown |= dict.fromkeys((T_IGNITION, T_IGNITION_SD), _INVALID)
        self._time_s = self._quiet_until_s = 0.0
        self._begin()

    def _begin(self) -> None:
        self._pulses = 0
        self._delays = np.zeros(2)  # sums over ignited pulses: of delays in us, and of their squares
        self._us = np.zeros(4)
        """Times in us: burning, short, open, and all operating time."""

    def output(self) -> Output:
        """Return a command for about 5 ms of pulses."""
        on_us = 10.0 * self._set[PULSE_DUR]
        pause_us = max(on_us * (100.0 / self._set[MAX_DUTY] - 1.0), _LEAST_PAUSE_US)
        on = self.enabled and self._set[POLARITY] != 0 and self._time_s >= self._quiet_until_s
        pulses = min(max(int(_FRAME_US / (on_us + pause_us)), 1), 50)
        return Output(pulses, on, on_us, on_us + pause_us, None, 0.1 * self._set[PULSE_CURRENT])

    def see(self, frame: Frame) -> None:
        """Add up the times of the frame's pulses."""
        self._time_s += frame.window.duration_ns * 1e-9
        if not frame.on:
            return
        pulses, kinds = frame.pulses, frame.pulses["kind"]
        shorted, ignited = kinds == SHORT, (kinds != OPEN) & (kinds != SHORT)
        delays, burns = pulses["delay_us"].astype(float), pulses["conducting_us"].astype(float)
        lengths = np.diff(pulses["start_us"].astype(float), append=frame.window.duration_ns * 1e-3)
        # the board's pause after a short counts as short
        self._us += burns[ignited].sum(), lengths[shorted].sum(), delays[~shorted].sum(), lengths.sum()
        self._pulses += int(ignited.sum())
        counted = np.minimum(delays[ignited], _MOST_IGNITION_US)
        self._delays += counted.sum(), (counted**2).sum()

    def read(self, register: int, count: int = 1) -> bytes:
        """Read registers one after the other; reading `CKP_N_PULSE` ends an interval and shows it."""
        found = []
        for at in range(register, register + count):
            if at == CKP_N_PULSE:
                self._flip()
            found.append(self._value(at & 0xFF))
        return bytes(found)

    def write(self, register: int, value: int) -> None:
        """Write a register: an invalid value becomes the nearest valid one, an invalid polarity OFF."""
        if register == POLARITY:
            value = value if value <= 4 else 0
        elif register in _RANGES:
            low, high = _RANGES[register]
            value = min(max(value, low), high)
        elif register != TEST:
            return
        changed, was_on = self._set[register] != value, self._set[POLARITY] != 0
        self._set[register] = value
        if changed and was_on and register in (POLARITY, PULSE_CURRENT):
            quiet_s = _POLARITY_CHANGE_S if register == POLARITY else _CURRENT_CHANGE_S
            self._quiet_until_s = max(self._quiet_until_s, self._time_s + quiet_s)

    def line(self, text: str) -> str:
        """Answer ``r REGISTER [COUNT]`` or ``w REGISTER VALUE ...``; numbers are decimal or as 0x10."""
        words = str.split(text)  # raises for bytes
        try:
            numbers = [int(word, 0) for word in words[1:]]
        except ValueError:
            numbers = []
        fine = bool(numbers) and all(0 <= number <= 0xFF for number in numbers)
        if fine and words[0] == "r" and len(numbers) <= 2 and (len(numbers) == 1 or numbers[1] > 0):
            read = self.read(numbers[0], numbers[1] if len(numbers) == 2 else 1)
            return f"0x{numbers[0]:02x}: {' '.join(map(str, read))}\r\n"
        if fine and words[0] == "w" and len(numbers) >= 2:
            for k, value in enumerate(numbers[1:]):
                self.write((numbers[0] + k) & 0xFF, value)
            return "ok\r\n"
        return "ERROR: give r REGISTER [COUNT] or w REGISTER VALUE ..., bytes as 18 or 0x12\r\n"

    def _value(self, register: int) -> int:
        if register == TEMPERATURE:
            return _WATER_C
        return self._set.get(register, self._shown.get(register, 0))

    def _flip(self) -> None:
        """Write the finished interval to the registers, and begin the next one."""
        pulse, short, open_, total = self._us.tolist()
        shares = (pulse / total, short / total, open_ / total) if total else (0.0, 0.0, 0.0)
        for register, share in zip((R_PULSE, R_SHORT, R_OPEN), shares, strict=True):
            self._shown[register] = min(int(255 * share + 0.5), 255)
        self._shown[CKP_N_PULSE] = min(self._pulses, 255)
        self._shown[T_IGNITION] = self._shown[T_IGNITION_SD] = _INVALID
        if self._pulses:
            mean, square = (self._delays / self._pulses).tolist()
            for register, value in ((T_IGNITION, mean), (T_IGNITION_SD, math.sqrt(max(square - mean**2, 0.0)))):
                self._shown[register] = min(math.floor(value / _IGNITION_UNIT_US + 0.5), _INVALID - 1)
        self._begin()


BOARDS: dict[str, Callable[[], Board]] = {board.name: board for board in (PowercoreV3, PowercoreV2, Pulser)}
"""Boards by name."""


def make_board(name: str) -> Board:
    """Return a newly started board; raises `InputError` for an unknown name."""
    if name not in BOARDS:
        raise InputError(f"there is no board '{name}'; choose one of {one_of(name, BOARDS)}")
    return BOARDS[name]()


# A board with its gap and the port of the axes, without a clock.

MOST_LINE = 127  # longest line in bytes (Powercore V3)
_MOST_STEPS = 100_000
_MOST_HZ = 1000.0
NO_TIME_S = 1e-9  # tolerance for sums of floats


@methods_refuse_wrong_types
class Rig:
    r"""A board, its gap, and the axes.

    Parameters
    ----------
    board : str or Board
        ``powercore`` (V3), ``powercore-v2`` or ``spark``.
    machine : Machine, optional
        Set-up with the board's generator; by default the usual one.
    seed : int
    gap_um, resolution : optional
        See `Gap`.

    Examples
    --------
    >>> rig = Rig("powercore", seed=1)
    >>> rig.board.unsolicited()
    'Setup complete\r\n'
    >>> rig.send("SET_ALL_PARAMETERS 0 0.05 5000 80")
    'OK: Parameters set\r\n'
    >>> rig.move("VEL 5 0")
    'ok\r\n'
    >>> rig.run(0.02)
    """

    def __init__(
        self, board: str | Board = "powercore", machine: Machine | None = None, *, seed: int = 0, **gap: Any
    ) -> None:
        self.board = make_board(board) if isinstance(board, str) else board
        if machine is None:
            machine = Machine.load(generator=self.board.generator)
        self.gap = Gap(machine, seed, **gap)
        self._stream_s, self._due_s = 0.0, 0.0  # interval of status lines, 0 for none; time of the next one
        self._watchers: list[Callable[[Frame], None]] = []

    @property
    def time_s(self) -> float:
        """Machine time."""
        return self.gap.time_s

    def watch(self, watcher: Callable[[Frame], None]) -> None:
        """Call an observer with every frame from now on."""
        self._watchers.append(watcher)

    def frame(self) -> Frame:
        """Run a frame, about 1 to 10 ms."""
        frame = self.gap.run(self.board.output())
        self.board.see(frame)
        for watcher in self._watchers:
            watcher(frame)
        return frame

    def run(self, seconds: float) -> None:
        """Run whole frames until this machine time has passed; see `time_s` for their length."""
        until_s = self.time_s + finite("seconds", seconds, 0.0)
        while self.time_s < until_s:
            self.frame()

    def send(self, text: str) -> str:
        """Send a line to the board's serial port and return the answer."""
        return self.board.line(text)

    def status(self) -> str:
        """Return the line of the motion port: machine time, places in um, enable input, wire, the board's pins."""
        x, y = self.gap.place_um
        pins = "".join(f" {name} {value:.4g}" for name, value in self.board.pins().items())
        wire = 0 if self.gap.lost else 1
        return f"T {self.time_s:.6f} X {x:.1f} Y {y:.1f} EN {int(self.board.enabled)} WIRE {wire}{pins}\r\n"

    def streamed(self) -> str:
        """Return a status line if one is due, at most one for each frame; see ``STREAM``."""
        if not self._stream_s or self.time_s < self._due_s - NO_TIME_S:
            return ""
        self._due_s = next_due_s(self._due_s, self._stream_s, self.time_s)
        return self.status()

    def move(self, text: str) -> str:
        """Answer a line of the motion port.

        ``STEP X 3``, ``POS x y`` in um from the start, ``VEL x y`` in um/s, ``STREAM hertz``, ``ENABLE 1``,
        ``THREAD``, and ``?`` for a status line.
        """
        words = str.split(text)  # raises for bytes
        name, numbers = (words[0].upper(), words[1:]) if words else ("", [])
        try:
            return self._motion(name, numbers)
        except (ValueError, InputError):
            return "ERROR: give STEP X|Y n, POS x y (um), VEL x y (um/s), STREAM hertz, ENABLE 0|1, THREAD or ?\r\n"

    def _motion(self, name: str, words: list[str]) -> str:
        axes, count = self.gap.setpoints, len(words)
        if name == "?" and not count:
            return self.status()
        if name == "STEP" and count == 2 and words[0].upper() in AXES:
            steps = int(words[1])
            if abs(steps) > _MOST_STEPS:
                return f"ERROR: at most {_MOST_STEPS} steps in a line\r\n"
            axes.step(AXES.index(words[0].upper()), steps)
        elif name == "POS" and count == 2:
            x0, y0 = self.gap.origin_um
            axes.go_to((x0 + finite("x", float(words[0])), y0 + finite("y", float(words[1]))))
        elif name == "VEL" and count == 2:
            x, y = (finite("a velocity", float(word)) for word in words)
            axes.move_at((x, y), self.gap.plant.time_ns)
        elif name == "STREAM" and count == 1:
            hertz = finite("hertz", float(words[0]))
            if not 0 <= hertz <= _MOST_HZ:
                return f"ERROR: STREAM takes 0 (off) to {_MOST_HZ:g} Hz\r\n"
            self._stream_s = 1.0 / hertz if hertz else 0.0
            self._due_s = self.time_s + self._stream_s
        elif name == "ENABLE" and words in (["0"], ["1"]):
            self.board.enabled = words == ["1"]
        elif name == "THREAD" and not count:
            if not self.gap.lost:
                return "ERROR: there is a wire\r\n"
            self.gap.thread()
        else:
            raise ValueError
        return "ok\r\n"


def next_due_s(due_s: float, every_s: float, now_s: float) -> float:
    """Return the first regular time after now; times within the finished frame are skipped."""
    while due_s < now_s + NO_TIME_S:
        due_s += every_s
    return due_s
