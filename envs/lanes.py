"""Lanes: episodes side by side, every one with a plant, a path and a generator setting of its own.

Everything per window is done for all lanes at once: the motor steps and the windows in compiled calls, the rest on
arrays. A lane's bits depend on nothing but its own scenario and commands.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from edmsim.envs.path_follower import DONE, FINE_PER_UM, LANE, OUT_OF_RANGE, RUNNING, follow, plan
from edmsim.envs.scenarios import CENTRE_UM, CORNER_DEG, Family, Scenario
from edmsim.errors import InputError
from edmsim.geometry import Polyline
from edmsim.machine.machine import Machine
from edmsim.plant.fleet import Fleet
from edmsim.plant.gap.generator import least_period_us
from edmsim.plant.kernel.state import FINE
from edmsim.plant.plant import Plant

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CAUSES = ("running", "done", "wire-break", "limit-switch", "persistent-short", "out-of-range")
"""Why an episode ended, by number (see `motion`); out of range is a wire pushed further than the plant's model holds
for."""
ON_US, PERIOD_US = 1.0, 5.0
"""Detents of the generator's knobs (ours: fine against what they change; propagators are kept by period)."""


class Lanes:
    """Episodes of one family.

    Parameters
    ----------
    family : Family
    count : int
    threads : int
        Threads that share the pulse loop.

    Attributes
    ----------
    fleet : Fleet
        The plants; ``fleet.windows`` and ``fleet.states`` tell what the last window was.
    rows : (n,) `motion.LANE`
        Numbers of every lane.
    scenarios : list of Scenario or None
        What each lane is at; None before its first episode.
    refused : list of str or None
        Why the generator refused the setting last asked for.
    corner_um, corner_deg : (n, most)
        Length of the present leg up to each corner, infinite for the filling, and its turn.
    """

    def __init__(self, family: Family, count: int, threads: int = 1) -> None:
        self.family = family
        self.count = count
        self.fleet = Fleet(
            [Plant(family.base, position_um=CENTRE_UM, resolution=family.resolution) for _ in range(count)], threads
        )
        self.rows: NDArray[np.void] = np.zeros(count, LANE)
        self.scenarios: list[Scenario | None] = [None] * count
        self.refused: list[str | None] = [None] * count
        self.corner_um: Floats = np.full((count, 1), np.inf)
        self.corner_deg: Floats = np.zeros((count, 1))
        self._leg = [0] * count
        self._points: Floats = np.zeros((count, 2, 2))
        self._along: Floats = np.zeros((count, 2))
        self._height_from: Floats = np.full((count, 1), np.inf)
        self._heights: Floats = np.zeros((count, 1))
        self._steps: Ints = np.zeros((count, 0, 3), np.int64)

    # --- beginning ---

    def begin(self, lane: int, scenario: Scenario) -> None:
        """Begin an episode."""
        machine, before = scenario.machine, self.scenarios[lane]
        start = scenario.legs_um[0][0]
        position = float(start[0]), float(start[1])
        plant = self.fleet.plants[lane]
        if before is not None and before.machine is machine:
            plant.reset(scenario.plant_seed, stock=scenario.stock, position_um=position)
        else:
            plant = Plant(
                machine, scenario.plant_seed, stock=scenario.stock, position_um=position,
                resolution=self.family.resolution,
            )
            self.fleet.replace(lane, plant)
        self.fleet.windows[lane] = np.zeros((), self.fleet.windows.dtype)
        self.scenarios[lane] = scenario
        self.refused[lane] = None
        self.rows[lane] = np.zeros((), LANE)
        self._take_constants(lane, machine)
        self.rows[lane]["total_um"] = sum(float(np.hypot(*np.diff(leg, axis=0).T).sum()) for leg in scenario.legs_um)
        starts, heights = scenario.heights
        self._height_from = _with_row(self._height_from, lane, starts, np.inf)
        self._heights = _with_row(self._heights, lane, heights, 0.0)
        self._begin_leg(lane, 0)

    def _take_constants(self, lane: int, machine: Machine) -> None:
        row, generator, table = self.rows[lane], machine.generator, machine.base.table
        row["open_V"] = generator.open_voltage_V.value
        row["limit_A"] = generator.mean_current_limit_A.value
        row["step_um"] = table.step_um.value
        row["table_um"] = table.travel_mm.value * 1e3
        row["first_setting_us"] = machine.t_on_us, machine.t_period_us
        self._take_setting(lane)

    def _take_setting(self, lane: int) -> None:
        row, plant = self.rows[lane], self.fleet.plants[lane]
        wait = plant.machine.generator.ignition_wait_us
        row["wait_us"] = plant.machine.t_on_us if wait is None else wait.value
        row["setting_us"] = plant.machine.t_on_us, plant.machine.t_period_us
        row["longest_ns"] = plant.longest_window_ns
        travel = self.family.max_feed_um_s * plant.longest_window_ns * 1e-9 / row["step_um"]
        room = 2 * math.ceil(travel) + 8
        if room > self._steps.shape[1]:
            self._steps = np.zeros((self.count, room, 3), np.int64)

    def _begin_leg(self, lane: int, leg: int) -> None:
        scenario = self.scenarios[lane]
        assert scenario is not None
        line = Polyline(scenario.legs_um[leg] * 1e-3, closed=False)
        points, along = line.points * 1e3, line.s * 1e3
        corners = line.corners(CORNER_DEG)
        self._leg[lane] = leg
        row = self.rows[lane]
        row["place"], row["segment"], row["reached_um"], row["cut_um"] = 0, 0, 0.0, 0.0
        row["end"], row["corners"] = math.floor(along[-1] * FINE_PER_UM), len(points)
        self._points = _with_row(self._points, lane, points, 0.0)
        self._along = _with_row(self._along, lane, along, np.inf)
        self.corner_um = _with_row(self.corner_um, lane, along[corners], np.inf)
        self.corner_deg = _with_row(self.corner_deg, lane, line.turn_deg[corners], 0.0)

    # --- one window ---

    @property
    def path_um(self) -> Floats:
        """Length of path behind each lane by its counters, over all its legs."""
        return np.asarray(self.rows["before_um"] + self.rows["place"] / FINE_PER_UM)

    def set_generator(self, lane: int, t_on_us: float, t_period_us: float) -> None:
        """Turn the knobs, to the nearest detent; what the generator refuses is told in `refused` and not done."""
        wanted = to_detents(t_on_us, t_period_us)
        self.refused[lane] = None
        if wanted == tuple(self.rows[lane]["setting_us"]):
            return
        try:
            self.fleet.plants[lane].set_generator(*wanted)
        except InputError as error:
            self.refused[lane] = str(error)
        else:
            self._take_setting(lane)

    def advance(self, lanes: Ints, feeds_um_s: Floats) -> None:
        """Fire 255 pulses in some lanes, each moving along its path at its feed (n,) in um/s, negative backwards."""
        fleet, rows = self.fleet, self.rows
        rows["feed_um_s"][lanes] = feeds_um_s[lanes]
        rows["feed_nm_s"][lanes] = np.rint(feeds_um_s[lanes] * 1e3)
        plan(lanes, rows, self._points, self._along, fleet.states, self._steps)
        status = fleet.advance(lanes, self._steps, rows["steps"])
        follow(
            lanes, rows, self._points, self._along, self._height_from, self._heights, fleet.states, fleet.windows
        )
        if (status != FINE).any():
            lost = lanes[(status != FINE) & (fleet.windows["broken"][lanes] == 0)]
            rows["cause"][lost] = OUT_OF_RANGE
        for lane in lanes[rows["cause"][lanes] == DONE]:
            self._end_leg(int(lane))

    def telling(self, lanes: Ints) -> list[int]:
        """Return those of some lanes about which there are words: the episode ended, or a setting was refused."""
        ended = set(lanes[self.rows["cause"][lanes] != RUNNING].tolist())
        return [lane for lane in lanes.tolist() if lane in ended or self.refused[lane] is not None]

    def _end_leg(self, lane: int) -> None:
        """Go on with the path's next piece, if there is one."""
        scenario, plant, row = self.scenarios[lane], self.fleet.plants[lane], self.rows[lane]
        assert scenario is not None
        following = self._leg[lane] + 1
        if following == len(scenario.legs_um):
            return
        row["cause"] = RUNNING
        row["before_um"] += row["place"] / FINE_PER_UM
        x, y = (float(v) for v in scenario.legs_um[following][0])
        table = plant.machine.base.table
        way = math.dist((x, y), plant.commanded_um)
        plant.rethread((x, y), round((way / table.rapid_um_s.value + table.threading_s.value) * 1e9))
        self._begin_leg(lane, following)


def to_detents(t_on_us: float, t_period_us: float) -> tuple[float, float]:
    """Return the setting of the knobs that is nearest."""
    return round(t_on_us / ON_US) * ON_US, round(t_period_us / PERIOD_US) * PERIOD_US


def least_setting_us(machine: Machine, t_on_us: float) -> tuple[float, float]:
    """Return an on-time with the shortest period at which the supply gives it, both in detents."""
    on = round(t_on_us / ON_US) * ON_US
    return on, math.ceil(least_period_us(machine, on) / PERIOD_US - 1e-9) * PERIOD_US


def _with_row(table: Floats, lane: int, row: Floats, filling: float) -> Floats:
    """Return the table with one row replaced, made wider if it must be."""
    if len(row) > table.shape[1]:
        wider = np.full((table.shape[0], len(row), *table.shape[2:]), filling)
        wider[:, : table.shape[1]] = table
        table = wider
    table[lane] = filling
    table[lane, : len(row)] = row
    return table
