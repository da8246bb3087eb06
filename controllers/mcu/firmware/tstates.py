"""Estimated T-states of the routines on the 8085, which give the simulated machine its response times.

The document has no listings. Each figure is our count for the shortest loop that we would write for the routine,
with the instruction times of the 8085 (MOV 4, DAD 10, INX 6, LHLD and SHLD 16, CALL 18, RET 10, a jump 10 or 7):

* VERM: eight rounds of a shift of the multiplier, a shift of the sum and half an addition, some 45 T each.
* MULTIPLY (16 x 16 bits to two words): sixteen rounds on three register pairs, 95 T each.
* FRACTION (16 bits of a quotient below 1): sixteen rounds of shift, compare and subtract, 115 T each.
* DIVIDE: 50 T for every doubling of the divisor, 120 T for every halving with its subtraction, so 170 T for every bit
  of the quotient.
* SQRT: DIVIDE, an addition, a shift and a comparison in every pass.

POSCAL's cost depends on the vector; `poscal_t_states` follows its path through REDUC, SQRT and both DIVIDEs.
"""

from __future__ import annotations

from edmsim.controllers.mcu.firmware.arithmetic import WORD, reduc, reduc2

CPU_HZ = 3_072_000  # clock of the 8085: half of a 6.144 MHz crystal (row T-77, assumed there)

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
"""The stepper interrupt routine without POSITI, in its order: acknowledge, save and read the speed; its count from a
table of 127 words to the timer; direction and pulse to port 2C; compare with the target, restore and return."""
INIT_T = 1500
EMERGENCY_T = 900
KEYBOARD_T = 250  # the routine of the keyboard interrupt: one word from the 8279 into the buffer
POSCAL_BOUND_T = 18_000
"""No POSCAL costs more; a test goes through all reduced vectors. The optimising routine counts with it."""


def seconds(t_states: int) -> float:
    """Time that a number of T-states takes, in s."""
    return t_states / CPU_HZ


def nanoseconds(t_states: int) -> int:
    """Time that a number of T-states takes, in whole ns, rounded down."""
    return t_states * 1_000_000_000 // CPU_HZ


def divide_t_states(dividend: int, divisor: int) -> int:
    """Cost of one DIVIDE: by the bits of its quotient."""
    quotient = dividend // divisor if divisor else 0
    return DIVIDE_T + DIVIDE_BIT_T * quotient.bit_length()


def sqrt_t_states(n: int) -> int:
    """Cost of one SQRT, pass by pass as in row T-67."""
    cost = x = 0
    following = ((n + 1) & WORD) >> 1
    x = n
    while x != following:
        x = following
        cost += SQRT_PASS_T + divide_t_states(n, x)
        following = ((n // x if x else 0) + x + 1) >> 1
    return cost


def poscal_t_states(dx: int, dy: int, speed: int) -> int:
    """Cost of one POSCAL for magnitudes in um (words) and a path speed of 0..255 units."""
    x, y, halvings = reduc(dx, dy)
    if x * x + y * y > WORD:
        x, y = reduc2(x, y)
        halvings += 1
    total = x * x + y * y
    length = round(total**0.5)
    return (
        POSCAL_FRAME_T + 2 * SUBSGN_T + halvings * HALVING_T + 4 * VERM_T + ADD_T + sqrt_t_states(total)
        + divide_t_states(x * speed, length) + divide_t_states(y * speed, length)
    )  # fmt: skip
