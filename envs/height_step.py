"""HeightStep: a straight cut through a workpiece whose height jumps."""

from dataclasses import dataclass

import numpy as np
import shapely

from edmsim.envs.arguments import LEAST_MM, Range, argument, ends_of, shows_arguments
from edmsim.envs.environment import EdmEnv
from edmsim.envs.gap_feed import GapFeed
from edmsim.envs.page import page
from edmsim.envs.scenario import Scenario
from edmsim.machine.machine import Machine
from edmsim.numeric import within
from edmsim.plant.workpiece.blanks import SLOT_GAP_UM, started_slot
from edmsim.plant.workpiece.height_steps import LowerRegion

LEAST_SHARE = 0.2  # least height of a band that may be asked for, as a share of the greatest (ours)
MOST_BANDS = 2000
"""Most bands of a cut (ours: ten times those of a shift; to draw them takes a second)."""
_MARGIN_UM = 2e3  # how far a band reaches beside and beyond the path (ours: well beyond what the wire erodes)


@shows_arguments
@dataclass(frozen=True, kw_only=True)
class HeightStep(GapFeed):
    """A straight cut through bands of drawn lengths and heights.

    Parameters
    ----------
    {arguments}
    """

    # ours: a few seconds of cutting each
    band_mm: Range = argument((0.1, 0.3), "mm", "(low, high) of a band's length")
    low_share: float = argument(0.25, "", f"least height of a band over the greatest, {LEAST_SHARE:g} to 1")

    def __post_init__(self) -> None:
        super().__post_init__()
        for length in ends_of("band_mm", self.band_mm):
            within("band_mm", length, max(LEAST_MM, self.length_mm / MOST_BANDS), self.reach_mm)
        within("low_share", self.low_share, LEAST_SHARE, 1.0)

    def draw_cut(
        self, rng: np.random.Generator, machine: Machine, seed: int, drawn: dict[str, float | str]
    ) -> Scenario:
        """Draw where the height jumps, and to what: uniformly, band by band."""
        total, band_mm = self.length_mm * 1e3, ends_of("band_mm", self.band_mm)
        starts, heights, at = [0.0], [machine.height_mm], float(rng.uniform(*band_mm)) * 1e3
        while at < total:
            starts.append(at)
            heights.append(machine.height_mm * float(rng.uniform(self.low_share, 1.0)))
            at += float(rng.uniform(*band_mm)) * 1e3
        ends = [*starts[1:], total + _MARGIN_UM]
        x, y = start = self.start_um(machine)
        x += machine.wire_diameter_um / 2 + SLOT_GAP_UM  # where the wire's front meets a jump
        steps = [
            LowerRegion(shapely.box(x + a, y - _MARGIN_UM, x + b, y + _MARGIN_UM), h)
            for a, b, h in zip(starts[1:], ends[1:], heights[1:], strict=True)
        ]
        drawn |= {"height_jumps": float(len(steps))}
        stock = started_slot(machine, start, steps=steps)
        profile = np.array(starts), np.array(heights)
        return Scenario(machine, stock, (self.path_um(machine),), profile, seed, drawn)


@page
class HeightStepEnv(EdmEnv):
    """A straight cut through a workpiece whose height jumps.

    Description
    -----------
    This is `GapFeedEnv` with a workpiece that has bands of different heights across the path. Where the height
    falls, the same pulses heat a shorter piece of wire, and a feed that was right before can break it. Heights are
    not observed: a controller must infer them from the pulses.

    Observation space
    -----------------
    Local heights below the greatest are not observed.

    Starting state
    --------------
    The wire is in the middle of the table, in a slot, 25 um from the metal. The first band has the greatest height.
    The length of each band is drawn uniformly from ``band_mm``, the height of each further band uniformly from
    ``low_share`` to 1 times the greatest.
    """

    task = HeightStep
