"""Logarithm, exponential, power and cube root for the pulse loop, to some 1e-8.

Calling the mathematical library takes longer than its arithmetic, because all registers are saved to memory and
restored. These functions are compiled into the loop instead. They use the series of the inverse hyperbolic tangent
and of the exponential, and a root estimated to 3 % with a series for its relative error, accurate enough for a
simulated spark.
"""

import math

import numpy as np

from edmsim.compiled.jit import compiled

_ROOT_HALF_BITS = np.int64(0x3FE6A09E667F3BCD)  # bits of sqrt(1/2); mantissas lie between it and sqrt(2)
_MANTISSA_BITS = np.int64(52)
_BIAS = np.int64(1023)
_LN2 = math.log(2.0)
_ROOT_BITS = np.int64(0x553F0A3D00000000)
"""Sum of the bits of x^(-1/3) and a third of the bits of x, as float64; the estimate is good to 4 % (ours: centred
error)."""
_ROOT_SERIES = 1.000000003, -0.3333331512, 0.22221701661, -0.17292879058, 0.14550243471, -0.11699287641
"""Coefficients of ``(1 + u)^(-1/3)`` from -0.090 to 0.1205, to 5e-9 (ours: minimax of the relative error)."""


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
    """Exponential of a number; 0 below -708, ``exp(708)`` above 708."""
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
def inverse_cube_root(x: float) -> float:
    """Inverse cube root of a number of at least 1e-100."""
    root = np.int64(_ROOT_BITS - np.int64(np.float64(x).view(np.uint64) // np.uint64(3))).view(np.float64)
    u = x * root * root * root - 1.0
    u2 = u * u
    low = (_ROOT_SERIES[0] + u * _ROOT_SERIES[1]) + u2 * (_ROOT_SERIES[2] + u * _ROOT_SERIES[3])
    return float(root * (low + u2 * u2 * (_ROOT_SERIES[4] + u * _ROOT_SERIES[5])))


@compiled
def cube_root(x: float) -> float:
    """Cube root of a number of at least 1e-100."""
    inverse = inverse_cube_root(x)
    return x * inverse * inverse
