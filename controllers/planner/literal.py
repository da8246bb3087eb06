"""The planner of 1982: POSCAL once per move and a reload counter per axis, with all their faults."""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.mcu.firmware.arithmetic import subsgn
from edmsim.controllers.mcu.firmware.poscal import UNIT_UM, Displacement, Unit, resolve, velocm
from edmsim.controllers.mcu.firmware.timers import SPEED_UNIT_NM_S, ReloadCounter
from edmsim.controllers.planner.protocol import PathFollower, PlannerState, check_window
from edmsim.controllers.protocols import Step


class LiteralPlanner(PathFollower):
    """Runs every move with the direction POSCAL found at its beginning; each axis stops at its own target.

    A component that REDUC drops never moves (row T-G11), the axis speeds are whole units (row T-G9), and
    the sum of squares wraps at 16 bits (row T-G6), so the wire strays from the line (row T-G12). Another
    speed repeats VELOCM alone; the timers take it from their next interrupt on. Backwards the same vector
    is run the other way.

    Parameters
    ----------
    points_um, speed_unit_nm_s, unit
        See `PathFollower`.
    """

    def __init__(
        self, points_um: NDArray[np.int64], speed_unit_nm_s: float = SPEED_UNIT_NM_S, unit: Unit = "um"
    ) -> None:
        super().__init__(points_um, speed_unit_nm_s, unit)
        self._counters = (ReloadCounter(), ReloadCounter())
        self._vector = self._vector_to(self._path.points[1], 1)

    @property
    def done(self) -> bool:
        """Whether the last move is over: each axis at its target, or lost by REDUC."""
        return self._move == self._path.last_move and not any(self._axes_to_go(1))

    def advance(self, start_ns: int, end_ns: int, speed_units: int) -> list[Step]:
        """Steps in a window of time; see `Planner.advance`."""
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

    def snapshot(self) -> PlannerState:
        """Everything that changes while running."""
        return {
            "move": self._move,
            "position": list(self._position),
            "vector": list(self._vector),
            "counters": [counter.left for counter in self._counters],
        }

    def restore(self, state: PlannerState) -> None:
        """Continue where `snapshot` was taken."""
        self._move = cast(int, state["move"])
        self._position = list(cast(list[int], state["position"]))
        self._vector = Displacement(*cast(list[int], state["vector"]))
        for counter, left in zip(self._counters, cast(list[int], state["counters"]), strict=True):
            counter.left = left

    def _vector_to(self, target: tuple[int, int], heading: int) -> Displacement:
        """POSCAL's vector from here to the end of a move, turned to point forwards along the path."""
        unit_um = UNIT_UM[self._unit]
        x, x_direction = subsgn(target[0] // unit_um, self._position[0] // unit_um)
        y, y_direction = subsgn(target[1] // unit_um, self._position[1] // unit_um)
        return resolve(x, y, x_direction * heading, y_direction * heading, literal_wrap=True)

    def _begin(self, heading: int) -> bool:
        """Pass to the next moves while this one is over; False where the path ends."""
        while not any(self._axes_to_go(heading)):
            if not 0 <= self._move + heading <= self._path.last_move:
                return False
            self._move += heading
            self._vector = self._vector_to(self._path.points[self._move + (heading > 0)], heading)
        return True

    def _axes_to_go(self, heading: int) -> tuple[bool, bool]:
        """Which axes still move: their component survived REDUC, their target is over 1 um ahead."""
        target = self._path.points[self._move + (heading > 0)]
        x_left = (target[0] - self._position[0]) * self._vector.x_direction * heading
        y_left = (target[1] - self._position[1]) * self._vector.y_direction * heading
        return self._vector.x > 0 and x_left > 1, self._vector.y > 0 and y_left > 1

    def _axis_speeds(self, speed: int, heading: int) -> list[int]:
        """VELOCM with the stored vector; an axis that has arrived stops and its counter is unloaded."""
        speeds = [abs(v) for v in velocm(self._vector, speed)]
        for axis, moving in enumerate(self._axes_to_go(heading)):
            if not moving:
                speeds[axis] = 0
                self._counters[axis].stop()
        return speeds

    def _step(self, axis: int, heading: int, time_ns: int) -> Step:
        """The interrupt routine: one routine, entered for x or for y (row T-71)."""
        direction = heading * (self._vector.y_direction if axis else self._vector.x_direction)
        self._count(axis, direction, wrap=True)
        return Step(time_ns, axis, direction)
