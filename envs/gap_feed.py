"""GapFeed: hold the gap in a straight cut, as fast as the machine can."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edmsim.envs.single import EdmEnv
from edmsim.envs.task import Family, Floats, Scenario, above_zero, even_height
from edmsim.envs.vector import EdmVectorEnv
from edmsim.machine.machine import Machine
from edmsim.plant.workpiece.start_slot import begun_slot


@dataclass(frozen=True, kw_only=True)
class GapFeed(Family):
    """A straight cut from a begun slot.

    Parameters
    ----------
    length_mm : float
        Length of the cut (ours: longer than the standard episode, so that time ends it and the return grows with
        the cutting rate).
    """

    length_mm: float = 3.0

    def __post_init__(self) -> None:
        super().__post_init__()
        above_zero("length_mm", self.length_mm, self.reach_mm)

    def draw_cut(
        self, rng: np.random.Generator, machine: Machine, seed: int, drawn: dict[str, float | str]
    ) -> Scenario:
        """Lay a straight path into the slot's end; nothing is drawn for it."""
        stock = begun_slot(machine, machine.base.table.centre_um)
        return Scenario(machine, stock, (self.path_um(machine),), even_height(machine), seed, drawn)

    def path_um(self, machine: Machine) -> Floats:
        """Return the path (2, 2), from the table's centre along x."""
        x, y = machine.base.table.centre_um
        return np.array([(x, y), (x + self.length_mm * 1e3, y)])


class GapFeedEnv(EdmEnv):
    """PAGE"""

    task = GapFeed


class GapFeedVectorEnv(EdmVectorEnv):
    """`GapFeedEnv`, many at once; arguments beside its own: those of `EdmVectorEnv`."""

    task = GapFeed
