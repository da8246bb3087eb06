"""Initial state of an episode: machine, stock, path, and the drawn values."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from edmsim.envs.arguments import Range, ends_of
from edmsim.errors import InputError
from edmsim.geometry import Floats
from edmsim.machine.machine import Machine
from edmsim.machine.ranges import choose, values_of, with_constants
from edmsim.machine.setting import flushing_Pa, standoffs_mm
from edmsim.plant.workpiece.kerf_field import Stock

if TYPE_CHECKING:
    from edmsim.plant.workpiece.blanks import WallLine
    from edmsim.program.path import WireContour


Drawn = dict[str, float | str]
"""What was drawn of an episode, by name, for `info`."""


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
    """Initial state of an episode."""

    machine: Machine
    stock: Stock
    legs_um: tuple[Floats, ...]  # (k, 2): the wire's path, leg by leg; a wire is threaded between two legs
    # (m,): path lengths in um at which the height changes, the first 0, and the heights from there on in mm
    heights: tuple[Floats, Floats]
    plant_seed: int
    drawn: Drawn
    # the edges of the part program, one for every leg; empty without a program
    contours: "tuple[WireContour, ...]" = ()
    wall: "WallLine | None" = None  # the wall to be finished by the only leg, along +x
    drift: Drift | None = None  # changes of the machine during the episode


def even_height(machine: Machine) -> tuple[Floats, Floats]:
    """Return `Scenario.heights` of a workpiece of one height."""
    return np.zeros(1), np.array([machine.height_mm])


# What is drawn of an episode's machine: constants nobody can know, and none that an operator sets.
# A dial of the operator, such as the pressure of the flushing, is not drawn: it keeps its value, which the
# observation contains. Constants without effect are not drawn either: friction and backlash of the table act where
# MuJoCo steps the machine, and only there; bore and flow of the nozzles where one stands off the workpiece; the
# rapid rate and the time for threading pay nothing but time that is not cut.

DIALS = ("dielectric.flushing_pressure_Pa", "guides.wire_speed_m_s")  # constants with a range that an operator sets
DRY = ("table.friction_N", "table.presliding_um", "table.backlash_um")
"""Constants of the table that count with ``mechanics="mujoco"`` only."""
NOZZLES = ("dielectric.nozzle_mm", "dielectric.nozzle_flow_l_min")
"""Constants that count where a nozzle stands off the workpiece only."""
_TIMES = ("table.rapid_um_s", "table.threading_s")


def names_of(machine: Machine, randomise: Sequence[str] | None, mechanics: str) -> tuple[str, ...]:
    """Return the constants that an episode draws: those named, or, for no names, all drawn by themselves."""
    if randomise is None:
        return ()
    without = _TIMES + (() if mechanics == "mujoco" else DRY) + (() if any(standoffs_mm(machine)) else NOZZLES)
    if not randomise:
        return tuple(name for name in machine.uncertain() if name not in (*without, *DIALS))
    dead = [name for name in randomise if name in without or (name == "table" and mechanics != "mujoco")]
    if dead:
        raise InputError(
            f"randomise names {dead[0]!r}, which has no effect here: friction and backlash count with "
            'mechanics="mujoco" only, bore and flow of nozzles with a stand-off only, times of the table never'
        )
    return tuple(name for name in choose(machine, randomise) if name not in without)


def draw_machine(
    rng: np.random.Generator, bases: Sequence[Machine], ranges: Mapping[str, Range | None], names: Sequence[str],
    drawn: Drawn,
) -> Machine:
    """Draw a machine of one of `bases`, with choices within ranges (None: the machine's own); `drawn` tells them."""
    machine = bases[int(rng.integers(len(bases)))]
    bounds = {name: ends_of(name, value) for name, value in ranges.items() if value is not None}
    values = {name: float(rng.uniform(*ends)) for name, ends in bounds.items()}
    if any(values[name] != getattr(machine, name) for name in values):
        machine = machine.with_(**values)
    if names:
        machine = machine.sample(rng, names)
        drawn |= values_of(machine, names)
    return machine
