"""The wall that a pass leaves: its distance from a line."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.plant.kernel.state import TILE
from edmsim.plant.workpiece.kerf_field import FULL, KerfField

REACH_UM = 80.0
"""Distance from the line, either way, within which the wall is looked for (ours: more than a pass takes or leaves);
below there is metal all over."""


class WallLine(NamedTuple):
    """Where a wall that faces +y is to be."""

    x_um: float  # where the line begins
    y_um: float  # of the line, along +x


def wall_error_um(field: KerfField, y_um: float, from_um: float, to_um: float) -> float:
    """Root mean square of a wall's distance from `y_um` over the height and a stretch of x, by columns of cells."""
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
