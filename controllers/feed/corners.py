"""Rules of gap laws for corners: a longer pulse period, and an offset of the guides.

Less power bends the wire less. The offset moves the guides off the path by as much as the wire bends. The numbers are
ours; those of a task's reference lines are in `edmsim.evaluation.lines`.
"""

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.feed.law import CornerRule, low_pass_weight
from edmsim.controllers.protocols import WindowObservation
from edmsim.geometry import CORNER_DEG, Floats, Polyline, left_of
from edmsim.machine.machine import Machine
from edmsim.machine.pulse_window import PulseWindow


def _corners(points_um: NDArray[Any], start_um: float) -> tuple[Floats, Floats]:
    """Return the length of path at a leg's corners, and how far it turns there, to the left."""
    line = Polyline(points_um * 1e-3, closed=False)
    corners = line.corners(CORNER_DEG)
    return line.s[corners] * 1e3 + start_um, line.turn_deg[corners]


@dataclass
class Corners(CornerRule):
    """A longer period near corners, and an offset after them."""

    # before_um, behind_um: path before and after a corner on which the period is longer; 0 for none
    before_um: float = 0.0
    behind_um: float = 0.0
    corner_factor: float = 4.0  # period near a corner divided by the period elsewhere
    # 0, or the deflection of a wire under 1 N per m of workpiece for which `corner_factor` is meant. The factor of
    # another wire is scaled with the square root of its deflection divided by this value.
    slack_um: float = 0.0
    offset_um: float = 0.0  # offset to the left of the path
    # force on the wire per height of workpiece, positive forward; negative for a wire that lags. The force bends the
    # wire by `lead_um`, and after a corner this deflection points off the path. The offset compensates it and fades
    # out as the wire turns into the new direction.
    pull_N_m: float = 0.0
    fade_um: float = 100.0  # length of path after a corner on which this compensation falls to 1/e

    def __post_init__(self) -> None:
        self.start_um = self._lead_um = 0.0
        self._at_corner = 1.0
        self._corners_um: Floats = np.zeros(0)
        self._turns_rad: Floats = np.zeros(0)

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Read the corners of the leg, and compute the bend of the wire."""
        self._corners_um, turns_deg = _corners(points_um, start_um)
        self._turns_rad = np.radians(turns_deg)
        self._lead_um = lead_um(machine, self.pull_N_m)
        slack = math.sqrt(lead_um(machine, 1.0) / self.slack_um) if self.slack_um else 1.0
        self._at_corner = max(self.corner_factor * slack, 1.0)
        self.start_um = start_um

    def slowing(self, path_um: float) -> float:
        """Return the factor on the period at a place of the path."""
        passed_um = path_um - self._corners_um
        near = bool(((-self.before_um < passed_um) & (passed_um < self.behind_um)).any())
        return self._at_corner if near else 1.0

    def offset(self, path_um: float) -> float:
        """Return the offset at a place of the path, to its left."""
        behind_um = path_um - self._corners_um
        passed = behind_um >= 0.0
        lateral_um = self._lead_um * np.sin(self._turns_rad[passed]) * np.exp(-behind_um[passed] / self.fade_um)
        return self.offset_um + float(lateral_um.sum())


@dataclass
class OuterCorners(CornerRule):
    """A longer period before outer corners: less and less metal is in front of a trim there."""

    # path before an outer corner of the wire's path on which the period is longer; 0 for none. Trims go straight past
    # the part's corner, by about their offset.
    before_um: float = 0.0
    corner_factor: float = 3.0  # period there divided by the period elsewhere

    def __post_init__(self) -> None:
        self.part_side: Literal["left", "right"] | None = None
        self._corners_um: Floats = np.zeros(0)

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Find where the leg turns to the part."""
        corners_um, turns_deg = _corners(points_um, start_um)
        towards = {"left": turns_deg > 0, "right": turns_deg < 0, None: np.zeros(len(turns_deg), bool)}
        self._corners_um = corners_um[towards[self.part_side]]
        self.start_um = start_um

    def slowing(self, path_um: float) -> float:
        """Return the factor on the period at a place of the path."""
        ahead_um = self._corners_um - path_um
        return self.corner_factor if ((ahead_um >= 0.0) & (ahead_um < self.before_um)).any() else 1.0


def lead_um(machine: Machine, force_N_m: float) -> float:
    """Return how far a load q bends a wire: ``q h (2 l - h) / (8 T) - q h**2 / (24 T)`` in the mean over h, in um."""
    height_m, guides_m = machine.height_mm * 1e-3, machine.guide_distance_mm * 1e-3
    bent = height_m * (2 * guides_m - height_m) / 8 - height_m**2 / 24
    return force_N_m * bent / machine.tension * 1e6


@dataclass
class TrueBend(Corners):
    """Offsets the guides by the wire's true deflection, which no sensor of a real machine measures.

    The offset is the opposite of the true mean deflection across the path. ``pull_N_m`` and ``fade_um`` have no
    effect.
    """

    # time constant of the average of the deflection: the guides must not follow the wire's vibration
    average_s: float = 0.25

    bent_um: tuple[float, float] = field(default=(0.0, 0.0), init=False)
    mean_um: Floats = field(default_factory=lambda: np.zeros(2), init=False)
    last_s: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._ends_um: Floats = np.zeros(0)
        self._left: Floats = np.zeros((1, 2))

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Read the path: the end of each segment and its direction to the left."""
        super().set_up(machine, points_um, start_um)
        pieces = np.diff(np.asarray(points_um, np.float64), axis=0)
        lengths_um = np.hypot(pieces[:, 0], pieces[:, 1])
        self._ends_um = start_um + np.cumsum(lengths_um)
        self._left = left_of(pieces / lengths_um[:, None])

    def begin(self) -> None:
        """Begin with a straight wire."""
        self.mean_um, self.last_s = np.zeros(2), 0.0

    def see(self, truth: PulseWindow) -> None:
        """Read the true deflection of a window."""
        self.bent_um = truth.deflection_um

    def look(self, window: WindowObservation) -> None:
        """Average the deflection."""
        weight = low_pass_weight(window.time_s - self.last_s, self.average_s)
        self.mean_um = self.mean_um + weight * (np.array(self.bent_um) - self.mean_um)
        self.last_s = window.time_s

    def offset(self, path_um: float) -> float:
        """Return the offset that brings the wire back onto the path."""
        piece = min(int(np.searchsorted(self._ends_um, path_um, side="right")), len(self._left) - 1)
        return self.offset_um - float(self.mean_um @ self._left[piece])
