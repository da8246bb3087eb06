"""The bound at corners: guides that go beside the path by what the wire is truly bent, which no machine shows."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.feed.set_point import SetPointController
from edmsim.controllers.protocols import ControllerState, FeedCommand, GapWindow, WindowObservation
from edmsim.geometry import left_of
from edmsim.machine.machine import Machine

_MEAN_UM = "bent_x_um", "bent_y_um"


@dataclass
class LeadOracleController(SetPointController):
    """Cuts as `SetPointController` does, and leads the guides so that the bent wire is on the path.

    The offset is the part of the true mean deflection across the path, to the other side. Force per height
    (``pull_N_m``) and fading (``fade_um``) have nothing to do here.

    Further parameters: see `SetPointController`.

    Parameters
    ----------
    average_s : float
        Time constant with which the deflection is averaged, so that the guides do not follow the wire's vibration.
    """

    name: ClassVar[str] = "lead-oracle"

    average_s: float = 0.25

    _bent_um: tuple[float, float] = field(default=(0.0, 0.0), init=False, repr=False)
    _mean_um: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2), init=False, repr=False)
    _seen_s: float = field(default=0.0, init=False, repr=False)
    _ends_um: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0), init=False, repr=False)
    _left: NDArray[np.float64] = field(default_factory=lambda: np.zeros((1, 2)), init=False, repr=False)

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Take in the path, too: where each of its pieces ends, and what is to the left of it."""
        super().set_up(machine, points_um, start_um)
        pieces = np.diff(np.asarray(points_um, np.float64), axis=0)
        lengths_um = np.hypot(pieces[:, 0], pieces[:, 1])
        self._ends_um = start_um + np.cumsum(lengths_um)
        self._left = left_of(pieces / lengths_um[:, None])

    def see(self, truth: GapWindow) -> None:
        """Take in the true deflection of a window."""
        self._bent_um = truth.deflection_um

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut with a wire that is straight, as far as is known."""
        self._mean_um, self._seen_s = np.zeros(2), 0.0
        return super().reset(max_feed_um_s)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed, setting and offset for the next window."""
        weight = -math.expm1((self._seen_s - window.time_s) / self.average_s) if self.average_s else 1.0
        self._mean_um = self._mean_um + weight * (np.array(self._bent_um) - self._mean_um)
        self._seen_s = window.time_s
        return super().update(window)

    def offset(self, path_um: float) -> float:
        """Return what brings the wire back on the path."""
        piece = min(int(np.searchsorted(self._ends_um, path_um, side="right")), len(self._left) - 1)
        return self.offset_um - float(self._mean_um @ self._left[piece])

    def snapshot(self) -> ControllerState:
        """Everything that changes while cutting."""
        places = dict(zip(_MEAN_UM, self._mean_um.tolist(), strict=True))
        return {**super().snapshot(), **places, "seen_s": self._seen_s}

    def restore(self, state: ControllerState) -> None:
        """Continue where `snapshot` was taken."""
        own = (*_MEAN_UM, "seen_s")
        super().restore({name: value for name, value in state.items() if name not in own})
        self._mean_um = np.array([float(state[name]) for name in _MEAN_UM])
        self._seen_s = float(state["seen_s"])
