"""Planners of tapered cuts: x and y move the lower guide, u and v the upper one relative to it.

`exact` plans all four axes in the same way. The other planners have two axes: they plan x and y, and u and v follow
along the path, step by step. Feeds and lengths refer to the faster face of the workpiece: a move is as long as on
that face.
"""

import bisect
import math

import numpy as np
from numpy.typing import ArrayLike

from edmsim.controllers.mcu.firmware.poscal import STEP_UM, Unit
from edmsim.controllers.planner.kinds import EXACT, FINE_PER_UM, LITERAL
from edmsim.controllers.planner.registry import Planner, kind_of, make_planner
from edmsim.controllers.protocols import Step, check_window
from edmsim.errors import InputError
from edmsim.geometry import Floats
from edmsim.snapshots import Snapshots

MOST_LEAD = 4.0
"""Greatest travel of u or v over that of x and y (ours): the number of their steps between two steps of x and y."""


def check_lead(name: str, points_um: ArrayLike, lead_um: ArrayLike) -> None:
    """Refuse corners (n, 2) and leads (n, 2) for which u and v cannot follow a planner's x and y."""
    kind, instead = kind_of(name), "choose the planner exact (--planner exact)"
    if kind.number == LITERAL:
        raise InputError(f"the planner {name} moves two axes, and this wire leans: {instead}, or poscal")
    if kind.number == EXACT:
        return
    moved = np.hypot(*np.diff(np.asarray(points_um, np.float64), axis=0).T)
    led = np.hypot(*np.diff(np.asarray(lead_um, np.float64), axis=0).T)
    k = int(np.argmax(led - MOST_LEAD * moved))
    if led[k] > MOST_LEAD * moved[k] + 1.0:
        x, y = np.asarray(points_um, np.float64)[k] * 1e-3
        raise InputError(
            f"the planner {name} lets u and v follow x and y, {MOST_LEAD:g} times as far at most: at x {x:.3f} "
            f"y {y:.3f} mm the lower guide goes {moved[k] * 1e-3:.3f} mm, the upper one {led[k] * 1e-3:.3f} mm more; "
            f"{instead}"
        )


def make_leaning_planner(
    name: str, points_um: ArrayLike, lead_um: ArrayLike, along_um: ArrayLike, unit: Unit = "um",
    step_um: float = STEP_UM,
) -> Planner:
    """Make a planner for a tilted wire from corners of the lower guide, and u, v and path length at each.

    It begins at length 0; it can run back to corners with negative lengths.
    """
    check_lead(name, points_um, lead_um)
    places = np.concatenate([np.asarray(points_um, np.float64), np.asarray(lead_um, np.float64)], axis=1)
    along = np.asarray(along_um, np.float64)
    if kind_of(name).number == EXACT:
        return ExactAxes(places, along, step_um)
    return Following(name, places, along, unit, step_um)


class ExactAxes(Snapshots):
    """An ideal line through points of several axes at path lengths `along_um`; between two points it is straight."""

    STATE = ("_behind", "_counts")
    speed_unit_nm_s = 1.0
    max_feed_um_s = math.inf

    def __init__(self, places_um: Floats, along_um: Floats, step_um: float) -> None:
        moving = np.concatenate([[True], np.diff(along_um) > 0.0])
        if moving.sum() < 2:
            raise InputError("a path needs two different points, not 1")
        self._along: list[float] = along_um[moving].tolist()
        self._step_um = step_um
        start_um = places_um[np.searchsorted(along_um, 0.0)]
        grid = np.floor(start_um / step_um + 0.5)  # the start is on the grid of steps
        self._from = start_um.tolist()
        self._steps: list[list[float]] = (places_um[moving] / step_um - (start_um / step_um - grid)).tolist()
        self._first: list[int] = grid.astype(int).tolist()
        self._counts = [0] * len(self._first)
        self._behind = 0
        self._begin: int = math.ceil(self._along[0] * FINE_PER_UM)
        self._end: int = math.floor(self._along[-1] * FINE_PER_UM)

    @property
    def position_um(self) -> tuple[float, float]:
        """Position counters of x and y in um."""
        x, y = (self._from[axis] + self._counts[axis] * self._step_um for axis in (0, 1))
        return (int(x) if x == int(x) else x, int(y) if y == int(y) else y)

    @property
    def path_um(self) -> float:
        """Length travelled along the path in um."""
        return self._behind / FINE_PER_UM

    @property
    def done(self) -> bool:
        """Whether the path's end is reached."""
        return self._behind >= self._end

    def advance(self, start_ns: int, end_ns: int, speed_units: int) -> list[Step]:
        """Steps in a window of time; see `Planner.advance`."""
        check_window(start_ns, end_ns, speed_units, None)
        feed, place = speed_units * 1e-3, self._behind / FINE_PER_UM
        end = min(max(place + feed * (end_ns - start_ns) * 1e-9, self._along[0]), self._along[-1])
        found: list[Step] = []
        for at_um, axis, direction in self._crossings(place, end):
            late_ns = math.ceil(abs(at_um - place) / abs(feed) * 1e9) if feed else 0
            time_ns = max(start_ns + late_ns, found[-1].time_ns if found else start_ns)
            if time_ns >= end_ns:
                break  # the next window begins with it
            self._counts[axis] += direction
            found.append(Step(time_ns, axis, direction))
        self._behind = min(max(self._behind + speed_units * (end_ns - start_ns), self._begin), self._end)
        return found

    def _crossings(self, place_um: float, end_um: float) -> list[tuple[float, int, int]]:
        """Return the lengths at which an axis passes the middle between two steps, in order."""
        forward, found = end_um >= place_um, []
        here = [first + count for first, count in zip(self._first, self._counts, strict=True)]
        k = min(max(bisect.bisect_right(self._along, place_um) - 1, 0), len(self._along) - 2)
        while True:
            low, high = self._along[k], self._along[k + 1]
            there = min(end_um, high) if forward else max(end_um, low)
            passed = []
            for axis, (a, b) in enumerate(zip(self._steps[k], self._steps[k + 1], strict=True)):
                goal = math.floor(a + (b - a) * ((there - low) / (high - low)) + 0.5)
                direction = 1 if goal > here[axis] else -1
                for count in range(here[axis], goal, direction):
                    edge = count + 0.5 * direction
                    at = low + (edge - a) / (b - a) * (high - low) if b != a else place_um
                    passed.append((min(max(at, low), high), axis, direction))
                here[axis] = goal
            found += sorted(passed, key=lambda step: step[0] if forward else -step[0])
            if there == end_um or (forward and k == len(self._along) - 2) or (not forward and k == 0):
                return found
            k += 1 if forward else -1


class Following(Snapshots):
    """A planner of x and y, whose steps u and v follow."""

    STATE = ("_planner", "_led")

    def __init__(self, name: str, places_um: Floats, along_um: Floats, unit: Unit, step_um: float) -> None:
        moved = np.hypot(*np.diff(places_um[:, :2], axis=0).T)
        moving = np.concatenate([[True], moved > 0.0])
        begin = int(np.searchsorted(along_um, 0.0))
        start = int(moving[: begin + 1].sum()) - 1
        self._planner = make_planner(name, places_um[moving, :2], unit=unit, step_um=step_um, start=start)
        self.speed_unit_nm_s, self.max_feed_um_s = self._planner.speed_unit_nm_s, self._planner.max_feed_um_s
        moved = moved[moved > 0.0]
        behind = -np.cumsum(moved[:start][::-1])[::-1]
        self._lower_um: Floats = np.concatenate([behind, [0.0], np.cumsum(moved[start:])])
        self._along_um = along_um[moving]
        self._along_um[-1] = along_um[-1]
        self._leads = places_um[moving, 2:]
        self._leads[-1] = places_um[-1, 2:]
        self._step_um = step_um
        self._led: list[int] = np.rint(places_um[begin, 2:] / step_um).astype(int).tolist()
        self._most = kind_of(name).max_speed or 0
        self.slowed = False  # whether the last speed was one that x and y cannot run

    @property
    def position_um(self) -> tuple[float, float]:
        """Position counters of x and y in um."""
        return self._planner.position_um

    @property
    def path_um(self) -> float:
        """Length travelled along the path in um."""
        return float(np.interp(self._planner.path_um, self._lower_um, self._along_um))

    @property
    def done(self) -> bool:
        """Whether the path's end is reached."""
        return self._planner.done

    def advance(self, start_ns: int, end_ns: int, speed_units: int) -> list[Step]:
        """Steps in a window of time; see `Planner.advance`."""
        before_um = self._planner.path_um
        steps = self._planner.advance(start_ns, end_ns, self._speed(before_um, speed_units))
        if not steps:
            return steps
        after_um, found, since_ns = self._planner.path_um, [], start_ns
        for number, step in enumerate(steps, 1):
            found += self._follow(before_um + (after_um - before_um) * number / len(steps), since_ns, step.time_ns)
            found.append(step)
            since_ns = step.time_ns
        return found

    def _speed(self, lower_um: float, speed_units: int) -> int:
        """Return the speed of x and y for a speed along the path, in whole units."""
        k = min(max(int(np.searchsorted(self._lower_um, lower_um, side="right")) - 1, 0), len(self._lower_um) - 2)
        along = self._along_um[k + 1] - self._along_um[k]
        share = (self._lower_um[k + 1] - self._lower_um[k]) / along if along > 0 else 1.0
        units = max(round(abs(speed_units) * share), 1) if speed_units else 0
        self.slowed = units > self._most
        units = min(units, self._most)
        return units if speed_units >= 0 else -units

    def _follow(self, lower_um: float, since_ns: int, time_ns: int) -> list[Step]:
        """Return the steps of u and v up to a length of the path of x and y, evenly distributed in time."""
        moves = []
        for axis in (0, 1):
            target = round(float(np.interp(lower_um, self._lower_um, self._leads[:, axis])) / self._step_um)
            more = target - self._led[axis]
            self._led[axis] = target
            moves += [(n / abs(more), 2 + axis, 1 if more > 0 else -1) for n in range(1, abs(more) + 1)]
        return [
            Step(since_ns + int(share * (time_ns - since_ns)), axis, direction)
            for share, axis, direction in sorted(moves)
        ]
