"""Motor steps along a polyline at a commanded speed, either way.

The ideal position runs along the path; an axis steps when that is further than 5/8 of a step from where the axis
stands. The margin keeps a path between two motor positions from swinging the motor to and fro. Steps fall on a grid
of a quarter um of travel.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

GRID_UM = 0.25
"""Travel between two looks at the ideal position (ours: an eighth of a step of 2 um)."""
MARGIN = 0.625
"""Distance from the axis, in steps, beyond which it steps (ours: half a step and a quarter of that half)."""


class Track:
    """Where the wire is led.

    Parameters
    ----------
    points_um : array (n, 2)
        Corners of the path on the table; no two in a row are the same.
    step_um : float
        One motor step.

    Attributes
    ----------
    length_um, path_um : float
        Length of the path, and how far along it the ideal position is.
    """

    def __init__(self, points_um: ArrayLike, step_um: float) -> None:
        points = np.asarray(points_um, np.float64)
        self.points_um: NDArray[np.float64] = points
        self._at = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        self._step_um = step_um
        self._axis_um = [float(points[0, 0]), float(points[0, 1])]
        self.length_um = float(self._at[-1])
        self.path_um = 0.0

    @property
    def done(self) -> bool:
        """Whether the path's end is reached."""
        return self.path_um >= self.length_um

    def advance(self, start_ns: int, duration_ns: int, feed_um_s: float) -> list[tuple[int, int, int]]:
        """Run for a window of time; returns the steps as `Plant.advance` takes them.

        The path is never left: a retract ends at its start.
        """
        end = min(max(self.path_um + feed_um_s * duration_ns * 1e-9, 0.0), self.length_um)
        travel = end - self.path_um
        if travel == 0.0:
            return []
        count = math.ceil(abs(travel) / GRID_UM)
        along = self.path_um + travel * (np.arange(1, count + 1) / count)
        x = np.interp(along, self._at, self.points_um[:, 0]).tolist()
        y = np.interp(along, self._at, self.points_um[:, 1]).tolist()
        per_ns = abs(feed_um_s) * 1e-9
        steps = []
        for number, place in enumerate(zip(x, y, strict=True)):
            time_ns = start_ns + min(int(abs(travel) * number / count / per_ns), duration_ns - 1)
            for axis in (0, 1):
                off = place[axis] - self._axis_um[axis]
                if abs(off) > MARGIN * self._step_um:
                    direction = 1 if off > 0 else -1
                    self._axis_um[axis] += direction * self._step_um
                    steps.append((time_ns, axis, direction))
        self.path_um = end
        return steps
