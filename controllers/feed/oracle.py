"""Bounds: a servo on the true gap and the true wire temperature, and guides that go by the wire's true bend.

No machine shows these. They only scale the others' figures. The servo runs as fast as the gap allows and slows down
where the wire grows hot; it is no proof of the fastest cut, so `edmsim evaluate` lets it rehearse every cut with
several gaps and keeps the best. At corners, guides are led beside the path.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.feed.gap_servo import Gains, ServoController
from edmsim.controllers.feed.set_point import SetPointController
from edmsim.controllers.protocols import FeedCommand, GapWindow, WindowObservation
from edmsim.errors import InputError
from edmsim.geometry import left_of
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES


@dataclass
class _Truth:
    """What was seen of the last window; a temperature below 0 where nothing was."""

    gap_um: float = 0.0
    temperature_K: float = -1.0


@dataclass
class OracleController(ServoController):
    """Holds the true gap at a target unless the wire is too hot.

    Further parameters: see `ServoController`.

    Parameters
    ----------
    gap_target_um : float
        Mean gap at the places of ignition that is held.
    proportional_um_s_um : float
        Feed per um above the target, um/s.
    integral_um_s2_um : float
        Growth of the feed per um above the target, um/s per s.
    short_um : float
        By how many um a window full of shorts is closer than its few sparks show (ours: by the target, so that it
        counts as shut).
    hot_K : float
        Wire temperature above which the wire slows down.
    kelvin_per_um : float
        How far above it costs as much as a gap 1 um too narrow.
    """

    name: ClassVar[str] = "oracle"

    gap_target_um: float = 16.0
    proportional_um_s_um: float = 1.0
    integral_um_s2_um: float = 2.0
    short_um: float = 16.0
    hot_K: float = 560.0
    kelvin_per_um: float = 10.0

    _truth: _Truth = field(default_factory=_Truth, init=False, repr=False)

    def gains(self) -> Gains:
        """How the servo answers."""
        return Gains(self.proportional_um_s_um, self.integral_um_s2_um, self.filter_s)

    def see(self, truth: GapWindow) -> None:
        """Take in the true gap and temperature of a window."""
        gap = truth.gap_um
        if math.isnan(gap):  # nothing ignited: all open, or all short
            gap = 2.0 * self.gap_target_um if truth.open > truth.short else 0.0
        self._truth = _Truth(gap, truth.wire_temperature_K)

    def error(self, window: WindowObservation) -> float:
        """Micrometres above the target, or how much too hot the wire is, whichever asks for less feed."""
        if self._truth.temperature_K < 0:
            raise InputError("the oracle was shown nothing of the gap: call see() before update()")
        wide = self._truth.gap_um - self.gap_target_um - self.short_um * window.short / WINDOW_PULSES
        return min(wide, (self.hot_K - self._truth.temperature_K) / max(self.kelvin_per_um, 1e-9))

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut."""
        self._truth = _Truth()
        return super().reset(max_feed_um_s)


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
    _last_s: float = field(default=0.0, init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._ends_um: NDArray[np.float64] = np.zeros(0)
        self._left: NDArray[np.float64] = np.zeros((1, 2))

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
        self._mean_um, self._last_s = np.zeros(2), 0.0
        return super().reset(max_feed_um_s)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed, setting and offset for the next window."""
        weight = -math.expm1((self._last_s - window.time_s) / self.average_s) if self.average_s else 1.0
        self._mean_um = self._mean_um + weight * (np.array(self._bent_um) - self._mean_um)
        self._last_s = window.time_s
        return super().update(window)

    def offset(self, path_um: float) -> float:
        """Return what brings the wire back on the path."""
        piece = min(int(np.searchsorted(self._ends_um, path_um, side="right")), len(self._left) - 1)
        return self.offset_um - float(self._mean_um @ self._left[piece])
