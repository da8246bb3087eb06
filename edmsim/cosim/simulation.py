"""The loop of design section 1: counts to the feed law, speed to the planner, steps to the plant, and round again.

One turn is one window of 255 pulses. Controllers see what a machine would let them see; the plant sees motor
steps and the generator's setting; nothing else passes between them.
"""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers import FeedController, WindowObservation
from edmsim.controllers.known_setup import tell
from edmsim.controllers.mcu.firmware.timers import MAX_FEED_UM_S
from edmsim.controllers.planner.registry import Planner, Step, make_planner, position_unit
from edmsim.controllers.protocols import DrivesSteps, MissesWindows, check_command
from edmsim.controllers.pulse_counters import WINDOW_PULSES, PulseAnalyser
from edmsim.cosim.legs import legs_of
from edmsim.cosim.sums import Sums
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.plant.plant import Plant
from edmsim.plant.window import PulseWindow
from edmsim.plant.workpiece.height_steps import HeightStep
from edmsim.plant.workpiece.kerf_field import Stock
from edmsim.program.path import CutPath
from edmsim.recording.closeups import NOTHING, RETRACT, TURN, Closeups, turns_um
from edmsim.recording.frames import Frames
from edmsim.recording.windows import WindowTable

FINISHED, WIRE_BREAK, LIMIT_SWITCH, PERSISTENT_SHORT, TIME_LIMIT = (
    "finished", "wire-break", "limit-switch", "persistent-short", "time-limit",
)
"""Outcomes of a cut."""


class _Speeds(NamedTuple):
    """Speeds of a window in units: one, and from a time on another."""

    first: int
    change_ns: int
    then: int

    def at(self, end_ns: int) -> int:
        """Return the speed in force at the window's end."""
        return self.then if self.change_ns < end_ns else self.first


class Progress(NamedTuple):
    """How far a cut is, for whoever watches."""

    path_um: float
    total_um: float
    time_s: float
    feed_um_s: float
    short: int
    open: int


class Simulation:
    """One cut in progress.

    Parameters
    ----------
    machine : Machine
    path : CutPath
    controller : FeedController
        Fresh; it is reset at the start of every leg.
    planner : str
        See `make_planner`. It counts steps in place of um where the table travels further than 16 bits of um
        (row T-61).
    seed : int
    resolution : str
    max_time_s : float, optional
        Machine time after which the cut is stopped.
    steps : tuple of HeightStep
        Where the workpiece is less high than `machine.height_mm`; see `edmsim.program.heights`.
    mechanics : {"modal", "mujoco"}
        What moves table and wire; see `Plant`.
    max_feed_um_s : float
        Greatest feed a controller may command; the planner's own, where that is less.

    Attributes
    ----------
    outcome, reason : str or None
        How the cut ended, and why.
    missed_windows : int
        Windows whose counts the controller did not read in time (row T-44).
    refused : str or None
        Why the generator last refused a setting the controller wanted.

    Raises
    ------
    InputError
        An unknown planner or resolution, a step that does not fit the machine's height, or a table too large, or
        motor steps of a length, that the planner cannot count.
    """

    def __init__(
        self,
        machine: Machine,
        path: CutPath,
        controller: FeedController,
        *,
        planner: str = "poscal",
        seed: int = 0,
        resolution: str = "default",
        max_time_s: float | None = None,
        steps: tuple[HeightStep, ...] = (),
        mechanics: str = "modal",
        max_feed_um_s: float = MAX_FEED_UM_S,
    ) -> None:
        self.machine = machine
        self.path = path
        self.controller = controller
        self._drives = controller if isinstance(controller, DrivesSteps) else None
        self._planner_name = planner
        table = machine.base.table
        self._step_um = table.step_um.value
        self._unit = position_unit(planner, table.travel_mm.value * 1e3, self._step_um)
        self._max_feed_um_s = max_feed_um_s
        self._max_time_ns = None if max_time_s is None else round(max_time_s * 1e9)
        self.legs = [leg for contour in path.contours for leg in legs_of(contour)]
        x0, y0, x1, y1 = (1e3 * v for v in path.stock_mm)
        radius = path.start_hole_radius_mm * 1e3
        holes = tuple((float(c.points_um[0, 0]), float(c.points_um[0, 1]), radius) for c in path.contours)
        first = path.contours[0].points_um[0]
        self.plant = Plant(
            machine, seed, stock=Stock((x0, y0, x1, y1), holes, steps, machine.height_mm),
            position_um=(float(first[0]), float(first[1])), resolution=resolution, mechanics=mechanics,
        )
        self.analyser = PulseAnalyser()
        self.windows = WindowTable()
        self.frames = Frames(self.plant.resolution.slices)
        slices, lowest_mm = self.plant.resolution.slices, min([s.height_mm for s in steps], default=machine.height_mm)
        middle = max(round(slices * lowest_mm / machine.height_mm), 1) // 2  # it has metal everywhere
        self.closeups = Closeups(slices, self.plant.resolution.rays, middle)
        self.plant.watch_pulses()
        self._feed_um_s, self._turns_passed = 0.0, 0
        self.sums = Sums()
        self.outcome: str | None = None
        self.reason: str | None = None
        self.refused: str | None = None
        self._missed_before = 0
        self._leg = 0
        self._dwell_until_ns = -1
        self._before_um = 0.0
        self._begin_leg(self.plant.commanded_um)
        self.total_um = sum(float(np.hypot(*np.diff(leg.points_um, axis=0).T).sum()) for leg in self.legs)

    def _begin_leg(self, place_um: tuple[float, float]) -> None:
        """Plan a leg from where the wire stands: it may have stopped half a step before the last leg's end."""
        self._leg_from_um = place_um
        points = self.legs[self._leg].points_um
        self._rest_until_ns = self.plant.time_ns + round(self.legs[self._leg].rest_s * 1e9)
        if place_um != (points[0, 0], points[0, 1]):
            points = np.concatenate([[place_um], points])
        tell(self.controller, self.machine, points)
        self._planner: Planner = make_planner(self._planner_name, points, unit=self._unit, step_um=self._step_um)
        self._turns_um, self._turns_passed = turns_um(points), 0
        self._dwell_until_ns = -1
        self._units = 0
        self._command = check_command(self.controller.name, self.controller.reset(self._limit_um_s))
        self._set_generator(self.machine.t_on_us, self.machine.t_period_us)  # every leg begins as set up

    @property
    def _limit_um_s(self) -> float:
        return min(self._max_feed_um_s, self._planner.max_feed_um_s)

    @property
    def path_um(self) -> float:
        """Length of path behind the wire, over all legs."""
        return self._before_um + self._planner.path_um

    @property
    def missed_windows(self) -> int:
        """Windows of all legs that were not read in time."""
        of_leg = self.controller.missed_windows if isinstance(self.controller, MissesWindows) else 0
        return self._missed_before + of_leg

    def step(self) -> Progress:
        """Run one window; afterwards `outcome` tells whether the cut is over."""
        start_ns = self.plant.time_ns
        speeds = self._speeds(start_ns)
        window = self._run_window(start_ns, speeds)
        self._units = speeds.at(self.plant.time_ns)
        feed = self._units * self._planner.speed_unit_nm_s * 1e-3
        self.sums.add(window)
        self._record(window, feed)
        if window.pulses == WINDOW_PULSES:
            self.analyser.count_window(window.short, window.open)
            counts = self.analyser.read()
            seen = WindowObservation(
                self.plant.time_ns * 1e-9, window.duration_ns * 1e-9, counts.short, counts.open,
                window.mean_voltage_V, window.mean_current_A, window.mean_delay_us, feed, self._planner.path_um,
            )
            self._command = check_command(self.controller.name, self.controller.update(seen))
            self._set_generator(self._command.t_on_us, self._command.t_period_us)
        self._judge(window)
        return Progress(
            self.path_um, self.total_um, self.plant.time_ns * 1e-9, feed, window.short, window.open
        )

    def _set_generator(self, t_on_us: float | None, t_period_us: float | None) -> None:
        """Give the generator the setting wanted; one it refuses changes nothing and is told in `refused`."""
        now = self.plant.machine.t_on_us, self.plant.machine.t_period_us
        wanted = now[0] if t_on_us is None else t_on_us, now[1] if t_period_us is None else t_period_us
        if wanted == now:
            return
        try:
            self.plant.set_generator(*wanted)
        except InputError as error:
            self.refused = error.reason

    def _speeds(self, start_ns: int) -> _Speeds:
        """Return the speeds of the window that begins: the last one until the controller is done, then its new."""
        if self._dwell_until_ns >= 0 or start_ns < self._rest_until_ns:
            return _Speeds(0, start_ns, 0)
        feed_um_s = max(-self._limit_um_s, min(self._limit_um_s, self._command.feed_um_s))
        units = round(feed_um_s * 1e3 / self._planner.speed_unit_nm_s)
        return _Speeds(self._units, start_ns + round(self._command.latency_s * 1e9), units)

    def _run_window(self, start_ns: int, speeds: _Speeds) -> PulseWindow:
        if self.plant.window_ns:
            return self.plant.advance(self._drive(self._plan(start_ns, start_ns + self.plant.window_ns, speeds)))
        # where the period varies, the window's end is known only afterwards: plan for the longest, then undo
        before = self._planner.snapshot()
        window = self.plant.advance(self._plan(start_ns, start_ns + self.plant.longest_window_ns, speeds))
        self._planner.restore(before)
        self._drive(self._plan(start_ns, self.plant.time_ns, speeds))  # told late, but those of the window only
        return window

    def _drive(self, steps: list[Step]) -> list[Step]:
        """Return the steps the motors are to make: a controller that has lines to them makes them itself."""
        return self._drives.drive(steps) if self._drives and steps else steps

    def _plan(self, start_ns: int, end_ns: int, speeds: _Speeds) -> list[Step]:
        """Motor steps of a window."""
        change_ns = min(speeds.change_ns, end_ns)
        if change_ns <= start_ns or speeds.first == speeds.then:
            return self._planner.advance(start_ns, end_ns, speeds.then)
        steps = self._planner.advance(start_ns, change_ns, speeds.first)
        return steps + self._planner.advance(change_ns, end_ns, speeds.then) if change_ns < end_ns else steps

    def _record(self, window: PulseWindow, feed_um_s: float) -> None:
        x, y = self.plant.commanded_um
        t_s = self.plant.time_ns * 1e-9
        self.windows.append(
            (
                t_s, x, y, feed_um_s, window.short, window.open, window.spark, window.arc,
                window.mean_voltage_V, window.mean_current_A, window.mean_delay_us, window.gap_um,
                -window.deflection_um[0], -window.deflection_um[1], window.wire_temperature_K, window.debris,
                self.plant.machine.t_on_us, self.plant.machine.t_period_us, self.path_um,
            )
        )
        if self.frames.wants_next:
            self.frames.offer(t_s, x, y, self.path_um, self.plant.deflections_um())
        else:
            self.frames.skip()

        self._keep_closeup(t_s, x, y, feed_um_s)

    def _keep_closeup(self, t_s: float, x: float, y: float, feed_um_s: float) -> None:
        plant, row = self.plant, self.closeups.row
        timing = plant.timing
        row["t_s"], row["guides_um"], row["path_um"] = t_s, (x, y), self.path_um
        row["burning_V"], row["current_A"], row["short_A"] = timing.burning_V, timing.current_A, timing.short_A
        row["wire_um"], row["walls_um"] = plant.walls_um(self.closeups.slice_index)
        row["deflection_um"] = plant.deflections_um()
        self.closeups.fill_pulses(plant.last_pulses())
        passed = bisect(self._turns_um, self._planner.path_um)
        event = TURN if passed != self._turns_passed else RETRACT if feed_um_s < 0 <= self._feed_um_s else NOTHING
        self._turns_passed, self._feed_um_s = passed, feed_um_s
        self.closeups.keep(event)

    def _judge(self, window: PulseWindow) -> None:
        x, y = self.plant.place_um  # the switches feel the carriage, not the position counter
        slack = self.machine.base.table.step_um.value
        travel = self.machine.base.table.travel_mm.value * 1e3
        if window.broken:
            height = self.plant.broken_height_mm
            self._stop(WIRE_BREAK, f"the wire broke {height:.1f} mm above the workpiece's lower face")
        elif self._command.alarm is not None:
            self._stop(PERSISTENT_SHORT, self._command.alarm)
        elif not (-slack <= x <= travel + slack and -slack <= y <= travel + slack):
            self._stop(LIMIT_SWITCH, f"an end switch of the table opened at x {x / 1e3:.3f} y {y / 1e3:.3f} mm")
        elif self._max_time_ns is not None and self.plant.time_ns >= self._max_time_ns:
            self._stop(TIME_LIMIT, f"the time limit of {self._max_time_ns * 1e-9:g} s of machine time was reached")
        elif self._planner.done:
            self._end_of_leg()

    def _stop(self, outcome: str, reason: str) -> None:
        self.outcome, self.reason = outcome, reason

    def _end_of_leg(self) -> None:
        leg = self.legs[self._leg]
        now = self.plant.time_ns
        if leg.dwell_s > 0 and self._dwell_until_ns < 0:
            self._dwell_until_ns = now + round(leg.dwell_s * 1e9)
        if now < self._dwell_until_ns:
            return
        if leg is self.legs[-1]:
            self.outcome = FINISHED
            return
        self._before_um += self._planner.path_um
        self._missed_before = self.missed_windows
        self._leg += 1
        following = self.legs[self._leg]
        if following.threads:
            self._thread_at(following.points_um[0])
        self._begin_leg(self.plant.commanded_um)

    def _thread_at(self, point_um: NDArray[np.int64]) -> None:
        table = self.machine.base.table
        x, y = self.plant.commanded_um
        way = math.hypot(point_um[0] - x, point_um[1] - y)
        seconds = way / table.rapid_um_s.value + table.threading_s.value
        self.plant.rethread((float(point_um[0]), float(point_um[1])), round(seconds * 1e9))

    def run(self, watch: Callable[[Progress], None] | None = None) -> str:
        """Run until the cut is over; returns the outcome. `watch` is called after every window."""
        while self.outcome is None:
            progress = self.step()
            if watch is not None:
                watch(progress)
        return self.outcome

    def snapshot(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Return everything that changes: arrays, and plain values fit for JSON."""
        arrays = {f"plant.{k}": v for k, v in self.plant.snapshot().items()}
        arrays.update({f"windows.{k}": np.asarray(v) for k, v in self.windows.snapshot().items()})
        arrays.update({f"frames.{k}": np.asarray(v) for k, v in self.frames.snapshot().items()})
        arrays.update({f"closeups.{k}": np.asarray(v) for k, v in self.closeups.snapshot().items()})
        values = {
            "leg": self._leg,
            "leg_from_um": list(self._leg_from_um),
            "rest_until_ns": self._rest_until_ns,
            "dwell_until_ns": self._dwell_until_ns,
            "before_um": self._before_um,
            "missed_before": self._missed_before,
            "units": self._units,
            "command": list(self._command),
            "refused": self.refused,
            "feed_um_s": self._feed_um_s,
            "turns_passed": self._turns_passed,
            "sums": vars(self.sums).copy(),
            "planner": self._planner.snapshot(),
            "controller": self.controller.snapshot(),
            "analyser": self.analyser.snapshot(),
        }
        return arrays, values

    def restore(self, arrays: Mapping[str, NDArray[Any]], values: Mapping[str, Any]) -> None:
        """Take back a `snapshot` of the same cut; it then continues bit for bit."""
        self._leg = values["leg"]
        x, y = values["leg_from_um"]
        self._begin_leg((x, y))
        self._rest_until_ns = values["rest_until_ns"]
        self._dwell_until_ns = values["dwell_until_ns"]
        self._before_um = values["before_um"]
        self._missed_before = values["missed_before"]
        self._units = values["units"]
        self._command = type(self._command)(*values["command"])
        self.refused = values["refused"]
        self.sums = Sums(**values["sums"])
        self._planner.restore(values["planner"])
        self.controller.restore(values["controller"])
        self.analyser.restore(values["analyser"])
        self.plant.restore(_part(arrays, "plant."))
        self.windows.restore(_part(arrays, "windows."))
        self.frames.restore(_part(arrays, "frames."))
        self.closeups.restore(_part(arrays, "closeups."))
        self._feed_um_s, self._turns_passed = values["feed_um_s"], values["turns_passed"]


def _part(arrays: Mapping[str, NDArray[Any]], prefix: str) -> dict[str, NDArray[Any]]:
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
