"""The default planner: POSCAL re-aimed at every step at a point a little ahead on the present move.

The thesis computes POSCAL once per move and loses the line by up to hundreds of um (rows T-G11, T-G12).
Here the same integer routines steer at a carrot a little ahead, as its text foresees ("the tangent may
change at every step"). Three things are ours: the carrot, the vector in quarter um, which keeps its length
precise (row T-G10), and the path speed doubled up to 128..255 for VELOCM, which gives slow paths the
direction of fast ones (rows T-G9, T-A4).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import cast

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.mcu.firmware.arithmetic import subsgn
from edmsim.controllers.mcu.firmware.poscal import STEP_UM, Displacement, Unit, resolve, velocm
from edmsim.controllers.mcu.firmware.timers import NEVER, SPEED_UNIT_NM_S, PhaseAccumulator
from edmsim.controllers.planner.protocol import PathFollower, PlannerState, check_window, near
from edmsim.controllers.protocols import Step

QUARTER = 4
"""Vectors are aimed in quarters of 1 um."""

QUARTER_PHASE = PhaseAccumulator.STEP // (QUARTER * STEP_UM)
"""Phase of an axis a quarter um ahead of its counter."""

CARROT_UM = 32
"""Distance of the carrot ahead of the wire in um (ours): 128 quarters, which suits POSCAL's 8 bits."""

SMALLEST_VECTOR = 91
"""Vectors with a shorter longer component are doubled before their length is taken (row T-G10)."""


class PoscalPlanner(PathFollower):
    """Steers two axes with POSCAL, VELOCM and phase accumulators along a path.

    Parameters
    ----------
    points_um, speed_unit_nm_s, unit
        See `PathFollower`.
    """

    _resolve: Callable[[int, int, int, int], Displacement] = staticmethod(resolve)
    """What makes a vector for VELOCM from magnitudes and directions."""

    def __init__(
        self, points_um: NDArray[np.int64], speed_unit_nm_s: float = SPEED_UNIT_NM_S, unit: Unit = "um"
    ) -> None:
        super().__init__(points_um, speed_unit_nm_s, unit)
        self._phases = (PhaseAccumulator(), PhaseAccumulator())
        self._heading = 1
        self._speed = 0
        self._steer()

    @property
    def done(self) -> bool:
        """Whether the path's end is reached, within 1 um in each axis."""
        return self._move == self._path.last_move and near(self.position_um, self._path.points[-1])

    def advance(self, start_ns: int, end_ns: int, speed_units: int) -> list[Step]:
        """Steps in a window of time; see `Planner.advance`."""
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

    def snapshot(self) -> PlannerState:
        """Everything that changes while running."""
        return {
            "move": self._move,
            "position": list(self._position),
            "phases": [phase.phase for phase in self._phases],
            "heading": self._heading,
            "aim": list(self._aim),
            "carrot_is_end": int(self._carrot_is_end),
            "speed": self._speed,
        }

    def restore(self, state: PlannerState) -> None:
        """Continue where `snapshot` was taken."""
        self._move = cast(int, state["move"])
        self._position = list(cast(list[int], state["position"]))
        for phase, value in zip(self._phases, cast(list[int], state["phases"]), strict=True):
            phase.phase = value
        self._heading = cast(int, state["heading"])
        self._aim = Displacement(*cast(list[int], state["aim"]))
        self._carrot_is_end = bool(state["carrot_is_end"])
        self._set_speed(cast(int, state["speed"]))

    def _command(self, speed_units: int) -> None:
        """Take a commanded speed; a change of sign turns the wire round where it is."""
        heading = 1 if speed_units > 0 else -1
        if heading != self._heading:
            self._heading = heading
            self._speed = abs(speed_units)
            self._steer()
        elif abs(speed_units) != self._speed:
            self._set_speed(abs(speed_units))

    def _set_speed(self, speed: int) -> None:
        """VELOCM for the present aim, at the speed doubled to fill 8 bits; rates are in units / 128."""
        self._speed = speed
        doublings = 8 - speed.bit_length()
        x, y = velocm(self._aim, speed << doublings)
        self._rates = (x << 7 - doublings, y << 7 - doublings) if speed else (0, 0)

    def _steer(self) -> None:
        """Pass to the next move where the commanded point has reached the end of this one, and aim anew."""
        x, y = self._find_carrot()
        while self._carrot_is_end and max(abs(x), abs(y)) <= 1 and not self._on_last_move():
            self._move += self._heading
            x, y = self._find_carrot()
        self._aim = self._resolve(*lengthened(x, y))
        self._set_speed(self._speed)

    def _ticks_to_arrival(self) -> int:
        """Ticks until the commanded point reaches the end of the move along its longer component."""
        axis = 0 if self._aim.x >= self._aim.y else 1
        if not (self._carrot_is_end and self._rates[axis]):
            return NEVER
        left = (self._target()[axis] - self._position[axis]) * PhaseAccumulator.STEP // STEP_UM
        return -(-(left - self._phases[axis].phase) // self._rates[axis])

    def _target(self) -> tuple[int, int]:
        """End of the present move in the present heading."""
        return self._path.points[self._move + (self._heading > 0)]

    def _on_last_move(self) -> bool:
        """Whether no move follows in the present heading."""
        return self._move == (self._path.last_move if self._heading > 0 else 0)

    def _at_end(self) -> bool:
        """Whether the wire is within 1 um of the path's end in the present heading."""
        return self._on_last_move() and near(self.position_um, self._target())

    def _find_carrot(self) -> tuple[int, int]:
        """Vector in quarter um from the commanded point, counters and phases together, to the carrot."""
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
    """Lead of the commanded position over an axis' counter in quarter um, rounded."""
    return (axis.phase + QUARTER_PHASE // 2) // QUARTER_PHASE


def lengthened(x: int, y: int) -> tuple[int, int, int, int]:
    """Magnitudes of a signed displacement in quarter um, doubled while it is short, and their directions."""
    x, x_direction = subsgn(x, 0)
    y, y_direction = subsgn(y, 0)
    while 0 < max(x, y) < SMALLEST_VECTOR:
        x, y = 2 * x, 2 * y
    return x, y, x_direction, y_direction
