"""The integer routines of the 1982 controller: 8 and 16 bit, no floating point.

Their names SUBSGN, REDUC, REDUC2, VERM, SQUARE, DIVIDE and SQRT are the thesis' (5.2). Where its text
contradicts itself, the routine states our solution. All but VERM are compiled: the planners call them in
compiled code, the computer of 1982 from Python.
"""

from __future__ import annotations

from edmsim.compiled.jit import exactly_compiled
from edmsim.errors import InputError

WORD = 0xFFFF  # largest 16-bit number: every number of the controller has 16 bits (row T-60)

BYTE = 0xFF  # largest 8-bit number, the operands of VERM (row T-64)


@exactly_compiled
def subsgn(a: int, b: int) -> tuple[int, int]:
    """Return ``|a - b|`` of two words, and +1 if ``a >= b``, else -1 (SUBSGN, row T-62)."""
    return (a - b, 1) if a >= b else (b - a, -1)


@exactly_compiled
def reduc(a: int, b: int) -> tuple[int, int, int]:
    """Halve two words together until both fit in 8 bits; returns them and how often (REDUC, rows T-63, T-A2)."""
    halvings = 0
    while (a | b) >> halvings > BYTE:
        halvings += 1
    return a >> halvings, b >> halvings, halvings


@exactly_compiled
def reduc2(a: int, b: int) -> tuple[int, int]:
    """Halve both once more, when the sum of their squares carries out of 16 bits (REDUC2, row T-A2)."""
    return a >> 1, b >> 1


def verm(a: int, b: int) -> int:
    """8 x 8 bit product of 16 bits, exact (VERM, row T-64); compiled code, whose bytes are bytes, multiplies."""
    if not (0 <= a <= BYTE and 0 <= b <= BYTE):
        raise InputError(f"VERM multiplies 8-bit numbers 0..255, not {a} and {b}")
    return a * b


def square(a: int) -> int:
    """Square of an 8-bit number (SQUARE, row T-65)."""
    return verm(a, a)


@exactly_compiled
def divide(dividend: int, divisor: int) -> int:
    """16 / 16 bit division: double the divisor until larger, then halve and subtract (DIVIDE, row T-66).

    The doubled divisor reaches 131 070 and so needs a 17th bit. The text exchanges the words for dividend
    and divisor (row T-A3): read literally every square root from 4 up would be 2. Returns 0 if either operand is 0;
    1 where the quotient of two non-zero numbers would be 0; else the floor.
    """
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
    return quotient if quotient > 0 else 1


@exactly_compiled
def sqrt(n: int) -> int:
    """Square root of a word by Newton-Raphson in integers, 0..256 (SQRT, row T-67).

    With ``k`` the floor of the root it is ``k + 1`` from ``n = k*k + k`` up, else ``k`` (row T-G2). ``n + 1`` wraps
    at 16 bits as in the machine: 65 535 gives 0, but no sum of two squares is 65 535 (row T-G3).
    """
    x, following = n, ((n + 1) & WORD) >> 1
    while x != following:
        x = following
        following = (divide(n, x) + x + 1) >> 1
    return x
