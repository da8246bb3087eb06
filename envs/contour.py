"""Contour: any part program, contour by contour."""

from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import ClassVar

import numpy as np

from edmsim.envs.arguments import Range, argument, shows_arguments
from edmsim.envs.environment import EdmEnv
from edmsim.envs.page import page
from edmsim.envs.reward import Weights
from edmsim.envs.scenario import Scenario, even_height
from edmsim.envs.task import Family
from edmsim.machine.machine import Machine
from edmsim.plant.workpiece.kerf_field import Stock
from edmsim.program.path import CutPath, plan_path


@shows_arguments
@dataclass(frozen=True, kw_only=True)
class Contour(Family):
    """The contours of a part program; dwells (G4) are left out.

    Parameters
    ----------
    {arguments}
    """

    program: str | Path | None = argument(None, "", "G-code or DXF file; None: a punch of 0.6 x 0.4 mm")
    height_mm: Range | None = (4.0, 20.0)
    episode_s: float | None = 300.0

    knows_corners: ClassVar[bool] = True
    own_weights: ClassVar[Weights] = Weights(profile=1.0, time=0.1)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._cut  # noqa: B018 - refuses a program that cannot be cut

    @cached_property
    def _cut(self) -> tuple[Stock, CutPath]:
        offset_mm, table_um = self.base.auto_offset_mm, round(self.base.base.table.travel_mm.value * 1e3)
        if self.program is None:
            with resources.as_file(resources.files(__package__) / "small_punch.ngc") as file:
                path = plan_path(file, auto_offset_mm=offset_mm, table_um=table_um)
        else:
            path = plan_path(self.program, auto_offset_mm=offset_mm, table_um=table_um)
        x0, y0, x1, y1 = (1e3 * v for v in path.stock_mm)
        radius = path.start_hole_radius_mm * 1e3
        holes = tuple((float(c.points_um[0, 0]), float(c.points_um[0, 1]), radius) for c in path.contours)
        return Stock((x0, y0, x1, y1), holes), path

    def draw_cut(
        self, rng: np.random.Generator, machine: Machine, seed: int, drawn: dict[str, float | str]
    ) -> Scenario:
        """Take the program's contours, one leg each; nothing is drawn for them."""
        stock, path = self._cut
        legs = tuple(c.points_um.astype(np.float64) for c in path.contours)
        return Scenario(machine, stock, legs, even_height(machine), seed, drawn, path.contours)


@page
class ContourEnv(EdmEnv):
    """A part program, contour by contour: cut it fast and accurately.

    Description
    -----------
    The wire cuts the contours of a G-code program or a drawing one after another; between two contours a new wire is
    threaded. Distance from the path costs.

    Starting state
    --------------
    The wire is in the start hole of the first contour. The program has no random draws.
    """

    task = Contour
