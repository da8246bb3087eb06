"""Random numbers of the pulse loop: counter-based draws, so that the state is one whole number.

Draw ``n`` under a key is the splitmix64 output function (Steele, Lea, Flood, OOPSLA 2014) of
``key + n * gamma``: it depends on nothing but the key and the count.
"""

from __future__ import annotations

import math

import numpy as np

from edmsim.compiled.jit import compiled, compiled_apart

GAMMA = np.uint64(0x9E3779B97F4A7C15)
_TAIL = 0.02425


@compiled
def mix(z: np.uint64) -> np.uint64:
    """Scramble 64 bits (the output function of splitmix64)."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@compiled
def uniform(key: np.uint64, count: np.uint64) -> float:
    """Draw number `count` under `key`: uniform on the open interval (0, 1), 53 bits."""
    bits = mix(key + count * GAMMA) >> np.uint64(11)
    return (np.float64(bits) + 0.5) * 1.1102230246251565e-16


@compiled
def normal(u: float) -> float:
    """Standard normal quantile of a share `u` (0 to 1): makes a normal draw of a uniform one.

    Rational approximations of P. J. Acklam (2003), relative error below 1.2e-9: a quarter of the time of Box and
    Muller's logarithm, root, sine and cosine.
    """
    if u < _TAIL:
        return _tail_quantile(u)
    if u > 1.0 - _TAIL:
        return -_tail_quantile(1.0 - u)
    q = u - 0.5
    r = q * q
    over = -39.69683028665376 * r + 220.9460984245205
    over = ((over * r - 275.9285104469687) * r + 138.3577518672690) * r - 30.66479806614716
    under = -54.47609879822406 * r + 161.5858368580409
    under = ((under * r - 155.6989798598866) * r + 66.80131188771972) * r - 13.28068155288572
    return q * (over * r + 2.506628277459239) / (under * r + 1.0)


@compiled_apart
def _tail_quantile(u: float) -> float:
    q = math.sqrt(-2.0 * math.log(u))
    over = ((-7.784894002430293e-3 * q - 0.3223964580411365) * q - 2.400758277161838) * q - 2.549732539343734
    under = ((7.784695709041462e-3 * q + 0.3224671290700398) * q + 2.445134137142996) * q + 3.754408661907416
    return ((over * q + 4.374664141464968) * q + 2.938163982698783) / (under * q + 1.0)


def key_of(seed: int) -> np.uint64:
    """Key of a seed: neighbouring seeds give unrelated keys."""
    with np.errstate(over="ignore"):
        return np.uint64(int(mix(np.uint64(int(seed) % 2**64) * GAMMA + GAMMA)))
