"""One episode before it begins: machine, stock, path, and what was drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.machine.machine import Machine
from edmsim.plant.workpiece.kerf_field import Stock

if TYPE_CHECKING:
    from edmsim.plant.workpiece.wall import WallLine
    from edmsim.program.path import WireContour

Floats = NDArray[np.float64]


class Scenario(NamedTuple):
    """One episode before it begins.

    Attributes
    ----------
    machine : Machine
    stock : Stock
    legs_um : tuple of float64 arrays (k, 2)
        The wire's path, piece by piece; a wire is threaded between two.
    heights : (float64 array (m,), float64 array (m,))
        Lengths of path in um from which on the height is another, the first 0, and those heights in mm.
    plant_seed : int
    drawn : dict
        What was drawn for it, by name, for `info`.
    contours : tuple of WireContour
        The edges the part program draws, one for every leg; none where no program is cut.
    wall : WallLine or None
        The wall that the one leg, along +x, is to finish.
    """

    machine: Machine
    stock: Stock
    legs_um: tuple[Floats, ...]
    heights: tuple[Floats, Floats]
    plant_seed: int
    drawn: dict[str, float | str]
    contours: tuple[WireContour, ...] = ()
    wall: WallLine | None = None


def even_height(machine: Machine) -> tuple[Floats, Floats]:
    """Return `Scenario.heights` of a workpiece of one height."""
    return np.zeros(1), np.array([machine.height_mm])
