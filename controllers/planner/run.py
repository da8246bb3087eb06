"""Every kind of planner behind one compiled call."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

from numba import boolean, float64, from_dtype, int64

from edmsim.compiled.jit import exactly_compiled
from edmsim.compiled.numba_internals import address_of, call_returning
from edmsim.controllers.mcu.firmware.timers import tick_before
from edmsim.controllers.planner.dda import dda_path_um, run_dda
from edmsim.controllers.planner.exact import FINE_PER_UM, path_end, run_exact
from edmsim.controllers.planner.poscal import begin_literal, begin_poscal, literal_done, near, run_literal, run_poscal
from edmsim.controllers.planner.record import (
    DDA,
    EXACT,
    LITERAL,
    PLANNER,
    POSCAL,
    SINE_TABLE,
    Floats,
    Ints,
    Row,
    place_um,
)


@exactly_compiled
def begin(row: Row, points: Floats) -> None:
    """Aim along the path from its start."""
    if row.kind in (POSCAL, SINE_TABLE):
        begin_poscal(row, points)
    elif row.kind == LITERAL:
        begin_literal(row, points)


@exactly_compiled
def advance(
    row: Row, points: Floats, along: Floats, lengths: Ints, start_ns: int, end_ns: int, speed: int, out: Ints
) -> int:
    """Run a planner for a window; writes time in ns, axis and direction of each step to `out` (room, 3).

    Returns the number of steps, also where there was no room for all; `LIMIT` if one would leave the counters' range.
    More rows of `points` and `along` than the path has do no harm.
    """
    if row.kind == EXACT:
        return run_exact(row, points, along, start_ns, end_ns, speed, out)
    if speed == 0:
        return 0
    tick, last = tick_before(start_ns, row.hertz, row.per), tick_before(end_ns, row.hertz, row.per)
    if row.kind == LITERAL:
        return run_literal(row, points, tick, last, speed, out)
    if row.kind == DDA:
        return run_dda(row, points, lengths, tick, last, speed, out)
    return run_poscal(row, points, tick, last, speed, out)


@exactly_compiled
def done(row: Row, points: Floats, along: Floats, lengths: Ints) -> bool:
    """Whether the path's end is reached."""
    if row.kind == EXACT:
        return bool(row.along >= path_end(row, along))
    if row.kind == LITERAL:
        return literal_done(row, points)
    if row.kind == DDA:
        return bool(row.move == row.last_move and row.along == lengths[row.last_move])
    return bool(row.move == row.last_move and near(row, points, row.last_move + 1))


@exactly_compiled
def path_um(row: Row, points: Floats, along: Floats) -> float:
    """Length travelled along the path, for counters that stray from it at the foot of their position."""
    if row.kind == EXACT:
        return float(row.along / FINE_PER_UM)
    if row.kind == DDA:
        return dda_path_um(row, along)
    x0, y0 = int(points[row.move, 0]), int(points[row.move, 1])
    x1, y1 = int(points[row.move + 1, 0]), int(points[row.move + 1, 1])
    length = along[row.move + 1] - along[row.move]
    run = ((place_um(row, 0) - x0) * (x1 - x0) + (place_um(row, 1) - y0) * (y1 - y0)) / length
    return float(along[row.move] + min(max(run, 0.0), length))


class Addresses(NamedTuple):
    """Where the machine code of planners is, in this process only."""

    advance: int
    path_um: int
    done: int


@functools.cache
def addresses() -> Addresses:
    """Return the addresses for `advance_at` and its neighbours."""
    path = from_dtype(PLANNER), float64[:, ::1], float64[::1]
    lengths, ints = int64[::1], int64[:, ::1]
    return Addresses(
        address_of(advance, *path, lengths, int64, int64, int64, ints),
        address_of(path_um, *path),
        address_of(done, *path, lengths),
    )


advance_at: Callable[..., int] = call_returning(int64)
"""In compiled code, call `advance` by its address with a tuple of its arguments. Planners are thousands of lines of
LLVM's, which are then not compiled again for each function that calls them."""
path_um_at: Callable[..., float] = call_returning(float64)
done_at: Callable[..., bool] = call_returning(boolean)
