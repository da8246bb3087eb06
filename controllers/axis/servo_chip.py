"""Code of both servo chips: parameters by name in the record's registers, the EEPROM's code, and typed lines.

>>> from edmsim.controllers.axis import make
>>> drive = make("uhu")
>>> drive.parameters["proportional_gain"] = 900
>>> drive.parameters["proportional_gain"]
900
"""

import itertools
import re
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis.drive import Drive, Screw, SerialDrive, axis_row
from edmsim.errors import InputError, methods_refuse_wrong_types
from edmsim.numeric import real, whole, whole_from


class Registers(MutableMapping[str, int]):
    """Registers of a drive's record by name; `places` has number, least and greatest value of each.

    A plant replaces the first record by its own row, so the record is looked up at every access.
    """

    OWNER: ClassVar[str] = "drive"  # in messages

    def __init__(self, owner: Drive, places: Mapping[str, tuple[int, int, int]]) -> None:
        self._owner, self._places = owner, dict(places)

    def __getitem__(self, name: str) -> int:
        return int(self._reg[self._place(name)[0]])

    def __setitem__(self, name: str, value: float) -> None:
        self._reg[self._place(name)[0]] = self.fitting(name, value)

    def fitting(self, name: str, value: float) -> int:
        """Return a value as int; raises `InputError` unless it fits into a register."""
        _, low, high = self._place(name)
        number = real(value)
        if number is None or not low <= number <= high or number != int(number):
            raise InputError(f"the {self.OWNER}'s {name} is {value!r}; it must be a whole number {low} to {high}")
        return int(number)

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __delitem__(self, name: str) -> None:
        raise InputError(f"the {self.OWNER}'s {name} cannot be taken away; set it to another value")

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    @property
    def _reg(self) -> NDArray[np.int64]:
        registers: NDArray[np.int64] = self._owner.record["reg"][0]
        return registers

    def _place(self, name: str) -> tuple[int, int, int]:
        if name not in self._places:
            raise InputError(f"the {self.OWNER} has no {name!r}; it has {', '.join(self._places)}")
        return self._places[name]


def by_name(changes: Mapping[str, float], name_of: Callable[[str], str], owner: str) -> dict[str, Any]:
    """Return changes by the parameters' names; raises `InputError` if two are of the same parameter."""
    found: dict[str, Any] = {}
    for key, value in changes.items():
        if (name := name_of(key)) in found:
            raise InputError(f"the {owner}'s {name} is given twice")
        found[name] = value
    return found


_MOST_LAW = 2**31  # greatest setting of a law (ours): most are times in ns


class ServoChip(SerialDrive):
    """A chip with an EEPROM and a serial line: 8 data bits, no parity, 1 stop bit."""

    title: ClassVar[str]  # in messages
    data: ClassVar[Mapping[str, Any]]  # ``models/drives/NAME.toml``
    signed: ClassVar[str] = ""  # the parameter that has a sign
    wraps: ClassVar[bool] = False  # whether its arithmetic wraps, see `Extensions`
    echoes: ClassVar[bool] = False  # whether it echoes typed characters

    def __init__(
        self, motor: NDArray[np.void] | None = None, stored: Mapping[str, int] | None = None,
        law: Mapping[str, int] | None = None,
    ) -> None:  # fmt: skip
        self.motor: NDArray[np.void] | None = axis_row() if motor is None else motor
        settings: Mapping[str, int] = self.data["law"]
        if unknown := sorted((law or {}).keys() - settings.keys()):
            raise InputError(f"the law of the {self.title} has no {unknown[0]!r}; it has {', '.join(settings)}")
        self._law = {**settings, **(law or {})}
        for name, value in self._law.items():
            turns, number = name.endswith("_sense"), whole(value)
            if number not in (1, -1) if turns else number is None or not 1 <= number <= _MOST_LAW:
                must = "1 or -1" if turns else f"a whole number 1 to {_MOST_LAW}"
                raise InputError(f"{name} of the {self.title}'s law is {value!r}; it must be {must}")
        self.record: NDArray[np.void] = self._fresh()
        names = [row["name"] for row in self.data["parameter"]]
        limits = [(-WORD // 2, WORD // 2 - 1) if name == self.signed else (0, WORD - 1) for name in names]
        self.parameters = Registers(self, {name: (k, *limits[k]) for k, name in enumerate(names)})
        self.extensions = Extensions(self, wraps=self.wraps)
        self._editor = LineEditor(echo=self.echoes)
        self._deliver(stored)
        self.power_up()

    @abstractmethod
    def _fresh(self) -> NDArray[np.void]:
        """Return the record of a drive after a reset, before its EEPROM is read."""

    @abstractmethod
    def _deliver(self, stored: Mapping[str, int] | None) -> None:
        """Prepare a new drive: write its EEPROM, with the parameters in `stored`, if any."""

    @classmethod
    def tuned(
        cls, axis: str = "table", changes: Mapping[str, float] = MappingProxyType({}), screw: Screw | None = None
    ) -> Self:
        """Return a drive tuned for an axis of `axis_row`; its EEPROM has the parameters, with overrides by `changes`.

        With a machine's screw, a step is the machine's, rounded to a whole number of counts.
        """
        tuned = cls.data["tuned"]
        if axis not in tuned:
            raise InputError(f"no {cls.title} is tuned for an axis {axis!r}; there are: {', '.join(tuned)}")
        fitted = {} if screw is None else {"step_multiplier": max(round(screw.counts_of(axis_row(axis))) - 1, 0)}
        names = {row["letter"]: row["name"] for row in cls.data["parameter"]}
        changed = by_name(changes, lambda key: names.get(key.upper(), key), Registers.OWNER)
        for name in sorted(changed.keys() - names.values()):
            has = ", ".join(f"{letter} {known}" for letter, known in names.items())
            raise InputError(f"the {Registers.OWNER} has no {name!r}; it has {has}")
        return cls(axis_row(axis), {**tuned[axis], **fitted, **changed})

    @property
    def _reg(self) -> NDArray[np.int64]:
        registers: NDArray[np.int64] = self.record["reg"][0]
        return registers


# The code of a drive's words in its EEPROM: a checksum, and every half byte as an extended Hamming word.
# Ten words make 42 bytes, so three banks of the UHU's parameters fill 126 of the ATtiny2313's 128 bytes. The manual
# names "checksum and forward error correction" without a layout (rows U-26, U-29, U-A24): the layout is ours.
# The servo processor module stores its only bank in the same code (row M-A16).

WORD = 1 << 16  # words are 0 to 65535
_HALF_BITS = 4
_CHECKED = (0b1101, 0b1011, 0b0111)
"""Data bits that each check bit of a Hamming (7,4) code covers; the eighth bit makes the parity of all eight even."""
_CORRECTABLE, _NOTED = 1, 2
"""Flipped bits of a code byte that are corrected, and that are detected: the code's distance is four."""


class Stored(NamedTuple):
    """Content of an EEPROM."""

    words: tuple[int, ...] | None  # 0 to 65535; None if a code byte has more flipped bits than can be corrected
    corrected: int  # number of corrected bits
    valid: bool  # whether all bytes could be read and the checksum is right


def _code_byte(half: int) -> int:
    checks = sum(((half & mask).bit_count() & 1) << (_HALF_BITS + k) for k, mask in enumerate(_CHECKED))
    return half | checks | ((half | checks).bit_count() & 1) << 7


_CODE = tuple(_code_byte(half) for half in range(1 << _HALF_BITS))


def _nearest(byte: int) -> tuple[int, int]:
    """Return the half byte with the nearest code, and the number of bits that differ."""
    away = [(byte ^ code).bit_count() for code in _CODE]
    return away.index(min(away)), min(away)


_DECODE = tuple(_nearest(byte) for byte in range(256))


def encode(words: Sequence[int], *, false_checksum: bool = False) -> bytes:
    """Return the EEPROM's code of words (0 to 65535); a new UHU has a false checksum (row U-28)."""
    plain = bytearray(itertools.chain.from_iterable(word.to_bytes(2, "big") for word in words))
    plain.append(_checksum(plain) ^ (0xFF if false_checksum else 0))
    return bytes(itertools.chain.from_iterable((_CODE[byte >> _HALF_BITS], _CODE[byte & 0xF]) for byte in plain))


def decode(image: bytes) -> Stored:
    """Decode an image by `encode`, with any bits flipped since."""
    halves = [_DECODE[byte] for byte in image]
    corrected = sum(away for _, away in halves if away == _CORRECTABLE)
    if any(away >= _NOTED for _, away in halves):
        return Stored(None, corrected, False)
    plain = bytes(high << _HALF_BITS | low for (high, _), (low, _) in zip(halves[::2], halves[1::2], strict=True))
    words = tuple(int.from_bytes(plain[k : k + 2], "big") for k in range(0, len(plain) - 1, 2))
    return Stored(words, corrected, _checksum(plain[:-1]) == plain[-1])


def _checksum(plain: bytes | bytearray) -> int:
    """Return the complement of the sum, so an EEPROM with only 00H or only FFH is not valid."""
    return ~sum(plain) & 0xFF


# The typed line of a drive's terminal and its numbers; both drives read lines this way, the UHU with echo.
# A line ends with CR; LF is ignored (rows U-A14, M-A14). Blanks before, in and after a command are ignored, and lower
# case equals upper case (rows U-A13, U-A15). A byte that is not printable ASCII makes the line an unknown command, so
# neither noise nor a wrong baud rate sets a parameter or moves a motor.

RETURN, LINE_FEED = 0x0D, 0x0A
BACKSPACE, DELETE = 0x08, 0x7F
"""Both delete the last character (ours: terminals send one or the other, the manuals name none)."""
NEW_LINE = b"\r\n"
_RUB_OUT = b"\b \b"
LONGEST = 32
"""Greatest length of a line (ours; the longest valid command has seven characters). A longer line is invalid."""
_COMMAND = re.compile(r"([^0-9])(-?[0-9]+)?")


class Command(NamedTuple):
    """A letter and the number after it; None without a number."""

    letter: str
    number: int | None


class LineEditor:
    """Collects bytes into lines; never echoes a byte with bit 7, which marks the UHU's stream (row U-35)."""

    def __init__(self, *, echo: bool) -> None:
        self._echo = echo
        self._typed = bytearray()
        self._spoilt = False

    def take(self, byte: int) -> tuple[bytes, str | None]:
        """Take a byte; returns the echo and, once a line has ended, its text in upper case without blanks."""
        if byte == RETURN:
            text = "\x00" if self._spoilt else self._typed.decode("ascii").replace(" ", "").upper()
            self.clear()
            return self._sent(NEW_LINE), text
        if byte == LINE_FEED:
            return b"", None
        if byte in (BACKSPACE, DELETE):
            erased = _RUB_OUT if self._typed else b""
            del self._typed[-1:]
            return self._sent(erased), None
        if not 0x20 <= byte < DELETE or len(self._typed) == LONGEST:
            self.spoil()
            return b"", None
        self._typed.append(byte)
        return self._sent(bytes([byte])), None

    def spoil(self) -> None:
        """Make the present line invalid, as after a receive error."""
        self._spoilt = True

    def clear(self) -> None:
        """Discard the present line, as after a reset."""
        self._typed.clear()
        self._spoilt = False

    def _sent(self, echo: bytes) -> bytes:
        return echo if self._echo else b""


def lines_of(texts: Iterable[str]) -> bytes:
    """Return lines of text as a drive sends them."""
    return b"".join(text.encode("ascii") + NEW_LINE for text in texts)


def command_in(text: str) -> Command | None:
    """Return the command in a line, or None if it holds no command: ``P600`` is ``Command("P", 600)``."""
    found = _COMMAND.fullmatch(text)
    return Command(found[1], None if found[2] is None else int(found[2])) if found else None


# Extensions of both chips beyond their manuals; in compatible mode all settings are 0.
#
# They follow the manual pages of LinuxCNC's components ``pid``, ``encoder`` and ``halscope``, without their code:
# anti-windup, the time of an output at its limit, derivatives of the command with three feed-forwards, and a recorder
# of four channels with samples before its trigger. Set them by name, ``drive.extensions["anti_windup"] = 1``. They
# survive a reset of the drive; its EEPROM does not store them.

EXTENSION_WORDS = slice(96, 106)  # registers of the settings in both chips' records
(
    ANTI_WINDUP, COMMAND_FILTER, VELOCITY_GAIN, ACCELERATION_GAIN, JERK_GAIN, SATURATING, TRIGGER, LEVEL, BEFORE,
    EVERY,
) = range(96, 106)  # fmt: skip
COMMAND, VELOCITY, ACCELERATION, JERK, AT_LIMIT, LIMITED_SINCE_NS, LIMITED_NS, LONGEST_LIMITED_NS = range(106, 114)
"""The last command; its filtered derivatives per interval, times 256; the side on which the output is limited (-1, 0,
1), since when, for how long, and the longest of these times."""
RECORDED, WAITED, TRIGGERED_AT, LAST_DIRECTION, STATE, AHEAD = range(114, 120)
"""Number of samples recorded, intervals since the last one, the sample of the trigger, the command's last direction,
the recorder's state (`WAITING`, `TRIGGERED`, `FULL`), and the intervals from the sample before the trigger to it."""
WAITING, TRIGGERED, FULL = range(3)
NEVER, AT_ONCE, ON_ERROR, ON_MOVE, ON_TURN, ON_LIMIT, ON_FAULT = range(7)
TRIGGERS = {
    "at once": AT_ONCE, "error": ON_ERROR, "move": ON_MOVE, "direction change": ON_TURN, "output limit": ON_LIMIT,
    "fault": ON_FAULT,
}  # fmt: skip
"""Triggers of a recording: at once, an error of `level` counts, the first commanded move, a change of its direction,
an output at its limit, a fault."""
SAMPLES, CHANNELS = 384, 4  # of a recording; a sample is a word of the record's memory, with four channels of 16 bits
MEMORY = 128  # first of these words; the words before are those of the servo processor module's own recorder

_ONE = 256
_LARGEST = 32767
_WRAPS = "saturating_arithmetic"
_PLACES = {
    "anti_windup": (ANTI_WINDUP, 0, 1),
    "command_filter": (COMMAND_FILTER, 0, 15),
    "velocity_feed_forward": (VELOCITY_GAIN, -_LARGEST, _LARGEST),
    "acceleration_feed_forward": (ACCELERATION_GAIN, -_LARGEST, _LARGEST),
    "jerk_feed_forward": (JERK_GAIN, -_LARGEST, _LARGEST),
    _WRAPS: (SATURATING, 0, 1),
}


@exactly_compiled
def start_command(reg: NDArray[np.int64], command: int) -> None:
    """Start with a constant command, as after a reset."""
    reg[COMMAND] = command
    reg[VELOCITY] = reg[ACCELERATION] = reg[JERK] = 0
    reg[AT_LIMIT] = reg[LIMITED_NS] = 0


@exactly_compiled
def derive_command(reg: NDArray[np.int64], command: int) -> None:
    """Update the command and its derivatives; velocity is averaged over about 2 ** ``command_filter`` intervals."""
    velocity = (command - reg[COMMAND]) * _ONE
    reg[COMMAND] = command
    velocity = reg[VELOCITY] + ((velocity - reg[VELOCITY]) >> reg[COMMAND_FILTER])
    acceleration = velocity - reg[VELOCITY]
    reg[JERK] = acceleration - reg[ACCELERATION]
    reg[VELOCITY], reg[ACCELERATION] = velocity, acceleration


@exactly_compiled
def feed_forward(reg: NDArray[np.int64]) -> int:
    """Return the output for the command's derivatives, times 256; a gain of 256 is one per count."""
    gained = reg[VELOCITY_GAIN] * reg[VELOCITY] + reg[ACCELERATION_GAIN] * reg[ACCELERATION]
    return int((gained + reg[JERK_GAIN] * reg[JERK]) >> 8)


@exactly_compiled
def holds_integrator(reg: NDArray[np.int64], error: int) -> bool:
    """Return whether anti-windup stops the integrator: the error would push an output further beyond its limit."""
    return bool(reg[ANTI_WINDUP] != 0 and reg[AT_LIMIT] * error > 0)


@exactly_compiled
def note_limit(reg: NDArray[np.int64], now_ns: int, side: int) -> None:
    """Register the side on which the output is at its limit: -1, 1, or 0 for neither."""
    if side == 0 or side != reg[AT_LIMIT]:
        reg[LIMITED_SINCE_NS] = now_ns
    reg[AT_LIMIT] = side
    reg[LIMITED_NS] = now_ns - reg[LIMITED_SINCE_NS]
    reg[LONGEST_LIMITED_NS] = max(reg[LONGEST_LIMITED_NS], reg[LIMITED_NS])


@exactly_compiled
def _channel(value: int, place: int) -> int:
    return (min(max(value, -_LARGEST), _LARGEST) & 0xFFFF) << (16 * place)


@exactly_compiled
def _triggers(reg: NDArray[np.int64], error: int, turned: bool, faulty: bool) -> bool:
    trigger = reg[TRIGGER]
    return bool(
        trigger == AT_ONCE or (trigger == ON_ERROR and abs(error) >= reg[LEVEL])
        or (trigger == ON_MOVE and reg[VELOCITY] != 0) or (trigger == ON_TURN and turned)
        or (trigger == ON_LIMIT and reg[AT_LIMIT] != 0) or (trigger == ON_FAULT and faulty)
    )  # fmt: skip


@exactly_compiled
def record_sample(
    reg: NDArray[np.int64], memory: NDArray[np.int64], error: int, velocity: int, output: int, faulty: bool
) -> None:
    """Record an interval: following error, velocity, the command's velocity, and the output."""
    direction = min(max(reg[VELOCITY], -1), 1)
    turned = direction * reg[LAST_DIRECTION] < 0
    if direction != 0:
        reg[LAST_DIRECTION] = direction
    if reg[TRIGGER] == NEVER or reg[STATE] == FULL:
        return
    if reg[STATE] == WAITING and reg[RECORDED] >= reg[BEFORE] and _triggers(reg, error, turned, faulty):
        reg[STATE], reg[TRIGGERED_AT], reg[AHEAD] = TRIGGERED, reg[RECORDED], reg[WAITED] + 1
        reg[WAITED] = reg[EVERY]  # the trigger's interval is recorded whichever it is
    reg[WAITED] += 1
    if reg[WAITED] < reg[EVERY]:
        return
    reg[WAITED] = 0
    low = _channel(error, 0) | _channel(velocity, 1)
    memory[MEMORY + reg[RECORDED] % SAMPLES] = low | _channel(reg[VELOCITY] // _ONE, 2) | _channel(output, 3)
    reg[RECORDED] += 1
    if reg[STATE] == TRIGGERED and reg[RECORDED] - reg[TRIGGERED_AT] == SAMPLES - reg[BEFORE]:
        reg[STATE] = FULL


class Recording(NamedTuple):
    """A recording of `SAMPLES` samples."""

    time_s: NDArray[np.float64]  # time since the trigger; negative before it
    # error, velocity, command_velocity, output: following error in counts, velocities in counts per interval, and the
    # output in the drive's own units, each limited to 16 bits
    error: NDArray[np.int16]
    velocity: NDArray[np.int16]
    command_velocity: NDArray[np.int16]
    output: NDArray[np.int16]


@methods_refuse_wrong_types
class Extensions(Registers):
    """A drive's settings by name, its recorder, and the time of its output at the limit.

    ============================= ======================================================================
    ``anti_windup``               1: the integrator stops if it would push an output beyond its limit
    ``command_filter``            0..15: the command's velocity is averaged over about 2**n intervals
    ``velocity_feed_forward``     output per count per interval of the command's velocity, times 256
    ``acceleration_feed_forward`` the same for the velocity's change per interval
    ``jerk_feed_forward``         the same for the change of that change
    ``saturating_arithmetic``     1: products and sums saturate where the chip's would wrap
    ============================= ======================================================================

    Parameters
    ----------
    owner : object with a record
        The drive.
    wraps : bool
        Whether the chip's arithmetic wraps; only then it has the last setting.
    """

    def __init__(self, owner: Drive, *, wraps: bool) -> None:
        super().__init__(owner, {name: place for name, place in _PLACES.items() if wraps or name != _WRAPS})

    @property
    def limited_s(self) -> float:
        """Time in s for which the output has been at its limit."""
        return float(self._reg[LIMITED_NS]) * 1e-9

    @property
    def longest_limited_s(self) -> float:
        """Longest time of the output at its limit since power-up."""
        return float(self._reg[LONGEST_LIMITED_NS]) * 1e-9

    def record_on(self, trigger: str, *, level: int = 0, before: int = 32, every: int = 1) -> None:
        """Arm the recorder.

        Parameters
        ----------
        trigger : str
            One of `TRIGGERS`.
        level : int
            Following error in counts that triggers, for ``error``.
        before : int
            Samples stored before the trigger, 0 to 383; the trigger is ignored until they exist.
        every : int
            Intervals per sample, 1 or more.

        Raises
        ------
        InputError
            An argument is invalid.
        """
        if trigger not in TRIGGERS:
            raise InputError(f"the recorder has no trigger {trigger!r}; it has {', '.join(TRIGGERS)}")
        level, before, every = whole_from("level", level), whole_from("before", before), whole_from("every", every)
        if not 0 <= before < SAMPLES or every < 1 or level < 0:
            raise InputError(
                f"a recording of {before} samples before the trigger, one every {every} intervals, level {level}: it "
                f"takes 0 to {SAMPLES - 1} before, every 1 or more, and a level of 0 or more"
            )
        reg = self._reg
        reg[[RECORDED, WAITED, TRIGGERED_AT, STATE]] = 0
        reg[[TRIGGER, LEVEL, BEFORE, EVERY]] = TRIGGERS[trigger], level, before, every

    def recording(self) -> Recording | None:
        """Return the recording; None until the memory is full."""
        reg, record = self._reg, self._owner.record
        if reg[STATE] != FULL:
            return None
        words = np.roll(record["memory"][0, MEMORY : MEMORY + SAMPLES], -int(reg[RECORDED] % SAMPLES))
        values = np.ascontiguousarray(words).view(np.int16).reshape(SAMPLES, CHANNELS)
        interval_s = int(record["num"][0]) / int(record["den"][0]) * 1e-9
        before, every = int(reg[BEFORE]), int(reg[EVERY])
        intervals = (np.arange(SAMPLES, dtype=np.float64) - before) * every
        intervals[:before] += every - int(reg[AHEAD])
        return Recording(intervals * interval_s, *values.T)
