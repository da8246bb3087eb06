"""A servo of pulse counts at one setting of the generator, with longer pauses near corners if wanted.

It is what an operator does with knobs and a table of settings, and what machines do at corners: they take power back
there, because the wire bends with it. The numbers are ours; those of a task's reference lines are in
`edmsim.evaluation.lines`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.feed.gap_servo import Gains, ServoController
from edmsim.controllers.protocols import ControllerState, FeedCommand, WindowObservation
from edmsim.controllers.pulse_counters import WINDOW_PULSES
from edmsim.geometry import Polyline
from edmsim.machine.machine import Machine
from edmsim.machine.setting import least_period_us

STEP_US = 5
"""The shortest period is rounded up to whole multiples of this (ours: knobs have steps)."""
CORNER_DEG = 20.0
"""A corner is where the path turns by at least this (ours: chords of arcs turn by less)."""


@dataclass
class SetPointController(ServoController):
    """Holds the share of opens less shorts by the feed, at a setting in proportion to the operator's.

    Where the period changes, the feed changes with it at once, as the metal does that is removed: a servo alone would
    run into the metal for a second.

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
    _on_us: float = field(default=1.0, init=False, repr=False)
    _least_us: float = field(default=0.0, init=False, repr=False)
    _factor: float = field(default=1.0, init=False, repr=False)

    def gains(self) -> Gains:
        """How the servo answers."""
        return Gains(self.proportional_um_s, self.integral_um_s2, self.filter_s)

    def error(self, window: WindowObservation) -> float:
        """Share of opens above the target, less the shorts."""
        return (window.open - window.short) / WINDOW_PULSES - self.open_target_share

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Take in the operator's setting, what the supply gives, and where the leg has corners."""
        line = Polyline(points_um * 1e-3, closed=False)
        self._machine = machine
        self._on_us = float(max(round(machine.t_on_us * self.on_factor), 1))
        self._least_us = float(math.ceil(least_period_us(machine, self._on_us) / STEP_US) * STEP_US)
        self._corners_um = line.s[line.corners(CORNER_DEG)] * 1e3 + start_um
        self._start_um = start_um

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut."""
        command = super().reset(max_feed_um_s)
        self._factor = self.factor(self._start_um)
        return self._with_setting(command)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed and setting for the next window."""
        factor = self.factor(window.path_um)
        self._servo.integral_um_s *= self._factor / factor
        self._factor = factor
        return self._with_setting(super().update(window))

    def snapshot(self) -> ControllerState:
        """Everything that changes while cutting."""
        return {**super().snapshot(), "factor": self._factor}

    def restore(self, state: ControllerState) -> None:
        """Continue where `snapshot` was taken."""
        self._factor = float(state["factor"])
        super().restore({name: value for name, value in state.items() if name != "factor"})

    def factor(self, path_um: float) -> float:
        """Return the period at a place of the path, in the operator's, and not shorter than the supply gives."""
        near = self.corner_um > 0 and bool((np.abs(self._corners_um - path_um) <= self.corner_um).any())
        return max(self._wanted() * (self.corner_factor if near else 1.0), self.least_factor)

    @property
    def least_factor(self) -> float:
        """Shortest period that the supply gives, in the operator's; 0 where no set-up is known."""
        return 0.0 if self._machine is None else self._least_us / self._machine.t_period_us

    def _wanted(self) -> float:
        """Period away from corners, in the operator's."""
        return self.period_factor

    def _with_setting(self, command: FeedCommand) -> FeedCommand:
        """Add the setting to a command, in whole us."""
        if self._machine is None:
            return command
        period_us = float(round(self._machine.t_period_us * self._factor))
        return command._replace(t_on_us=self._on_us, t_period_us=period_us)
