"""One cut by one controller, and what came of it."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import NamedTuple

import numpy as np
import shapely

from ..controllers import FeedCommand, FeedController, SeesTruth, WindowObservation, make
from ..cosim import change_setting
from ..errors import InputError, PlantError
from ..metrology import profile_error
from ..plant.plant import Plant, PulseWindow
from .scenarios import MAX_FEED_UM_S, NEAR_CORNER_UM, Scenario, draw
from .track import Track

FINISHED, BROKEN, JAMMED, STOPPED, TIME = "finished", "wire break", "jammed", "stopped", "time"
"""How a cut can end. Jammed: the wire was driven into the metal, beyond what the model holds for. Stopped: the
controller gave up."""
ORACLE = "oracle"
ORACLE_GAPS_UM = (3.0, 4.0, 5.0, 6.0, 7.0, 9.0)
"""Gaps the oracle rehearses a cut with (ours: from shorts all the time to a wide gap)."""
_HEIGHT_EVERY_UM = 5.0


class Result(NamedTuple):
    """What came of a cut.

    Attributes
    ----------
    seed : int
    controller : str
    outcome : str
    time_s, length_mm, area_mm2 : float
        Machine time; path cut, and its length times the local height.
    rate_mm2_min : float
        Area over time, where a lost wire costs the machine's time for threading another.
    short_share, open_share : float
        Of all pulses.
    error_um : float
        Root mean square of the profile error: of the cut edge at the contour, of the wire's true path near the
        corner; NaN elsewhere, and where the cut did not come that far.
    hottest_K : float
        Highest wire temperature.
    """

    seed: int
    controller: str
    outcome: str
    time_s: float
    length_mm: float
    area_mm2: float
    rate_mm2_min: float
    short_share: float
    open_share: float
    error_um: float
    hottest_K: float

    @property
    def broke(self) -> bool:
        """Whether the wire broke."""
        return self.outcome == BROKEN

    @property
    def jammed(self) -> bool:
        """Whether the wire was driven into the metal for good."""
        return self.outcome in (JAMMED, STOPPED)


def cut(env_id: str, seed: int, controller: str, resolution: str) -> Result:
    """Make one cut; the oracle rehearses it with several gaps, and its fastest cut counts.

    Parameters
    ----------
    env_id : str
    seed : int
        Of the set-up and of every draw of the plant.
    controller : str
        Name of a feed controller; its gains are those found by the search.
    resolution : {"fast", "default", "fine"}
    """
    scenario = draw(env_id, seed)
    if controller != ORACLE:
        return Episode(scenario, make(controller), seed, resolution).run()
    tried = [
        Episode(scenario, make(ORACLE, gap_target_um=gap), seed, resolution).run() for gap in ORACLE_GAPS_UM
    ]
    return max(tried, key=lambda result: result.rate_mm2_min)


class Episode:
    """One cut in progress.

    Parameters
    ----------
    scenario : Scenario
    controller : FeedController
        Is reset.
    seed : int
        Of every draw of the plant.
    resolution : str
    """

    def __init__(self, scenario: Scenario, controller: FeedController, seed: int, resolution: str) -> None:
        x, y = (float(v) for v in scenario.points_um[0])
        self.scenario = scenario
        self.controller = controller
        self.plant = Plant(
            scenario.machine, seed, stock=scenario.stock, position_um=(x, y), resolution=resolution
        )
        if not self.plant.window_ns:
            raise InputError("controllers are compared with generators of a fixed period")
        self.track = Track(scenario.points_um, scenario.machine.base.table.step_um.value)
        self._seed = seed
        self._short = self._open = self._pulses = 0
        self._furthest_um = self._hottest_K = self._error2_um3 = self._near_um = 0.0
        self._command = controller.reset(MAX_FEED_UM_S)

    def run(self) -> Result:
        """Cut to the end."""
        outcome = None
        while outcome is None:
            outcome = self.step()
        return self._result(outcome)

    def step(self) -> str | None:
        """Run one window; returns the outcome if that was the last."""
        feed = min(max(self._command.feed_um_s, -MAX_FEED_UM_S), MAX_FEED_UM_S)
        steps = self.track.advance(self.plant.time_ns, self.plant.window_ns, feed)
        try:
            window = self.plant.advance(steps)
        except PlantError as error:
            self._add(error.window)
            return JAMMED
        self._add(window)
        if window.broken:
            return BROKEN
        self._command = self._ask(window, feed)
        if self._command.alarm is not None:
            return STOPPED
        if self.track.done:
            return FINISHED
        return TIME if self.plant.time_ns * 1e-9 >= self.scenario.limit_s else None

    def _ask(self, window: PulseWindow, feed_um_s: float) -> FeedCommand:
        """Show the window to the controller and set the generator as it wants, unless that is refused."""
        if isinstance(self.controller, SeesTruth):
            self.controller.see(window)
        command = self.controller.update(WindowObservation(
            self.plant.time_ns * 1e-9, window.duration_ns * 1e-9, window.short, window.open,
            window.mean_voltage_V, window.mean_current_A, window.mean_delay_us, feed_um_s, self.track.path_um,
        ))  # fmt: skip
        with suppress(InputError):  # a refused setting changes nothing
            change_setting(self.plant, command.t_on_us, command.t_period_us)
        return command

    def _add(self, window: PulseWindow) -> None:
        self._short += window.short
        self._open += window.open
        self._pulses += window.pulses
        self._hottest_K = max(self._hottest_K, window.wire_temperature_K)
        gained = max(0.0, self.track.path_um - self._furthest_um)
        self._furthest_um += gained
        corner = self.scenario.corner_um
        if corner is None or not gained:
            return
        wire = np.add(self.plant.commanded_um, window.deflection_um)
        if math.dist(wire, corner) <= NEAR_CORNER_UM:
            off = shapely.LineString(self.scenario.points_um).distance(shapely.Point(wire))
            self._error2_um3 += off**2 * gained
            self._near_um += gained

    def _result(self, outcome: str) -> Result:
        seconds = self.plant.time_ns * 1e-9
        area = self._area_mm2()
        lost_s = self.scenario.machine.base.table.threading_s.value if outcome in (BROKEN, JAMMED, STOPPED) else 0.0
        return Result(
            self._seed, self.controller.name, outcome, seconds, self._furthest_um * 1e-3, area,
            60.0 * area / (seconds + lost_s), self._short / self._pulses, self._open / self._pulses,
            self._error_um(), self._hottest_K,
        )

    def _area_mm2(self) -> float:
        """Path cut times the local height, as the slices have it."""
        relief = self.plant.field.relief
        if relief is None or not self._furthest_um:
            return self._furthest_um * 1e-3 * self.scenario.machine.height_mm
        count = math.ceil(self._furthest_um / _HEIGHT_EVERY_UM)
        along = (np.arange(count) + 0.5) * (self._furthest_um / count)
        line = shapely.LineString(self.scenario.points_um)
        heights = relief.heights_mm(shapely.get_coordinates(shapely.line_interpolate_point(line, along)))
        return float(heights.mean()) * self._furthest_um * 1e-3

    def _error_um(self) -> float:
        if self.scenario.contour is not None:
            return profile_error(self.plant.field, self.scenario.contour).stats()["rms"]
        return math.sqrt(self._error2_um3 / self._near_um) if self._near_um else math.nan
