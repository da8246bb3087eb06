"""GapFeed: hold the gap in a straight cut, as fast as the machine can."""

from dataclasses import dataclass

import numpy as np

from edmsim.envs.arguments import argument, shows_arguments
from edmsim.envs.environment import EdmEnv
from edmsim.envs.page import page
from edmsim.envs.scenario import Scenario, even_height
from edmsim.envs.task import Family
from edmsim.geometry import Floats
from edmsim.machine.machine import Machine
from edmsim.numeric import within
from edmsim.plant.workpiece.blanks import started_slot


@shows_arguments
@dataclass(frozen=True, kw_only=True)
class GapFeed(Family):
    """A straight cut from a begun slot.

    Parameters
    ----------
    {arguments}
    """

    # ours: longer than the standard episode, so that time ends it and the return grows with the cutting rate
    length_mm: float = argument(3.0, "mm", "length of the cut")

    def __post_init__(self) -> None:
        super().__post_init__()
        within("length_mm", self.length_mm, self.least_mm, self.reach_mm)

    def draw_cut(
        self, rng: np.random.Generator, machine: Machine, seed: int, drawn: dict[str, float | str]
    ) -> Scenario:
        """Lay a straight path into the slot's end; nothing is drawn for it."""
        stock = started_slot(machine, self.start_um(machine))
        return Scenario(machine, stock, (self.path_um(machine),), even_height(machine), seed, drawn)

    def start_um(self, machine: Machine) -> tuple[float, float]:
        """Return the first place of the wire: the middle of the table."""
        return machine.base.table.centre_um

    def path_um(self, machine: Machine) -> Floats:
        """Return the path (2, 2), along x."""
        x, y = self.start_um(machine)
        return np.array([(x, y), (x + self.length_mm * 1e3, y)])


@page
class GapFeedEnv(EdmEnv):
    """A straight cut: hold the gap, as fast as the machine can.

    Description
    -----------
    The wire cuts straight ahead from the end of a slot. An action sets its feed in the next window of 255 pulses,
    25.5 ms at the standard setting. If the feed is too low, pulses find no metal (open). If it is too high, the wire
    touches the metal (short), bends, and finally breaks or is stopped. The path is longer than an episode, so the
    return grows with the cutting rate.

    Starting state
    --------------
    The wire is in the middle of the table, in a slot, 25 um from the metal.
    """

    task = GapFeed
