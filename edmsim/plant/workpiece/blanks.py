"""Workpieces before the cut: a block in front of the wire, a slot, a wavy wall. Measuring the wall of a pass."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.plant.kernel.state import TILE
from edmsim.plant.workpiece.height_steps import LowerRegion
from edmsim.plant.workpiece.kerf_field import FULL, KerfField, Stock

SLOT_UM = 400.0  # length of the slot behind the wire (ours: beyond the range of rays)
SLOT_GAP_UM = 30.0  # gap around the wire at the slot's end (ours: slightly wider than the front gap of cuts)
BLOCK_UM = 1000.0  # length of a wavy wall before and after the needed part (ours: beyond the range of rays)
_SCALLOP_UM = 20.0  # spacing of the holes that form a slot: their cusps are below 0.5 um
_FRONT_GAP_UM = 30.0  # gap between the wire and a block in front of it (ours)


def block_in_front(machine: Machine, x_um: float) -> Stock:
    """Return a block that covers the rest of the table, with a straight edge just in front of a wire at `x_um`."""
    travel_um = machine.base.table.travel_mm.value * 1e3
    return Stock((x_um + machine.wire_diameter_um / 2 + _FRONT_GAP_UM, 0.0, travel_um, travel_um))


def wavy_wall(
    wall_um: tuple[float, float], length_um: float, wave_um: float, spacing_um: float, shift_um: float
) -> Stock:
    """Return a block whose upper edge along +x is a row of shallow arcs, as a coarse pass may leave it."""
    # `wall_um` is the middle between the deepest and the highest points of the waves, `wave_um` the distance from the
    # bottom of an arc to the ridge between two, `shift_um` the beginning of the arcs in x.
    x, y = wall_um
    radius = spacing_um**2 / (8 * wave_um)
    centres = np.arange(x - BLOCK_UM + shift_um, x + length_um + BLOCK_UM, spacing_um)
    holes = tuple((float(c), y - wave_um / 2 + radius, radius) for c in centres)
    return Stock((x - BLOCK_UM, 0.0, x + length_um + BLOCK_UM, y + wave_um / 2), holes)


def checked_stock(stock: Stock, machine: Machine) -> Stock:
    """Return a workpiece; raises `InputError` if its greatest height is not the machine's."""
    if stock.lower_regions and stock.height_mm != machine.height_mm:
        raise InputError(f"the stepped workpiece is {stock.height_mm:g} mm high and the machine set up for "
                         f"{machine.height_mm:g} mm; they must be the same")
    return stock


def started_slot(
    machine: Machine, end_um: tuple[float, float], *, gap_um: float = SLOT_GAP_UM,
    lower_regions: Sequence[LowerRegion] = (),
) -> Stock:
    """Return a block with a slot along +x; the wire at its end has a gap of `gap_um` on three sides."""
    x, y = end_um
    radius = machine.wire_diameter_um / 2 + gap_um
    holes = tuple((float(c), y, radius) for c in np.arange(x - SLOT_UM, x + 1.0, _SCALLOP_UM))
    travel = machine.base.table.travel_mm.value * 1e3
    height_mm = machine.height_mm if lower_regions else None
    return Stock((x - SLOT_UM, 0.0, travel, travel), holes, tuple(lower_regions), height_mm)


# The wall after a pass: its distance from a line.

REACH_UM = 80.0
"""Distance from the line, on both sides, in which the wall is searched (ours: more than a pass removes or leaves);
below there is only metal."""


class WallLine(NamedTuple):
    """Nominal place of a wall that faces +y."""

    x_um: float  # beginning of the line, which runs along +x
    y_um: float  # its place


def wall_error_um(field: KerfField, y_um: float, from_um: float, to_um: float) -> float:
    """Return the rms distance of a wall from `y_um` over the height and a range of x, by columns of cells."""
    return float(_error_um(field.tiles, field.index, field.n_slices, field.cell_um, y_um, from_um, to_um))


@exactly_compiled
def _error_um(
    tiles: NDArray[np.uint16], index: NDArray[np.int32], slices: int, cell_um: float, y_um: float, from_um: float,
    to_um: float,
) -> float:
    first, last = math.ceil(from_um / cell_um - 0.5), math.ceil(to_um / cell_um - 0.5)
    low, high = math.floor((y_um - REACH_UM) / cell_um), math.ceil((y_um + REACH_UM) / cell_um)
    squares = 0.0
    for ix in range(first, last):
        for number in range(slices):
            parts = 0
            for iy in range(low, high):
                place = index[ix // TILE, iy // TILE]
                parts += tiles[place, number, ix % TILE, iy % TILE] if place >= 0 else 0
            squares += (low * cell_um + parts * cell_um / FULL - y_um) ** 2
    count = max(last - first, 0) * slices
    return math.sqrt(squares / count) if count else math.nan
