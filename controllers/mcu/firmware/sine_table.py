"""The sine table that the thesis advises instead of the square root (6.3, row T-72).

A quarter turn has 255 entries of 8 bits: entry ``i`` is the sine of ``i / 254`` of 90 degrees, entry ``254 - i``
its cosine. The nearest entry is right to 0.5 % of full scale (row T-A7). The machine has no arc tangent: it finds
the entry of a direction by bisection, with two products of VERM at each of eight comparisons. These replace the
eleven divisions of SQRT.
"""

from __future__ import annotations

import math

import numpy as np

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.mcu.firmware.arithmetic import BYTE, reduc
from edmsim.controllers.mcu.firmware.poscal import Displacement
from edmsim.errors import InputError

LAST = 254  # index of the last entry, 90 degrees: 255 entries in all (row T-72)

FULL_SCALE = 255  # entry of a sine of 1: 8 bits (row T-72)

SINE = bytes(round(FULL_SCALE * math.sin(math.pi / 2 * i / LAST)) for i in range(LAST + 1))
"""The table as it would be burnt into the EPROM."""

_ENTRIES = np.frombuffer(SINE, np.uint8).astype(np.int64)


def sine(index: int) -> int:
    """Sine of ``index / 254`` of 90 degrees, 0..255 for 0..1."""
    return SINE[index]


def cosine(index: int) -> int:
    """Cosine of ``index / 254`` of 90 degrees, 0..255 for 0..1."""
    return SINE[LAST - index]


def direction(x: int, y: int) -> int:
    """Index of the entry nearest to a vector's direction: 0 (along x) to 254 (along y), of magnitudes of 8 bits."""
    if not (0 <= x <= BYTE and 0 <= y <= BYTE):
        raise InputError(f"the sine table takes magnitudes of 8 bits, 0..255, not {x} and {y}")
    return _nearest(x, y)


@exactly_compiled
def _nearest(x: int, y: int) -> int:
    """Index of the entry whose direction lies nearest."""
    low, high = 0, LAST
    while high - low > 1:
        middle = (low + high) >> 1
        if x * _ENTRIES[middle] <= y * _ENTRIES[LAST - middle]:
            low = middle
        else:
            high = middle
    return low if _aside(x, y, low) <= _aside(x, y, high) else high


@exactly_compiled
def _aside(x: int, y: int, index: int) -> int:
    """Length of a vector, times 255, across the direction of an entry."""
    return int(abs(y * _ENTRIES[LAST - index] - x * _ENTRIES[index]))


@exactly_compiled
def look_up(x: int, y: int, x_direction: int, y_direction: int) -> Displacement:
    """Vector of length 255 (0 for none) in a displacement's direction: what `resolve` does, without a square root."""
    x, y, halvings = reduc(x, y)
    if x == y == 0:
        return Displacement(0, 0, 0, x_direction, y_direction, halvings)
    index = _nearest(x, y)
    return Displacement(
        int(_ENTRIES[LAST - index]), int(_ENTRIES[index]), FULL_SCALE, x_direction, y_direction, halvings
    )
