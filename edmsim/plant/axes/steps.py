"""Moves of a number of steps, at once, at a rate, or with ramps; and rapids of x and y."""

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
from edmsim.plant.axes.feed_drive import coast_all
from edmsim.plant.kernel.state import Axes

MOVE = np.dtype(
    [
        ("axis", "i8"),
        ("start_ns", "i8"),
        ("end_ns", "i8"),
        ("count", "i8"),  # number of steps; the sign is the direction
        ("made", "i8"),  # steps made so far
        ("rate_Hz", "f8"),
        ("ramp_s", "f8"),  # duration of each ramp; 0 makes all steps at once
    ]
)
"""A move of the step source."""
STEP_OPEN, DIR_OPEN = 1, 2
"""Bits: the step input or the direction input is unplugged and pulled up: no steps, or always positive."""


def move(axis: int, start_ns: int, count: int, rate_Hz: float, accel_Hz_s: float) -> NDArray[np.void]:
    """Return a move as a record of `MOVE`; one that is too short for its ramps has a triangular profile."""
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
    """Return the number of steps of a move up to a time."""
    total: int = abs(row.count)
    if now_ns >= row.end_ns:
        return total
    if now_ns <= row.start_ns:
        return 0
    since = (now_ns - row.start_ns) * 1e-9
    left = (row.end_ns - now_ns) * 1e-9
    ramp = row.ramp_s
    if since < ramp:
        travelled = 0.5 * row.rate_Hz * since * since / ramp
    elif left < ramp:
        travelled = total - 0.5 * row.rate_Hz * left * left / ramp
    else:
        travelled = row.rate_Hz * (since - 0.5 * ramp)
    return int(min(max(math.floor(travelled), 0), total))


@compiled
def make_steps(moves: NDArray[np.void], axis: int, unplugged: int, now_ns: int) -> int:
    """Advance an axis' moves to a time; return the steps since, positive minus negative."""
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


# A rapid: x and y move to another place under their drives, with the wire cut off and the generator off.
#
# edmsim's own integrator moves the axes even if MuJoCo moves the table in the cut: without the wire there are only
# rotor, screw and table, which MuJoCo would move in the same way.

@cache
def rapid_constants() -> dict[str, float]:
    """Return the constants of a rapid by name."""
    found: dict[str, float] = tomllib.loads(models.path("drives/board.toml").read_text(encoding="utf-8"))["rapid"]
    return found


def straight_moves(counts: Sequence[int], start_ns: int, rate_Hz: float, at_once: Sequence[bool]) -> NDArray[np.void]:
    """Return the moves of a straight line; drives with their own ramps receive all steps at once."""
    distance = math.hypot(*counts)
    rows = [np.zeros(0, MOVE)]
    for axis, count in enumerate(counts):
        if count:
            rate = 0.0 if at_once[axis] else rate_Hz * abs(count) / distance
            rows.append(move(axis, start_ns, count, rate, rate / rapid_constants()["ramp_s"]))
    return np.concatenate(rows)


def time_left_s(
    before_um: NDArray[np.float64], away_um: NDArray[np.float64], between_s: float, near_um: float
) -> float:
    """Return the time until the axes are near their targets at their speed; infinite if one does not approach."""
    far = away_um > near_um
    nearer_um = (before_um - away_um)[far]
    if np.any(nearer_um <= 0.0):
        return math.inf
    return float(np.max(away_um[far] / nearer_um, initial=0.0)) * between_s


@compiled
def run_moves(axes: Axes, moves: NDArray[np.void], until_ns: int) -> bool:
    """Run the drives and their axes to a time; stop and return False if the machine must stop another axis."""
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
