"""Extensions of both chips beyond their manuals; in compatible mode all settings are 0.

They follow the manual pages of LinuxCNC's components ``pid``, ``encoder`` and ``halscope``, without their code:
anti-windup, the time of an output at its limit, derivatives of the command with three feed-forwards, and a recorder
of four channels with samples before its trigger. Set them by name, ``drive.extensions["anti_windup"] = 1``. They
survive a reset of the drive; its EEPROM does not store them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis.parameters import HasRecord, Registers
from edmsim.errors import InputError

EXTENSION_WORDS = slice(96, 106)  # registers of both chips' records that hold the settings
(
    ANTI_WINDUP, COMMAND_FILTER, VELOCITY_GAIN, ACCELERATION_GAIN, JERK_GAIN, SATURATING, TRIGGER, LEVEL, BEFORE,
    EVERY,
) = range(96, 106)  # fmt: skip
COMMAND, VELOCITY, ACCELERATION, JERK, AT_LIMIT, LIMITED_SINCE_NS, LIMITED_NS, LONGEST_LIMITED_NS = range(106, 114)
"""The last command; its filtered derivatives per interval, times 256; on which side the output is limited (-1, 0, 1),
since when, for how long, and the longest of these times."""
RECORDED, WAITED, TRIGGERED_AT, LAST_DIRECTION, STATE = range(114, 119)
"""Samples recorded, intervals since the last one, the sample of the trigger, the command's last direction, and where
the recorder is."""
WAITING, TRIGGERED, FULL = range(3)
NEVER, AT_ONCE, ON_ERROR, ON_MOVE, ON_TURN, ON_LIMIT, ON_FAULT = range(7)
TRIGGERS = {
    "at once": AT_ONCE, "error": ON_ERROR, "move": ON_MOVE, "direction change": ON_TURN, "output limit": ON_LIMIT,
    "fault": ON_FAULT,
}  # fmt: skip
"""Triggers of a recording: at once, an error of `level` counts, the first commanded move, a change of its direction,
an output at its limit, a fault."""
SAMPLES, CHANNELS = 384, 4  # samples of a recording, each a word of the record's memory with four channels of 16 bits
MEMORY = 128  # first of these words; those before it are the servo processor module's own recorder's

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
    """Begin with a command at rest, as after a reset."""
    reg[COMMAND] = command
    reg[VELOCITY] = reg[ACCELERATION] = reg[JERK] = 0
    reg[AT_LIMIT] = reg[LIMITED_NS] = 0


@exactly_compiled
def derive_command(reg: NDArray[np.int64], command: int) -> None:
    """Take the command in counts; its velocity is averaged over some 2 ** ``command_filter`` intervals."""
    velocity = (command - reg[COMMAND]) * _ONE
    reg[COMMAND] = command
    velocity = reg[VELOCITY] + ((velocity - reg[VELOCITY]) >> reg[COMMAND_FILTER])
    acceleration = velocity - reg[VELOCITY]
    reg[JERK] = acceleration - reg[ACCELERATION]
    reg[VELOCITY], reg[ACCELERATION] = velocity, acceleration


@exactly_compiled
def feed_forward(reg: NDArray[np.int64]) -> int:
    """Return what the command's derivatives add to the output, times 256; a gain of 256 is one per count."""
    gained = reg[VELOCITY_GAIN] * reg[VELOCITY] + reg[ACCELERATION_GAIN] * reg[ACCELERATION]
    return int((gained + reg[JERK_GAIN] * reg[JERK]) >> 8)


@exactly_compiled
def holds_integrator(reg: NDArray[np.int64], error: int) -> bool:
    """Say whether anti-windup keeps the integrator as it is: its error would push on an output at its limit."""
    return bool(reg[ANTI_WINDUP] != 0 and reg[AT_LIMIT] * error > 0)


@exactly_compiled
def note_limit(reg: NDArray[np.int64], now_ns: int, side: int) -> None:
    """Note on which side the output is at its limit: -1, 1, or 0 for neither."""
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
    """Let the recorder see an interval: following error, velocity, the command's velocity, and the output."""
    direction = min(max(reg[VELOCITY], -1), 1)
    turned = direction * reg[LAST_DIRECTION] < 0
    if direction != 0:
        reg[LAST_DIRECTION] = direction
    if reg[TRIGGER] == NEVER or reg[STATE] == FULL:
        return
    if reg[STATE] == WAITING and reg[RECORDED] >= reg[BEFORE] and _triggers(reg, error, turned, faulty):
        reg[STATE], reg[TRIGGERED_AT], reg[WAITED] = TRIGGERED, reg[RECORDED], reg[EVERY]
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

    def __init__(self, owner: HasRecord, *, wraps: bool) -> None:
        super().__init__(owner, {name: place for name, place in _PLACES.items() if wraps or name != _WRAPS})

    @property
    def limited_s(self) -> float:
        """How long the output has been at its limit."""
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
        time_s = (np.arange(SAMPLES, dtype=np.float64) - int(reg[BEFORE])) * (interval_s * int(reg[EVERY]))
        return Recording(time_s, *values.T)
