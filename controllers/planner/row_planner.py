"""A planner in Python around its compiled row."""

from __future__ import annotations

import math

import numpy as np

from edmsim.controllers.mcu.firmware.arithmetic import WORD
from edmsim.controllers.mcu.firmware.poscal import soft_limit
from edmsim.controllers.planner import run
from edmsim.controllers.planner.course import Course
from edmsim.controllers.planner.protocol import PlannerState
from edmsim.controllers.planner.record import CHANGES, LIMIT, position_um
from edmsim.controllers.protocols import Step
from edmsim.errors import InputError

_ROOM = 64  # steps of a window for which there is room at first


class RowPlanner:
    """Runs a course by compiled code; see `Planner` and `make_planner`."""

    def __init__(self, course: Course, speed_unit_nm_s: float, max_speed: int | None) -> None:
        self.speed_unit_nm_s = speed_unit_nm_s
        self._max_speed = max_speed
        self._course = course
        self._row = course.row[0]
        self._room = np.zeros((_ROOM, 3), np.int64)

    @property
    def max_feed_um_s(self) -> float:
        """Greatest path speed in um/s."""
        return math.inf if self._max_speed is None else self._max_speed * self.speed_unit_nm_s / 1000

    @property
    def position_um(self) -> tuple[float, float]:
        """Position counters in um, whole where start and steps are."""
        x, y = (position_um(self._row, axis) for axis in (0, 1))
        return (int(x) if x == int(x) else x, int(y) if y == int(y) else y)

    @property
    def path_um(self) -> float:
        """Length travelled along the path in um."""
        _, points, along, _ = self._course
        return run.path_um(self._row, points, along)

    @property
    def done(self) -> bool:
        """Whether the path's end is reached."""
        _, points, along, lengths = self._course
        return run.done(self._row, points, along, lengths)

    def advance(self, start_ns: int, end_ns: int, speed_units: int) -> list[Step]:
        """Steps in a window of time; see `Planner.advance`."""
        self._check_window(start_ns, end_ns, speed_units)
        _, points, along, lengths = self._course
        before = self._row.copy()
        made = run.advance(self._row, points, along, lengths, start_ns, end_ns, speed_units, self._room)
        if made == LIMIT:
            size_um = int(self._row["unit_um"])
            raise soft_limit(next(v for v in self.position_um if not 0 <= v <= WORD * size_um), size_um)
        if made > len(self._room):
            self._room = np.zeros((made, 3), np.int64)
            self._course.row[0] = before
            run.advance(self._row, points, along, lengths, start_ns, end_ns, speed_units, self._room)
        return [Step(*step) for step in self._room[:made].tolist()]

    def snapshot(self) -> PlannerState:
        """Everything that changes while running."""
        return {name: self._row[name].tolist() for name in CHANGES}

    def restore(self, state: PlannerState) -> None:
        """Continue where `snapshot` was taken."""
        for name in CHANGES:
            self._row[name] = state[name]

    def _check_window(self, start_ns: int, end_ns: int, speed_units: int) -> None:
        """Refuse a window that runs backwards in time and a speed beyond the greatest."""
        if end_ns < start_ns:
            raise InputError(f"a window must not end before it starts, but {end_ns} ns is before {start_ns} ns")
        most = self._max_speed
        if most is not None and not -most <= speed_units <= most:
            raise InputError(f"the path speed must be -{most}..{most} units, not {speed_units}")
