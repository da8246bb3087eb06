"""The servo processor module, revision A, of 2010: a replacement for the UHU servo chip with faster inputs.

Its parameters, and settings not in its guide, are in ``models/drives/servo_module.toml``.
"""

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled import axis_rows
from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis import servo_chip
from edmsim.controllers.axis.drive import data_of, new_record, restart, set_period
from edmsim.controllers.axis.servo_chip import WORD, Command, ServoChip, command_in, lines_of
from edmsim.errors import methods_refuse_wrong_types

# The servo processor module's registers: the words of ``DRIVE.reg`` that its loop and its dialogue share.

PARAMETERS = (
    ACCELERATION_FF, CLAMP, DERIVATIVE, ERROR_LIMIT, ERROR_SCALE, INTEGRAL, REGION, SCALE, DIVIDER, OFFSET,
    PROPORTIONAL, INTERVAL, VELOCITY_FF, MULTIPLIER, FILTER,
) = tuple(range(15))  # fmt: skip
"""A C D E F I J K L O P T V X Y: the values that S saves, as entered."""

SETTINGS = (
    GAIN_SCALE, STEP_SENSE, ENCODER_SENSE, REST_NS, SAVE_NS, LED_RUN_NS, LED_RECORDER_NS, LED_REPEAT_NS, LED_FLASH_NS,
) = tuple(range(15, 24))  # fmt: skip
"""The table ``law`` of ``models/drives/servo_module.toml``, in its order."""

CHIP = DUTY_CENTRE, GREATEST_CLAMP, BYTE_NS = tuple(range(24, 27))
"""Values of the table ``chip``; the last is the time of a byte on the serial line."""

(
    STATUS, FRESH, SETPOINT, POSITION, ORIGIN, EDGES, ERROR, VELOCITY, COMMANDED, LAST_SETPOINT, LAST_POSITION,
    LAST_ERROR, ACCUMULATED, TICK, OUTPUT, DUTY, LIMIT, PEAK, NOW_NS, MOVED_NS, SAVED_FROM_NS, SAVING, CODE, RECORDED,
    DUMPING, DUMPED, LINE_FREE_NS, RELEASING,
) = range(27, 55)  # fmt: skip
"""State of the loop: counts, counts per cycle, duty counts, and times of the plant's clock. ``FRESH`` is set from
power-up to the first cycle; ``ORIGIN`` is the encoder's count at position 0, ``ACCUMULATED`` the integral times
``GAIN_SCALE``, ``SAVING`` whether the EEPROM is being written, ``CODE`` that of the recorder, ``RECORDED`` the cycles
since its trigger, ``DUMPING`` the line of its memory being sent, from 1 on, 0 for none, ``DUMPED`` the number of its
characters sent, ``LINE_FREE_NS`` the time at which the serial line takes the next one. ``RELEASING`` is set for the
cycle that releases the fault output, because that output may still hold the fault input low."""

IMAGE, N_IMAGE = 64, 62
"""Bytes that a save writes, eight per word: 15 parameters and a checksum, encoded by
`edmsim.controllers.axis.servo_chip`. Words from 96 on belong to its extensions."""
N_MEMORY = 128  # words of the recorder's memory (row M-A4)

FAULT_BIT, FOLLOWING_BIT, EXTERNAL_BIT = 1 << 0, 1 << 1, 1 << 2
RECORDER_BIT, TRIGGERED_BIT, SATURATED_BIT, NEGATIVE_BIT = 1 << 7, 1 << 8, 1 << 10, 1 << 11
RECEIVE_BIT, TRANSMIT_BIT = 1 << 14, 1 << 15  # bits of ``STATUS`` (guide 4.6.8)
CLEARED_BY_RESET = FAULT_BIT | FOLLOWING_BIT | EXTERNAL_BIT | SATURATED_BIT | RECEIVE_BIT | TRANSMIT_BIT
"""Guide 4.14: "all internal error flags" and the saturation flag (row M-A15)."""
NO_ERROR_LIMIT = 32767  # guide 4.4: an error limit above this one never trips


# The servo processor module's loop in whole numbers: PID with antidither and feed-forwards, trip and clamp.
# With proportional gain 1250, an error of 10 counts makes 48 duty counts of 1024, 4.7 % of the supply. The guide
# does not define the scale of gains; here it is 1/256, like its other scales (row M-A9). The integral accumulates its
# gain times the error, so a change of gain, as in the antidither region, does not shift the output. It is limited
# to the clamp (ours: more can never act).

Words: TypeAlias = NDArray[np.int64]
SCALE_ONE = 256  # K, F and the antidither bracket are in 1/256 (guide 4.5, 4.9)


@exactly_compiled
def wrapped(value: int, bits: int) -> int:
    """Return the lowest bits of a number, in two's complement."""
    half = 1 << (bits - 1)
    return ((value + half) & ((1 << bits) - 1)) - half


@exactly_compiled
def _report_saturation(reg: Words) -> None:
    """Set the saturation flag, which only R clears; not in a stopped loop, which has no output."""
    if reg[STATUS] & FAULT_BIT == 0:
        reg[STATUS] |= SATURATED_BIT


@exactly_compiled
def narrowed(reg: Words, value: int, bits: int) -> int:
    """Fit a number into a word: clamped and reported as saturated, or wrapped (row M-35)."""
    fits = wrapped(value, bits)
    if fits == value or reg[servo_chip.SATURATING] == 0:
        return fits
    _report_saturation(reg)
    limit = (1 << (bits - 1)) - 1
    return limit if value > 0 else -limit


@exactly_compiled
def towards_zero(value: int, divisor: int) -> int:
    """Divide and round towards zero."""
    return value // divisor if value >= 0 else -(-value // divisor)


@exactly_compiled
def clamp_of(reg: Words) -> int:
    """Return the limit of duty counts by C, which has no effect above the greatest value (guide 4.2)."""
    return int(min(reg[CLAMP], reg[GREATEST_CLAMP]))


@exactly_compiled
def put_duty(reg: Words, output: int) -> None:
    """Set output and duty: the offset is added to the loop's output, then the sum is clamped (row M-40)."""
    demand = output + reg[OFFSET]
    held = min(max(demand, -clamp_of(reg)), clamp_of(reg))
    if held != demand:
        _report_saturation(reg)
    servo_chip.note_limit(reg, reg[NOW_NS], (demand > held) - (demand < held))
    reg[OUTPUT] = output
    reg[DUTY] = reg[DUTY_CENTRE] + held


@exactly_compiled
def stop(reg: Words, cause: int) -> None:
    """Stop the loop; the cause is a bit of the status, or 0 (Q)."""
    reg[STATUS] |= FAULT_BIT | cause
    put_duty(reg, 0)


@exactly_compiled
def reset_loop(reg: Words) -> None:
    """Start the loop at the motor's position (guide 4.14), with its state cleared."""
    reg[STATUS] &= ~CLEARED_BY_RESET
    reg[SETPOINT] = reg[POSITION]
    reg[LAST_SETPOINT] = reg[SETPOINT]
    reg[ERROR] = reg[LAST_ERROR] = reg[COMMANDED] = reg[ACCUMULATED] = reg[TICK] = reg[PEAK] = 0
    servo_chip.start_command(reg, reg[SETPOINT])
    reg[RELEASING] = 1
    put_duty(reg, 0)


@exactly_compiled
def _control(reg: Words, acceleration: int) -> int:
    """Return the output of a cycle in duty counts."""
    error = reg[ERROR]
    scale = reg[SCALE] if abs(error) <= reg[REGION] else SCALE_ONE
    reg[TICK] += 1
    if reg[TICK] >= reg[INTERVAL] and not servo_chip.holds_integrator(reg, error):
        reg[TICK] = 0
        most = clamp_of(reg) * reg[GAIN_SCALE]
        reg[ACCUMULATED] += reg[INTEGRAL] * scale // SCALE_ONE * error
        reg[ACCUMULATED] = min(max(reg[ACCUMULATED], -most), most)
    total = reg[PROPORTIONAL] * scale // SCALE_ONE * error + reg[ACCUMULATED]
    total += reg[DERIVATIVE] * scale // SCALE_ONE * (error - reg[LAST_ERROR])
    total += reg[VELOCITY_FF] * reg[COMMANDED] + reg[ACCELERATION_FF] * acceleration
    servo_chip.derive_command(reg, reg[servo_chip.COMMAND] + reg[COMMANDED])
    total += towards_zero(servo_chip.feed_forward(reg) * reg[GAIN_SCALE], SCALE_ONE)
    reg[LAST_ERROR] = error
    return narrowed(reg, towards_zero(narrowed(reg, total, 32), reg[GAIN_SCALE]), 16)


@exactly_compiled
def _measure(reg: Words) -> tuple[int, bool]:
    """Update error, velocities and limit; return the commanded acceleration, and whether the direction changed."""
    commanded = narrowed(reg, wrapped(reg[SETPOINT] - reg[LAST_SETPOINT], 32), 16)
    acceleration = commanded - reg[COMMANDED]
    reg[COMMANDED], reg[LAST_SETPOINT] = commanded, reg[SETPOINT]
    reg[VELOCITY] = wrapped(reg[POSITION] - reg[LAST_POSITION], 16)
    reg[LAST_POSITION] = reg[POSITION]
    reg[ERROR] = narrowed(reg, wrapped(reg[SETPOINT] - reg[POSITION], 32), 16)
    reg[LIMIT] = reg[ERROR_LIMIT] + abs(commanded) * reg[ERROR_SCALE] // SCALE_ONE
    before = reg[STATUS] & NEGATIVE_BIT
    if commanded != 0:
        reg[STATUS] = reg[STATUS] | NEGATIVE_BIT if commanded < 0 else reg[STATUS] & ~NEGATIVE_BIT
        reg[MOVED_NS] = reg[NOW_NS]
    return acceleration, bool(reg[STATUS] & NEGATIVE_BIT != before)


@exactly_compiled
def take_steps(reg: Words, edges: int) -> None:
    """Move the setpoint by the steps since the last call, each 1 + X counts (guide 4.18)."""
    steps = (edges - reg[EDGES]) * reg[STEP_SENSE]
    reg[SETPOINT] = wrapped(reg[SETPOINT] + steps * (1 + reg[MULTIPLIER]), 32)
    reg[EDGES] = edges


@exactly_compiled
def _take_count(reg: Words, count: int) -> None:
    """Read the encoder's counter, which is 0 at power-up."""
    count *= reg[ENCODER_SENSE]
    if reg[FRESH] != 0:
        reg[ORIGIN], reg[FRESH] = count, 0
    reg[POSITION] = wrapped(count - reg[ORIGIN], 32)


@exactly_compiled
def cycle(reg: Words, count: int, edges: int, fault: bool, time_ns: int) -> tuple[bool, bool]:
    """Run the loop on the counters of encoder and steps; returns whether it ran, and whether it changed direction."""
    reg[NOW_NS] = time_ns
    take_steps(reg, edges)
    _take_count(reg, count)
    if reg[SAVING] != 0:
        if time_ns - reg[SAVED_FROM_NS] < reg[SAVE_NS]:
            return False, False
        reg[SAVING] = 0
    acceleration, turned = _measure(reg)
    if reg[STATUS] & FAULT_BIT != 0:
        return False, turned
    reg[PEAK] = max(reg[PEAK], abs(reg[ERROR]))
    if fault and reg[RELEASING] == 0:
        stop(reg, EXTERNAL_BIT)
    elif reg[ERROR_LIMIT] <= NO_ERROR_LIMIT and abs(reg[ERROR]) > reg[LIMIT]:
        stop(reg, FOLLOWING_BIT)
    else:
        put_duty(reg, _control(reg, acceleration))
    reg[RELEASING] = 0
    return reg[STATUS] & FAULT_BIT == 0, turned


# The servo processor module's data recorder: 128 numbers from a trigger on, then sent a line each (guide 4.20).
# ``Z157`` is 5 + 24 + 128: every 32nd cycle, without trigger, the duty. The first number is from the trigger's
# cycle. The guide says that a spreadsheet can read the data; here each number is a signed decimal with CR LF (row
# M-A18), sent at the serial line's speed.

RATE, TRIGGER, FIRST_SOURCE = 0b111, 0b11 << 3, 5
"""Parts of a code: cycles per entry as a power of 2, trigger, first bit of the source."""
ON_VELOCITY, ON_TURN, UNUSED, AT_ONCE = 0, 8, 16, 24  # triggers
_SOURCES = ERROR, VELOCITY, COMMANDED, OUTPUT, DUTY, LIMIT  # recorded, by the code from `FIRST_SOURCE` on
_RETURN, _LINE_FEED, _MINUS, _ZERO = 13, 10, 45, 48  # characters


@exactly_compiled
def _triggered(reg: Words, turned: bool) -> bool:
    trigger = reg[CODE] & TRIGGER
    if trigger == ON_TURN:
        return turned
    return bool(trigger == AT_ONCE or reg[COMMANDED] != 0)


@exactly_compiled
def note(reg: Words, memory: Words, turned: bool) -> None:
    """Wait for the trigger, then record until the memory is full; called after the loop."""
    if reg[STATUS] & RECORDER_BIT == 0:
        return
    if reg[STATUS] & TRIGGERED_BIT == 0:
        if not _triggered(reg, turned):
            return
        reg[STATUS] |= TRIGGERED_BIT
        reg[RECORDED] = 0
    rate = reg[CODE] & RATE
    if reg[RECORDED] & ((1 << rate) - 1) == 0:
        memory[reg[RECORDED] >> rate] = reg[_SOURCES[reg[CODE] >> FIRST_SOURCE]]
    reg[RECORDED] += 1
    if reg[RECORDED] >> rate == N_MEMORY:
        reg[STATUS] &= ~(RECORDER_BIT | TRIGGERED_BIT)
        reg[DUMPING], reg[DUMPED], reg[LINE_FREE_NS] = 1, 0, reg[NOW_NS]


@exactly_compiled
def character_of(value: int, place: int) -> int:
    """Return a character of a number's line: sign, digits, CR, LF."""
    size, digits = abs(value), 1
    while size >= 10**digits:
        digits += 1
    first = 1 if value < 0 else 0
    if place < first:
        return _MINUS
    if place < first + digits:
        return int(_ZERO + size // 10 ** (first + digits - 1 - place) % 10)
    return _RETURN if place == first + digits else _LINE_FEED


@exactly_compiled
def dump(drive: Any) -> None:
    """Send as much of a full memory as the serial line takes until the present time."""
    reg = drive.reg
    while reg[DUMPING] != 0 and reg[LINE_FREE_NS] <= reg[NOW_NS]:
        character = character_of(drive.memory[reg[DUMPING] - 1], reg[DUMPED])
        axis_rows.put_byte(drive, character)
        reg[DUMPED] += 1
        reg[LINE_FREE_NS] += reg[BYTE_NS]
        if character == _LINE_FEED:
            reg[DUMPED] = 0
            reg[DUMPING] = reg[DUMPING] + 1 if reg[DUMPING] < N_MEMORY else 0


# The servo processor module's serial dialogue: a typed line in, the module's answer out.
# The answer to ``P1250`` is ``(P) - Kp: 1250 (1000)``: name, value, and, if an antidither scale is set, the gain in
# the antidither region. The module does not echo or prompt. Answers end with CR LF; the answer to an unknown
# command is ``?`` (rows M-2, M-4, M-11..M-18, M-A11..M-A14).

DATA: dict[str, Any] = data_of("servo_module")
LETTERS = {entry["letter"]: register for register, entry in zip(PARAMETERS, DATA["parameter"], strict=True)}
_SCALED = PROPORTIONAL, INTEGRAL, DERIVATIVE  # gains that the antidither scale changes (guide 4.9)
UNKNOWN = "?"
_HIGHEST, _LOWEST = WORD - 1, -WORD // 2


def answer(reg: NDArray[np.int64], text: str) -> list[str]:
    """Execute a line (upper case, without blanks) on the module's registers; return the lines of its answer."""
    if not text:
        return []
    if reg[DUMPING] != 0:  # the answer collides with a dump (ours: the guide does not define the flag's cause)
        reg[STATUS] |= TRANSMIT_BIT
    if text in _PLAIN:
        return _PLAIN[text](reg)
    if text in _READ:
        return [_READ[text](reg)]
    command = command_in(text)
    if command is None:
        return [UNKNOWN]
    if command.letter in "+-":
        return _move(reg, command)
    if command.letter == "Z":
        return _record(reg, command.number)
    if command.letter in LETTERS:
        return _set(reg, LETTERS[command.letter], command.number)
    return [UNKNOWN]


def words_of(reg: NDArray[np.int64]) -> list[int]:
    """Return the parameters as words of the EEPROM."""
    return [int(value) % WORD for value in reg[list(PARAMETERS)]]


def parameter_line(reg: NDArray[np.int64], register: int) -> str:
    """Return the line with which the module confirms and shows a parameter."""
    value, letter = int(reg[register]), DATA["parameter"][register]["letter"]
    shown = f"({letter}) - {DATA['parameter'][register]['label']}: {value}"
    if register in _SCALED and reg[SCALE] != SCALE_ONE:
        shown += f" ({value * int(reg[SCALE]) // SCALE_ONE})"
    return shown


def _set(reg: NDArray[np.int64], register: int, number: int | None) -> list[str]:
    if number is not None:
        if not (_LOWEST if register == OFFSET else 0) <= number <= _HIGHEST:  # row M-46: only the offset has a sign
            return [UNKNOWN]
        reg[register] = wrapped(number, 16) if register == OFFSET else number
    return [parameter_line(reg, register)]


def _menu(reg: NDArray[np.int64]) -> list[str]:
    return [*(parameter_line(reg, register) for register in PARAMETERS), f"Peak Error: {reg[PEAK]}"]


def _move(reg: NDArray[np.int64], command: Command) -> list[str]:
    """Step the setpoint (guide 4.22); a stopped module accepts the step without a move (row M-A21)."""
    if command.number is None or not 0 <= command.number <= (_HIGHEST if command.letter == "+" else -_LOWEST):
        return [UNKNOWN]
    direction = 1 if command.letter == "+" else -1
    reg[SETPOINT] = wrapped(reg[SETPOINT] + direction * command.number, 32)
    reg[MOVED_NS] = reg[NOW_NS]
    limit = reg[ERROR_LIMIT]
    if reg[STATUS] & FAULT_BIT == 0 and limit <= NO_ERROR_LIMIT and command.number > limit:
        stop(reg, FOLLOWING_BIT)
        reg[PEAK] = max(reg[PEAK], abs(narrowed(reg, wrapped(reg[SETPOINT] - reg[POSITION], 32), 16)))
    return [f"Move {command.letter}{command.number}"]


def _record(reg: NDArray[np.int64], code: int | None) -> list[str]:
    """Start or abort the recorder; Z0 starts, Z alone aborts (row M-A7)."""
    if code is not None and (not 0 <= code < len(_SOURCES) << FIRST_SOURCE or code & TRIGGER == UNUSED):
        return [UNKNOWN]
    reg[STATUS] &= ~(RECORDER_BIT | TRIGGERED_BIT)
    reg[DUMPING] = 0  # because the memory will be overwritten (ours: the guide does not say whether a dump ends)
    if code is None:
        return ["Recorder OFF"]
    reg[CODE] = code
    reg[STATUS] |= RECORDER_BIT
    return ["Recorder ON"]


def _save(reg: NDArray[np.int64]) -> list[str]:
    if reg[NOW_NS] - reg[MOVED_NS] < reg[REST_NS]:
        return ["Motor moving, not saved"]
    reg.view(np.uint8)[8 * IMAGE :][: N_IMAGE] = list(servo_chip.encode(words_of(reg)))
    reg[SAVED_FROM_NS], reg[SAVING] = reg[NOW_NS], 1
    return ["Parameters saved"]


def _quit(reg: NDArray[np.int64]) -> list[str]:
    stop(reg, 0)
    return ["Servo is OFF"]


def _reset(reg: NDArray[np.int64]) -> list[str]:
    reset_loop(reg)
    return ["Servo RESET!"]


def _words(name: str, value: int) -> str:
    """Return a 32-bit register as two words, as printed in the guide (row M-12)."""
    return f"{name}: {(value >> 16) % WORD}, {value % WORD}"


_PLAIN = {"?": _menu, "Q": _quit, "R": _reset, "S": _save}
_READ = {
    "GV": lambda reg: f"Velocity: {reg[VELOCITY]}",
    "GP": lambda reg: _words("Pos", int(reg[POSITION])),
    "GT": lambda reg: _words("Setpoint", int(reg[SETPOINT])),
    "GE": lambda reg: f"Error: {reg[ERROR]}",
    "GF": lambda reg: f"Scaled limit: {reg[LIMIT]}",
    "GO": lambda reg: f"PID Output: {reg[OUTPUT]}",
    "GD": lambda reg: f"PWM Dutycyle: {reg[DUTY]}",
    "GS": lambda reg: f"Status: {reg[STATUS]:016b}",
}


DELIVERED = tuple(entry["value"] for entry in DATA["parameter"])
_BITS_OF_A_BYTE = 10  # start bit, eight data bits, stop bit
_CHIP = DATA["chip"]


@exactly_compiled
def _lamp(reg: Words) -> int:
    """Return the status LED's bit: the number of flashes shows the cause of a stop; a running loop blinks evenly."""
    status, now_ns, flash_ns = reg[STATUS], reg[NOW_NS], reg[LED_FLASH_NS]
    if status & FAULT_BIT != 0:
        flashes = 3 if status & EXTERNAL_BIT != 0 else 2 if status & FOLLOWING_BIT != 0 else 1
        since_ns = now_ns % reg[LED_REPEAT_NS]
        lit = since_ns < 2 * flashes * flash_ns and since_ns % (2 * flash_ns) < flash_ns
    else:
        period_ns = reg[LED_RECORDER_NS] if status & RECORDER_BIT != 0 else reg[LED_RUN_NS]
        lit = 2 * (now_ns % period_ns) < period_ns
    return axis_rows.LED if lit else 0


@exactly_compiled
def _lines(reg: Words) -> int:
    """Return the output lines; only the module's own fault pulls the fault output (row M-A15)."""
    status = reg[STATUS]
    lines = _lamp(reg)
    if status & FAULT_BIT != 0:
        lines |= axis_rows.FREEWHEEL
    if status & FOLLOWING_BIT != 0:
        lines |= axis_rows.FAULT_OUT
    if status & (FOLLOWING_BIT | EXTERNAL_BIT) != 0:
        lines |= axis_rows.FAULT
    return lines


@exactly_compiled
def _write(reg: Words, eeprom: NDArray[np.uint8], now_ns: int) -> None:
    """Write the EEPROM's bytes up to the present time of a save; after a power failure the rest is unchanged."""
    if reg[SAVING] != 0:
        for k in range(min(N_IMAGE * (now_ns - reg[SAVED_FROM_NS]) // reg[SAVE_NS], N_IMAGE)):
            eeprom[k] = reg[IMAGE + k // 8] >> 8 * (k % 8) & 255


@axis_rows.sample
def _servo_module(drive_at: Any, axis_at: Any) -> None:
    drive, axis = axis_rows.carray(drive_at, 1)[0], axis_rows.carray(axis_at, 1)[0]
    reg = drive.reg
    _write(reg, drive.eeprom, drive.now_ns)
    ran, turned = cycle(reg, axis.count, drive.setpoint, axis.lines & axis_rows.FAULT_IN != 0, drive.now_ns)
    if ran:
        note(reg, drive.memory, turned)
    faulty = reg[STATUS] & FAULT_BIT != 0
    servo_chip.record_sample(reg, drive.memory, reg[ERROR], reg[VELOCITY], reg[OUTPUT], faulty)
    dump(drive)
    drive.command = (reg[DUTY] - reg[DUTY_CENTRE]) / reg[DUTY_CENTRE]
    drive.lines = _lines(reg)


@methods_refuse_wrong_types
class ServoModule(ServoChip):
    r"""The servo processor module on an axis.

    Parameters
    ----------
    motor : record array (1,), optional
        Motor, supply and encoder (`edmsim.controllers.axis.drive.axis_row`); by default those of the machine's table.
    stored : mapping of str to int, optional
        Parameters in the EEPROM that override the defaults, by name, for example ``{"proportional_gain": 900}``.
    law : mapping of str to int, optional
        Overrides of the table ``law`` of ``models/drives/servo_module.toml``, not defined by the guide, for
        example ``{"save_ns": 5_000_000}``.

    Attributes
    ----------
    parameters : mapping of str to int
        Parameters set by the terminal's letters, by name. A new loop rate or encoder filter acts from the next call
        of `line`; only ``S`` saves them to the EEPROM.
    extensions : Extensions
        Functions beyond its guide. ``saturating_arithmetic`` is 1 by default (row M-35). In compatible mode all are
        0, and 16 and 32 bits wrap as the guide warns in 4.4.

    Raises
    ------
    InputError
        `stored` or `law` has an unknown name, or `stored` a number out of range.

    Examples
    --------
    >>> ServoModule().line(b"P1250\r")
    b'(P) - Kp: 1250\r\n'
    """

    name, title, data, wraps = "servo-module", "servo module", DATA, True
    signed = "output_offset"  # row M-46
    sample: axis_rows.SampleFunction = _servo_module
    baud: float = _CHIP["baud"]

    def _deliver(self, stored: Mapping[str, int] | None) -> None:
        self.extensions["saturating_arithmetic"] = 1
        self.parameters.update(stored or {})
        self.record["eeprom"][0, : N_IMAGE] = list(servo_chip.encode(words_of(self._reg)))

    def _fresh(self, words: Sequence[int] = DELIVERED) -> NDArray[np.void]:
        record = new_record()
        reg = record["reg"][0]
        reg[list(PARAMETERS)] = words
        reg[OFFSET] = wrapped(reg[OFFSET], 16)
        reg[list(SETTINGS)] = list(self._law.values())
        reg[list(CHIP)] = _CHIP["duty_centre"], _CHIP["greatest_clamp"], round(_BITS_OF_A_BYTE * 1e9 / _CHIP["baud"])
        put_duty(reg, 0)
        record["delay_ns"], record["pwm_ns"] = _CHIP["calculation_ns"], _CHIP["duty_period_ns"]
        record["num"] = _period_ns(reg)
        record["count_rate_Hz"] = _count_rate(reg)
        return record

    @property
    def counts_per_step(self) -> float:
        """Encoder counts per step edge, X + 1."""
        reg = self._reg
        return float((reg[MULTIPLIER] + 1) * reg[STEP_SENSE] * reg[ENCODER_SENSE])

    @property
    def recording(self) -> bool:
        """Whether the recorder is filling or sending its memory; False before its trigger or with the loop off."""
        reg = self._reg
        fills = bool(reg[STATUS] & TRIGGERED_BIT and not reg[STATUS] & FAULT_BIT)
        return fills or reg[DUMPING] != 0

    def why_stopped(self) -> str:
        """Return why its loop is off, except by the fault input."""
        reg = self._reg
        if reg[STATUS] & FOLLOWING_BIT:
            return f"its following error passed the limit E of {reg[LIMIT]} counts"
        return "its loop is off" if reg[STATUS] & FAULT_BIT and not reg[STATUS] & EXTERNAL_BIT else ""

    def line(self, text: bytes) -> bytes:
        """Receive text over the serial line and return the answer; a new loop rate or filter acts from now on."""
        reg = self._reg
        reg[NOW_NS] = self.record["now_ns"][0]
        take_steps(reg, int(self.record["setpoint"][0]))
        sent = []
        for byte in text:
            _, typed = self._editor.take(byte)
            if typed is not None:
                sent += answer(reg, typed)
        self.record["count_rate_Hz"] = _count_rate(reg)
        if _period_ns(reg) != self.record["num"][0]:
            set_period(self.record, _period_ns(reg), 1)
        return lines_of(sent)

    def power_up(self) -> bytes:
        """Start with the EEPROM's parameters; if they are invalid, with the defaults and the motor off."""
        stored = servo_chip.decode(self.record["eeprom"][0, : N_IMAGE].tobytes())
        words = stored.words if stored.valid else None
        fresh = self._fresh(words or DELIVERED)
        reg = fresh["reg"][0]
        reg[servo_chip.EXTENSION_WORDS] = self._reg[servo_chip.EXTENSION_WORDS]
        reg[FRESH], reg[EDGES], reg[NOW_NS] = 1, self.record["setpoint"][0], self.record["now_ns"][0]
        reg[MOVED_NS] = reg[NOW_NS] - reg[REST_NS]
        if words is None:
            reg[STATUS] = FAULT_BIT
            fresh["lines"] = axis_rows.FREEWHEEL
        restart(self.record, fresh)
        self._editor.clear()
        return lines_of([_CHIP["message"]] if words is not None else [_CHIP["message"], _CHIP["bad_memory"]])

    def receive_error(self) -> None:
        """Set the receive error in the status; the current line becomes an unknown command."""
        self._reg[STATUS] |= RECEIVE_BIT
        self._editor.take(0)


def _period_ns(reg: Words) -> int:
    """Return the time of a cycle (guide 4.10)."""
    divider = min(int(reg[DIVIDER]), _CHIP["greatest_loop_divider"]) + _CHIP["loop_divider_offset"]
    return int(_CHIP["duty_period_ns"] * divider)


def _count_rate(reg: Words) -> float:
    """Return the highest rate of encoder edges that pass the filter (guide 4.19)."""
    rates: list[float] = _CHIP["filter_Hz"]
    return rates[min(int(reg[FILTER]), len(rates) - 1)]
