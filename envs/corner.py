"""Corner: a sharp turn to be cut accurately; actions set the pulse generator, too."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from edmsim.envs.reward import Weights
from edmsim.envs.single import EdmEnv
from edmsim.envs.task import CORNER_DEG, Family, Floats, Scenario, above_zero, ends_of, even_height
from edmsim.envs.vector import EdmVectorEnv
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.plant.workpiece.start_slot import begun_slot

SHARPEST_DEG = 160.0
"""Sharpest turn that may be asked for (ours: beyond it the second leg runs back in the first one's kerf)."""
MOST_OCTAVES = 4.0
"""Greatest reach of the generator's knobs either way that may be asked for (ours)."""


@dataclass(frozen=True, kw_only=True)
class Corner(Family):
    """Two legs with a sharp turn between.

    Parameters
    ----------
    leg_mm : float
        Length of each leg.
    turn_deg : (low, high)
        Range of the turn, drawn per episode, to the left or to the right.
    setting_octaves : float
        How far the knobs turn either way: an action of 1 multiplies the on-time, or the ratio of period to on-time,
        by 2 to the power of this.
    """

    leg_mm: float = 0.3
    turn_deg: tuple[float, float] = (45.0, 135.0)
    setting_octaves: float = 2.0

    action_names: ClassVar[tuple[str, ...]] = ("feed", "on_time", "duty_factor")
    knows_corners: ClassVar[bool] = True
    own_weights: ClassVar[Weights] = Weights(profile=4.0, time=0.1)  # accuracy first

    def __post_init__(self) -> None:
        super().__post_init__()
        above_zero("leg_mm", self.leg_mm, self.reach_mm / 2)
        above_zero("setting_octaves", self.setting_octaves, MOST_OCTAVES)
        low, high = ends_of("turn_deg", self.turn_deg)
        if not CORNER_DEG <= low <= high <= SHARPEST_DEG:
            raise InputError(
                f"turn_deg is {self.turn_deg!r}: give a range within {CORNER_DEG:g} to {SHARPEST_DEG:g} degrees"
            )

    def draw_cut(
        self, rng: np.random.Generator, machine: Machine, seed: int, drawn: dict[str, float | str]
    ) -> Scenario:
        """Draw the turn: uniformly, to either side with the same probability."""
        turn = float(rng.uniform(*self.turn_deg)) * (1 if rng.random() < 0.5 else -1)
        leg, (x, y) = self.leg_mm * 1e3, machine.base.table.centre_um
        angle = math.radians(turn)
        path = np.array(
            [(x, y), (x + leg, y), (x + leg + leg * math.cos(angle), y + leg * math.sin(angle))], np.float64
        )
        drawn |= {"turn_deg": turn}
        return Scenario(machine, begun_slot(machine, (x, y)), (path,), even_height(machine), seed, drawn)

    def setting_us(self, first_us: Floats, wanted: Floats) -> tuple[float, float]:
        """Return on-time and period: multiples of the first ones.

        The second action turns the duty factor: were it the period, half of all pairs would ask for more than the
        supply gives.
        """
        on_us, period_us = first_us
        on, pause = (2.0 ** (self.setting_octaves * float(a)) for a in wanted)
        return on_us * on, period_us * on * pause


class CornerEnv(EdmEnv):
    """PAGE"""

    task = Corner


class CornerVectorEnv(EdmVectorEnv):
    """`CornerEnv`, many at once; arguments beside its own: those of `EdmVectorEnv`."""

    task = Corner
