"""Time on the machine of 1982: durations of its routines, and times of steps from axis speeds.

Times are integer nanoseconds; the common clock of the steps is an exact rational number, so they do not drift and do
not depend on windows. It is counted down in two ways.
"""

from fractions import Fraction

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.mcu.firmware.poscal import STEP_UM, WORD, resolve
from edmsim.errors import InputError

# Estimated T-states of the routines on the 8085, because the document has no listings. Each number is our count for
# the shortest loop of the routine, with the instruction times of the 8085 (MOV 4, DAD 10, INX 6, LHLD and SHLD 16,
# CALL 18, RET 10, a jump 10 or 7):
# * VERM: eight rounds of a shift of the multiplier, a shift of the sum and half an addition, some 45 T each.
# * MULTIPLY (16 x 16 bits to two words): sixteen rounds on three register pairs, 95 T each.
# * FRACTION (16 bits of a quotient below 1): sixteen rounds of shift, compare and subtract, 115 T each.
# * DIVIDE: 50 T for every doubling of the divisor, 120 T for every halving with its subtraction: 170 T per bit.
# * SQRT: DIVIDE, an addition, a shift and a comparison in every pass.
# POSCAL's cost depends on the vector; `poscal_t_states` follows its path through REDUC, SQRT and both DIVIDEs.

CPU_HZ = 3_072_000  # clock of the 8085: half of a 6.144 MHz crystal (row T-77, an assumption)

VERM_T = 430
MULTIPLY_T = 1580
FRACTION_T = 1900
DIVIDE_T = 80
DIVIDE_BIT_T = 170
SQRT_PASS_T = 120
SUBSGN_T = 80
HALVING_T = 60
ADD_T = 60  # addition, subtraction or comparison of words in memory, with the loads and stores around it
POSCAL_FRAME_T = 250  # POSCAL's own calls, saves, and the stores to XVELOC and YVELOC
READ_OUT_T = 150  # polling port 3C, reading both counters at 4030H and 4031H, reading the clock
POSITI_T = 130
ENTRY_T, LOAD_T, PULSE_T, RETURN_T = 100, 80, 70, 50
"""The stepper interrupt routine without POSITI, in order: acknowledge, save and read the speed; its count from a
table of 127 words to the timer; direction and pulse to port 2C; compare with the target, restore and return."""
INIT_T = 1500
EMERGENCY_T = 900
KEYBOARD_T = 250  # the routine of the keyboard interrupt: one word from the 8279 into the buffer
POSCAL_BOUND_T = 18_000
"""Greatest cost of POSCAL, proved by a test over all reduced vectors. The optimising routine assumes it."""


def seconds(t_states: int) -> float:
    """Return the duration of a number of T-states in s."""
    return t_states / CPU_HZ


def nanoseconds(t_states: int) -> int:
    """Return the duration of a number of T-states in whole ns, rounded down."""
    return t_states * 1_000_000_000 // CPU_HZ


def divide_t_states(dividend: int, divisor: int) -> int:
    """Return the cost of a DIVIDE from the bits of its quotient."""
    quotient = dividend // divisor if divisor else 0
    return DIVIDE_T + DIVIDE_BIT_T * quotient.bit_length()


def sqrt_t_states(n: int) -> int:
    """Return the cost of a SQRT, pass by pass as in row T-67."""
    cost = x = 0
    following = ((n + 1) & WORD) >> 1
    x = n
    while x != following:
        x = following
        cost += SQRT_PASS_T + divide_t_states(n, x)
        following = ((n // x if x else 0) + x + 1) >> 1
    return cost


def poscal_t_states(dx: int, dy: int, speed: int) -> int:
    """Return the cost of a POSCAL for magnitudes in um (words) and a path speed of 0..255 units."""
    x, y, *_, halvings = resolve(dx, dy, 1, 1)
    total = x * x + y * y
    length = round(total**0.5)
    return (
        POSCAL_FRAME_T + 2 * SUBSGN_T + halvings * HALVING_T + 4 * VERM_T + ADD_T + sqrt_t_states(total)
        + divide_t_states(x * speed, length) + divide_t_states(y * speed, length)
    )  # fmt: skip


TIMER_COUNT = 65_536  # counts of the 16-bit 8253 per step at a speed of one unit (row T-74)

SPEED_UNIT_NM_S = 262.5
"""Speed unit in nm/s: 15.75 um/min, for 2 mm/min in 7 bits (row T-A1; the text prints 252.6)."""

MAX_SPEED = 127  # largest path speed in units (row T-A1)

MAX_FEED_UM_S = MAX_SPEED * SPEED_UNIT_NM_S / 1000  # largest path speed in um/s: 33.3375, or 2 mm/min (row T-A1)

NEVER = 1 << 62  # ticks of an axis that does not move

STEP_PHASE = TIMER_COUNT << 7  # phase of one motor step; every tick adds the axis speed in units / 128

OVERFLOW = STEP_PHASE * 5 // 8  # phase at which an axis steps (see `run_phase`)

_SECOND_NS = 1_000_000_000
_MOST_HERTZ = 4_000_000_000


def timer_clock_hz(speed_unit_nm_s: float, step_um: float = STEP_UM) -> Fraction:
    """Return the clock (row T-75) for one step per 65 536 ticks at one unit (row T-74): 43008/5 Hz at 262.5 nm/s."""
    if not speed_unit_nm_s > 0:
        raise InputError(f"the speed unit must be above 0 nm/s (the controller has 262.5), not {speed_unit_nm_s}")
    # both are decimal numbers such as 252.6; binary fractions would give huge numerators and denominators
    unit, step = (Fraction(number).limit_denominator(1000) for number in (speed_unit_nm_s, step_um))
    hertz = TIMER_COUNT * unit / (step * 1000)
    if max(hertz.numerator, hertz.denominator) > _MOST_HERTZ:
        raise InputError(f"a speed unit of {speed_unit_nm_s} nm/s gives a clock of {hertz} Hz: choose a rounder one")
    return hertz


@exactly_compiled
def reload_count(speed: int) -> int:
    """Return the reload value of the 8253 for an axis speed of at least 1 unit: 65 536 div speed (row T-76)."""
    return TIMER_COUNT // speed


@exactly_compiled
def tick_before(time_ns: int, hertz: int, per: int) -> int:
    """Return the index of the last tick before a time; ``before(a) + 1 .. before(b)`` are in ``a <= t < b``."""
    seconds = (time_ns - 1) // _SECOND_NS
    rest_ns = time_ns - 1 - seconds * _SECOND_NS
    ticks = seconds * hertz // per
    left = seconds * hertz - ticks * per
    return ticks + (left * _SECOND_NS + rest_ns * hertz) // (per * _SECOND_NS)


@exactly_compiled
def tick_time_ns(tick: int, hertz: int, per: int) -> int:
    """Return the time of a tick: this number of periods after time 0, rounded up to whole ns."""
    seconds = tick * per // hertz
    left = tick * per - seconds * hertz
    return seconds * _SECOND_NS - (-left * _SECOND_NS // hertz)


@exactly_compiled
def ticks_to_overflow(phase: int, rate: int) -> int:
    """Return the ticks until the step of an axis with this phase, at a signed rate in units / 128; or `NEVER`."""
    if rate > 0:
        return (OVERFLOW - phase) // rate + 1
    if rate < 0:
        return (OVERFLOW + phase) // -rate + 1
    return NEVER


@exactly_compiled
def run_phase(phase: int, rate: int, ticks: int) -> tuple[int, int]:
    """Advance an accumulator by at most `ticks_to_overflow` ticks; return its phase, and the step: +1, -1 or 0.

    The phase is the lead of the commanded position over the counter. Every tick adds the axis speed, so a new speed
    has effect at once and the fraction of a step is kept. Seven bits below the unit are for the axis speeds of slow
    paths. The overflow is a quarter of a half step beyond it, so a path exactly between two motor positions does not
    make the motor oscillate.
    """
    phase += rate * ticks
    if phase > OVERFLOW:
        return phase - STEP_PHASE, 1
    if phase < -OVERFLOW:
        return phase + STEP_PHASE, -1
    return phase, 0


@exactly_compiled
def loaded(left: int, speed: int) -> int:
    """Return the ticks until a channel of the 8253 interrupts: the rest, or at 0 the next load (row T-76)."""
    return reload_count(speed) if left == 0 else left
