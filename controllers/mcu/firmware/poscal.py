"""POSCAL turns a displacement and a path speed into axis speeds (5.2.1), POSITI counts steps (5.3.1)."""

from __future__ import annotations

from typing import Literal, NamedTuple

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.mcu.firmware.arithmetic import WORD, divide, reduc, reduc2, sqrt, subsgn
from edmsim.errors import InputError

STEP_UM = 2  # table travel in um of one motor step of the machine of 1982 (row T-16)

Unit = Literal["um", "step"]
"""What the 16 bits of a position count: um, or steps for a table of more travel (row T-61)."""

OFF_TABLE = -1  # what `counted` returns at a soft limit


def unit_um(unit: Unit, step_um: int = STEP_UM) -> int:
    """Table travel of one unit of position in um."""
    return step_um if unit == "step" else 1


def unit_for(travel_um: float, step_um: int = STEP_UM) -> Unit:
    """Unit in which positions on a table fit 16 bits: um up to 65 535 um of travel, else steps (row T-61)."""
    if travel_um <= WORD:
        return "um"
    if travel_um <= WORD * step_um:
        return "step"
    raise InputError(
        f"a table of {travel_um / 1000:g} mm is too large: 16 bits count {WORD * step_um / 1000:g} mm in steps"
    )


def check_1982(step_um: float) -> None:
    """Refuse a machine whose motor steps are not the 2 um that the controller of 1982 is built for (row T-16)."""
    if step_um != STEP_UM:
        raise InputError(
            f"the machine's table.step_um is {step_um:g}, and the controller of 1982 is built for motor steps of "
            f"{STEP_UM} um: give it a machine with table.step_um = {STEP_UM}, or cut with another controller"
        )


class Displacement(NamedTuple):
    """A displacement vector as VELOCM needs it."""

    x: int  # component reduced to 8 bits, 0..255
    y: int
    length: int  # SQRT of the sum of their squares, 0..256: nine bits (row T-G7)
    x_direction: int  # +1 or -1 (rows T-17, T-62)
    y_direction: int
    halvings: int  # how often the components were halved


@exactly_compiled
def resolve(x: int, y: int, x_direction: int, y_direction: int, literal_wrap: bool = False) -> Displacement:
    """Reduce the magnitudes (words) of a displacement and find its length (the middle of POSCAL, row T-69).

    With `literal_wrap` the sum of squares wraps at 16 bits, as the thesis' text would; the length is then nonsense
    for a fifth of all vectors (row T-G6). Without, both components are halved once more (row T-A2).
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
    """Split a path speed (0..255) into axis speeds of its sign, ``component * speed / length`` (VELOCM, row T-68).

    DIVIDE answers at least 1 for every component that is not 0, so the slow axis never stands still and at
    speeds of 1 and 2 units every oblique path runs at 45 degrees (row T-A4).
    """
    x = divide(displacement.x * speed, displacement.length)
    y = divide(displacement.y * speed, displacement.length)
    return x * displacement.x_direction, y * displacement.y_direction


@exactly_compiled
def poscal(
    position_um: tuple[int, int], target_um: tuple[int, int], speed: int, literal_wrap: bool = False
) -> tuple[int, int]:
    """Axis speeds that lead from one point (words, um) straight to another: XVELOC and YVELOC (POSCAL, row T-69)."""
    x, x_direction = subsgn(target_um[0], position_um[0])
    y, y_direction = subsgn(target_um[1], position_um[1])
    return velocm(resolve(x, y, x_direction, y_direction, literal_wrap), speed)


@exactly_compiled
def counted(position: int, units: int, wrap: bool) -> int:
    """Position counter after some units more or less, wrapped at 16 bits; `OFF_TABLE` if it must not wrap."""
    moved = position + units
    if wrap:
        return moved & WORD
    return moved if 0 <= moved <= WORD else OFF_TABLE


def positi(position: int, direction: int, wrap: bool = False, unit: Unit = "um") -> int:
    """Position counter after a step of 2 um or 1 unit (POSITI, row T-70); lost steps stay unseen (row T-19).

    It wraps at 16 bits as the machine did, or takes the ends as soft limits and refuses (row T-A11).
    """
    size_um = unit_um(unit)
    units = STEP_UM // size_um * direction
    moved = counted(position, units, wrap)
    if moved == OFF_TABLE:
        raise soft_limit((position + units) * size_um, size_um)
    return moved


def soft_limit(place_um: float, size_um: float) -> InputError:
    """Error of a step that would leave what 16 bits count in units of that size."""
    return InputError(f"soft limit: a step to {place_um:g} um would leave the table's 0..{WORD * size_um:g} um")
