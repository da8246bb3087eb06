"""Servos of pulse counts at a set point of the generator: one that an operator knows, or one found on the machine.

`SetPointController` does what an operator does with knobs and a table of settings, and what machines do at corners:
they take power back there, because the wire bends with it, and lead the guides beside the path by as much as it is
bent. The numbers are ours; those of a task's reference lines are in `edmsim.evaluation.lines`.

`ClimbController` searches: more power until a wire breaks, then less. It is how an operator finds the setting for a
wire and a height that no table has (ours). Its pace was chosen in the first version of ThinWire: of five on 64
training machines that of the defaults earned 1,336, with 23 wires lost; the others 1,100 to 1,359, with 20 to 27.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.feed.gap_servo import Gains, ServoController
from edmsim.controllers.protocols import FeedCommand, WindowObservation
from edmsim.geometry import CORNER_DEG, Polyline
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES, least_period_us

STEP_US = 5
"""The shortest period is rounded up to whole multiples of this (ours: knobs have steps)."""


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
    before_um, behind_um : float
        Lengths of path before and behind a corner on which the period is longer; 0 for none.
    corner_factor : float
        Period there over the period elsewhere.
    slack_um : float
        Where this is above 0, that is so for a wire that 1 N per m of workpiece bends by as many um, and longer or
        shorter in proportion to the root of what it bends another: errors grow with the bend, and time with the
        period.
    offset_um : float
        Offset to the left of the path.
    pull_N_m : float
        Force on the wire per height of workpiece, forward; below 0 for a wire that lags. It bends the wire ahead of
        its guides, by `lead_um`, and a corner turns that into an error beside the path: behind it, the offset is
        changed by as much to the other side, and less and less as the wire comes round.
    fade_um : float
        Length of path behind a corner on which that falls to 1/e.
    """

    name: ClassVar[str] = "set-point"

    open_target_share: float = 0.1
    proportional_um_s: float = 10.0
    integral_um_s2: float = 30.0
    on_factor: float = 1.0
    period_factor: float = 1.0
    before_um: float = 0.0
    behind_um: float = 0.0
    corner_factor: float = 4.0
    slack_um: float = 0.0
    offset_um: float = 0.0
    pull_N_m: float = 0.0
    fade_um: float = 100.0

    _factor: float = field(default=1.0, init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._machine: Machine | None = None
        self._corners_um: NDArray[np.float64] = np.zeros(0)
        self._turns_rad: NDArray[np.float64] = np.zeros(0)
        self._lead_um = self._start_um = self._least_us = 0.0
        self._on_us = self._at_corner = 1.0

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
        corners = line.corners(CORNER_DEG)
        self._corners_um = line.s[corners] * 1e3 + start_um
        self._turns_rad = np.radians(line.turn_deg[corners])
        self._lead_um = lead_um(machine, self.pull_N_m)
        slack = math.sqrt(lead_um(machine, 1.0) / self.slack_um) if self.slack_um else 1.0
        self._at_corner = max(self.corner_factor * slack, 1.0)
        self._start_um = start_um

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut."""
        command = super().reset(max_feed_um_s)
        self._factor = self.factor(self._start_um)
        return self._with_setting(command)._replace(offset_um=self.offset(self._start_um))

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed and setting for the next window."""
        factor = self.factor(window.path_um)
        self._servo.integral_um_s *= self._factor / factor
        self._factor = factor
        return self._with_setting(super().update(window))._replace(offset_um=self.offset(window.path_um))

    def factor(self, path_um: float) -> float:
        """Return the period at a place of the path, in the operator's, and not shorter than the supply gives."""
        passed_um = path_um - self._corners_um
        near = bool(((-self.before_um < passed_um) & (passed_um < self.behind_um)).any())
        return max(self._slowing() * (self._at_corner if near else 1.0), self.least_factor)

    def offset(self, path_um: float) -> float:
        """Return the offset at a place of the path, to its left."""
        behind_um = path_um - self._corners_um
        passed = behind_um >= 0.0
        lateral_um = self._lead_um * np.sin(self._turns_rad[passed]) * np.exp(-behind_um[passed] / self.fade_um)
        return self.offset_um + float(lateral_um.sum())

    @property
    def least_factor(self) -> float:
        """Shortest period that the supply gives, in the operator's; 0 where no set-up is known."""
        return 0.0 if self._machine is None else self._least_us / self._machine.t_period_us

    def _slowing(self) -> float:
        """Period away from corners, in the operator's."""
        return self.period_factor

    def _with_setting(self, command: FeedCommand) -> FeedCommand:
        """Add the setting to a command, in whole us."""
        if self._machine is None:
            return command
        period_us = float(round(self._machine.t_period_us * self._factor))
        return command._replace(t_on_us=self._on_us, t_period_us=period_us)


def lead_um(machine: Machine, force_N_m: float) -> float:
    """Return how far a wire is bent, in um, in the mean over the workpiece's height.

    A string between the guides with an even load over the middle of its length: ``q h (2 l - h) / (8 T)`` at mid
    height, less ``q h**2 / (24 T)`` in the mean.

    Parameters
    ----------
    machine : Machine
        Height h, tension T and distance l of the guides.
    force_N_m : float
        The load q.
    """
    height_m, guides_m = machine.height_mm * 1e-3, machine.guide_distance_mm * 1e-3
    bent = height_m * (2 * guides_m - height_m) / 8 - height_m**2 / 24
    return force_N_m * bent / machine.tension * 1e6


@dataclass
class ClimbController(SetPointController):
    """Shortens the period step by step until the wire breaks, and stays below what broke it.

    Further parameters: see `SetPointController`; ``period_factor`` is where the first wire begins.

    Parameters
    ----------
    climb_s : float
        Time of cutting after which the period is made shorter; it waits while the wire retracts.
    step_share : float
        By how much: a share of it.
    back_factor : float
        Period after a break over the one that broke the wire. From there on it is held; a further break lengthens it
        again.
    """

    name: ClassVar[str] = "climb"

    climb_s: float = 5.0
    step_share: float = 0.13
    back_factor: float = 1.41

    _climb: dict[str, float] = field(default_factory=dict, init=False, repr=False)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut, with nothing known of the machine."""
        self._climb = {"factor": self.period_factor, "held_s": 0.0, "broken": 0.0}
        return super().reset(max_feed_um_s)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed and setting for the next window."""
        climb = self._climb
        if not (self._servo.retracting or climb["broken"]):
            climb["held_s"] += window.duration_s
        if climb["held_s"] >= self.climb_s:
            climb["held_s"] = 0.0
            climb["factor"] = max(climb["factor"] * (1.0 - self.step_share), self.least_factor)
        return super().update(window)

    def wire_lost(self) -> FeedCommand:
        """Begin with a fresh wire where the last one broke, at a longer period."""
        climb, limit_um_s = self._climb, self._servo.max_feed_um_s
        climb |= {"factor": climb["factor"] * self.back_factor, "held_s": 0.0, "broken": 1.0}
        return SetPointController.reset(self, limit_um_s)

    def _slowing(self) -> float:
        """Period away from corners, in the operator's."""
        return self._climb["factor"]
