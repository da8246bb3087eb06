"""Initial state of an episode: machine, stock, path, and the drawn values."""

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
    """Changes of a machine within an episode, linear with machine time and not observed."""

    # time in which all of it happens, and from one step of it to the next
    over_s: float
    every_s: float
    conductivity_uS_cm: float  # of the water, in the end
    flushing_share: float  # of the nozzles' pressures, what is left at the workpiece in the end

    def machine(self, machine: Machine, time_s: float) -> Machine:
        """Return the machine after a time."""
        share, water = min(time_s / self.over_s, 1.0), machine.base.dielectric.conductivity_uS_cm
        now = water.model_copy(update={"value": water.value + share * (self.conductivity_uS_cm - water.value)})
        left = 1.0 - share * (1.0 - self.flushing_share)
        lower_Pa, upper_Pa = flushing_Pa(machine)
        drifted = with_constants(machine, {"dielectric.conductivity_uS_cm": now})
        return drifted.with_(flushing_lower_Pa=left * lower_Pa, flushing_upper_Pa=left * upper_Pa)


class Scenario(NamedTuple):
    """Initial state of an episode.

    Attributes
    ----------
    machine : Machine
    stock : Stock
    legs_um : tuple of float64 arrays (k, 2)
        The wire's path, leg by leg; a wire is threaded between two legs.
    heights : (float64 array (m,), float64 array (m,))
        Path lengths in um at which the height changes, the first 0, and the heights from there on in mm.
    plant_seed : int
    drawn : dict
        The drawn values by name, for `info`.
    contours : tuple of WireContour
        The edges of the part program, one for every leg; empty without a program.
    wall : WallLine or None
        The wall to be finished by the only leg, along +x.
    drift : Drift or None
        Changes of the machine during the episode.
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
