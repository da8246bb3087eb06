"""The planners in plain Python, as they were before they were compiled: what the compiled ones are held to.

Nothing is shared with them but the errors. The numbers are those of a table of 2 um steps.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from edmsim.errors import InputError

from .reference_arithmetic import (
    MAX_SPEED,
    NEVER,
    SPEED_UNIT_NM_S,
    STEP_UM,
    TIMER_COUNT,
    UNIT_UM,
    WORD,
    Displacement,
    PhaseAccumulator,
    ReloadCounter,
    TickClock,
    Unit,
    look_up,
    positi,
    resolve,
    subsgn,
    velocm,
)


class Step(NamedTuple):

    time_ns: int
    axis: int
    direction: int


class Polyline:

    def __init__(self, points_um: np.ndarray, unit: Unit = "um") -> None:
        unit_um = UNIT_UM[unit]
        array = np.asarray(points_um)
        if array.ndim != 2 or array.shape[1] != 2:
            raise InputError(f"a path needs points in an array of shape (n, 2), not {array.shape}")
        if not np.issubdtype(array.dtype, np.integer):
            raise InputError(f"a path needs points in whole um, not an array of {array.dtype}")
        points = [(int(x), int(y)) for x, y in array]
        for i, (x, y) in enumerate(points):
            if not (0 <= x <= WORD * unit_um and 0 <= y <= WORD * unit_um):
                raise InputError(
                    f"point {i} of the path lies at ({x}, {y}) um, outside the table's 0..{WORD * unit_um} um"
                )
            if x % unit_um or y % unit_um:
                raise InputError(f"point {i} of the path, ({x}, {y}) um, is not a whole number of {unit_um} um steps")
        kept = [point for i, point in enumerate(points) if i == 0 or point != points[i - 1]]
        if len(kept) < 2:
            raise InputError(f"a path needs two different points, not {len(kept)}")
        self.points = tuple(kept)
        starts = [0.0]
        for a, b in pairwise(kept):
            starts.append(starts[-1] + math.dist(a, b))
        self.starts_um = tuple(starts)

    @property
    def last_move(self) -> int:
        return len(self.points) - 2

    def travelled_um(self, move: int, position_um: tuple[int, int]) -> float:
        (x0, y0), (x1, y1) = self.points[move], self.points[move + 1]
        start, end = self.starts_um[move], self.starts_um[move + 1]
        along = ((position_um[0] - x0) * (x1 - x0) + (position_um[1] - y0) * (y1 - y0)) / (end - start)
        return start + min(max(along, 0.0), end - start)


class PathFollower:

    def __init__(
        self, points_um: np.ndarray, speed_unit_nm_s: float = SPEED_UNIT_NM_S, unit: Unit = "um"
    ) -> None:
        self._path = Polyline(points_um, unit)
        self._unit: Unit = unit
        self._clock = TickClock(speed_unit_nm_s)
        self._move = 0
        self._position = list(self._path.points[0])

    @property
    def position_um(self) -> tuple[int, int]:
        return self._position[0], self._position[1]

    @property
    def path_um(self) -> float:
        return self._path.travelled_um(self._move, self.position_um)

    def _count(self, axis: int, direction: int, wrap: bool = False) -> None:
        unit_um = UNIT_UM[self._unit]
        self._position[axis] = positi(self._position[axis] // unit_um, direction, wrap, self._unit) * unit_um


def near(a_um: tuple[int, int], b_um: tuple[int, int]) -> bool:
    return abs(a_um[0] - b_um[0]) <= 1 and abs(a_um[1] - b_um[1]) <= 1


def check_window(start_ns: int, end_ns: int, speed_units: int) -> None:
    if end_ns < start_ns:
        raise InputError(f"a window must not end before it starts, but {end_ns} ns is before {start_ns} ns")
    if not -MAX_SPEED <= speed_units <= MAX_SPEED:
        raise InputError(f"the path speed must be -{MAX_SPEED}..{MAX_SPEED} units, not {speed_units}")


QUARTER = 4

QUARTER_PHASE = PhaseAccumulator.STEP // (QUARTER * STEP_UM)

CARROT_UM = 32

SMALLEST_VECTOR = 91


class PoscalPlanner(PathFollower):

    _resolve: object = staticmethod(resolve)

    def __init__(
        self, points_um: np.ndarray, speed_unit_nm_s: float = SPEED_UNIT_NM_S, unit: Unit = "um"
    ) -> None:
        super().__init__(points_um, speed_unit_nm_s, unit)
        self._phases = (PhaseAccumulator(), PhaseAccumulator())
        self._heading = 1
        self._speed = 0
        self._steer()

    @property
    def done(self) -> bool:
        return self._move == self._path.last_move and near(self.position_um, self._path.points[-1])

    def advance(self, start_ns: int, end_ns: int, speed_units: int) -> list[Step]:
        check_window(start_ns, end_ns, speed_units)
        steps: list[Step] = []
        if speed_units == 0:
            return steps
        self._command(speed_units)
        tick, last = self._clock.before(start_ns), self._clock.before(end_ns)
        while tick < last and not self._at_end():
            x_rate, y_rate = self._rates
            to_step = min(self._phases[0].ticks_to_step(x_rate), self._phases[1].ticks_to_step(y_rate))
            to_steer = min(to_step, self._ticks_to_arrival())
            due = min(to_steer, last - tick)
            tick += due
            for axis in (0, 1):
                direction = self._phases[axis].run(self._rates[axis], due)
                if direction:
                    self._count(axis, direction)
                    steps.append(Step(self._clock.time_ns(tick), axis, direction))
            if due == to_steer:
                self._steer()
        return steps

    def _command(self, speed_units: int) -> None:
        heading = 1 if speed_units > 0 else -1
        if heading != self._heading:
            self._heading = heading
            self._speed = abs(speed_units)
            self._steer()
        elif abs(speed_units) != self._speed:
            self._set_speed(abs(speed_units))

    def _set_speed(self, speed: int) -> None:
        self._speed = speed
        doublings = 8 - speed.bit_length()
        x, y = velocm(self._aim, speed << doublings)
        self._rates = (x << 7 - doublings, y << 7 - doublings) if speed else (0, 0)

    def _steer(self) -> None:
        x, y = self._find_carrot()
        while self._carrot_is_end and max(abs(x), abs(y)) <= 1 and not self._on_last_move():
            self._move += self._heading
            x, y = self._find_carrot()
        self._aim = self._resolve(*lengthened(x, y))
        self._set_speed(self._speed)

    def _ticks_to_arrival(self) -> int:
        axis = 0 if self._aim.x >= self._aim.y else 1
        if not (self._carrot_is_end and self._rates[axis]):
            return NEVER
        left = (self._target()[axis] - self._position[axis]) * PhaseAccumulator.STEP // STEP_UM
        return -(-(left - self._phases[axis].phase) // self._rates[axis])

    def _target(self) -> tuple[int, int]:
        return self._path.points[self._move + (self._heading > 0)]

    def _on_last_move(self) -> bool:
        return self._move == (self._path.last_move if self._heading > 0 else 0)

    def _at_end(self) -> bool:
        return self._on_last_move() and near(self.position_um, self._target())

    def _find_carrot(self) -> tuple[int, int]:
        end = self._target()
        origin = self._path.points[self._move + (self._heading < 0)]
        run_x, run_y = QUARTER * (end[0] - origin[0]), QUARTER * (end[1] - origin[1])
        x = QUARTER * (self._position[0] - origin[0]) + quarters(self._phases[0])
        y = QUARTER * (self._position[1] - origin[1]) + quarters(self._phases[1])
        length = math.isqrt(run_x * run_x + run_y * run_y)
        ahead = max((x * run_x + y * run_y) // length, 0) + QUARTER * CARROT_UM
        self._carrot_is_end = ahead >= length
        if self._carrot_is_end:
            return run_x - x, run_y - y
        return run_x * ahead // length - x, run_y * ahead // length - y


def quarters(axis: PhaseAccumulator) -> int:
    return (axis.phase + QUARTER_PHASE // 2) // QUARTER_PHASE


def lengthened(x: int, y: int) -> tuple[int, int, int, int]:
    x, x_direction = subsgn(x, 0)
    y, y_direction = subsgn(y, 0)
    while 0 < max(x, y) < SMALLEST_VECTOR:
        x, y = 2 * x, 2 * y
    return x, y, x_direction, y_direction


class LiteralPlanner(PathFollower):

    def __init__(
        self, points_um: np.ndarray, speed_unit_nm_s: float = SPEED_UNIT_NM_S, unit: Unit = "um"
    ) -> None:
        super().__init__(points_um, speed_unit_nm_s, unit)
        self._counters = (ReloadCounter(), ReloadCounter())
        self._vector = self._vector_to(self._path.points[1], 1)

    @property
    def done(self) -> bool:
        return self._move == self._path.last_move and not any(self._axes_to_go(1))

    def advance(self, start_ns: int, end_ns: int, speed_units: int) -> list[Step]:
        check_window(start_ns, end_ns, speed_units)
        steps: list[Step] = []
        if speed_units == 0:
            return steps
        heading = 1 if speed_units > 0 else -1
        tick, last = self._clock.before(start_ns), self._clock.before(end_ns)
        while tick < last and self._begin(heading):
            speeds = self._axis_speeds(abs(speed_units), heading)
            due = min(*(c.ticks_to_step(v) for c, v in zip(self._counters, speeds, strict=True)), last - tick)
            tick += due
            for axis in (0, 1):
                if self._counters[axis].run(speeds[axis], due):
                    steps.append(self._step(axis, heading, self._clock.time_ns(tick)))
        return steps

    def _vector_to(self, target: tuple[int, int], heading: int) -> Displacement:
        unit_um = UNIT_UM[self._unit]
        x, x_direction = subsgn(target[0] // unit_um, self._position[0] // unit_um)
        y, y_direction = subsgn(target[1] // unit_um, self._position[1] // unit_um)
        return resolve(x, y, x_direction * heading, y_direction * heading, literal_wrap=True)

    def _begin(self, heading: int) -> bool:
        while not any(self._axes_to_go(heading)):
            if not 0 <= self._move + heading <= self._path.last_move:
                return False
            self._move += heading
            self._vector = self._vector_to(self._path.points[self._move + (heading > 0)], heading)
        return True

    def _axes_to_go(self, heading: int) -> tuple[bool, bool]:
        target = self._path.points[self._move + (heading > 0)]
        x_left = (target[0] - self._position[0]) * self._vector.x_direction * heading
        y_left = (target[1] - self._position[1]) * self._vector.y_direction * heading
        return self._vector.x > 0 and x_left > 1, self._vector.y > 0 and y_left > 1

    def _axis_speeds(self, speed: int, heading: int) -> list[int]:
        speeds = [abs(v) for v in velocm(self._vector, speed)]
        for axis, moving in enumerate(self._axes_to_go(heading)):
            if not moving:
                speeds[axis] = 0
                self._counters[axis].stop()
        return speeds

    def _step(self, axis: int, heading: int, time_ns: int) -> Step:
        direction = heading * (self._vector.y_direction if axis else self._vector.x_direction)
        self._count(axis, direction, wrap=True)
        return Step(time_ns, axis, direction)


UM = TIMER_COUNT // STEP_UM


class DdaPlanner(PathFollower):

    def __init__(
        self, points_um: np.ndarray, speed_unit_nm_s: float = SPEED_UNIT_NM_S, unit: Unit = "um"
    ) -> None:
        super().__init__(points_um, speed_unit_nm_s, unit)
        self._lengths = tuple(
            math.isqrt(((bx - ax) ** 2 + (by - ay) ** 2) * UM**2)
            for (ax, ay), (bx, by) in pairwise(self._path.points)
        )
        self._along = 0

    @property
    def path_um(self) -> float:
        return self._path.starts_um[self._move] + self._along / UM

    @property
    def done(self) -> bool:
        return self._move == self._path.last_move and self._along == self._lengths[-1]

    def advance(self, start_ns: int, end_ns: int, speed_units: int) -> list[Step]:
        check_window(start_ns, end_ns, speed_units)
        steps: list[Step] = []
        if speed_units == 0:
            return steps
        heading = 1 if speed_units > 0 else -1
        tick, budget = self._clock.before(start_ns), 0
        budget = abs(speed_units) * (self._clock.before(end_ns) - tick)
        travelled = 0
        while True:
            ahead, axis = self._next_step(heading)
            room = self._lengths[self._move] - self._along if heading > 0 else self._along
            if min(ahead, room) > budget - travelled:
                self._along += heading * (budget - travelled)
                return steps
            self._along += heading * min(ahead, room)
            travelled += min(ahead, room)
            if ahead <= room:
                # The point passes the threshold between two ticks; the motor hears of it at the later one.
                ticks = -(-travelled // abs(speed_units))
                steps.append(self._step(axis, heading, self._clock.time_ns(tick + ticks)))
            elif not self._turn(heading):
                return steps

    def _next_step(self, heading: int) -> tuple[int, int]:
        x, y = self._until_step(0, heading), self._until_step(1, heading)
        return (x, 0) if x <= y else (y, 1)

    def _until_step(self, axis: int, heading: int) -> int:
        a, b = self._path.points[self._move], self._path.points[self._move + 1]
        run = (b[axis] - a[axis]) * heading
        if run == 0:
            return NEVER
        # Measured from the end the point comes from, in the axis' own direction of travel.
        origin = a if heading > 0 else b
        length = self._lengths[self._move]
        behind = (self._position[axis] - origin[axis]) * (1 if run > 0 else -1)
        passed = self._along if heading > 0 else length - self._along
        return max((behind + 1) * length // abs(run) + 1 - passed, 0)

    def _step(self, axis: int, heading: int, time_ns: int) -> Step:
        a, b = self._path.points[self._move], self._path.points[self._move + 1]
        direction = heading if b[axis] > a[axis] else -heading
        self._count(axis, direction)
        return Step(time_ns, axis, direction)

    def _turn(self, heading: int) -> bool:
        if not 0 <= self._move + heading <= self._path.last_move:
            return False
        self._move += heading
        self._along = 0 if heading > 0 else self._lengths[self._move]
        return True


class SineTablePlanner(PoscalPlanner):

    _resolve = staticmethod(look_up)


PLANNERS = {
    "poscal": PoscalPlanner, "poscal-literal": LiteralPlanner, "dda": DdaPlanner, "sine-table": SineTablePlanner,
}
