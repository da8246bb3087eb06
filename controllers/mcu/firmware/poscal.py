"""POSCAL turns a displacement and a path speed into axis speeds (5.2.1), POSITI counts steps (5.3.1)."""

from __future__ import annotations

from typing import Literal, NamedTuple

from edmsim.controllers.mcu.firmware.arithmetic import WORD, divide, reduc, reduc2, sqrt, square, subsgn, verm
from edmsim.errors import InputError

STEP_UM = 2
"""Table travel of one motor step in um (row T-16)."""

Unit = Literal["um", "step"]
"""What the 16 bits of a position count: um, or steps for a table of twice the travel (row T-61)."""

UNIT_UM: dict[Unit, int] = {"um": 1, "step": STEP_UM}
"""Table travel of one unit of position in um."""


def unit_for(travel_um: float) -> Unit:
    """Unit in which positions on a table fit 16 bits: um up to 65 535 um of travel, steps up to 131 070 um.

    Raises
    ------
    InputError
        If the table is larger still (row T-61).
    """
    for unit, unit_um in UNIT_UM.items():
        if travel_um <= WORD * unit_um:
            return unit
    raise InputError(
        f"a table of {travel_um / 1000:g} mm is too large: 16 bits count {WORD * STEP_UM / 1000:g} mm in steps"
    )


class Displacement(NamedTuple):
    """A displacement vector as VELOCM needs it.

    Attributes
    ----------
    x, y : int
        Components reduced to 8 bits, 0..255.
    length : int
        SQRT of the sum of their squares, 0..256: nine bits (row T-G7).
    x_direction, y_direction : int
        +1 or -1 (rows T-17, T-62).
    halvings : int
        How often the components were halved.
    """

    x: int
    y: int
    length: int
    x_direction: int
    y_direction: int
    halvings: int


def resolve(x: int, y: int, x_direction: int, y_direction: int, literal_wrap: bool = False) -> Displacement:
    """Reduce the magnitudes of a displacement and find its length (the middle of POSCAL, row T-69).

    Parameters
    ----------
    x, y : int
        Magnitudes, 16-bit unsigned.
    x_direction, y_direction : int
        +1 or -1, kept as they are.
    literal_wrap : bool
        True lets the sum of squares wrap at 16 bits, as the thesis' text would; the length is then nonsense
        for a fifth of all vectors (row T-G6). False halves both components once more (row T-A2).
    """
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
    """Split a path speed into signed axis speeds, ``component * speed / length`` (VELOCM, row T-68).

    DIVIDE answers at least 1 for every component that is not 0, so the slow axis never stands still and at
    speeds of 1 and 2 units every oblique path runs at 45 degrees (row T-A4).

    Parameters
    ----------
    displacement : Displacement
    speed : int
        Path speed in units, 0..255.

    Returns
    -------
    (int, int)
        Speeds of x and y in the same units.
    """
    x = divide(verm(displacement.x, speed), displacement.length)
    y = divide(verm(displacement.y, speed), displacement.length)
    return x * displacement.x_direction, y * displacement.y_direction


def poscal(
    position_um: tuple[int, int], target_um: tuple[int, int], speed: int, literal_wrap: bool = False
) -> tuple[int, int]:
    """Axis speeds that lead from one point to another in a straight line (POSCAL, row T-69).

    Parameters
    ----------
    position_um, target_um : (int, int)
        16-bit unsigned coordinates in um.
    speed : int
        Path speed in units, 0..255.
    literal_wrap : bool
        See `resolve`.

    Returns
    -------
    (int, int)
        XVELOC and YVELOC: signed speeds in the same units.
    """
    x, x_direction = subsgn(target_um[0], position_um[0])
    y, y_direction = subsgn(target_um[1], position_um[1])
    return velocm(resolve(x, y, x_direction, y_direction, literal_wrap), speed)


def positi(position: int, direction: int, wrap: bool = False, unit: Unit = "um") -> int:
    """Position counter after one step: 2 um, or 1 step, up or down (POSITI, row T-70).

    The counter assumes that the motor obeys; lost steps stay unseen (row T-19).

    Parameters
    ----------
    position : int
        Counter before the step, 0..65535 units.
    direction : int
        +1 or -1.
    wrap : bool
        True wraps at 16 bits as the machine did; False treats the ends as soft limits (row T-A11).
    unit : {"um", "step"}
        What the counter counts (row T-61).

    Raises
    ------
    InputError
        If the step would leave 0..65535 units and `wrap` is False.
    """
    moved = position + STEP_UM // UNIT_UM[unit] * direction
    if wrap:
        return moved & WORD
    if not 0 <= moved <= WORD:
        unit_um = UNIT_UM[unit]
        raise InputError(
            f"soft limit: a step to {moved * unit_um} um would leave the table's 0..{WORD * unit_um} um"
        )
    return moved
