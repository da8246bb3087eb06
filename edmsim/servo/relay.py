"""The relay experiment: a loop of endless gain makes an axis swing by itself, and the swing tells how fast it is.

Åström and Hägglund 1984: the period is the ultimate one, and ``4 h / (pi a)`` the ultimate gain, for a relay of
height h and a swing of amplitude a. At a drive's serial line the relay is P at its largest and everything else at
nought, and the limit of the output is its height.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from edmsim.errors import InputError
from edmsim.servo.operator import MOVE_RATE, Operator

_HEIGHT, _FACTOR, _HIGHEST = 25, 1.5, 500
"""Height of the first relay, factor to the next, and the highest, in the units of T or of C (ours)."""
_SEEN_COUNTS = range(8, 50)
"""Amplitudes to measure (ours): far above a count, and within the 63 counts that the UHU's stream shows."""
_KICK, _FEWEST_SWINGS = 4, 4


class Swing(NamedTuple):
    """What an axis tells of itself: ultimate gain in units of output per count, period in s, amplitude in counts."""

    gain: float
    period_s: float
    amplitude: float


def swing_of(operator: Operator) -> Swing:
    """Let an axis swing under a relay whose height is raised or lowered until the swing is well seen.

    Raises
    ------
    InputError
        If the axis does not swing, or so widely that the drive shows no swing.
    """
    heights = {_HEIGHT}
    height = _HEIGHT
    while True:
        operator.enter({**operator.relay, "E": operator.no_trip, operator.height: height})
        answer = operator.step(_KICK, MOVE_RATE)
        late = answer.time_s > answer.time_s[-1] / 3
        error, time_s = answer.error[late], answer.time_s[late]
        amplitude = float(np.ptp(error)) / 2
        factor = _FACTOR if amplitude < _SEEN_COUNTS.start else 1 / _FACTOR if amplitude >= _SEEN_COUNTS.stop else 1.0
        wanted = round(height * factor)
        if wanted in heights or not 1 < wanted <= _HIGHEST:
            break
        height = wanted
        heights.add(height)
    high = error > error.mean()
    rises = time_s[1:][high[1:] & ~high[:-1]]
    if len(rises) < _FEWEST_SWINGS:
        raise InputError(
            f"the axis does not swing steadily under a relay of {operator.height}{height}: it is held fast, runs "
            "away, or has play before its encoder"
        )
    return Swing(4 * height / (math.pi * amplitude), float(np.diff(rises).mean()), amplitude)
