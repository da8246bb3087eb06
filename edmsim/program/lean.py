"""The way of a wire that may lean: where its guides go, where it is at every height, and how long its path is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.geometry import arc_lengths
from edmsim.program.taper import GuideHeights, Ruled

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Lean:
    """How a wire leans along a path."""

    # (n, 2): for each point of the path where the upper guide is, relative to the lower one: axes u and v
    upper_um: NDArray[np.int64]
    # (n, 2): for each point the heights over the workpiece's lower face at which the wire bends, at lower and
    # upper guide
    bends_mm: Floats
    wall: Ruled  # the part's wall as drawn, in mm on the table
    height_mm: float  # of the workpiece

    def shares(self, height_mm: float) -> Floats:
        """Return by what share (n, 1) of the upper guide's lead the wire is led at a height."""
        lower, upper = self.bends_mm.T
        return np.asarray(((height_mm - lower) / (upper - lower))[:, None])

    def moved(self, by_mm: Floats) -> Lean:
        """Return the same elsewhere on the table."""
        return replace(self, wall=self.wall.moved(by_mm))


class Way(NamedTuple):
    """Where the lower guide goes, (n, 2) in whole um, and how the wire leans on the way; None: it is vertical."""

    points_um: NDArray[np.int64]
    lean: Lean | None = None

    def at_height(self, height_mm: float) -> NDArray[np.int64]:
        """Return where the wire goes at a height, in whole um."""
        if self.lean is None:
            return self.points_um
        led = np.round(self.lean.upper_um * self.lean.shares(height_mm)).astype(np.int64)
        return np.asarray(self.points_um + led)

    def at_mid_height(self) -> NDArray[np.int64]:
        """Return where it goes at half the workpiece's height."""
        return self.points_um if self.lean is None else self.at_height(0.5 * self.lean.height_mm)

    @property
    def along_um(self) -> Floats:
        """Length of path (n,) up to every point: of a leaning wire the longer of both faces, move by move."""
        if self.lean is None:
            return arc_lengths(self.points_um)
        ways = [np.hypot(*np.diff(self.at_height(z), axis=0).T) for z in (0.0, self.lean.height_mm)]
        # a move of the guides alone takes time as well
        ways.append(1e-3 * np.hypot(*np.diff(self.lean.upper_um, axis=0).T))
        return np.concatenate([[0.0], np.cumsum(np.max(ways, axis=0))])

    @property
    def slant(self) -> Floats:
        """Length of the wall across the path over the workpiece's height, for every move: 1 / cos of its angle."""
        if self.lean is None:
            return np.ones(len(self.points_um) - 1)
        steps = np.diff(self.at_mid_height(), axis=0)
        lower, upper = self.lean.bends_mm.T
        slope = self.lean.upper_um * 1e-3 / (upper - lower)[:, None]
        middle, length = (slope[1:] + slope[:-1]) / 2, np.maximum(np.hypot(*steps.T), 1e-9)
        return np.asarray(np.hypot(1.0, (middle[:, 1] * steps[:, 0] - middle[:, 0] * steps[:, 1]) / length))


def guides_for(
    points_mm: Floats, at_mm: float, slope: Floats, guides: GuideHeights, grid_um: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """Return where the guides are, in whole um, for wires that pass points and lean by so much per height."""
    # points of the lower guide, whole multiples of `grid_um`, and of the upper one relative to it
    bends = guides.bends_mm(slope)
    lower, upper = (points_mm + slope * (z - at_mm)[:, None] for z in bends.T)
    points = np.round(lower * 1000 / grid_um).astype(np.int64) * grid_um
    return points, np.round((upper - lower) * 1000).astype(np.int64), bends
