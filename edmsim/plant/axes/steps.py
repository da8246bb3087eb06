"""Moves of an exact number of steps, at once, at a rate, or with ramps; and rapids of x and y."""

import math
import tomllib
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim import models
from edmsim.compiled.axis_rows import N_AXES
from edmsim.compiled.jit import compiled
from edmsim.plant.axes.board import NOBODY, first_due, serve, shut_off, tripped, watch
from edmsim.plant.axes.shaft import coast_all
from edmsim.plant.kernel.state import Axes

MOVE = np.dtype(
    [
        ("axis", "i8"),
        ("start_ns", "i8"),
        ("end_ns", "i8"),
        ("count", "i8"),  # steps; their sign is the direction
        ("made", "i8"),  # steps made so far
        ("rate_Hz", "f8"),
        ("ramp_s", "f8"),  # in which the rate is reached, and left; 0 makes all steps at once
    ]
)
"""A move of the step source."""
STEP_OPEN, DIR_OPEN = 1, 2
"""Bits: the step input, or the direction input, is unplugged. A pull-up holds it: no step, always positive."""


def move(axis: int, start_ns: int, count: int, rate_Hz: float, accel_Hz_s: float) -> NDArray[np.void]:
    """Return a move as a row of `MOVE`; one too short for its ramps is the faster part of a triangle."""
    row = np.zeros(1, MOVE)
    steps = abs(count)
    ramp_s, seconds = 0.0, 0.0
    if rate_Hz > 0:
        if accel_Hz_s > 0:
            rate_Hz = min(rate_Hz, math.sqrt(steps * accel_Hz_s))
            ramp_s = rate_Hz / accel_Hz_s
        seconds = steps / rate_Hz + ramp_s if rate_Hz > 0 else 0.0
    row[0] = axis, start_ns, start_ns + round(seconds * 1e9), count, 0, rate_Hz, ramp_s
    return row


@compiled
def _steps_by(row: Any, now_ns: int) -> int:
    """Steps of a move made by a time, without their sign."""
    total: int = abs(row.count)
    if now_ns >= row.end_ns:
        return total
    if now_ns <= row.start_ns:
        return 0
    since = (now_ns - row.start_ns) * 1e-9
    left = (row.end_ns - now_ns) * 1e-9
    ramp = row.ramp_s
    if since < ramp:
        way = 0.5 * row.rate_Hz * since * since / ramp
    elif left < ramp:
        way = total - 0.5 * row.rate_Hz * left * left / ramp
    else:
        way = row.rate_Hz * (since - 0.5 * ramp)
    return int(min(max(math.floor(way), 0), total))


@compiled
def make_steps(moves: NDArray[np.void], axis: int, unplugged: int, now_ns: int) -> int:
    """Carry an axis' moves on to a time; return the step edges that came since, up less down."""
    edges: int = 0
    for k in range(moves.shape[0]):
        row = moves[k]
        if row.axis != axis or row.made == abs(row.count) or now_ns < row.start_ns:
            continue
        made = _steps_by(row, now_ns)
        forward = row.count > 0 or unplugged & DIR_OPEN != 0
        if unplugged & STEP_OPEN == 0:
            edges += made - row.made if forward else row.made - made
        row.made = made
    return edges


# A rapid: x and y go to another place under their drives, the wire cut and the generator off.
#
# The axes are stepped by edmsim's own integrator, whatever moves the table while it cuts: without the wire, rotor,
# screw and table are all there is, and MuJoCo moves them alike.

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
