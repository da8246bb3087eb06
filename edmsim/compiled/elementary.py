"""Logarithm, exponential, power and cube root for the pulse loop, to some 1e-8.

A call of the mathematical library costs the loop more than its arithmetic: whatever stands in registers goes to
memory and back. These few lines are compiled into the loop instead: the series of the inverse hyperbolic tangent and
of the exponential, and Halley's iteration for the cube root, as exact as a simulated spark needs.
"""

from __future__ import annotations

import math

import numpy as np

from edmsim.compiled.jit import compiled

_ROOT_HALF_BITS = np.int64(0x3FE6A09E667F3BCD)
"""Bits of the root of 1/2: mantissas are taken from there to the root of 2."""
_MANTISSA_BITS = np.int64(52)
_BIAS = np.int64(1023)
_LN2 = math.log(2.0)
_CUBE_ROOT_BITS = np.uint64(0x2A9F789300000000)
"""What a third of the bits of x lacks of the bits of its cube root, the error evened out (value: fdlibm, cbrt)."""


@compiled
def logarithm(x: float) -> float:
    """Natural logarithm of a positive normal number."""
    bits = np.float64(x).view(np.int64)
    exponent = (bits - _ROOT_HALF_BITS) >> _MANTISSA_BITS
    f = np.int64(bits - (exponent << _MANTISSA_BITS)).view(np.float64) - 1.0
    s = f / (2.0 + f)
    z = s * s
    odd = (1.0 / 3 + z * (1.0 / 5)) + z * z * (1.0 / 7 + z * (1.0 / 9))
    return float(exponent * _LN2 + 2.0 * (s + s * z * odd))


@compiled
def exponential(x: float) -> float:
    """Exponential of a number; 0 below -708, and that of 708 above it."""
    x = min(x, 708.0)
    if x < -708.0:
        return 0.0
    twos = np.floor(x * (1.0 / _LN2) + 0.5)
    r = x - twos * _LN2
    r2 = r * r
    low = (1.0 + r) + r2 * (1.0 / 2 + r * (1.0 / 6))
    high = (1.0 / 24 + r * (1.0 / 120)) + r2 * (1.0 / 720 + r * (1.0 / 5040))
    series = low + r2 * r2 * high
    return float(series * np.int64((np.int64(twos) + _BIAS) << _MANTISSA_BITS).view(np.float64))


@compiled
def power(x: float, exponent: float) -> float:
    """Power of a positive number."""
    return exponential(exponent * logarithm(x))


@compiled
def cube_root(x: float) -> float:
    """Cube root of a positive number that is no smaller than 1e-100."""
    root = np.uint64(np.float64(x).view(np.uint64) // np.uint64(3) + _CUBE_ROOT_BITS).view(np.float64)
    for _ in range(2):
        cube = root * root * root
        root *= (cube + 2.0 * x) / (2.0 * cube + x)
    return float(root)
