"""A rapid: x and y go to another place under their drives, the wire cut and the generator off.

The axes are stepped by edmsim's own integrator, whatever moves the table while it cuts: without the wire, rotor,
screw and table are all there is, and MuJoCo moves them alike.
"""

import math
import tomllib
from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from edmsim import models
from edmsim.compiled.axis_rows import N_AXES
from edmsim.compiled.jit import compiled
from edmsim.plant.axes.board import NOBODY, first_due, serve, shut_off, tripped, watch
from edmsim.plant.axes.shaft import coast_all
from edmsim.plant.axes.steps import MOVE, make_steps, move
from edmsim.plant.kernel.state import Axes


@cache
def rapid_constants() -> dict[str, float]:
    """Return the constants of a rapid by name."""
    found: dict[str, float] = tomllib.loads(models.path("drives/board.toml").read_text(encoding="utf-8"))["rapid"]
    return found


def straight_moves(counts: Sequence[int], start_ns: int, rate_Hz: float, at_once: Sequence[bool]) -> NDArray[np.void]:
    """Return moves along a straight line; axes whose drive makes ramps of its own get their steps at once."""
    way = math.hypot(*counts)
    rows = [np.zeros(0, MOVE)]
    for axis, count in enumerate(counts):
        if count:
            rate = 0.0 if at_once[axis] else rate_Hz * abs(count) / way
            rows.append(move(axis, start_ns, count, rate, rate / rapid_constants()["ramp_s"]))
    return np.concatenate(rows)


def time_left_s(
    before_um: NDArray[np.float64], away_um: NDArray[np.float64], between_s: float, near_um: float
) -> float:
    """Return how long axes take at their pace until they are near their places; infinite if one comes no nearer."""
    far = away_um > near_um
    nearer_um = (before_um - away_um)[far]
    if np.any(nearer_um <= 0.0):
        return math.inf
    return float(np.max(away_um[far] / nearer_um, initial=0.0)) * between_s


@compiled
def run_moves(axes: Axes, moves: NDArray[np.void], until_ns: int) -> bool:
    """Run the drives and their axes to a time; false, and no further, once the machine has to stop another axis."""
    before = tripped(axes)
    while True:
        who, due_ns = first_due(axes, until_ns)
        fine = coast_all(axes, 0, due_ns)
        for axis in range(N_AXES):
            axes.drives[axis].setpoint += make_steps(moves, axis, 0, due_ns)
        watch(axes, due_ns)
        if tripped(axes) & ~before or not fine:
            return False
        if who == NOBODY:
            return True
        if not serve(axes, who, due_ns):
            shut_off(axes, who % N_AXES, due_ns)
