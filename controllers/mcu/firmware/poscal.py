"""POSCAL converts a displacement and a path speed to axis speeds (5.2.1), POSITI counts steps (5.3.1)."""

import math
from typing import Literal, NamedTuple

import numpy as np

from edmsim.compiled.jit import exactly_compiled
from edmsim.errors import InputError

# The integer routines of the 1982 controller: 8 and 16 bit, no floating point.
# Their names SUBSGN, REDUC, REDUC2, VERM, SQUARE, DIVIDE and SQRT are those of the thesis (5.2). Where its text
# contradicts itself, the routine states our solution. All but VERM are compiled, because the planners call them in
# compiled code; the computer of 1982 calls them from Python.

WORD = 0xFFFF  # greatest 16-bit number: all numbers of the controller have 16 bits (row T-60)

BYTE = 0xFF  # greatest 8-bit number, for operands of VERM (row T-64)


@exactly_compiled
def subsgn(a: int, b: int) -> tuple[int, int]:
    """Return ``|a - b|`` of two words, and +1 if ``a >= b``, else -1 (SUBSGN, row T-62)."""
    return (a - b, 1) if a >= b else (b - a, -1)


@exactly_compiled
def reduc(a: int, b: int) -> tuple[int, int, int]:
    """Halve two words together until both have 8 bits; return them and the number of halvings (REDUC, T-63, T-A2)."""
    halvings = 0
    while (a | b) >> halvings > BYTE:
        halvings += 1
    return a >> halvings, b >> halvings, halvings


@exactly_compiled
def reduc2(a: int, b: int) -> tuple[int, int]:
    """Halve both once more if the sum of their squares exceeds 16 bits (REDUC2, row T-A2)."""
    return a >> 1, b >> 1


def verm(a: int, b: int) -> int:
    """Return the exact 16-bit product of two bytes (VERM, row T-64); compiled code multiplies directly."""
    if not (0 <= a <= BYTE and 0 <= b <= BYTE):
        raise InputError(f"VERM multiplies 8-bit numbers 0..255, not {a} and {b}")
    return a * b


def square(a: int) -> int:
    """Return the square of an 8-bit number (SQUARE, row T-65)."""
    return verm(a, a)


@exactly_compiled
def divide(dividend: int, divisor: int) -> int:
    """Divide 16 by 16 bits: double the divisor until it is greater, then halve and subtract (DIVIDE, row T-66).

    The doubled divisor is up to 131 070 and needs a 17th bit. The text exchanges dividend and divisor (row T-A3):
    read literally, every square root from 4 up would be 2. Returns 0 if an operand is 0; 1 if the quotient of two
    non-zero numbers would be 0; otherwise the floor.
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
    """Return the square root of a word by Newton-Raphson in integers, 0..256 (SQRT, row T-67).

    If ``k`` is the floor of the root, the result is ``k + 1`` from ``n = k*k + k`` up, otherwise ``k`` (row T-G2).
    ``n + 1`` wraps at 16 bits as in the machine: 65 535 gives 0, but no sum of two squares is 65 535 (row T-G3).
    """
    x, following = n, ((n + 1) & WORD) >> 1
    while x != following:
        x = following
        following = (divide(n, x) + x + 1) >> 1
    return x


STEP_UM = 2  # table travel in um per motor step of the machine of 1982 (row T-16)

Unit = Literal["um", "step"]
"""Unit of a 16-bit position: um, or steps for a table of more travel (row T-61)."""

OFF_TABLE = -1  # result of `counted` at a soft limit


def unit_um(unit: Unit, step_um: int = STEP_UM) -> int:
    """Return the table travel of one unit of position in um."""
    return step_um if unit == "step" else 1


def unit_for(travel_um: float, step_um: int = STEP_UM) -> Unit:
    """Return the unit for 16-bit positions on a table: um up to 65 535 um of travel, otherwise steps (row T-61)."""
    if travel_um <= WORD:
        return "um"
    if travel_um <= WORD * step_um:
        return "step"
    raise InputError(
        f"a table of {travel_um / 1000:g} mm is too large: 16 bits count {WORD * step_um / 1000:g} mm in steps; "
        "the planner exact has no such limit"
    )


def check_1982(step_um: float) -> None:
    """Refuse a machine whose motor steps are not 2 um, those of the controller of 1982 (row T-16)."""
    if step_um != STEP_UM:
        raise InputError(
            f"the machine's table.step_um is {step_um:g}, and the controller of 1982 is built for motor steps of "
            f"{STEP_UM} um: give it a machine with table.step_um = {STEP_UM}, or cut with another controller"
        )


class Displacement(NamedTuple):
    """A displacement vector for VELOCM."""

    x: int  # component reduced to 8 bits, 0..255
    y: int
    length: int  # SQRT of the sum of the squares, 0..256: nine bits (row T-G7)
    x_direction: int  # +1 or -1 (rows T-17, T-62)
    y_direction: int
    halvings: int  # number of halvings of the components


@exactly_compiled
def resolve(x: int, y: int, x_direction: int, y_direction: int, literal_wrap: bool = False) -> Displacement:
    """Reduce the magnitudes (words) of a displacement and find its length (the middle of POSCAL, row T-69).

    With `literal_wrap` the sum of squares wraps at 16 bits, as by the thesis' text; the length is then wrong for a
    fifth of all vectors (row T-G6). Otherwise both components are halved once more (row T-A2).
    """
    x, y, halvings = reduc(x, y)
    total = x * x + y * y
    if total > WORD:
        if literal_wrap:
            total &= WORD
        else:
            x, y = reduc2(x, y)
            halvings += 1
            total = x * x + y * y
    return Displacement(x, y, sqrt(total), x_direction, y_direction, halvings)


@exactly_compiled
def velocm(displacement: Displacement, speed: int) -> tuple[int, int]:
    """Divide a path speed (0..255) into signed axis speeds, ``component * speed / length`` (VELOCM, row T-68).

    DIVIDE returns at least 1 for every component that is not 0. So the slow axis never stops, and at speeds of 1 and
    2 units every oblique path runs at 45 degrees (row T-A4).
    """
    x = divide(displacement.x * speed, displacement.length)
    y = divide(displacement.y * speed, displacement.length)
    return x * displacement.x_direction, y * displacement.y_direction


@exactly_compiled
def poscal(
    position_um: tuple[int, int], target_um: tuple[int, int], speed: int, literal_wrap: bool = False
) -> tuple[int, int]:
    """Return the axis speeds XVELOC and YVELOC of a straight move between points (words, um) (POSCAL, row T-69)."""
    x, x_direction = subsgn(target_um[0], position_um[0])
    y, y_direction = subsgn(target_um[1], position_um[1])
    return velocm(resolve(x, y, x_direction, y_direction, literal_wrap), speed)


@exactly_compiled
def counted(position: int, units: int, wrap: bool) -> int:
    """Return the position counter after a change, wrapped at 16 bits; `OFF_TABLE` if it must not wrap."""
    moved = position + units
    if wrap:
        return moved & WORD
    return moved if 0 <= moved <= WORD else OFF_TABLE


def positi(position: int, direction: int, wrap: bool = False, unit: Unit = "um") -> int:
    """Return the position counter after a step of 2 um or 1 unit (POSITI, row T-70), lost or not (row T-19).

    It wraps at 16 bits as in the machine, or refuses at the ends as soft limits (row T-A11).
    """
    size_um = unit_um(unit)
    units = STEP_UM // size_um * direction
    moved = counted(position, units, wrap)
    if moved == OFF_TABLE:
        raise soft_limit((position + units) * size_um, size_um)
    return moved


def soft_limit(place_um: float, size_um: float) -> InputError:
    """Return the error of a step that would overflow 16 bits in units of this size."""
    return InputError(f"soft limit: a step to {place_um:g} um would leave the table's 0..{WORD * size_um:g} um")


# The sine table that the thesis advises instead of the square root (6.3, row T-72).
# A quarter turn has 255 entries of 8 bits: entry ``i`` is the sine of ``i / 254`` of 90 degrees, entry ``254 - i``
# its cosine. The nearest entry has an error of up to 0.5 % of full scale (row T-A7). The machine has no arc tangent:
# it finds the entry of a direction by bisection, with two products of VERM at each of eight comparisons. These
# replace the eleven divisions of SQRT.

LAST = 254  # index of the last entry, 90 degrees: 255 entries in all (row T-72)

FULL_SCALE = 255  # entry of a sine of 1: 8 bits (row T-72)

SINE = bytes(round(FULL_SCALE * math.sin(math.pi / 2 * i / LAST)) for i in range(LAST + 1))
"""Return the table as stored in the EPROM."""

_ENTRIES = np.frombuffer(SINE, np.uint8).astype(np.int64)


@exactly_compiled
def _nearest(x: int, y: int) -> int:
    """Return the index of the entry nearest to the direction of 8-bit magnitudes, 0 (x) to 254 (y)."""
    low, high = 0, LAST
    while high - low > 1:
        middle = (low + high) >> 1
        if x * _ENTRIES[middle] <= y * _ENTRIES[LAST - middle]:
            low = middle
        else:
            high = middle
    return low if _aside(x, y, low) <= _aside(x, y, high) else high


@exactly_compiled
def _aside(x: int, y: int, index: int) -> int:
    """Return 255 times the component of a vector perpendicular to an entry's direction."""
    return int(abs(y * _ENTRIES[LAST - index] - x * _ENTRIES[index]))


@exactly_compiled
def look_up(x: int, y: int, x_direction: int, y_direction: int) -> Displacement:
    """Return a vector of length 255 (or 0) in a displacement's direction: `resolve` without a square root."""
    x, y, halvings = reduc(x, y)
    if x == y == 0:
        return Displacement(0, 0, 0, x_direction, y_direction, halvings)
    index = _nearest(x, y)
    return Displacement(
        int(_ENTRIES[LAST - index]), int(_ENTRIES[index]), FULL_SCALE, x_direction, y_direction, halvings
    )
