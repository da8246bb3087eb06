"""The integer routines and timers in plain Python, as they were before they were compiled."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import NamedTuple

from edmsim.errors import InputError

WORD = 0xFFFF

BYTE = 0xFF


def subsgn(a: int, b: int) -> tuple[int, int]:
    return (a - b, 1) if a >= b else (b - a, -1)


def reduc(a: int, b: int) -> tuple[int, int, int]:
    halvings = max((a | b).bit_length() - 8, 0)
    return a >> halvings, b >> halvings, halvings


def reduc2(a: int, b: int) -> tuple[int, int]:
    return a >> 1, b >> 1


def verm(a: int, b: int) -> int:
    if not (0 <= a <= BYTE and 0 <= b <= BYTE):
        raise InputError(f"VERM multiplies 8-bit numbers 0..255, not {a} and {b}")
    return a * b


def square(a: int) -> int:
    return verm(a, a)


def divide(dividend: int, divisor: int) -> int:
    if dividend == 0 or divisor == 0:
        return 0
    shifted, quotient = divisor, 0
    while shifted <= dividend:
        shifted <<= 1
    while shifted > divisor:
        shifted >>= 1
        quotient <<= 1
        if dividend >= shifted:
            dividend -= shifted
            quotient |= 1
    return quotient or 1


def sqrt(n: int) -> int:
    x, following = n, ((n + 1) & WORD) >> 1
    while x != following:
        x = following
        following = (divide(n, x) + x + 1) >> 1
    return x


STEP_UM = 2

Unit = str

UNIT_UM: dict[str, int] = {"um": 1, "step": STEP_UM}


class Displacement(NamedTuple):

    x: int
    y: int
    length: int
    x_direction: int
    y_direction: int
    halvings: int


def resolve(x: int, y: int, x_direction: int, y_direction: int, literal_wrap: bool = False) -> Displacement:
    x, y, halvings = reduc(x, y)
    total = square(x) + square(y)
    if total > WORD:
        if literal_wrap:
            total &= WORD
        else:
            x, y = reduc2(x, y)
            halvings += 1
            total = square(x) + square(y)
    return Displacement(x, y, sqrt(total), x_direction, y_direction, halvings)


def velocm(displacement: Displacement, speed: int) -> tuple[int, int]:
    x = divide(verm(displacement.x, speed), displacement.length)
    y = divide(verm(displacement.y, speed), displacement.length)
    return x * displacement.x_direction, y * displacement.y_direction


def positi(position: int, direction: int, wrap: bool = False, unit: Unit = "um") -> int:
    moved = position + STEP_UM // UNIT_UM[unit] * direction
    if wrap:
        return moved & WORD
    if not 0 <= moved <= WORD:
        unit_um = UNIT_UM[unit]
        raise InputError(
            f"soft limit: a step to {moved * unit_um} um would leave the table's 0..{WORD * unit_um} um"
        )
    return moved


TIMER_COUNT = 65_536

SPEED_UNIT_NM_S = 262.5

MAX_SPEED = 127

MAX_FEED_UM_S = MAX_SPEED * SPEED_UNIT_NM_S / 1000

NEVER = 1 << 62


def timer_clock_hz(speed_unit_nm_s: float) -> Fraction:
    if not speed_unit_nm_s > 0:
        raise InputError(
            f"the speed unit must be above 0 nm/s (the controller has 262.5), not {speed_unit_nm_s}"
        )
    # The unit is a decimal number such as 252.6; its binary fraction would give a clock of absurd terms.
    unit = Fraction(speed_unit_nm_s).limit_denominator(1000)
    return TIMER_COUNT * unit / (STEP_UM * 1000)


def reload_count(speed: int) -> int:
    return TIMER_COUNT // speed


class TickClock:

    def __init__(self, speed_unit_nm_s: float = SPEED_UNIT_NM_S) -> None:
        self.hertz = timer_clock_hz(speed_unit_nm_s)
        self._per_period = self.hertz.numerator
        self._period_ns = self.hertz.denominator * 1_000_000_000

    def before(self, time_ns: int) -> int:
        return (time_ns - 1) * self._per_period // self._period_ns

    def time_ns(self, tick: int) -> int:
        return -(-tick * self._period_ns // self._per_period)


class PhaseAccumulator:

    STEP = TIMER_COUNT << 7
    OVERFLOW = STEP * 5 // 8

    def __init__(self) -> None:
        self.phase = 0

    def ticks_to_step(self, rate: int) -> int:
        if rate > 0:
            return (self.OVERFLOW - self.phase) // rate + 1
        if rate < 0:
            return (self.OVERFLOW + self.phase) // -rate + 1
        return NEVER

    def run(self, rate: int, ticks: int) -> int:
        self.phase += rate * ticks
        if self.phase > self.OVERFLOW:
            self.phase -= self.STEP
            return 1
        if self.phase < -self.OVERFLOW:
            self.phase += self.STEP
            return -1
        return 0


class ReloadCounter:

    def __init__(self) -> None:
        self.left = 0

    def ticks_to_step(self, speed: int) -> int:
        if speed == 0:
            return NEVER
        if self.left == 0:
            self.left = reload_count(speed)
        return self.left

    def run(self, speed: int, ticks: int) -> bool:
        if speed == 0:
            return False
        self.left -= ticks
        return self.left == 0

    def stop(self) -> None:
        self.left = 0


LAST = 254

FULL_SCALE = 255

SINE = bytes(round(FULL_SCALE * math.sin(math.pi / 2 * i / LAST)) for i in range(LAST + 1))


def sine(index: int) -> int:
    return SINE[index]


def cosine(index: int) -> int:
    return SINE[LAST - index]


def direction(x: int, y: int) -> int:
    low, high = 0, LAST
    while high - low > 1:
        middle = (low + high) >> 1
        if verm(x, sine(middle)) <= verm(y, cosine(middle)):
            low = middle
        else:
            high = middle
    return low if _aside(x, y, low) <= _aside(x, y, high) else high


def _aside(x: int, y: int, index: int) -> int:
    return abs(verm(y, cosine(index)) - verm(x, sine(index)))


def look_up(x: int, y: int, x_direction: int, y_direction: int) -> Displacement:
    x, y, halvings = reduc(x, y)
    if x == y == 0:
        return Displacement(0, 0, 0, x_direction, y_direction, halvings)
    index = direction(x, y)
    return Displacement(cosine(index), sine(index), FULL_SCALE, x_direction, y_direction, halvings)
