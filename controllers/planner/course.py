"""The checked path of a planner, and its row at the path's start."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edmsim.controllers.mcu.firmware.arithmetic import WORD
from edmsim.controllers.mcu.firmware.poscal import STEP_UM, Unit, unit_um
from edmsim.controllers.mcu.firmware.timers import SPEED_UNIT_NM_S, TIMER_COUNT, timer_clock_hz
from edmsim.controllers.planner.kinds import DDA, EXACT, NM, PLANNER, Floats, Ints, begin
from edmsim.errors import InputError
from edmsim.geometry import Polyline


class Course(NamedTuple):
    """A planner ready to run, as compiled code takes it."""

    row: NDArray[np.void]
    points_um: Floats  # (n, 2): corners of the path, each different from the one before
    along_um: Floats  # (n,): length of path up to each
    lengths: Ints  # (n - 1,): of every move in 65 536ths of a motor step, rounded down; 0 but for `DDA`

    @classmethod
    def of(
        cls, kind: int, points_um: ArrayLike, speed_unit_nm_s: float = SPEED_UNIT_NM_S, unit: Unit = "um",
        step_um: float = STEP_UM, start: int = 0,
    ) -> Course:
        """Begin a path (n, 2) for a kind of `record` at a point of it; refuses what the planner cannot count."""
        # lengths count from that point, so those of the points before it are negative: only a retract comes there
        array = np.asarray(points_um, np.float64)
        if array.ndim != 2 or array.shape[1] != 2:
            raise InputError(f"a path needs points in an array of shape (n, 2), not {array.shape}")
        row: NDArray[np.void] = np.zeros(1, PLANNER)
        row["kind"], row["step_um"] = kind, step_um
        row["unit_um"] = size_um = unit_um(unit, round(step_um))
        if kind == EXACT:
            lay = _exact
        else:
            grid_um = 1 / NM if kind == DDA and step_um != round(step_um) else size_um
            # counters of um that are off the grid of steps may pass a corner by half a step
            _check_counts(array, grid_um, size_um, 0.0 if step_um <= STEP_UM or unit == "step" else step_um)
            clock = timer_clock_hz(speed_unit_nm_s, step_um)
            row["hertz"], row["per"] = clock.numerator, clock.denominator
            lay = _counted
        points, along = lay(array[start:])
        if len(points) < 2:
            raise InputError(f"a path needs two different points, not {len(points)}")
        if start > 0:
            behind, back = lay(array[start::-1])
            row["move"] = len(behind) - 1
            points, along = np.concatenate([behind[:0:-1], points]), np.concatenate([-back[:0:-1], along])
        row["last_move"], row["from_um"] = len(points) - 2, array[start]
        lengths = _lengths(points, step_um) if kind == DDA else np.zeros(len(points) - 1, np.int64)
        begin(row[0], points)
        return cls(row, points, along, lengths)


def _check_counts(points: Floats, grid_um: float, size_um: int, margin_um: float) -> None:
    """Refuse points that counters of such units cannot hold, or that lie between those of a grid."""
    low, high = margin_um, WORD * size_um - margin_um
    for i, (x, y) in enumerate(points.tolist()):
        if not (low <= x <= high and low <= y <= high):
            raise InputError(
                f"point {i} of the path lies at ({x:g}, {y:g}) um, outside the table's {low:.10g}..{high:.10g} um"
            )
        if any(abs(v / grid_um - round(v / grid_um)) > 1e-6 for v in (x, y)):
            of_nm = "in whole um" if grid_um == 1 else "in whole nm"
            what = f"a whole number of {grid_um:g} um steps" if grid_um > 1 else of_nm
            raise InputError(f"point {i} of the path, ({x:g}, {y:g}) um, is not {what}")


def _counted(points: Floats) -> tuple[Floats, Floats]:
    """Corners without repetitions, and the length of path up to each."""
    distinct = points[np.concatenate([[True], np.any(np.diff(points, axis=0) != 0.0, axis=1)])]
    along = [0.0]
    for a, b in pairwise(distinct.tolist()):
        along.append(along[-1] + math.dist(a, b))
    return distinct, np.array(along)


def _exact(points: Floats) -> tuple[Floats, Floats]:
    """The same of corners that are not whole numbers: those nearer than 0.1 um to the one before are left out."""
    if not np.isfinite(points).all():
        raise InputError("a path needs points of finite numbers")
    line = Polyline(points * 1e-3, closed=False)
    return line.points * 1e3, line.s * 1e3


def _lengths(points: Floats, step_um: float) -> Ints:
    """Lengths of the moves in 65 536ths of a step, rounded down."""
    nm = [(round(x * NM), round(y * NM)) for x, y in points.tolist()]
    return np.array(
        [
            math.isqrt(((bx - ax) ** 2 + (by - ay) ** 2) * TIMER_COUNT**2 // round(step_um * NM) ** 2)
            for (ax, ay), (bx, by) in pairwise(nm)
        ],
        np.int64,
    )
