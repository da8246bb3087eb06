"""Trim: a finishing pass that makes a wavy wall straight and brings it to its target."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from edmsim.envs.arguments import LEAST_MM, Range, argument, ends_of, shows_arguments
from edmsim.envs.environment import EdmEnv
from edmsim.envs.gap_feed import GapFeed
from edmsim.envs.page import page
from edmsim.envs.reward import Weights
from edmsim.envs.scenario import Scenario, even_height
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.numeric import within
from edmsim.plant.workpiece.blanks import wavy_wall
from edmsim.plant.workpiece.wall import WallLine

GAP_UM = 28.0
"""Gap beside the wire for which the path is laid out (ours: what the standard set-up leaves at 100 um/s)."""
LEAST_RATIO = 4.0
"""Length of a wave over its height, at the least: its arcs are flat, and meet in ridges."""
ROOM_UM = 1.0  # least gap that the highest ridge must leave at first (ours)


@shows_arguments
@dataclass(frozen=True, kw_only=True)
class Trim(GapFeed):
    """A pass along a wavy wall.

    Parameters
    ----------
    {arguments}
    """

    length_mm: float = argument(1.0, "mm", "length of the pass")
    wave_um: Range = argument((4.0, 10.0), "um", "(low, high) of the waves' height, ridge to bottom")
    wave_mm: Range = argument((0.2, 0.6), "mm", "(low, high) of their length")
    allowance_um: Range = argument((4.0, 12.0), "um", "(low, high) of the metal to remove")
    height_mm: Range | None = (10.0, 40.0)
    action: Literal["change", "speed", "servo"] = "speed"
    knobs: Sequence[str] = ("on_time", "duty_factor")
    setting_octaves: float = 1.0
    offset_um: float | None = 12.0
    decision_s: float | None = 0.25
    episode_s: float | None = 60.0
    max_feed_um_s: float = 200.0
    energy_bound_mJ: float | None = 2.0

    finishes_wall: ClassVar[bool] = True
    own_weights: ClassVar[Weights] = Weights(short=0.0, open=0.0, profile=4.0, roughness=4.0, time=0.5)

    def __post_init__(self) -> None:
        """Refuse what cannot be used."""
        super().__post_init__()
        highest_um = ends_of("wave_um", self.wave_um)[1]
        for length in ends_of("wave_mm", self.wave_mm):
            within("wave_mm", length, max(LEAST_MM, LEAST_RATIO * highest_um * 1e-3), self.reach_mm)
        proud_um = ends_of("allowance_um", self.allowance_um)[1] + highest_um / 2
        if proud_um > GAP_UM - ROOM_UM:
            raise InputError(
                f"allowance_um and half of wave_um may come to {proud_um:g} um, and the wire would stand in the "
                f"metal: {GAP_UM - ROOM_UM:g} um at the most"
            )

    @staticmethod
    def own_machine() -> Machine:
        """Return the laboratory machine with short pulses."""
        return Machine.load(t_on_us=10.0, t_period_us=60.0)

    def draw_cut(
        self, rng: np.random.Generator, machine: Machine, seed: int, drawn: dict[str, float | str]
    ) -> Scenario:
        """Draw allowance and waves, and where they begin: uniformly."""
        names = "allowance_um", "wave_um", "wave_mm"
        drawn |= {name: float(rng.uniform(*ends_of(name, getattr(self, name)))) for name in names}
        allowance_um, wave_um, wave_mm = (float(drawn[name]) for name in names)
        path = self.path_um(machine)
        x, y = (float(v) for v in path[0])
        wall = WallLine(x, y - machine.wire_diameter_um / 2 - GAP_UM)
        stock = wavy_wall(
            (x, wall.y_um + allowance_um), self.length_mm * 1e3, wave_um, wave_mm * 1e3,
            float(rng.uniform(0.0, wave_mm * 1e3)),
        )
        return Scenario(machine, stock, (path,), even_height(machine), seed, drawn, wall=wall)


@page
class TrimEnv(EdmEnv):
    """A finishing pass along a wavy wall: make it straight, at its target.

    Description
    -----------
    A rough cut left a wavy wall with some um of metal too much. The wire passes along it once more, with short
    pulses, and removes this metal. No front limits the feed. A fast pass removes little, mostly from the ridges, and
    leaves the wall wavy and too high; a slow pass removes too much. The final wall depends on feed, power, the metal
    to remove, and constants that cannot be observed. An offset of the guides shifts the wall. The wall is measured
    behind the wire for the reward only; the observation has its pulses.

    Action space
    ------------
    Left is away from the wall.

    Reward
    ------
    The wall is measured 80 um behind the wire, where no more metal is removed. So the wall of the last 80 um of the
    path does not count.

    Starting state
    --------------
    The wire is in the middle of the table, at the side of the wall. The target of the wall is 28 um from the wire's
    edge. The metal to remove, from the target to the middle of the waves, the height of the waves from ridge to
    bottom, and their length are drawn uniformly from ``allowance_um``, ``wave_um`` and ``wave_mm``. The waves are
    arcs with ridges between them, like the edge of a row of wide holes.

    Versions
    --------
    v1: debris ignites the gap, jets bend the wire, and water carries heat and gas away behind it. v0 is withdrawn.
    """

    task = Trim
