"""Errors of each planner, and of the computer of 1982, in path, speed and end point.

The moves are straight, in all directions and at many speeds.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.mcu.computer import Computer, PathRun
from edmsim.controllers.mcu.firmware.poscal import STEP_UM
from edmsim.controllers.mcu.firmware.timers import MAX_SPEED, SPEED_UNIT_NM_S
from edmsim.controllers.planner.registry import PLANNERS, Planner, make_planner

MACHINE = "mcu"  # name of the computer of 1982, which makes its own steps
COMPARED = (*PLANNERS, MACHINE)
SPEEDS = (1, 2, 4, 8, 16, 32, 64, 127)  # speeds in units at which the planners are compared: those of row T-G9
DIRECTIONS_DEG = range(360)
LONG_UM, SHORT_UM = 2500, 50
"""Lengths of the moves: far above the 8 bits of REDUC, where the squares wrap near 45 degrees, and below them."""
STRETCH_UM = 100.0  # length over which a local speed is averaged; single steps make a ripple of some 1 % in it
START_UM = (30_000, 30_001)
_MARGIN = 4.0  # longest time of a move over its nominal time; the slowest planner needs twice the nominal time


class MoveError(NamedTuple):
    """Errors of one straight move."""

    path_max_um: float  # distance of the position counters from the line, after every step
    path_rms_um: float
    # mean speed along the line from the first to the last step, relative to the commanded one, minus 100 %
    speed_percent: float
    # rms deviation of the speed over lengths of `STRETCH_UM`, in % of the commanded one; NaN for fewer than two
    ripple_percent: float
    end_um: float  # distance from the end of the move to the place where the motors stopped


def move(planner: str, run_um: tuple[int, int], speed: int, start_um: tuple[int, int] = START_UM) -> MoveError:
    """Run one straight move of a planner of `PLANNERS` or of `MACHINE` to its end, at 1 to 127 units."""
    start = np.array(start_um)
    run = np.array(run_um)
    length = math.hypot(*run_um)
    commanded = speed * SPEED_UNIT_NM_S * 1e-3
    until_ns = round((_MARGIN * (length + 2 * STEP_UM) / commanded) * 1e9)
    follower = _follower(planner, np.array([start, start + run]))
    steps = follower.advance(0, until_ns, round(commanded * 1e3 / follower.speed_unit_nm_s))
    moved = np.zeros((len(steps), 2))
    moved[np.arange(len(steps)), [step.axis for step in steps]] = [STEP_UM * step.direction for step in steps]
    positions = np.cumsum(moved, axis=0)
    times = np.array([step.time_ns for step in steps]) * 1e-9
    along, across = positions @ run / length, positions @ (run[::-1] * (1, -1)) / length
    away = np.hypot(across, along - np.clip(along, 0.0, length))
    return MoveError(
        float(away.max()),
        float(np.sqrt((away**2).mean())),
        100.0 * ((along[-1] - along[0]) / (times[-1] - times[0]) / commanded - 1.0),
        100.0 * _ripple(along, times) / commanded,
        float(np.hypot(*(positions[-1] - run))),
    )


def _follower(planner: str, points_um: NDArray[np.int64]) -> Planner:
    if planner != MACHINE:
        return make_planner(planner, points_um)
    computer = Computer(wrap=True)
    computer.init()
    start, end = ((int(x), int(y)) for x, y in points_um)
    computer.set_position(*start)
    computer.set_speed(MAX_SPEED)
    computer.start()
    return PathRun(computer, (start, end))


def _ripple(along_um: NDArray[np.float64], times: NDArray[np.float64]) -> float:
    """Return the rms deviation of the speed over lengths of `STRETCH_UM` from its mean, in um/s."""
    furthest = np.maximum.accumulate(along_um)
    marks = np.arange(furthest[0], furthest[-1], STRETCH_UM)
    if len(marks) < 3:
        return math.nan
    speeds = STRETCH_UM / np.diff(np.interp(marks, furthest, times))
    return float(speeds.std())


def around(
    planner: str, length_um: float, speed: int, directions_deg: Iterable[float] = DIRECTIONS_DEG
) -> NDArray[np.float64]:
    """Return the errors of moves of one length in many directions: (directions, fields of `MoveError`)."""
    runs = (
        (round(length_um * math.cos(a)), round(length_um * math.sin(a)))
        for a in np.radians(list(directions_deg))
    )
    return np.array([move(planner, run, speed) for run in runs])
