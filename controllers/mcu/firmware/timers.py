"""What turns axis speeds into step times: a common clock, and the two ways to count it down.

Time is int nanoseconds; the clock is an exact rational, so that no step ever drifts and a window may be cut
anywhere without moving one.
"""

from __future__ import annotations

from fractions import Fraction

from edmsim.controllers.mcu.firmware.poscal import STEP_UM
from edmsim.errors import InputError

TIMER_COUNT = 65_536
"""Counts of the 16-bit 8253 at which a speed of one unit makes one step (row T-74)."""

SPEED_UNIT_NM_S = 262.5
"""Speed unit in nm/s: 15.75 um/min, so that 7 bits reach 2 mm/min (row T-A1; the text prints 252.6)."""

MAX_SPEED = 127
"""Largest path speed in units (row T-A1)."""

MAX_FEED_UM_S = MAX_SPEED * SPEED_UNIT_NM_S / 1000
"""Largest path speed in um/s: 33.3375, or 2 mm/min (row T-A1)."""

NEVER = 1 << 62
"""A number of ticks that no run reaches: the axis stands still."""


def timer_clock_hz(speed_unit_nm_s: float) -> Fraction:
    """Clock at which one unit is one step per 65 536 ticks (row T-74): exactly 43008/5 Hz at 262.5 nm/s.

    The real clock is unknown (row T-75).

    Raises
    ------
    InputError
        If the unit is not above 0.
    """
    if not speed_unit_nm_s > 0:
        raise InputError(
            f"the speed unit must be above 0 nm/s (the controller has 262.5), not {speed_unit_nm_s}"
        )
    # The unit is a decimal number such as 252.6; its binary fraction would give a clock of absurd terms.
    unit = Fraction(speed_unit_nm_s).limit_denominator(1000)
    return TIMER_COUNT * unit / (STEP_UM * 1000)


def reload_count(speed: int) -> int:
    """Reload value of the 8253 for an axis speed of 1 unit or more: 65 536 div speed (row T-76)."""
    return TIMER_COUNT // speed


class TickClock:
    """The common clock: tick ``k`` falls at ``k`` periods after time zero, rounded up to a whole nanosecond.

    Parameters
    ----------
    speed_unit_nm_s : float
        Speed unit in nm/s, which fixes the clock.
    """

    def __init__(self, speed_unit_nm_s: float = SPEED_UNIT_NM_S) -> None:
        self.hertz = timer_clock_hz(speed_unit_nm_s)
        self._per_period = self.hertz.numerator
        self._period_ns = self.hertz.denominator * 1_000_000_000

    def before(self, time_ns: int) -> int:
        """Index of the last tick before a time; ``before(a) + 1 .. before(b)`` fall into ``a <= t < b``."""
        return (time_ns - 1) * self._per_period // self._period_ns

    def time_ns(self, tick: int) -> int:
        """Time of a tick in ns."""
        return -(-tick * self._period_ns // self._per_period)


class PhaseAccumulator:
    """Fraction of a step an axis is ahead of its counter; a signed accumulator that steps on overflow.

    Every tick adds the axis speed, so a new speed counts at once and the fraction is kept. Seven bits below
    the unit carry the axis speeds of slow paths. The overflow lies a quarter of a half step beyond it, so
    that a path that runs exactly between two motor positions does not make the motor swing to and fro.

    Attributes
    ----------
    phase : int
        Lead of the commanded position over the counter; `STEP` is one motor step of 2 um.
    """

    STEP = TIMER_COUNT << 7
    OVERFLOW = STEP * 5 // 8

    def __init__(self) -> None:
        self.phase = 0

    def ticks_to_step(self, rate: int) -> int:
        """Ticks until the axis steps at a signed rate in units / 128; `NEVER` at rate 0."""
        if rate > 0:
            return (self.OVERFLOW - self.phase) // rate + 1
        if rate < 0:
            return (self.OVERFLOW + self.phase) // -rate + 1
        return NEVER

    def run(self, rate: int, ticks: int) -> int:
        """Let some ticks pass, at most `ticks_to_step`; return the step due: +1, -1, or 0 for none."""
        self.phase += rate * ticks
        if self.phase > self.OVERFLOW:
            self.phase -= self.STEP
            return 1
        if self.phase < -self.OVERFLOW:
            self.phase += self.STEP
            return -1
        return 0


class ReloadCounter:
    """A channel of the 8253: counts down from its reload value and interrupts at zero.

    The interrupt routine reads the axis speed and loads the next count, so a new speed counts from the next
    step on.

    Attributes
    ----------
    left : int
        Ticks until the interrupt; 0 when nothing is loaded.
    """

    def __init__(self) -> None:
        self.left = 0

    def ticks_to_step(self, speed: int) -> int:
        """Ticks until the interrupt, loading the counter if need be; speed 0 holds the count (row T-76)."""
        if speed == 0:
            return NEVER
        if self.left == 0:
            self.left = reload_count(speed)
        return self.left

    def run(self, speed: int, ticks: int) -> bool:
        """Let some ticks pass, at most `ticks_to_step`; True if the interrupt comes."""
        if speed == 0:
            return False
        self.left -= ticks
        return self.left == 0

    def stop(self) -> None:
        """Unload the counter: its axis has arrived."""
        self.left = 0
