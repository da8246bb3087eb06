"""Offset of the guides from the programmed path, by extra steps to the motors in every window.

A bent wire cuts off the path of its guides. A controller that estimates this error can offset the guides to the
other side. In a trim pass, guides nearer to the wall remove more metal.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.planner.kinds import EXACT, segment_at
from edmsim.controllers.planner.registry import Course
from edmsim.controllers.protocols import Step
from edmsim.geometry import Floats
from edmsim.snapshots import Snapshots


@exactly_compiled
def next_steps(
    points_um: Floats, along_um: Floats, last: int, path_um: float, offset_um: float, step_um: float,
    made: NDArray[np.int64],
) -> tuple[int, int]:
    """Return by how many steps, -1, 0 or 1, the motors of x and y go nearer to an offset to the left of the path.

    One step per axis and window, 80 um/s at the thesis' setting, is slow enough for a motor that turns, and fast
    enough for what bends a wire. `made` (2,) are the steps by which the motors are beside the path already.
    """
    k = segment_at(along_um, last, path_um, 0)
    dx, dy = points_um[k + 1, 0] - points_um[k, 0], points_um[k + 1, 1] - points_um[k, 1]
    scale = offset_um / (math.hypot(dx, dy) * step_um)
    more_x, more_y = int(np.rint(-dy * scale)) - made[0], int(np.rint(dx * scale)) - made[1]
    return min(max(more_x, -1), 1), min(max(more_y, -1), 1)


class PathOffset(Snapshots):
    """The offset of a cut, leg by leg; `lateral_um` is the motors' offset from the program's place."""

    STATE = ("_made",)

    def __init__(self, step_um: float) -> None:
        self._step_um = step_um
        self._made: NDArray[np.int64] = np.zeros(2, np.int64)
        self._points: Floats = np.zeros((0, 2))
        self._along: Floats = np.zeros(0)

    @property
    def lateral_um(self) -> tuple[float, float]:
        """Extra steps in um."""
        x, y = (self._made * self._step_um).tolist()
        return x, y

    def clear(self) -> None:
        """Stand at a place of the program that was reached without steps."""
        self._made[:] = 0

    def begin_leg(self, points_um: NDArray[Any], along_um: Floats | None = None) -> None:
        """Go along the next leg, whose lengths of path may be other than those of its points; the motors stay."""
        if along_um is None:
            course = Course.of(EXACT, points_um)
            self._points, self._along = course.points_um, course.along_um
            return
        moves = np.concatenate([[True], (np.diff(points_um, axis=0) != 0).any(axis=1)])
        self._points, self._along = np.asarray(points_um[moves], np.float64), along_um[moves]

    def steps(self, time_ns: int, path_um: float, offset_um: float) -> list[Step]:
        """Return the steps of the window that begins, at a length of the leg."""
        more = next_steps(
            self._points, self._along, len(self._points) - 2, path_um, offset_um, self._step_um, self._made
        )
        self._made += more
        return [Step(time_ns, axis, direction) for axis, direction in enumerate(more) if direction]
