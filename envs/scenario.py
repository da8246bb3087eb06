"""One episode before it begins: machine, stock, path, and what was drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.machine.machine import Machine
from edmsim.machine.ranges import with_constants
from edmsim.machine.setting import flushing_Pa
from edmsim.plant.workpiece.kerf_field import Stock

if TYPE_CHECKING:
    from edmsim.plant.workpiece.wall import WallLine
    from edmsim.program.path import WireContour

Floats = NDArray[np.float64]


class Drift(NamedTuple):
    """What changes of a machine within an episode, evenly with machine time, and where no dial shows it."""

    # time in which all of it happens, and from one step of it to the next
    over_s: float
    every_s: float
    conductivity_uS_cm: float  # of the water, in the end
    flushing_share: float  # of the nozzles' pressures, what is left at the workpiece in the end

    def machine(self, machine: Machine, time_s: float) -> Machine:
        """Return what a machine has become after a time."""
        share, water = min(time_s / self.over_s, 1.0), machine.base.dielectric.conductivity_uS_cm
        now = water.model_copy(update={"value": water.value + share * (self.conductivity_uS_cm - water.value)})
        left = 1.0 - share * (1.0 - self.flushing_share)
        lower_Pa, upper_Pa = flushing_Pa(machine)
        drifted = with_constants(machine, {"dielectric.conductivity_uS_cm": now})
        return drifted.with_(flushing_lower_Pa=left * lower_Pa, flushing_upper_Pa=left * upper_Pa)


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
    drift : Drift or None
        What changes of the machine in the course of the episode.
    """

    machine: Machine
    stock: Stock
    legs_um: tuple[Floats, ...]
    heights: tuple[Floats, Floats]
    plant_seed: int
    drawn: dict[str, float | str]
    contours: tuple[WireContour, ...] = ()
    wall: WallLine | None = None
    drift: Drift | None = None


def even_height(machine: Machine) -> tuple[Floats, Floats]:
    """Return `Scenario.heights` of a workpiece of one height."""
    return np.zeros(1), np.array([machine.height_mm])
