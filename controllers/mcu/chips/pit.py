"""The 8253: three counters of sixteen bits, each with a clock of its own.

Counter 0 makes the interrupts of the x stepper, counter 1 those of y, counter 2 the bit rate of the serial channels
(row T-22). It has the modes that this machine can use: 0 (interrupt on terminal count), 2 (rate generator) and 3
(square wave), in binary.
"""

from dataclasses import dataclass

from edmsim.controllers.mcu.firmware.timers import NEVER, TIMER_COUNT
from edmsim.errors import InputError
from edmsim.snapshots import Snapshots

X, Y, BIT_RATE, CONTROL = range(4)  # offsets of the counters and the control register
TERMINAL_COUNT, RATE, SQUARE_WAVE = 0, 2, 3  # modes


def control_word(counter: int, mode: int) -> int:
    """Return the control word of a counter's mode; its count is then written low byte first."""
    return counter << 6 | 0x30 | mode << 1


@dataclass
class Counter:
    """One counter."""

    mode: int = TERMINAL_COUNT
    reload: int = 0  # count loaded, 0 for 65 536
    left: int = 0  # ticks until the output rises; 0 if it has risen in mode 0, or nothing is loaded
    low: int = -1  # low byte of a count that is being written; -1 for none
    latched: int = -1  # latched count for reading; -1 for none
    low_was_read: bool = False

    def load(self, count: int) -> None:
        """Load a count; 0 counts 65 536 ticks (row T-74)."""
        self.reload = count
        self.left = count or TIMER_COUNT

    def latch(self) -> None:
        """Latch the present count until both of its bytes are read."""
        self.latched, self.low_was_read = self.left & 0xFFFF, False

    @property
    def ticks_to_rise(self) -> int:
        """Return the ticks until the output rises; `NEVER` if the counter does not run."""
        return self.left or NEVER

    def run(self, ticks: int) -> int:
        """Advance by ticks of the clock; return the number of rising edges of the output."""
        if not self.left or ticks < self.left:
            self.left -= ticks if self.left else 0
            return 0
        if self.mode == TERMINAL_COUNT:
            self.left = 0
            return 1
        period = self.reload or TIMER_COUNT
        rises, since = divmod(ticks - self.left, period)
        self.left = period - since
        return rises + 1


class Pit8253(Snapshots):
    """Three counters behind four addresses."""

    STATE = ("counters",)

    def __init__(self) -> None:
        self.counters = (Counter(), Counter(), Counter())

    def read(self, offset: int) -> int:
        """Read the low and then the high byte of a count, which a control word or the first read latches."""
        if offset == CONTROL:
            return 0xFF
        counter = self.counters[offset]
        if counter.latched < 0:
            counter.latch()
        value = counter.latched
        if counter.low_was_read:
            counter.latched, counter.low_was_read = -1, False
            return value >> 8
        counter.low_was_read = True
        return value & 0xFF

    def write(self, offset: int, byte: int) -> None:
        """Write a control word, or the low and then the high byte of a count."""
        if offset == CONTROL:
            self._control(byte)
            return
        counter = self.counters[offset]
        if counter.low < 0:
            counter.low = byte
        else:
            counter.load(byte << 8 | counter.low)
            counter.low = -1

    def _control(self, word: int) -> None:
        number, access, mode = word >> 6, word >> 4 & 3, word >> 1 & 7
        if mode & 3 in (RATE, SQUARE_WAVE):
            mode &= 3
        if number == CONTROL or access not in (0, 3) or mode not in (TERMINAL_COUNT, RATE, SQUARE_WAVE) or word & 1:
            raise InputError(
                f"control word {word:02X}H: the counters of this 8253 take two bytes in binary, in mode 0, 2 or 3"
            )
        counter = self.counters[number]
        if access == 0:
            counter.latch()
        else:
            counter.mode, counter.left, counter.low = mode, 0, -1
            counter.latched, counter.low_was_read = -1, False
