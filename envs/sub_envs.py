"""Sub-environments: parallel episodes, each with its own plant, path and generator setting.

`SubEnvs` runs their windows, `Batch` their steps: it turns actions into commands, and makes observations, rewards and
infos. Everything is done for all sub-environments at once, in compiled calls or on arrays. A sub-environment's
results depend, bit for bit, on its own scenario and commands only.
"""

import functools
import math
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from edmsim.closed_loop.stops import WORDS, StopCause
from edmsim.compiled.jit import exactly_compiled
from edmsim.compiled.random import key_of
from edmsim.controllers.planner.kinds import PLANNER, addresses
from edmsim.controllers.planner.registry import Course, kind_of, position_unit
from edmsim.controllers.protocols import WindowObservation
from edmsim.envs import gap_servo, observation, path_follower, reward
from edmsim.envs.task import EnvArguments, Family, Scenario
from edmsim.errors import InputError
from edmsim.geometry import Floats, Ints, path_corners
from edmsim.machine.machine import Machine
from edmsim.machine.setting import discharge_current_A, ignition_wait_us, open_V
from edmsim.plant.fleet import Fleet
from edmsim.plant.plant import Plant
from edmsim.plant.workpiece.blanks import wall_error_um
from edmsim.snapshots import Snapshots

_Number = TypeVar("_Number", np.float64, np.int64)
FINISHED_UM = 80.0
"""Distance behind the wire from which it erodes a wall no more (ours: half the length of wall in its rays' range)."""
STRETCH_UM = 24.0  # length of wall that is measured at every window (ours: four columns of cells)
NEVER_NS = np.iinfo(np.int64).max
_NO_STEPS: Ints = np.zeros((0, 3), np.int64)
_CAUSES = np.array(["" if cause is StopCause.RUNNING else WORDS[cause].info for cause in StopCause], object)
"""Texts of `info` for the causes of an episode's end, by their numbers."""


class SubEnvs:
    """Episodes of one family; `threads` share the pulse loop."""

    def __init__(self, family: Family, count: int, threads: int = 1) -> None:
        self.family = family  # of the next episodes
        self.families = [family] * count  # of the present episode of each
        self.count = count
        centre_um = family.base.base.table.centre_um
        plants = [
            Plant(family.base, 0, position_um=centre_um, resolution=family.resolution, mechanics=family.mechanics)
            for _ in range(count)
        ]
        self.fleet = Fleet(plants, threads)
        self.rows: NDArray[np.void] = np.zeros(count, path_follower.SUB_ENV)
        # (n,): planners that turn every sub-environment's feed into motor steps
        self.planners: NDArray[np.void] = np.zeros(count, PLANNER)
        # called after each window of a sub-environment, before a new wire is threaded; a copy has none
        self.watchers: list[tuple[int, Callable[[], None]]] = []
        self._planner = kind_of(family.planner)
        self._other_planner: NDArray[np.void] = np.zeros(1, PLANNER)
        # present episode of each; None before the first
        self.scenarios: list[Scenario | None] = [None] * count
        # (n,): why the generator refused the last setting; empty if it did not
        self.refused: NDArray[np.object_] = np.full(count, "", object)
        # (n, most): length of the present leg up to each corner, padded with infinity
        self.corner_um: Floats = np.full((count, 1), np.inf)
        self.corner_deg: Floats = np.zeros((count, 1))
        # sub-environments that lost a wire in the last window, with its on-time and period
        self.lost: list[tuple[int, tuple[float, float]]] = []
        self.leg = [0] * count  # number of the present leg of each
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
        self.refused[index] = ""
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
        row = self.rows[index]
        for name in ("path_um", "reached_um", "cut_um", "beside"):
            row[name] = 0
        row["settling_ns"] = path_follower.SETTLING_NS
        table_um, step_um = float(row["table_um"]), float(row["step_um"])
        points_um = self.scenario(index).legs_um[leg]
        laid = _laid(self.family.planner, table_um, step_um, points_um.tobytes(), points_um.shape)
        course, corner_um, corner_deg = laid
        self.planners[index] = course.row[0]
        self._points = _with_row(self._points, index, course.points_um, 0.0)
        self._along = _with_row(self._along, index, course.along_um, np.inf)
        self._lengths = _with_row(self._lengths, index, course.lengths, 0)
        self.corner_um = _with_row(self.corner_um, index, corner_um, np.inf)
        self.corner_deg = _with_row(self.corner_deg, index, corner_deg, 0.0)

    # --- one window ---

    def observation(self, index: int) -> WindowObservation:
        """Return the observation of a sub-environment's last window for feed controllers."""
        window, row = self.fleet.plants[index].window(), self.rows[index]
        end_ns = window.start_ns + window.duration_ns  # a new wire may have been threaded since
        path_um = float(row["before_um"] + row["path_um"])
        return WindowObservation.of(window, end_ns, float(row["feed_um_s"]), path_um)

    def set_generator(self, index: int, t_on_us: float, t_period_us: float) -> None:
        """Set the generator to the nearest detents; if it refuses, nothing changes, and `refused` has the reason."""
        setting = self.families[index].to_detents(t_on_us, t_period_us)
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

        The guides move to the sub-environment's ``offset_um`` from the path, which holds until it is set again.

        A planner that counts rounds the feed to its units and limits it to its greatest feed; with `exact` the
        recorded feed is not rounded to the planner's 1 nm/s.
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
            indices, rows, *code, self.planners, *path, self._height_from, self._heights, self.corner_um,
            fleet.states, fleet.windows, _NO_STEPS,
        )
        if self.family.finishes_wall:
            for index in indices.tolist():
                self._measure_wall(index)
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
        """Continue after the end of a leg or a wire, and update machines whose drift is due."""
        rows = self.rows
        for index in indices[rows["cause"][indices] == path_follower.DONE]:
            self._end_leg(int(index))
        for index in indices[rows["cause"][indices] == path_follower.WIRE_BREAK]:
            self._lose_wire(int(index))
        for index in indices[rows["elapsed_ns"][indices] >= rows["drifts_ns"][indices]]:
            self._drift(int(index))

    def _drift(self, index: int) -> None:
        """Update a sub-environment's machine to its drift, and set the time of the next update."""
        scenario, elapsed_ns = self.scenario(index), int(self.rows[index]["elapsed_ns"])
        assert scenario.drift is not None
        self.fleet.plants[index].drift(scenario.drift.machine(scenario.machine, elapsed_ns * 1e-9))
        self.rows[index]["drifts_ns"] = elapsed_ns + round(scenario.drift.every_s * 1e9)

    def _measure_wall(self, index: int) -> None:
        """Set the sub-environment's error to that of the wall just finished; before that, no error counts."""
        row, wall = self.rows[index], self.scenario(index).wall
        assert wall is not None
        behind_um = wall.x_um + float(row["reached_um"]) - FINISHED_UM
        row["near"] = behind_um - STRETCH_UM >= wall.x_um
        row["error_um"] = 0.0
        if row["near"]:
            row["error_um"] = wall_error_um(
                self.fleet.plants[index].field, wall.y_um, behind_um - STRETCH_UM, behind_um
            )

    @property
    def out_of_time(self) -> NDArray[np.bool_]:
        """Which sub-environments (n,) have reached the time limit of an episode."""
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
        """Begin the path's next leg, if there is one."""
        legs_um, plant, row = self.scenario(index).legs_um, self.fleet.plants[index], self.rows[index]
        following = self.leg[index] + 1
        if following == len(legs_um):
            return
        row["cause"] = path_follower.RUNNING
        row["before_um"] += row["path_um"]
        x, y = (float(v) for v in legs_um[following][0])
        table = plant.machine.base.table
        distance_um = math.dist((x, y), plant.commanded_um)
        plant.rethread((x, y), round((distance_um / table.rapid_um_s.value + table.threading_s.value) * 1e9))
        self._reset_setting(index)
        self._begin_leg(index, following)

    def _reset_setting(self, index: int) -> None:
        """Set the generator to the episode's first setting, with which every leg and every wire begins."""
        machine, plant = self.scenario(index).machine, self.fleet.plants[index]
        if plant.machine is not machine:
            plant.set_generator(machine.t_on_us, machine.t_period_us)
            self._take_setting(index)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state of a copy, which has no watchers."""
        return {**self.__dict__, "watchers": []}


@functools.lru_cache(maxsize=256)  # in many families all episodes have the same path
def _laid(
    planner: str, table_um: float, step_um: float, points: bytes, shape: tuple[int, int]
) -> tuple[Course, Floats, Floats]:
    """Return the course along a leg's points in um, the leg's length up to each of its corners, and their turns."""
    points_um = np.frombuffer(points).reshape(shape)
    kind, unit = kind_of(planner), position_unit(planner, table_um, step_um)
    course = Course.of(kind.number, points_um, kind.speed_unit_nm_s, unit, step_um)
    return course, *path_corners(points_um)


def _with_row(table: NDArray[_Number], index: int, row: NDArray[_Number], filling: float) -> NDArray[_Number]:
    """Return the table with one row replaced, widened if necessary."""
    if len(row) > table.shape[1]:
        wider = np.full((table.shape[0], len(row), *table.shape[2:]), filling, table.dtype)
        wider[:, : table.shape[1]] = table
        table = wider
    table[index] = filling
    table[index, : len(row)] = row
    return table


class ObservationBuilder(Snapshots):
    """Builds the observations of n episodes, window by window."""

    STATE = ("sums", "_history", "_scales", "_threaded_ns", "_broke_at")

    def __init__(self, family: Family, count: int, sensors: observation.Sensors) -> None:
        self.family, self.sensors = family, sensors
        width = len(family.step_entries)
        self._history = np.zeros((count, family.history + sensors.delay_steps, width), np.float32)
        self._setup = np.zeros((count, len(observation.SETUP_ENTRIES)), np.float32)
        # (n,) `STEP_SUMS`: sums over the windows of the present step
        self.sums: NDArray[np.void] = np.zeros(count, observation.STEP_SUMS)
        self._scales: NDArray[np.void] = np.zeros(count, observation.SCALE)
        self._take_arguments(slice(None))
        self._threaded_ns = np.zeros(count, np.int64)
        self._broke_at = np.zeros(count)
        self._values = np.zeros(len(observation.MEASURED))

    def begin(self, i: int, row: np.void, machine: Machine, noise_key: np.uint64 | int = 0) -> None:
        """Begin an episode on a machine; `row` is its `path_follower.SUB_ENV`."""
        self._history[i] = 0.0
        self.sums[i] = np.zeros((), observation.STEP_SUMS)
        self._setup[i] = observation.values_of(observation.SETUP_ENTRIES, machine, 1)[0]
        self._scales[i]["key"], self._scales[i]["draws"] = noise_key, 0
        self._broke_at[i] = 0.0
        self._take_arguments(i)
        self.take_scale(i, row)
        self._threaded_ns[i] = row["elapsed_ns"]

    def _take_arguments(self, which: int | slice) -> None:
        """Set the divisors that are arguments, for episodes that begin."""
        for name in ("max_feed_um_s", "wires"):
            self._scales[name][which] = getattr(self.family, name)
        self._scales["episode_s"][which] = self.family.episode_s or np.inf

    def take_scale(self, i: int, row: np.void) -> None:
        """Set the divisors that depend on the generator's setting, and the sensors' errors."""
        scale = self._scales[i]
        for name in ("open_V", "limit_A", "wait_us"):
            scale[name] = row[name]
        scale["noise_share"], scale["step"] = self.sensors.noise_share, self.sensors.step

    def lose_wire(self, i: int, row: np.void, setting_us: tuple[float, float]) -> None:
        """Store the setting at which a wire broke, and the time at which the next one begins."""
        on_us, period_us = setting_us
        self._broke_at[i] = max(self._broke_at[i], period_us / on_us)
        self._threaded_ns[i] = row["elapsed_ns"]

    def begin_step(self) -> None:
        """Begin a step: set its sums to 0."""
        self.sums.view(np.int64)[:] = 0  # as integers, because records take ten times as long

    def add(self, active: NDArray[np.int64], rows: NDArray[np.void], windows: NDArray[np.void]) -> None:
        """Add a window of some episodes; `rows` are all `path_follower.SUB_ENV`, `windows` `kernel.state.WINDOW`."""
        observation.accumulate_window(active, rows, windows, self.sums)

    def end_step(self, active: NDArray[np.int64]) -> None:
        """Insert the last step of some episodes at the front of their history."""
        observation.push_step(active, self.sums, self._scales, self._history, self._values)

    def observations(self, rows: NDArray[np.void], corner_um: Floats, corner_deg: Floats) -> NDArray[np.float32]:
        """Return all observations, (n, entries), in a new array; corners as in `Known`."""
        parts = [self._history[:, self.sensors.delay_steps :].reshape(len(rows), -1), self._setup]
        if known := self.family.known_entries:
            age_s = np.asarray((rows["elapsed_ns"] - self._threaded_ns) * 1e-9, np.float64)
            what = observation.Known(
                rows, corner_um, corner_deg, age_s, self._broke_at, self.family.offset_um, self._scales
            )
            parts.append(observation.values_of(known, what, len(rows)))
        return np.concatenate(parts, axis=1)


STEP_INFO = np.dtype(
    [
        ("time_s", "f8"),  # machine time at the end of the step
        ("dt_s", "f8"),  # machine time of the step
        ("path_um", "f8"),  # path length travelled by the planner, over all legs
        ("feed_um_s", "f8"),
        ("offset_um", "f8"),
        ("t_on_us", "f8"),
        ("t_period_us", "f8"),
        ("energy_mJ", "f8"),  # energy of a discharge with the setting
        ("short", "i8"),  # pulses of the step by class
        ("open", "i8"),
        ("spark", "i8"),
        ("arc", "i8"),
        ("gap_um", "f8"),  # mean of the last window's ignitions; -1 without any, because checkers fail with NaN
        ("wire_temperature_K", "f8"),  # greatest of the last window
        ("debris", "f8"),  # at the end of the last window
        ("error_um", "f8"),  # distance of the wire from the path at the end of the last window
        ("area_mm2", "f8"),  # cut in the step
        ("wires_lost", "i8"),  # in the episode
        ("cost", "f8"),  # of the step
    ]
)
"""Numbers of `info` at every step; a real machine does not measure all of them."""


@exactly_compiled
def fill_infos(
    rows: NDArray[np.void], states: NDArray[np.void], windows: NDArray[np.void], shown: NDArray[np.void],
    accounts: NDArray[np.void], infos: NDArray[np.void],
) -> None:
    """Write `STEP_INFO` (n,) of all sub-environments, from the records of their plants, observations and rewards."""
    for i in range(infos.shape[0]):
        info, row, window, sums, account = infos[i], rows[i], windows[i], shown[i], accounts[i]
        setting_us, ignitions = row.setting_us, window.ignitions
        info.time_s = states[i].time_ns * 1e-9
        info.dt_s = row.step_ns * 1e-9
        info.path_um = row.before_um + row.path_um
        info.feed_um_s = row.feed_um_s
        info.offset_um = row.offset_um
        info.t_on_us = setting_us[0]
        info.t_period_us = setting_us[1]
        info.energy_mJ = row.energy_mJ
        info.short = sums.short
        info.open = sums.open
        info.spark = sums.ignited - sums.arc
        info.arc = sums.arc
        info.gap_um = window.gap_um / ignitions if ignitions > 0 else -1.0
        info.wire_temperature_K = window.temperature_max_K
        info.debris = window.debris
        info.error_um = row.error_um
        info.area_mm2 = account.area_mm2
        info.wires_lost = row.wires_lost
        info.cost = account.cost


class Batch:
    """Parallel episodes of one family, with their observations, rewards and infos."""

    def __init__(self, family: Family, count: int, threads: int = 1) -> None:
        self.family = family
        self.sub_envs = SubEnvs(family, count, threads)
        self.builder = ObservationBuilder(family, count, family.measured_by)
        self._servos: NDArray[np.void] = np.zeros(count, gap_servo.SERVO)
        self._feed_um_s = np.zeros(count)
        self._episodes = np.zeros(count, np.int64)
        self._constants: list[dict[str, float | str]] = [{} for _ in range(count)]
        self.account = reward.StepRewards(count)  # rewards, their terms and costs of the last step

    def change(self, family: EnvArguments) -> None:
        """Use another family, with the same spaces and kind of plants, in the episodes that begin after this call."""
        assert isinstance(family, Family)
        self.family = self.sub_envs.family = self.builder.family = family
        self._episodes[:] = 0

    def begin(self, index: int, rng: np.random.Generator, machine: Machine | None, *, redraw: bool) -> dict[str, Any]:
        """Begin an episode, on `machine` if it is not None; `redraw` draws another one. Returns the reset's info."""
        family, before = self.family, self.sub_envs.scenarios[index]
        chosen = machine
        lasts = 0 < self._episodes[index] < family.machine_episodes
        if chosen is None and before is not None and lasts and not redraw:
            chosen = before.machine
        scenario = family.draw(rng, chosen)
        if chosen is None:
            self._constants[index] = {name: scenario.drawn[name] for name in family.drawn_constants}
        self._episodes[index] = 0 if machine is not None else (self._episodes[index] if chosen is not None else 0) + 1
        self.sub_envs.begin(index, scenario)
        self.account.weigh(index, family.reward_weights, family.error_bound_um, family.energy_bound_mJ)
        self.builder.begin(index, self.sub_envs.rows[index], scenario.machine, key_of(scenario.plant_seed + 1))
        self._begin_wire(index)
        constants = self._constants[index] if machine is None else {}
        return {
            "drawn": {**constants, **scenario.drawn}, "plant_seed": scenario.plant_seed,
            "total_um": float(self.sub_envs.rows[index]["total_um"]),
        }

    def _begin_wire(self, index: int) -> None:
        feed_um_s = self.sub_envs.families[index].first_feed_um_s
        self._feed_um_s[index] = feed_um_s
        gap_servo.begin(self._servos[index], feed_um_s)

    def clear(self) -> None:
        """Set the rewards and costs of the last step to 0."""
        self.account.begin()

    @property
    def ended(self) -> NDArray[np.bool_]:
        """Which episodes (n,) have terminated."""
        return np.asarray(self.sub_envs.rows["cause"] != path_follower.RUNNING)

    @property
    def out_of_time(self) -> NDArray[np.bool_]:
        """Which sub-environments (n,) have reached the time limit of an episode."""
        return self.sub_envs.out_of_time

    def close(self) -> None:
        """Shut down the threads."""
        self.sub_envs.fleet.close()

    def step(self, active: Ints, actions: NDArray[np.float32]) -> Floats:
        """Run a step in the active environments; returns the rewards (n,), or (n, objectives), 0 in the others."""
        sub_envs = self.sub_envs
        clamped = np.minimum(np.maximum(actions.astype(np.float64), -1.0), 1.0)  # np.clip takes four times as long
        self.account.begin()
        self.builder.begin_step()
        sub_envs.rows["step_ns"] = 0
        for family, left in self._by_family(active):
            self._command(family, left, clamped)
            while len(left):
                self._window(family, left)
                left = self._waiting(family, left)
        self.builder.end_step(active)
        account, objectives = self.account, self.family.objectives
        rewards = [account.rows[name] for name in objectives or ("total",)]
        return np.stack(rewards, axis=1) if objectives else rewards[0].copy()

    def _by_family(self, active: Ints) -> Iterator[tuple[Family, Ints]]:
        """Yield the families of the running episodes with their sub-environments; a `change` may make several."""
        every = self.sub_envs.families
        families = every if len(active) == len(every) else [every[k] for k in active.tolist()]
        present = dict(zip(map(id, families), families, strict=True))
        for family in present.values():
            yield family, active if len(present) == 1 else active[[one is family for one in families]]

    def _command(self, family: Family, active: Ints, clamped: Floats) -> None:
        """Set the generators, the offsets, and the feeds or the servos' targets."""
        sub_envs = self.sub_envs
        if family.knobs:
            for k in active.tolist():
                first_us = sub_envs.rows[k]["first_setting_us"]
                self._set_generator(k, *family.setting_us(first_us, clamped[k, 1 : 1 + len(family.knobs)]))
        which = slice(None) if len(active) == sub_envs.count else active  # a view takes no time
        if family.offset_um is not None:
            sub_envs.rows["offset_um"][which] = clamped[which, -1] * family.offset_um
        if family.action == "servo":
            self._servos["target"][which] = gap_servo.target_of(clamped[which, 0], family.servo_target_share)
            return
        limit = family.greatest_feed_um_s
        requested_um_s = family.next_feed_um_s(self._feed_um_s[which], clamped[which, 0])
        self._feed_um_s[which] = np.minimum(np.maximum(requested_um_s, -limit), limit)

    def _window(self, family: Family, left: Ints) -> None:
        """Run a window in some sub-environments."""
        sub_envs, by_servo = self.sub_envs, family.action == "servo"
        sub_envs.advance(left, self._servos["feed_um_s"].copy() if by_servo else self._feed_um_s)
        windows = sub_envs.fleet.windows
        self.builder.add(left, sub_envs.rows, windows)
        self.account.add(left, sub_envs.rows, windows)
        if by_servo:
            gap_servo.respond(left, self._servos, windows, family.greatest_feed_um_s, *family.servo_gains)
        for index, setting_us in sub_envs.lost:
            self.builder.lose_wire(index, sub_envs.rows[index], setting_us)
            self._begin_wire(index)

    def _waiting(self, family: Family, left: Ints) -> Ints:
        """Return those of some sub-environments whose next action is not due yet."""
        if family.decision_s is None:
            return left[:0]
        wait_ns, rows = round(family.decision_s * 1e9), self.sub_envs.rows
        return np.asarray(left[(rows["step_ns"][left] < wait_ns) & (rows["cause"][left] == path_follower.RUNNING)])

    def _set_generator(self, index: int, t_on_us: float, t_period_us: float) -> None:
        """Set the generator; if it refuses the period, set the shortest that it accepts for the on-time."""
        sub_envs = self.sub_envs
        sub_envs.set_generator(index, t_on_us, t_period_us)
        refused = sub_envs.refused[index]
        if refused:
            machine, family = sub_envs.fleet.plants[index].machine, sub_envs.families[index]
            sub_envs.set_generator(index, *family.least_setting_us(machine, t_on_us))
            sub_envs.refused[index] = refused
        self.builder.take_scale(index, sub_envs.rows[index])

    def observations(self) -> NDArray[np.float32]:
        """Return every sub-environment's observation, in a new array."""
        sub_envs = self.sub_envs
        return self.builder.observations(sub_envs.rows, sub_envs.corner_um, sub_envs.corner_deg)

    def infos(self) -> dict[str, Any]:
        """Return the infos of a step, in new arrays (n,); a real machine does not measure all of them.

        Numbers are those of `STEP_INFO`. Texts are the reasons of an episode's end and of a setting that the
        generator refused, or empty.
        """
        sub_envs, fleet = self.sub_envs, self.sub_envs.fleet
        step: NDArray[np.void] = np.empty(sub_envs.count, STEP_INFO)
        fill_infos(sub_envs.rows, fleet.states, fleet.windows, self.builder.sums, self.account.rows, step)
        return {
            **{name: step[name] for name in STEP_INFO.names or ()},
            "reward_terms": self.account.terms,
            "cause": _CAUSES[sub_envs.rows["cause"]],
            "refused": sub_envs.refused.copy(),
        }
