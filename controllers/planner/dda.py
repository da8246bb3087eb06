"""An ideal line generator: each axis stays within half a step of a point that runs along the path."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import cast

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.mcu.firmware.poscal import STEP_UM, Unit
from edmsim.controllers.mcu.firmware.timers import NEVER, SPEED_UNIT_NM_S, TIMER_COUNT
from edmsim.controllers.planner.protocol import PathFollower, PlannerState, check_window
from edmsim.controllers.protocols import Step

UM = TIMER_COUNT // STEP_UM
"""Path length of 1 um, as the sum of the speeds in units over the ticks of the clock."""


class DdaPlanner(PathFollower):
    """Moves a point along the path at the commanded speed; an axis steps when it is over 1 um behind.

    Parameters
    ----------
    points_um, speed_unit_nm_s, unit
        See `PathFollower`.
    """

    def __init__(
        self, points_um: NDArray[np.int64], speed_unit_nm_s: float = SPEED_UNIT_NM_S, unit: Unit = "um"
    ) -> None:
        super().__init__(points_um, speed_unit_nm_s, unit)
        self._lengths = tuple(
            math.isqrt(((bx - ax) ** 2 + (by - ay) ** 2) * UM**2)
            for (ax, ay), (bx, by) in pairwise(self._path.points)
        )
        self._along = 0

    @property
    def path_um(self) -> float:
        """Length travelled along the path in um."""
        return self._path.starts_um[self._move] + self._along / UM

    @property
    def done(self) -> bool:
        """Whether the path's end is reached."""
        return self._move == self._path.last_move and self._along == self._lengths[-1]

    def advance(self, start_ns: int, end_ns: int, speed_units: int) -> list[Step]:
        """Steps in a window of time; see `Planner.advance`."""
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

    def snapshot(self) -> PlannerState:
        """Everything that changes while running."""
        return {"move": self._move, "along": self._along, "position": list(self._position)}

    def restore(self, state: PlannerState) -> None:
        """Continue where `snapshot` was taken."""
        self._move = cast(int, state["move"])
        self._along = cast(int, state["along"])
        self._position = list(cast(list[int], state["position"]))

    def _next_step(self, heading: int) -> tuple[int, int]:
        """Length until the next step if the present move had no end (`NEVER` if none), and its axis."""
        x, y = self._until_step(0, heading), self._until_step(1, heading)
        return (x, 0) if x <= y else (y, 1)

    def _until_step(self, axis: int, heading: int) -> int:
        """Length until the running point is more than 1 um ahead of an axis."""
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
        """Pass to the next move; False if there is none."""
        if not 0 <= self._move + heading <= self._path.last_move:
            return False
        self._move += heading
        self._along = 0 if heading > 0 else self._lengths[self._move]
        return True
