"""The words of the terminal and of the host's programs: moves and settings, HELP, STATUS, the program in RAM.

HELP shows a whole job first, then explains each word. Lines fit the terminal's 80 columns, and texts fit the 24
lines less the live view.

The program is a list of moves and settings as bytes in memory, where the monitor shows and changes them. An entry is
a kind and its data (ours): ``01`` x y is a straight move; ``02`` and ``03`` with x y and the centre's x y are arcs
clockwise and counterclockwise, in words with the low byte first. ``10`` and more is a setting; its three low bits
select which of its words apply: the codes of t(i) and t(p), and the speed. ``00`` ends the program.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from edmsim.consoles.computer_1982.line_input import SEPARATORS, InputBuffer, getnum, gnumhx, skip
from edmsim.controllers.mcu.chips.bus import Bus
from edmsim.controllers.mcu.chips.dac import MOST_CODE, PulseSettings, time_text
from edmsim.controllers.mcu.firmware.memory_map import PROGRAM_ENTRIES
from edmsim.controllers.mcu.firmware.timers import MAX_SPEED
from edmsim.controllers.pulse_counters import percent_of_window
from edmsim.errors import InputError

# The words of a path: an operator types them before START, and the host minicomputer sends them as a program.
# The thesis says that programs come from the host through the second serial channel (4.1), without an example; the
# lines are ours. They use the terminal's words, so the host can send all that you can type::
#     * a punch                       (a comment)
#     TI 30 TP 100 SPEED 100          settings from this position on
#     NEW 33000 32500                 a straight move, um
#     CW 33500 32000 33000 32000      an arc to a position about a centre; CCW counterclockwise
#     END

LAST_WORD, COMMENT = b"END", b"*"


class Move(NamedTuple):
    """A move to a new position in um: straight, or about a centre."""

    end_um: tuple[int, int]
    centre_um: tuple[int, int] | None = None
    clockwise: bool = False

    def __str__(self) -> str:
        """Return the line that would be typed."""
        if self.centre_um is None:
            return f"NEW {self.end_um[0]} {self.end_um[1]}"
        word = "CW" if self.clockwise else "CCW"
        return f"{word} {self.end_um[0]} {self.end_um[1]} {self.centre_um[0]} {self.centre_um[1]}"


class Setting(NamedTuple):
    """Codes of V(t(i)) and V(t(p)), 0..511, and the cutting speed in units, 1..127; None: unchanged."""

    t_i: int | None = None
    t_p: int | None = None
    speed: int | None = None

    def __str__(self) -> str:
        """Return the line that would be typed."""
        pulses = [f"{word} {code:02X}H" for word, code in (("TI", self.t_i), ("TP", self.t_p)) if code is not None]
        return " ".join(pulses + ([] if self.speed is None else [f"SPEED {self.speed}"]))


Entry = Move | Setting


def read_word(buffer: InputBuffer) -> str:
    """Read the letters (and question marks) at the pointer, after separators; empty at the end of the line."""
    skip(buffer)
    word = ""
    while chr(buffer.waiting).isalpha() or buffer.waiting == ord("?"):
        word += chr(buffer.waiting)
        buffer.advance()
    return word


def until_separator(text: bytes) -> bytes:
    """Return the text before the first separator."""
    return re.split(rb"[%b]" % re.escape(SEPARATORS), text)[0]


def is_code(text: bytes) -> bool:
    """Return whether a text is a code: hexadecimal digits and an H. Codes such as AH begin like a word."""
    return re.fullmatch(rb"[0-9A-F]+H", text) is not None


def read_number(buffer: InputBuffer) -> int:
    """Read a decimal number of 16 bits; raises `InputError` unless a separator or the line's end follows."""
    column, written = buffer.column, buffer.rest
    number = getnum(buffer)
    if buffer.waiting and buffer.waiting not in SEPARATORS:
        found = until_separator(written)
        raise InputError(f"a whole number is expected at column {column}, not {found.decode('ascii')}")
    return number


def read_numbers(buffer: InputBuffer, count: int, what: str) -> list[int]:
    """Read `count` decimal numbers of 16 bits, separated; `what` names them in an error."""
    numbers: list[int] = []
    while len(numbers) < count:
        if not skip(buffer):
            raise InputError(f"{what} is expected")
        numbers.append(read_number(buffer))
    return numbers


def at_end(buffer: InputBuffer) -> None:
    """Raise `InputError` if a line has more than separators left."""
    if skip(buffer):
        raise InputError(f"{buffer.rest.decode('ascii')} is not expected here")


def read_move(word: str, buffer: InputBuffer) -> Move:
    """Read the numbers of NEW, CW or CCW and the end of the line."""
    if word == "NEW":
        x, y = read_numbers(buffer, 2, "NEW x y")
        at_end(buffer)
        return Move((x, y))
    x, y, xc, yc = read_numbers(buffer, 4, f"{word} x y and the centre's x y")
    at_end(buffer)
    return Move((x, y), (xc, yc), word == "CW")


def read_setting(word: str, buffer: InputBuffer, pulses: PulseSettings) -> Setting:
    """Read one or more of TI, TP and SPEED with their numbers: decimal us, or hexadecimal codes (``4DH``)."""
    found: dict[str, int] = {}
    while word:
        if word == "SPEED":
            found["speed"] = check_speed(read_numbers(buffer, 1, f"SPEED 1 to {MAX_SPEED} in units")[0])
        elif word == "TI":
            found["t_i"] = read_code(buffer, pulses.code_of_t_i, "TI in us or as a code 0H to 1FFH")
        elif word == "TP":
            found["t_p"] = read_code(buffer, pulses.code_of_t_p, "TP in us or as a code 0H to 1FFH")
        else:
            raise InputError(f"{word} cannot follow settings; TI, TP and SPEED can")
        word = read_word(buffer)
    at_end(buffer)
    return Setting(**found)


def check_speed(units: int) -> int:
    """Return a cutting speed; raises `InputError` if it is invalid."""
    if not 1 <= units <= MAX_SPEED:
        raise InputError(f"SPEED is 1 to {MAX_SPEED} units, not {units}")
    return units


def read_code(buffer: InputBuffer, code_of: Callable[[int], int], what: str) -> int:
    """Return the code of a time: the line has the time in us, or the code itself."""
    if not skip(buffer):
        raise InputError(f"{what} is expected")
    number = until_separator(buffer.rest)
    if not number.endswith(b"H"):
        return code_of(read_number(buffer))
    code = gnumhx(buffer)
    buffer.advance()  # skip the H
    if code > MOST_CODE:
        raise InputError(f"a code is 0H to {MOST_CODE:X}H, not {code:X}H")
    return code


def read_program(lines: Iterable[bytes], pulses: PulseSettings) -> list[Entry]:
    """Read the host's lines, in capitals, up to END; an `InputError` names the line."""
    entries: list[Entry] = []
    for number, text in enumerate(lines, 1):
        if text.strip() == LAST_WORD:
            if not any(isinstance(entry, Move) for entry in entries):
                raise InputError("the host's program moves nothing")
            return entries
        try:
            entry = _read_line(InputBuffer(text), pulses)
        except InputError as error:
            raise InputError(f"line {number} of the host's program: {error.reason}") from None
        if entry is not None:
            entries.append(entry)
        if len(entries) > PROGRAM_ENTRIES:
            raise InputError(f"line {number} of the host's program is one more than the {PROGRAM_ENTRIES} that fit")
    raise InputError("the host's program ends without END")


def _read_line(buffer: InputBuffer, pulses: PulseSettings) -> Entry | None:
    if not skip(buffer) or buffer.rest.startswith(COMMENT):
        return None
    word = read_word(buffer)
    if word in ("NEW", "CW", "CCW"):
        return read_move(word, buffer)
    if word in ("TI", "TP", "SPEED"):
        return read_setting(word, buffer, pulses)
    raise InputError(f"{word or buffer.rest.decode('ascii')} is not one of NEW, CW, CCW, TI, TP, SPEED, END")


# The machine's state, as STATUS prints it for the operator.


class Status(NamedTuple):
    """The machine's state for the operator."""

    state: str  # ``STAND-BY``, ``CUTTING``, ``JOGGING`` or ``EMERGENCY: ...`` with the cause
    position: tuple[int, int]
    unit: str  # unit of the position counters: ``um`` or ``STEPS``
    speed: int  # the set limit of the cutting speed, in units
    running: int  # present speed; negative while moving back
    short: int
    open: int
    counted: int  # 255, or 0 while no pulses have been counted since INIT
    windows: int  # number of windows read since the start
    missed: int  # number of windows not read in time (row T-44)
    t_i: int  # code of V(t(i))
    t_p: int
    t_i_us: float
    t_p_us: float
    generator_on: bool
    voltage_V: float  # mean over the gap
    current_A: float
    time_s: float
    move: Move | None  # present move of a cut

    @property
    def erosion(self) -> int:
        """Pulses of the last window that eroded."""
        return max(self.counted - self.short - self.open, 0)


def describe(status: Status, target: Move | None) -> str:
    """Return the text of STATUS, with the present move of a cut or else the new position."""
    x, y = status.position
    return "\n".join(
        (
            f"{status.state}   POSITION X {x} Y {y} {status.unit}   {status.move or target or 'NO NEW POSITION'}",
            f"SPEED {status.running} OF {status.speed} UNITS   SHORT {percent_of_window(status.short):.1f} %   "
            f"OPEN {percent_of_window(status.open):.1f} %   WINDOWS {status.windows}, MISSED {status.missed}",
            pulses(status),
            f"GENERATOR {'ON' if status.generator_on else 'OFF'}   GAP {status.voltage_V:.0f} V "
            f"{status.current_A:.2f} A   TIME {status.time_s:.1f} s",
        )
    )


def pulses(status: Status) -> str:
    """Return both times and their codes, as STATUS prints them."""

    def show(code: int, us: float) -> str:
        return f"{time_text(us)} us ({code:02X}H)" if code else "NOT SET (00H)"

    return f"t(i) {show(status.t_i, status.t_i_us)}   t(p) {show(status.t_p, status.t_p_us)}"


JOB = """\
A JOB, STEP BY STEP                        HELP and a word tells more of it
 1  STATUS              what the machine is doing
 2  X 50   Y -200       jog an axis by N um, with the generator off
 3  POS 1000 2000       call this place X 1000 Y 2000 um
 4  NEW 1300 2000       new position, straight; CW or CCW: on an arc
 5  TI 30 TP 100        pulse duration and period in us
 6  SPEED 100           greatest cutting speed, 1 to 127 units
 7  START               generator and timers on: cuts to the new position
 8  STATUS  STOP  WAIT  meanwhile: look, stop, or wait for the end
 9  BYE                 leaves, the machine made safe
HELP MORE is about programs, emergencies, typing and the monitor."""

MORE = """\
MAIN asks for 3 to 7 one after the other.
LOAD takes a program from the host, LIST shows it, RUN cuts it.
GEN ON and GEN OFF run and stop the generator without a move. KEY presses
keys of the front panel; TENSION LOW and FULL set that of the wire.
EM or Ctrl-C is the emergency stop. After it nothing moves until INIT; then
WIRE threads a new wire if it broke, and GO goes on with the cut.
BS or DEL takes a character back, Ctrl-X the line; Ctrl-R types it again.
MON leads to the monitor: memory, registers, tapes. Ctrl-\\ is the reset button."""

WORDS = {
    "HELP": """\
HELP            a job, step by step
HELP MORE       the rest
HELP word       what the word does; also ?""",
    "STATUS": """\
STATUS          state, position, the move under way or the new position,
                speed, counts of the last 255 pulses in percent, t(i), t(p),
                gap voltage and current, and the windows that were not read
                in time""",
    "POS": """\
POS             where the wire is, um
POS x y         call this place x y, 0 to 65535 um; nothing moves""",
    "NEW": """\
NEW x y         new position, um, along a straight line; START cuts to it""",
    "CW": """\
CW x y xc yc    new position x y, um, clockwise about the centre xc yc
CCW x y xc yc   the other way round; START cuts to it""",
    "TI": """\
TI us           pulse duration t(i) in whole us, to 1000
TI 4DH          the code of V(t(i)) itself, 0H to FFH; 100H to 1FFH are the
                coarse range, chosen by itself for more than 50 us
                TI 30 TP 100 SPEED 90 on one line are taken over together.
                A pair that draws more than 2 A is refused; the old one stays.""",
    "TP": """\
TP us           pulse period t(p) in whole us, to 10000
TP 80H          the code of V(t(p)) itself, 0H to FFH; 100H to 1FFH are the
                coarse range, chosen by itself for more than 150 us; see TI""",
    "SPEED": """\
SPEED n         greatest cutting speed, 1 to 127 units of 0.2625 um/s; below
                it the counts of short and open pulses decide""",
    "START": """\
START           generator and timers on: cuts to the new position, then stops
                and says READY""",
    "STOP": """\
STOP            stops the timers and the generator; GO goes on from there""",
    "GO": """\
GO              goes on with the cut that was stopped, by STOP or in an
                emergency, once INIT, WIRE, TI and TP have made it possible""",
    "X": """\
X um            jogs along x by N um (X -200 goes back), generator off,
                at 127 units; motor steps are 2 um. Refused while moving.
Y um            the same along y""",
    "GEN": """\
GEN ON          runs the pulse generator (OEV = 0)
GEN OFF         stops it (OEV = 1); a voltage stays on the wire for a while""",
    "WAIT": """\
WAIT            waits until the machine stands still
WAIT s          waits s seconds of machine time, or until it is stopped""",
    "MAIN": """\
MAIN            asks for position, new position, t(i), t(p) and cutting speed
                and then starts. An empty line keeps what is shown; any other
                word ends the questions.""",
    "LOAD": """\
LOAD            takes a program from the host: lines with NEW, CW, CCW, TI,
                TP, SPEED as they are typed here, * before a comment, END last.
                A faulty program is refused and the old one kept.""",
    "LIST": """\
LIST            shows the program""",
    "RUN": """\
RUN             cuts the program from where the wire is; settings are taken
                over where they stand between the moves""",
    "EM": """\
EM              emergency stop: the steppers stand, the generator is off, both
                codes are 0. So does Ctrl-C, an end switch, a broken wire.
                Nothing moves until INIT; the position is kept.""",
    "INIT": """\
INIT            makes the machine safe and ready: generator off, codes 0,
                position kept. Give t(i) and t(p) again before START. From an
                end switch, jog back.""",
    "MON": """\
MON             leads to the monitor, which shows and alters memory and the
                registers of the chips; G there leads back. The machine goes
                on meanwhile.""",
    "MORE": MORE,
    "WIRE": """\
WIRE            threads a new wire where the old one was; takes a minute.
                Refused where that is inside the workpiece: jog back with X
                or Y first""",
    "TENSION": """\
TENSION LOW     halves the wire's tension
TENSION FULL    gives it back; so does INIT""",
    "KEY": """\
KEY names       presses keys of the front panel one after the other: digits,
                CLEAR X Y T(I) T(P) SPEED START STOP GO INIT X+ X- Y+ Y-, SHIFT
                before one. KEY 300 X+ jogs by 300 um. Before a live view
                Ctrl-K gives your keyboard to the panel, and takes it back.""",
    "BYE": """\
BYE             makes the machine safe and leaves""",
}
"""Help text of each word."""

ALIASES = {"CCW": "CW", "Y": "X", "?": "HELP"}  # words explained together with another


END, STRAIGHT, CLOCKWISE, COUNTER_CLOCKWISE, SETTING = 0x00, 0x01, 0x02, 0x03, 0x10
_WORDS = {STRAIGHT: 2, CLOCKWISE: 4, COUNTER_CLOCKWISE: 4, SETTING: 3}


class ProgramStore:
    """A program in memory: address of its first entry, greatest number of entries."""

    def __init__(self, memory: Bus, first: int, most: int) -> None:
        self._memory = memory
        self._first = first
        self._most = most

    def write(self, entries: Sequence[Entry]) -> None:
        """Write a program to memory."""
        data = b"".join(map(_bytes_of, entries)) + bytes([END])
        for offset, byte in enumerate(data):
            self._memory.write(self._first + offset, byte)

    def read(self) -> list[Entry]:
        """Return the program in memory; raises `InputError` if its bytes are not a program."""
        entries: list[Entry] = []
        address = self._first
        while kind := self._memory.read(address):
            if len(entries) == self._most:
                raise InputError(f"the program at {self._first:04X}H has no end: 00H was overwritten")
            of_kind = SETTING if kind & ~0x07 == SETTING else kind
            if of_kind not in _WORDS:
                raise InputError(f"the program's byte at {address:04X}H is {kind:02X}H, which begins no entry")
            words = [self._memory.word(address + 1 + 2 * k) for k in range(_WORDS[of_kind])]
            if of_kind == SETTING:
                entries.append(Setting(*(word if kind >> k & 1 else None for k, word in enumerate(words))))
            else:
                centre = (words[2], words[3]) if len(words) == 4 else None
                entries.append(Move((words[0], words[1]), centre, kind == CLOCKWISE))
            address += 1 + 2 * len(words)
        return entries


def _bytes_of(entry: Entry) -> bytes:
    if isinstance(entry, Setting):
        kind = SETTING | sum((value is not None) << k for k, value in enumerate(entry))
        words = [value or 0 for value in entry]
    else:
        kind = STRAIGHT if entry.centre_um is None else CLOCKWISE if entry.clockwise else COUNTER_CLOCKWISE
        words = [*entry.end_um, *(entry.centre_um or ())]
    return bytes([kind]) + b"".join(word.to_bytes(2, "little") for word in words)
