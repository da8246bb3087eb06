"""What every planner offers, and the checked path it follows."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.mcu.firmware.arithmetic import WORD
from edmsim.controllers.mcu.firmware.poscal import UNIT_UM, Unit, positi
from edmsim.controllers.mcu.firmware.timers import MAX_SPEED, SPEED_UNIT_NM_S, TickClock
from edmsim.controllers.protocols import Step
from edmsim.errors import InputError

PlannerState = dict[str, int | list[int]]
"""A planner's snapshot: whole numbers only, fit for JSON."""


class Planner(Protocol):
    """Follows a path at a commanded speed and says when each axis steps.

    A planner holds no clock of its own: windows may be cut anywhere, and the steps stay the same.
    """

    @property
    def position_um(self) -> tuple[int, int]:
        """Position counters in um (row T-70); even numbers away from the start point."""

    @property
    def path_um(self) -> float:
        """Length travelled along the path in um, 0 at its start."""

    @property
    def done(self) -> bool:
        """Whether the path's end is reached."""

    def advance(self, start_ns: int, end_ns: int, speed_units: int) -> list[Step]:
        """Run the path for a window of time.

        Parameters
        ----------
        start_ns, end_ns : int
            The window; steps fall at ``start_ns <= time_ns < end_ns``.
        speed_units : int
            Path speed, -127..127 units; negative runs the path backwards, no further than its start.

        Returns
        -------
        list of Step
            In order of time.

        Raises
        ------
        InputError
            If the window ends before it starts or the speed is out of range.
        """

    def snapshot(self) -> PlannerState:
        """Everything that changes while running."""

    def restore(self, state: PlannerState) -> None:
        """Continue exactly where `snapshot` was taken; the planner must have been made for the same path."""


class Polyline:
    """The straight moves of a path in whole um.

    Parameters
    ----------
    points_um : int array (n, 2)
        Corner points; a point that repeats the one before it is dropped.
    unit : {"um", "step"}
        What the position counters count: 0..65535 um, or whole steps of 2 um up to 131 070 um (row T-61).

    Attributes
    ----------
    points : tuple of (int, int)
        Corner points in um, each different from the one before.
    starts_um : tuple of float
        Length of the path up to every point, in um.

    Raises
    ------
    InputError
        If the array has another shape, holds fractions of a unit, leaves the table, or has no two different
        points.
    """

    def __init__(self, points_um: NDArray[np.int64], unit: Unit = "um") -> None:
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
                raise InputError(f"point {i} of the path, ({x}, {y}) um, is no whole number of {unit_um} um steps")
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
        """Index of the last straight move; move ``i`` leads from point ``i`` to ``i + 1``."""
        return len(self.points) - 2

    def travelled_um(self, move: int, position_um: tuple[int, int]) -> float:
        """Path length at the foot of a position on one of the moves, in um."""
        (x0, y0), (x1, y1) = self.points[move], self.points[move + 1]
        start, end = self.starts_um[move], self.starts_um[move + 1]
        along = ((position_um[0] - x0) * (x1 - x0) + (position_um[1] - y0) * (y1 - y0)) / (end - start)
        return start + min(max(along, 0.0), end - start)


class PathFollower:
    """What every planner keeps: its path, its clock, the move it is on, and the position counters.

    Parameters
    ----------
    points_um : int array (n, 2)
        Corner points; see `Polyline`.
    speed_unit_nm_s : float
        Speed unit in nm/s.
    unit : {"um", "step"}
        What the position counters count (row T-61).
    """

    def __init__(
        self, points_um: NDArray[np.int64], speed_unit_nm_s: float = SPEED_UNIT_NM_S, unit: Unit = "um"
    ) -> None:
        self._path = Polyline(points_um, unit)
        self._unit: Unit = unit
        self._clock = TickClock(speed_unit_nm_s)
        self._move = 0
        self._position = list(self._path.points[0])

    @property
    def position_um(self) -> tuple[int, int]:
        """Position counters in um."""
        return self._position[0], self._position[1]

    @property
    def path_um(self) -> float:
        """Length travelled along the path in um, at the foot of the position counters."""
        return self._path.travelled_um(self._move, self.position_um)

    def _count(self, axis: int, direction: int, wrap: bool = False) -> None:
        """POSITI for one axis: the counter holds units, `position_um` shows um."""
        unit_um = UNIT_UM[self._unit]
        self._position[axis] = positi(self._position[axis] // unit_um, direction, wrap, self._unit) * unit_um


def near(a_um: tuple[int, int], b_um: tuple[int, int]) -> bool:
    """Whether two points differ by no more than half a step, 1 um, in either axis (row T-18)."""
    return abs(a_um[0] - b_um[0]) <= 1 and abs(a_um[1] - b_um[1]) <= 1


def check_window(start_ns: int, end_ns: int, speed_units: int) -> None:
    """Refuse a window that runs backwards in time and a speed beyond 127 units."""
    if end_ns < start_ns:
        raise InputError(f"a window must not end before it starts, but {end_ns} ns is before {start_ns} ns")
    if not -MAX_SPEED <= speed_units <= MAX_SPEED:
        raise InputError(f"the path speed must be -{MAX_SPEED}..{MAX_SPEED} units, not {speed_units}")
