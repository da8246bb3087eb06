"""The UHU Servo Controller 3.00: a position servo on an ATtiny2313, tuned over a serial line.

Source: the manual of 25.9.05 (rows U-1 to U-70); all constants are in ``models/drives/uhu.toml``.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled import axis_rows
from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis import servo_chip
from edmsim.controllers.axis.drive import data_of, new_record, restart, set_period
from edmsim.controllers.axis.servo_chip import WORD, ServoChip, command_in, lines_of
from edmsim.errors import methods_refuse_wrong_types

DATA = data_of("uhu")

# The UHU's registers: the words of ``DRIVE.reg`` that its loop and its dialogue share.

P, I, D, H, X, T, N, E, M, O, C = range(11)  # noqa: E741
"""Registers of the parameters, in the order of the help text."""
SETTINGS = (
    CONTROL_FULL, INTEGRAL_DIVISOR, SPEED_DIVISOR, FILTER_OFFSET, STREAM_EVERY, STREAM_ZERO, CALCULATION_NS,
    INTERRUPT_NS, STEP_SENSE, ENCODER_SENSE,
) = tuple(range(11, 21))  # fmt: skip
"""Registers of values that the manual does not define, in the order of the table ``law`` in
``models/drives/uhu.toml``."""
(
    TARGET, LAST_EDGES, REFERENCE, POSITION, SPEED, CHANGE, INTEGRAL, CONTROL, LAST_ILLEGAL, LAST_INTERRUPTS,
    ZERO_COUNT,
) = range(21, 32)  # fmt: skip
"""State of the loop: setpoint in counts and the step edges in it; the reference, whose speed is limited by X (counts
times SPEED_DIVISOR); position, speed and its change at the last sample; the integrator and the control variable (both
times 256); the illegal transitions counted in O; the encoder edges whose interrupts were counted; the encoder's count
at position 0."""
LATCHED, RESTART = 32, 33
"""Why the output is off (the bits below), and the reset that the next sample executes."""
TRACKING, ERROR_INPUT, TIMED_OUT, BAD_BANK = 1, 2, 4, 8
OWN_FAULTS = TRACKING | TIMED_OUT | BAD_BANK
SOFT, HARD = 1, 2
STREAM_ON, STREAM_WAIT = 34, 35  # whether the stream of tracking errors is on, and intervals since its last byte


# The UHU's recalculation, in whole numbers: an extended PID with feedback of speed and of speed's change.
# Gains are 16-bit words of 8.8 fixed point (row U-12). The control variable is in units of T, 255 of them for the
# full range of the duty cycle, with eight more bits inside the loop. The manual's log names a 16-bit limiter and 16
# x 16 multiplication; here nothing wraps: the error is limited to 16 bits, sums have 64.

_ONE = 256
_LARGEST_ERROR = 32767


@exactly_compiled
def take_steps(reg: NDArray[np.int64], edges: int) -> None:
    """Move the setpoint by M + 1 counts for each step edge since the last call (row U-22).

    If a reset is pending, the edges are dropped.
    """
    if reg[RESTART] == 0:
        reg[TARGET] += reg[STEP_SENSE] * (edges - reg[LAST_EDGES]) * (reg[M] + 1)
    reg[LAST_EDGES] = edges


@exactly_compiled
def reset_loop(reg: NDArray[np.int64], edges: int, count: int, illegal: int) -> None:
    """Reset: the setpoint becomes the position (row U-A25) plus the counts of G; a hard reset sets it to 0."""
    ahead = reg[TARGET] - reg[POSITION]
    if reg[RESTART] == HARD:
        reg[ZERO_COUNT] = reg[ENCODER_SENSE] * count
        reg[LAST_ILLEGAL] = illegal
    reg[RESTART] = 0
    reg[POSITION] = reg[ENCODER_SENSE] * count - reg[ZERO_COUNT]
    reg[TARGET] = reg[POSITION] + ahead
    reg[REFERENCE] = reg[POSITION] * reg[SPEED_DIVISOR]
    reg[LAST_EDGES] = edges
    reg[SPEED] = reg[CHANGE] = reg[INTEGRAL] = reg[CONTROL] = 0


@exactly_compiled
def latch_faults(reg: NDArray[np.int64], illegal: int, error_input_low: bool) -> None:
    """Count the encoder's illegal transitions; latch causes that switch the output off (rows U-6, U-21, U-50)."""
    reg[O] = min(reg[O] + illegal - reg[LAST_ILLEGAL], WORD - 1)
    reg[LAST_ILLEGAL] = illegal
    if error_input_low and reg[LATCHED] & OWN_FAULTS == 0:
        reg[LATCHED] |= ERROR_INPUT
    if reg[LATCHED] == 0 and abs(reg[TARGET] - reg[POSITION]) >= reg[E]:
        reg[LATCHED] |= TRACKING


@exactly_compiled
def measure(reg: NDArray[np.int64], count: int) -> None:
    """Update position, speed and speed's change, its first and second differences."""
    position = reg[ENCODER_SENSE] * count - reg[ZERO_COUNT]
    speed = position - reg[POSITION]
    reg[CHANGE], reg[SPEED], reg[POSITION] = speed - reg[SPEED], speed, position


@exactly_compiled
def control(reg: NDArray[np.int64], now_ns: int) -> int:
    """Return the control variable, -T to T; the reference follows the setpoint by X at most (row U-A29)."""
    behind = reg[TARGET] * reg[SPEED_DIVISOR] - reg[REFERENCE]
    reg[REFERENCE] += min(max(behind, -reg[X]), reg[X])
    reference = reg[REFERENCE] // reg[SPEED_DIVISOR]
    servo_chip.derive_command(reg, reference)
    error = reference - reg[POSITION]
    error = min(max(error, -_LARGEST_ERROR), _LARGEST_ERROR)
    most = min(reg[T], reg[CONTROL_FULL])
    limit = most * _ONE
    if not servo_chip.holds_integrator(reg, error):
        grown = reg[INTEGRAL] + reg[I] * error * _ONE // reg[INTEGRAL_DIVISOR]
        reg[INTEGRAL] = min(max(grown, -limit), limit)
    damping = reg[D] * reg[SPEED] + reg[H] * reg[CHANGE]
    demand = reg[P] * error + reg[INTEGRAL] - damping + servo_chip.feed_forward(reg)
    servo_chip.note_limit(reg, now_ns, 1 if demand >= limit else -1 if demand <= -limit else 0)
    demand = min(max(demand, -limit), limit)
    reg[CONTROL] += (demand - reg[CONTROL]) * reg[N] // (reg[N] + reg[FILTER_OFFSET])
    return int(min(max((reg[CONTROL] + _ONE // 2) // _ONE, -most), most))


@exactly_compiled
def stream_byte(reg: NDArray[np.int64]) -> int:
    """Return the tracking error as a byte with bit 7 set, or 0 if no byte is due (rows U-34 to U-36)."""
    if reg[STREAM_ON] == 0:
        return 0
    reg[STREAM_WAIT] += 1
    if reg[STREAM_WAIT] < reg[STREAM_EVERY]:
        return 0
    reg[STREAM_WAIT] = 0
    value = reg[STREAM_ZERO] + reg[TARGET] - reg[POSITION]
    return int(128 + min(max(value, 0), 127))


# The UHU's serial dialogue, to the character (rows U-7 to U-13, U-A13 to U-A18).
# A line is a letter and a whole number. A letter alone prints its line of the help and waits for the number::
#     >P600           >P
#     OK              (P)rop.      900: 600
#     >               OK
# The help lists a counter, but C is the cycle: ``COUNTER``, typed in full, prints the encoder's count (ours).

PROMPT = b">"
_LOAD, _SAVE, _GO = "L", "S", "G"
_COMMAND_LINES = {_LOAD: "(L)oad       [0,1,2]", _SAVE: "(S)ave       [0,1,2]", _GO: "(G)o         [Wert]"}
"""Lines of the help after those of the parameters; [Wert] is German for value, as printed (row U-10)."""
_COUNTER = "COUNTER"
_LAST_LINES = ("(C)ounter", "(R)eset")
"""The first is from an older version; the letter C is the cycle in this one (row U-A9)."""
_OK, _UNKNOWN, _BAD_BANK = "OK", "?", "EEPROM: Error!"
_BANKS = range(3)
_TAKEN = {_LOAD: _BANKS, _SAVE: _BANKS, _GO: range(-32_000, 32_001)}
"""Valid numbers of these commands; a parameter's number is a word."""


def _reply(*lines: str) -> bytes:
    return lines_of(lines) + PROMPT


_DUTY_RANGE = 0  # index in ``real``: share of the supply for the full range of duty, in locked antiphase
_TABLE = DATA["parameter"]
_LABELS = {row["letter"]: row["label"] for row in _TABLE}  # text before the values in the help
_NAMES = {row["letter"]: row["name"] for row in _TABLE}
_STORED = [name for name in _NAMES.values() if name != "overruns"]


@axis_rows.sample
def _recalculate(drive_at: Any, axis_at: Any) -> None:
    drive, axis = axis_rows.carray(drive_at, 1)[0], axis_rows.carray(axis_at, 1)[0]
    reg = drive.reg
    output = 0
    if drive.event == axis_rows.WATCHDOG:
        reg[LATCHED] |= TIMED_OUT
        drive.delay_ns = 0
    else:
        low = axis.lines & axis_rows.FAULT_IN != 0
        if reg[RESTART] != 0:
            low = False  # its own error output, released only in this sample, may still hold the net low
            reset_loop(reg, drive.setpoint, axis.count, axis.illegal)
            servo_chip.start_command(reg, reg[POSITION])
            reg[LAST_INTERRUPTS] = axis.edges
        interrupts = axis.edges - reg[LAST_INTERRUPTS] + abs(drive.setpoint - reg[LAST_EDGES])
        reg[LAST_INTERRUPTS] = axis.edges
        drive.delay_ns = reg[CALCULATION_NS]
        drive.busy_ns = reg[CALCULATION_NS] + interrupts * reg[INTERRUPT_NS]
        take_steps(reg, drive.setpoint)
        measure(reg, axis.count)
        latch_faults(reg, axis.illegal, low)
        if reg[LATCHED] == 0:
            output = control(reg, drive.now_ns)
        else:
            servo_chip.note_limit(reg, drive.now_ns, 0)
        error = reg[TARGET] - reg[POSITION]
        servo_chip.record_sample(reg, drive.memory, error, reg[SPEED], output, reg[LATCHED] != 0)
        sent = stream_byte(reg)
        if sent != 0:
            axis_rows.put_byte(drive, sent)
    drive.command = drive.real[_DUTY_RANGE] * output / reg[CONTROL_FULL]
    if reg[LATCHED] == 0:
        drive.lines = axis_rows.LED
    else:
        own = axis_rows.FAULT_OUT if reg[LATCHED] & OWN_FAULTS else 0
        drive.lines = axis_rows.FAULT | axis_rows.FREEWHEEL | axis_rows.ERROR_LED | own


def _period_ns(cycle: int) -> tuple[int, int]:
    """Return the recalculation interval as a fraction: C = 50 is 533 333.3 ns; 0 acts as 1 (rows U-4, U-A23)."""
    clock = DATA["clock"]
    num, den = max(cycle, 1) * clock["prescaler"] * 1_000_000_000, clock["crystal_Hz"]
    common = math.gcd(num, den)
    return num // common, den // common


@methods_refuse_wrong_types
class Uhu(ServoChip):
    r"""A UHU servo controller.

    Parameters
    ----------
    motor : record array (1,), optional
        Motor, supply and encoder, a row of `edmsim.compiled.axis_rows.MOTOR`; by default those of the table.
    stored : mapping of str to int, optional
        Parameters in bank 0 at power-up, by name; the others have their presets. By default the drive is in its
        condition upon delivery: no bank is valid, and the output is off until a reset by ``R``.
    law : mapping of str to int, optional
        Overrides of the table ``law`` of ``models/drives/uhu.toml``, not defined by the manual, for example
        ``{"encoder_sense": -1}``.

    Attributes
    ----------
    parameters : mapping of str to int
        Parameters set by the terminal's letters, by name; words 0 to 65535. A ``cycle`` typed at the terminal acts
        from the next interval, one set here from the next reset.
    extensions : Extensions
        Functions beyond its manual, see `edmsim.controllers.axis.servo_chip`.

    Raises
    ------
    InputError
        `stored` or `law` has an unknown name, or `stored` a number out of range.

    Examples
    --------
    >>> drive = Uhu()
    >>> drive.line(b"R\r")
    b'R\r\nOK\r\n>'
    """

    name, title, data, echoes = "uhu", "UHU", DATA, True
    baud = DATA["clock"]["crystal_Hz"] / 16 / DATA["serial"]["baud_divisor"]
    sample: axis_rows.SampleFunction = _recalculate

    def _fresh(self) -> NDArray[np.void]:
        pins, law = DATA["pins"], self._law
        values = [row["value"] for row in _TABLE]
        record = new_record(_period_ns(values[C]))
        reg = record["reg"][0]
        reg[: len(values)] = values
        reg[list(SETTINGS)] = list(law.values())[: len(SETTINGS)]
        reg[RESTART] = HARD
        record["real"][0, _DUTY_RANGE] = pins["duty_high"] - pins["duty_low"]
        record["lines"] = axis_rows.FREEWHEEL
        record["watchdog_ns"] = DATA["clock"]["watchdog_ms"] * 1_000_000
        record["pwm_ns"] = 1_000_000_000 // law["pwm_Hz"]
        record["count_rate_Hz"] = law["edge_rate_Hz"]
        return record

    def _deliver(self, stored: Mapping[str, int] | None) -> None:
        for bank in _BANKS:
            self.save(bank, false_checksum=True)
        if stored is not None:
            self.parameters.update(stored)
            self.save(0)

    @property
    def counts_per_step(self) -> float:
        """Encoder counts per step edge, M + 1."""
        return float((self._reg[M] + 1) * self._reg[STEP_SENSE] * self._reg[ENCODER_SENSE])

    def why_stopped(self) -> str:
        """Return why its output is off (row U-50)."""
        causes = {
            TRACKING: f"its following error reached the limit E of {self._reg[E]} counts",
            TIMED_OUT: f"its watchdog saw no recalculation for {DATA['clock']['watchdog_ms']} ms",
            BAD_BANK: "its parameters could not be read",
        }
        return ", ".join(text for bit, text in causes.items() if self._reg[LATCHED] & bit)

    def line(self, text: bytes) -> bytes:
        """Receive typed text; return its echo and the answers."""
        sent = b""
        for byte in text:
            echo, line = self._editor.take(byte)
            sent += echo if line is None else echo + self._answer(line)
        return sent

    def receive_error(self) -> None:
        """Discard the current line after a byte without a stop bit."""
        self._editor.spoil()

    def power_up(self) -> bytes:
        """Restart as at power-up, a low reset pin or ``+``: load bank 0, return the start-up text (row U-39)."""
        fresh = self._fresh()
        fresh["reg"][0, servo_chip.EXTENSION_WORDS] = self._reg[servo_chip.EXTENSION_WORDS]
        restart(self.record, fresh)
        stored = self._read(0)
        if stored.words is not None:
            self._use(stored.words)
        set_period(self.record, *_period_ns(self.parameters["cycle"]))
        self._reg[LATCHED] = 0 if stored.valid else BAD_BANK
        self._editor.clear()
        self._pending = ""  # letter whose number is expected in the next line
        state = "OK" if stored.valid else "Error!"
        number = DATA["identity"]["serial_number"]
        return _reply(f"UHU Servo Controller 3.00 (c) Snr: {number}", f"EEPROM: {state}", "Help by (?)")

    @property
    def position(self) -> int:
        """Position in counts relative to power-up; the terminal prints it as ``COUNTER``."""
        return int(self._reg[POSITION])

    def value(self, letter: str) -> int:
        """Return a letter's parameter."""
        return self.parameters[_NAMES[letter]]

    def enter(self, letter: str, value: int) -> None:
        """Set a letter's parameter immediately."""
        take_steps(self._reg, int(self.record["setpoint"][0]))
        self.parameters[_NAMES[letter]] = value
        self._time_next()

    def load(self, bank: int) -> bool:
        """Load a bank; if it is invalid, leave the parameters and switch the output off (rows U-69, U-A21)."""
        stored = self._read(bank)
        if stored.words is None or not stored.valid:
            self._reg[LATCHED] |= BAD_BANK
            return False
        take_steps(self._reg, int(self.record["setpoint"][0]))
        self._use(stored.words)
        self._time_next()
        return True

    def save(self, bank: int, *, false_checksum: bool = False) -> None:
        """Save the parameters to a bank without any check (row U-47)."""
        words = [self.parameters[name] for name in _STORED]
        self.record["eeprom"][0, self._place(bank)] = list(servo_chip.encode(words, false_checksum=false_checksum))

    def go(self, counts: int) -> None:
        """Move the setpoint; X limits the speed (row U-30)."""
        self._reg[TARGET] += counts

    def soft_reset(self) -> None:
        """Switch the output on with the present parameters and the setpoint at the axis (rows U-31, U-A25).

        The timer of the recalculation restarts (log 2.16).
        """
        self._reg[LATCHED] = 0
        self._reg[TARGET] = self._reg[POSITION]
        self._reg[RESTART] = max(int(self._reg[RESTART]), SOFT)
        self.stream(False)
        set_period(self.record, *_period_ns(self.parameters["cycle"]))

    def stream(self, on: bool) -> None:
        """Start or stop the stream of tracking errors (row U-33)."""
        self._reg[STREAM_ON], self._reg[STREAM_WAIT] = int(on), 0

    def _place(self, bank: int) -> slice:
        size = 2 * (2 * len(_STORED) + 1)  # two bytes per word and a checksum; two code bytes each
        return slice(bank * size, (bank + 1) * size)

    def _read(self, bank: int) -> servo_chip.Stored:
        return servo_chip.decode(self.record["eeprom"][0, self._place(bank)].tobytes())

    def _use(self, words: tuple[int, ...]) -> None:
        self.parameters.update(zip(_STORED, words, strict=True))

    def _answer(self, line: str) -> bytes:
        pending, self._pending = self._pending, ""
        if not line:
            return PROMPT
        if line == _COUNTER and not pending:
            return _reply(f"{_LAST_LINES[0]:13}{self.position}")
        command = command_in(pending + line)
        if command is None:
            return _reply(_UNKNOWN)
        letter, number = command
        if letter in _LABELS or letter in _COMMAND_LINES:
            return self._ask(letter) if number is None else self._set(letter, number)
        return self._act(letter) if number is None else _reply(_UNKNOWN)

    def _ask(self, letter: str) -> bytes:
        self._pending = letter
        return f"{self._help_line(letter)}: ".encode("ascii")

    def _help_line(self, letter: str) -> str:
        return _COMMAND_LINES.get(letter) or f"{_LABELS[letter]}{self.value(letter)}"

    def _set(self, letter: str, number: int) -> bytes:
        if number not in _TAKEN.get(letter, range(WORD)):
            return _reply(_UNKNOWN)
        if letter == _LOAD:
            return _reply(_OK if self.load(number) else _BAD_BANK)
        if letter == _SAVE:
            self.save(number)
        elif letter == _GO:
            self.go(number)
        else:
            self.enter(letter, number)
        return _reply(_OK)

    def _act(self, letter: str) -> bytes:
        if letter == "+":
            return self.power_up()
        if letter == "A":
            self.stream(True)
            return PROMPT
        if letter in "#?":
            return _reply(*map(self._help_line, _LABELS), *_COMMAND_LINES.values(), *_LAST_LINES)
        actions: dict[str, Callable[[], None]] = {"R": self.soft_reset, "Z": lambda: self.stream(False)}
        if letter not in actions:
            return _reply(_UNKNOWN)
        actions[letter]()
        return _reply(_OK)

    def _time_next(self) -> None:
        """Set the length of the intervals after the present one by C."""
        record = self.record
        record["num"], record["den"] = _period_ns(self.parameters["cycle"])
        record["epoch_ns"], record["index"] = record["due_ns"], 0
