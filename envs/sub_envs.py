"""Sub-environments: episodes side by side, every one with a plant, a path and a generator setting of its own.

Everything per window is done for all sub-environments at once: the motor steps and the windows in compiled calls, the
rest on arrays. A sub-environment's bits depend on nothing but its own scenario and commands.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.mcu.firmware.poscal import Unit
from edmsim.controllers.planner.kinds import PLANNER, addresses
from edmsim.controllers.planner.registry import Course, kind_of, position_unit
from edmsim.controllers.protocols import WindowObservation
from edmsim.envs import knobs, path_follower
from edmsim.envs.task import Family, Scenario
from edmsim.errors import InputError
from edmsim.geometry import CORNER_DEG, Floats, Polyline
from edmsim.machine.machine import Machine
from edmsim.machine.setting import discharge_current_A, ignition_wait_us, open_V
from edmsim.plant.fleet import Fleet
from edmsim.plant.plant import Plant
from edmsim.plant.workpiece.blanks import wall_error_um

Ints = NDArray[np.int64]
_Number = TypeVar("_Number", np.float64, np.int64)
FINISHED_UM = 80.0
"""Distance behind the wire from which on it takes no more from a wall (ours: half of what its rays see of one)."""
STRETCH_UM = 24.0  # length of wall that is measured at every window (ours: four columns of cells)
NEVER_NS = np.iinfo(np.int64).max
_NO_STEPS: Ints = np.zeros((0, 3), np.int64)

class SubEnvs:
    """Episodes of one family; `threads` share the pulse loop."""

    def __init__(self, family: Family, count: int, threads: int = 1) -> None:
        self.family = family  # of the next episodes
        self.families = [family] * count  # of the present one of each
        self.count = count
        centre_um = family.base.base.table.centre_um
        plants = [
            Plant(family.base, 0, position_um=centre_um, resolution=family.resolution, mechanics=family.mechanics)
            for _ in range(count)
        ]
        self.fleet = Fleet(plants, threads)
        self.rows: NDArray[np.void] = np.zeros(count, path_follower.SUB_ENV)
        # (n,): what makes motor steps of every sub-environment's feed
        self.planners: NDArray[np.void] = np.zeros(count, PLANNER)
        # called after each window of a sub-environment, before a fresh wire is threaded; a copy has none
        self.watchers: list[tuple[int, Callable[[], None]]] = []
        self._planner = kind_of(family.planner)
        self._other_planner: NDArray[np.void] = np.zeros(1, PLANNER)
        # the present episode of each; None before its first one
        self.scenarios: list[Scenario | None] = [None] * count
        # (n,): why the generator refused the setting last asked for; empty where it did not
        self.refused: NDArray[np.object_] = np.full(count, "", object)
        # (n, most): length of the present leg up to each corner, infinite for the filling
        self.corner_um: Floats = np.full((count, 1), np.inf)
        self.corner_deg: Floats = np.zeros((count, 1))
        # (n,): whether path errors of the last window count, as `Family.near_corner_um` says; at a wall to finish,
        # whether some is behind the wire
        self.near = np.ones(count, np.bool_)
        # which sub-environments lost a wire in the last window, and at which on-time and period
        self.lost: list[tuple[int, tuple[float, float]]] = []
        self.leg = [0] * count  # which leg of its path each is on
        self._points: Floats = np.zeros((count, 2, 2))
        self._along: Floats = np.zeros((count, 2))
        self._lengths: Ints = np.zeros((count, 2), np.int64)
        self._height_from: Floats = np.full((count, 1), np.inf)
        self._heights: Floats = np.zeros((count, 1))

    # --- beginning ---

    def begin(self, index: int, scenario: Scenario) -> None:
        """Begin an episode."""
        machine, before = scenario.machine, self.scenarios[index]
        start = scenario.legs_um[0][0]
        position = float(start[0]), float(start[1])
        plant = self.fleet.plants[index]
        same = before is not None and before.machine is machine and before.drift is None
        another = None if same else machine
        plant.reset(scenario.plant_seed, stock=scenario.stock, position_um=position, machine=another)
        self.fleet.windows[index] = np.zeros((), self.fleet.windows.dtype)
        self.scenarios[index], self.families[index] = scenario, self.family
        self.refused[index], self.near[index] = "", True
        self.rows[index] = np.zeros((), path_follower.SUB_ENV)
        self._take_constants(index, machine)
        self.rows[index]["total_um"] = sum(float(np.hypot(*np.diff(leg, axis=0).T).sum()) for leg in scenario.legs_um)
        starts, heights = scenario.heights
        self._height_from = _with_row(self._height_from, index, starts, np.inf)
        self._heights = _with_row(self._heights, index, heights, 0.0)
        self.rows[index]["drifts_ns"] = NEVER_NS if scenario.drift is None else 0
        self._begin_leg(index, 0)

    def scenario(self, index: int) -> Scenario:
        """Return the present episode of a sub-environment that has begun one."""
        scenario = self.scenarios[index]
        if scenario is None:
            raise InputError("no episode has begun: call reset() first")
        return scenario

    def _take_constants(self, index: int, machine: Machine) -> None:
        row, generator, table = self.rows[index], machine.generator, machine.base.table
        row["open_V"] = open_V(machine)
        row["limit_A"] = generator.mean_current_limit_A.value
        row["step_um"] = table.step_um.value
        row["table_um"] = table.travel_mm.value * 1e3
        row["threading_s"] = table.threading_s.value
        family = self.families[index]
        row["latency_ns"], row["scrap_ns"] = round(family.latency_s * 1e9), int(family.scrap_s * 1e9)
        row["ends_ns"] = NEVER_NS if family.episode_s is None else min(round(family.episode_s * 1e9), NEVER_NS)
        row["near_um"] = np.inf if family.near_corner_um is None else family.near_corner_um
        row["first_setting_us"] = machine.t_on_us, machine.t_period_us
        self._take_setting(index)

    def _take_setting(self, index: int) -> None:
        row, plant = self.rows[index], self.fleet.plants[index]
        row["wait_us"] = ignition_wait_us(plant.machine)
        burning_V = plant.machine.material.burning_voltage_V.value
        row["energy_mJ"] = discharge_current_A(plant.machine) * burning_V * plant.machine.t_on_us * 1e-3
        row["setting_us"] = plant.machine.t_on_us, plant.machine.t_period_us
        row["longest_ns"] = plant.longest_window_ns

    def _begin_leg(self, index: int, leg: int) -> None:
        self.leg[index] = leg
        row, kind = self.rows[index], self._planner
        for name in ("path_um", "reached_um", "cut_um", "beside"):
            row[name] = 0
        row["settling_ns"] = path_follower.SETTLING_NS
        step_um = float(row["step_um"])
        unit = position_unit(self.family.planner, float(row["table_um"]), step_um)
        points_um = self.scenario(index).legs_um[leg]
        course, corner_um, corner_deg = _laid(
            kind.number, kind.speed_unit_nm_s, unit, step_um, points_um.tobytes(), points_um.shape
        )
        self.planners[index] = course.row[0]
        self._points = _with_row(self._points, index, course.points_um, 0.0)
        self._along = _with_row(self._along, index, course.along_um, np.inf)
        self._lengths = _with_row(self._lengths, index, course.lengths, 0)
        self.corner_um = _with_row(self.corner_um, index, corner_um, np.inf)
        self.corner_deg = _with_row(self.corner_deg, index, corner_deg, 0.0)

    # --- one window ---

    @property
    def path_um(self) -> Floats:
        """Length of path behind each sub-environment by its planner, over all its legs."""
        return np.asarray(self.rows["before_um"] + self.rows["path_um"])

    def observation(self, index: int) -> WindowObservation:
        """Return what a machine shows of a sub-environment's last window, as feed controllers see it."""
        window, row = self.fleet.plants[index].window(), self.rows[index]
        end_ns = window.start_ns + window.duration_ns  # a fresh wire may have been threaded since
        path_um = float(row["before_um"] + row["path_um"])
        return WindowObservation.of(window, end_ns, float(row["feed_um_s"]), path_um)

    def set_generator(self, index: int, t_on_us: float, t_period_us: float) -> None:
        """Set the generator to the nearest detents; a setting that it refuses is not made, and `refused` says why."""
        setting = knobs.to_detents(t_on_us, t_period_us, self.families[index].detents_us)
        self.refused[index] = ""
        if setting == tuple(self.rows[index]["setting_us"]):
            return
        try:
            self.fleet.plants[index].set_generator(*setting)
        except InputError as error:
            self.refused[index] = str(error)
        else:
            self._take_setting(index)

    def advance(self, indices: Ints, feeds_um_s: Floats) -> None:
        """Fire 255 pulses in some of them, each moving along its path at its feed (n,) in um/s, negative backwards.

        The guides go to the sub-environment's ``offset_um`` beside the path, which stays until it is set again.

        A planner that counts takes the feed in its units, and no more than its greatest; `exact` shows it as it was
        given, finer than its 1 nm/s.
        """
        fleet, rows = self.fleet, self.rows
        kind = self._planner
        feeds = feeds_um_s, kind.max_feed_um_s, kind.speed_unit_nm_s, kind.counts
        code, path = addresses(), (self._points, self._along, self._lengths)
        planners = code.advance, self.planners, self._other_planner
        most, sideways = path_follower.plan(indices, rows, *feeds, *planners, *path, fleet.states, fleet.steps)
        if most + 2 > fleet.steps.shape[1]:
            fleet.make_room(most + 2)
            path_follower.plan(indices, rows, *feeds, *planners, *path, fleet.states, fleet.steps)
        if sideways:
            path_follower.lead_sideways(indices, rows, self.planners, *path[:2], fleet.states, fleet.steps)
        failed = fleet.advance(indices, rows["steps"])
        due = path_follower.follow(
            indices, rows, *code, self.planners, *path, self._height_from, self._heights, fleet.states, fleet.windows,
            _NO_STEPS,
        )
        self._count_errors(indices)
        if len(failed):
            rows["cause"][failed[fleet.windows["broken"][failed] == 0]] = path_follower.OUT_OF_RANGE
        if self.watchers:
            advanced = set(indices.tolist())
            for index, see in self.watchers:
                if index in advanced:
                    see()
        self.lost = []
        if due:
            self._go_on(indices)

    def _go_on(self, indices: Ints) -> None:
        """Begin what follows where a leg or a wire has come to its end, or where the machine is another by now."""
        rows = self.rows
        for index in indices[rows["cause"][indices] == path_follower.DONE]:
            self._end_leg(int(index))
        for index in indices[rows["cause"][indices] == path_follower.WIRE_BREAK]:
            self._lose_wire(int(index))
        for index in indices[rows["elapsed_ns"][indices] >= rows["drifts_ns"][indices]]:
            self._drift(int(index))

    def _drift(self, index: int) -> None:
        """Let a sub-environment's machine become what it is by now, and say when it will be another."""
        scenario, elapsed_ns = self.scenario(index), int(self.rows[index]["elapsed_ns"])
        assert scenario.drift is not None
        self.fleet.plants[index].drift(scenario.drift.machine(scenario.machine, elapsed_ns * 1e-9))
        self.rows[index]["drifts_ns"] = elapsed_ns + round(scenario.drift.every_s * 1e9)

    def _count_errors(self, indices: Ints) -> None:
        if self.family.finishes_wall:
            for index in indices:
                self._measure_wall(int(index))
        elif np.isfinite(near_um := self.rows["near_um"]).any():
            way_um = np.abs(self.corner_um - self.rows["reached_um"][:, None])
            self.near = (way_um <= near_um[:, None]).any(axis=1)

    def _measure_wall(self, index: int) -> None:
        """Let the sub-environment's error be that of the wall just finished; none counts before there is one."""
        row, wall = self.rows[index], self.scenario(index).wall
        assert wall is not None
        behind_um = wall.x_um + float(row["reached_um"]) - FINISHED_UM
        self.near[index] = behind_um - STRETCH_UM >= wall.x_um
        row["error_um"] = 0.0
        if self.near[index]:
            row["error_um"] = wall_error_um(
                self.fleet.plants[index].field, wall.y_um, behind_um - STRETCH_UM, behind_um
            )

    @property
    def out_of_time(self) -> NDArray[np.bool_]:
        """Which sub-environments (n,) have cut for as long as an episode lasts."""
        return np.asarray(self.rows["elapsed_ns"] >= self.rows["ends_ns"])

    def _lose_wire(self, index: int) -> None:
        """Thread the next wire where the last one broke, if the episode has one."""
        row, plant = self.rows[index], self.fleet.plants[index]
        row["wires_lost"] += 1
        self.lost.append((index, tuple(row["setting_us"].tolist())))
        if row["wires_lost"] >= self.families[index].wires:
            return
        row["cause"] = path_follower.RUNNING
        row["settling_ns"], row["shorted_s"] = path_follower.SETTLING_NS, 0.0
        threading_ns = round(float(row["threading_s"]) * 1e9)
        plant.rethread(plant.commanded_um, threading_ns)
        if self.family.counts_threading:
            row["elapsed_ns"] += threading_ns
            row["step_ns"] += threading_ns
        self._reset_setting(index)

    def _end_leg(self, index: int) -> None:
        """Go on with the path's next piece, if there is one."""
        legs_um, plant, row = self.scenario(index).legs_um, self.fleet.plants[index], self.rows[index]
        following = self.leg[index] + 1
        if following == len(legs_um):
            return
        row["cause"] = path_follower.RUNNING
        row["before_um"] += row["path_um"]
        x, y = (float(v) for v in legs_um[following][0])
        table = plant.machine.base.table
        way = math.dist((x, y), plant.commanded_um)
        plant.rethread((x, y), round((way / table.rapid_um_s.value + table.threading_s.value) * 1e9))
        self._reset_setting(index)
        self._begin_leg(index, following)

    def _reset_setting(self, index: int) -> None:
        """Set the generator as it was set up: so every leg begins, and every wire."""
        machine, plant = self.scenario(index).machine, self.fleet.plants[index]
        if plant.machine is not machine:
            plant.set_generator(machine.t_on_us, machine.t_period_us)
            self._take_setting(index)

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy needs; watchers stay with the original."""
        return {**self.__dict__, "watchers": []}


@functools.lru_cache(maxsize=256)  # episodes of many families have one path
def _laid(
    kind: int, speed_unit_nm_s: float, unit: Unit, step_um: float, points: bytes, shape: tuple[int, int]
) -> tuple[Course, Floats, Floats]:
    """Course along a leg's points in um, and length of the leg up to each of its corners with its turn."""
    points_um = np.frombuffer(points).reshape(shape)
    line = Polyline(points_um * 1e-3, closed=False)
    corners = line.corners(CORNER_DEG)
    course = Course.of(kind, points_um, speed_unit_nm_s, unit, step_um)
    return course, line.s[corners] * 1e3, line.turn_deg[corners]


def _with_row(table: NDArray[_Number], index: int, row: NDArray[_Number], filling: float) -> NDArray[_Number]:
    """Return the table with one row replaced, made wider if it must be."""
    if len(row) > table.shape[1]:
        wider = np.full((table.shape[0], len(row), *table.shape[2:]), filling, table.dtype)
        wider[:, : table.shape[1]] = table
        table = wider
    table[index] = filling
    table[index, : len(row)] = row
    return table
