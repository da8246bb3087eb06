"""Steps that offset the guides from the path, compiled; see `edmsim.controllers.axis.path_offset`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.planner.exact import segment_at

Floats = NDArray[np.float64]


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
