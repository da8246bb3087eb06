"""A servo of pulse counts at one setting of the generator, with longer pauses near corners if wanted.

It is what an operator does with knobs and a table of settings, and what machines do at corners: they take power back
there, because the wire bends with it. The numbers are ours; those of a task's reference lines are in
`edmsim.evaluation.lines`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.feed.gap_servo import Gains, ServoController
from edmsim.controllers.protocols import FeedCommand, WindowObservation
from edmsim.controllers.pulse_counters import WINDOW_PULSES
from edmsim.geometry import Polyline
from edmsim.machine.machine import Machine
from edmsim.machine.setting import least_period_us

CORNER_DEG = 20.0
"""A corner is where the path turns by at least this (ours: chords of arcs turn by less)."""


@dataclass
class SetPointController(ServoController):
    """Holds the share of opens less shorts by the feed, at a setting in proportion to the operator's.

    Further parameters: see `ServoController`.

    Parameters
    ----------
    open_target_share : float
        Share of open pulses held when nothing shorts.
    proportional_um_s, integral_um_s2 : float
        Feed, and its growth per second, per unit of the difference from the target.
    on_factor, period_factor : float
        On-time and pulse period, in those that the operator set.
    corner_um : float
        Length of path before and behind a corner within which the period is longer; 0 for none.
    corner_factor : float
        Period there over the period elsewhere.
    """

    name: ClassVar[str] = "set-point"

    open_target_share: float = 0.1
    proportional_um_s: float = 10.0
    integral_um_s2: float = 30.0
    on_factor: float = 1.0
    period_factor: float = 1.0
    corner_um: float = 0.0
    corner_factor: float = 4.0

    _machine: Machine | None = field(default=None, init=False, repr=False)
    _corners_um: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0), init=False, repr=False)
    _start_um: float = field(default=0.0, init=False, repr=False)

    def gains(self) -> Gains:
        """How the servo answers."""
        return Gains(self.proportional_um_s, self.integral_um_s2, self.filter_s)

    def error(self, window: WindowObservation) -> float:
        """Share of opens above the target, less the shorts."""
        return (window.open - window.short) / WINDOW_PULSES - self.open_target_share

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Take in the operator's setting and where the leg has corners."""
        line = Polyline(points_um * 1e-3, closed=False)
        self._machine = machine
        self._corners_um = line.s[line.corners(CORNER_DEG)] * 1e3 + start_um
        self._start_um = start_um

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut."""
        return self._with_setting(super().reset(max_feed_um_s), self._start_um)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed and setting for the next window."""
        return self._with_setting(super().update(window), window.path_um)

    def factor(self, path_um: float) -> float:
        """Return the period at a place of the path, in the operator's."""
        near = self.corner_um > 0 and bool((np.abs(self._corners_um - path_um) <= self.corner_um).any())
        return self.period_factor * (self.corner_factor if near else 1.0)

    def _with_setting(self, command: FeedCommand, path_um: float) -> FeedCommand:
        """Add the setting to a command: whole us, and no period shorter than the supply gives."""
        if self._machine is None:
            return command
        on_us = max(round(self._machine.t_on_us * self.on_factor), 1)
        period_us = round(self._machine.t_period_us * self.factor(path_um))
        least_us = -(-least_period_us(self._machine, on_us) // 5) * 5
        return command._replace(t_on_us=float(on_us), t_period_us=float(max(period_us, least_us)))
