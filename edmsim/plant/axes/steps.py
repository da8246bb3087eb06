"""A source of step pulses: moves of an exact number of steps, at once, at a rate, or with ramps."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import compiled

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
