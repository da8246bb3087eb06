"""A planner's data in compiled code: a row of numbers and the corners of its path."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.mcu.firmware.arithmetic import WORD
from edmsim.controllers.mcu.firmware.poscal import Displacement, counted
from edmsim.controllers.mcu.firmware.timers import tick_time_ns

POSCAL, LITERAL, DDA, SINE_TABLE, EXACT = range(5)  # kinds of planners

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Row = Any  # one row of `PLANNER`; compiled code writes to it

PLANNER = np.dtype(
    [
        ("kind", "i8"),  # one of the five above
        ("last_move", "i8"),  # index of the path's last straight move
        ("unit_um", "i8"),  # travel of one unit of position
        ("hertz", "i8"),  # the clock is hertz / per
        ("per", "i8"),
        ("step_um", "f8"),  # travel of a motor step
        ("from_um", "f8", 2),  # where the planner began
        # what changes while it runs, see `CHANGES`
        ("move", "i8"),  # the one the wire is on
        ("counter", "i8", 2),  # steps made, those back deducted
        ("along", "i8"),  # length run in 1 / 10^12 um (`EXACT`), or within the move in step_um / 65536 (`DDA`)
        ("timer", "i8", 2),  # to the next step: an accumulator's phase, or ticks left of a reload counter (`LITERAL`)
        ("rate", "i8", 2),  # axis speeds in units / 128
        ("aim", "i8", 5),  # fields of the `Displacement` they come from, but its halvings
        ("carrot_is_end", "i8"),  # whether that leads to the move's end
        ("heading", "i8"),  # of the last command
        ("speed", "i8"),  # of the last command, in units
    ]
)
"""Numbers of one planner."""

CHANGES = ("move", "counter", "along", "timer", "rate", "aim", "carrot_is_end", "heading", "speed")
"""Fields that change while a planner runs."""

LIMIT = -1  # what is returned in place of a number of steps if one would leave what the counters count


@exactly_compiled
def place_um(row: Row, axis: int) -> int:
    """Position counter of an axis in whole um; that of `LITERAL` wraps at 16 bits."""
    place = int(row.from_um[axis]) + int(row.step_um) * row.counter[axis]
    if row.kind == LITERAL:
        return int(counted(place // row.unit_um, 0, True) * row.unit_um)
    return int(place)


@exactly_compiled
def position_um(row: Row, axis: int) -> float:
    """Position counter of an axis in um, whatever its steps are."""
    if row.kind == LITERAL:
        return float(place_um(row, axis))
    return float(row.from_um[axis] + row.step_um * row.counter[axis])


@exactly_compiled
def count(row: Row, axis: int, direction: int) -> bool:
    """Count a step; False if it would leave what 16 bits count and the counter does not wrap."""
    row.counter[axis] += direction
    return bool(row.kind == LITERAL or 0 <= position_um(row, axis) <= WORD * row.unit_um)


@exactly_compiled
def note(row: Row, out: Ints, made: int, tick: int, axis: int, direction: int) -> int:
    """Write a step behind those made, if there is room; return how many there are."""
    if made < out.shape[0]:
        out[made, 0], out[made, 1], out[made, 2] = tick_time_ns(tick, row.hertz, row.per), axis, direction
    return made + 1


@exactly_compiled
def aim_at(row: Row, way: Displacement) -> None:
    """Keep the vector that leads on."""
    row.aim[0], row.aim[1], row.aim[2] = way.x, way.y, way.length
    row.aim[3], row.aim[4] = way.x_direction, way.y_direction


@exactly_compiled
def aimed(row: Row) -> Displacement:
    """Return the vector kept."""
    return Displacement(row.aim[0], row.aim[1], row.aim[2], row.aim[3], row.aim[4], 0)


