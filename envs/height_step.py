"""HeightStep: a straight cut through a workpiece whose height jumps, the classic wire breaker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from edmsim.envs.gap_feed import GapFeed
from edmsim.envs.single import EdmEnv
from edmsim.envs.task import Scenario, above_zero, ends_of
from edmsim.envs.vector import EdmVectorEnv
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.plant.workpiece.height_steps import HeightStep as Step
from edmsim.plant.workpiece.start_slot import SLOT_GAP_UM, begun_slot

LEAST_SHARE = 0.2
"""Least height of a band that may be asked for, as a share of the greatest (ours)."""
_BESIDE_UM = 2e3
"""How far a band reaches beside and beyond the path (ours: well beyond what the wire erodes)."""


@dataclass(frozen=True, kw_only=True)
class HeightStep(GapFeed):
    """A straight cut through bands of drawn lengths and heights.

    Parameters
    ----------
    band_mm : (low, high)
        Lengths of path between two jumps (ours: a few seconds of cutting each).
    low_share : float
        Least local height as a share of the greatest, `LEAST_SHARE` to 1.
    """

    band_mm: tuple[float, float] = (0.1, 0.3)
    low_share: float = 0.25

    def __post_init__(self) -> None:
        super().__post_init__()
        for length in ends_of("band_mm", self.band_mm):
            above_zero("band_mm", length)
        if not LEAST_SHARE <= self.low_share <= 1:
            raise InputError(f"low_share is {self.low_share!r}: give a share from {LEAST_SHARE:g} to 1")

    def draw_cut(
        self, rng: np.random.Generator, machine: Machine, seed: int, drawn: dict[str, float | str]
    ) -> Scenario:
        """Draw where the height jumps, and to what: uniformly, band by band."""
        total = self.length_mm * 1e3
        starts, heights, at = [0.0], [machine.height_mm], float(rng.uniform(*self.band_mm)) * 1e3
        while at < total:
            starts.append(at)
            heights.append(machine.height_mm * float(rng.uniform(self.low_share, 1.0)))
            at += float(rng.uniform(*self.band_mm)) * 1e3
        ends = [*starts[1:], total + _BESIDE_UM]
        x, y = machine.base.table.centre_um
        x += machine.wire_diameter_um / 2 + SLOT_GAP_UM  # where the wire's front meets a jump
        steps = [
            Step(shapely.box(x + a, y - _BESIDE_UM, x + b, y + _BESIDE_UM), h)
            for a, b, h in zip(starts[1:], ends[1:], heights[1:], strict=True)
        ]
        drawn |= {"height_jumps": float(len(steps))}
        stock = begun_slot(machine, machine.base.table.centre_um, steps=steps)
        profile = np.array(starts), np.array(heights)
        return Scenario(machine, stock, (self.path_um(machine),), profile, seed, drawn)


class HeightStepEnv(EdmEnv):
    """PAGE"""

    task = HeightStep


class HeightStepVectorEnv(EdmVectorEnv):
    """`HeightStepEnv`, many at once; arguments beside its own: those of `EdmVectorEnv`."""

    task = HeightStep
