"""Random numbers of the pulse loop: counter-based draws, whose state is one integer.

Draw ``n`` of a key is the splitmix64 output function (Steele, Lea, Flood, OOPSLA 2014) of ``key + n * gamma``. It
depends only on the key and the count.
"""

import math
from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic

from edmsim.compiled.jit import compiled

GAMMA = np.uint64(0x9E3779B97F4A7C15)


@compiled
def mix(z: np.uint64) -> np.uint64:
    """Scramble 64 bits (the output function of splitmix64)."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@compiled
def uniform(key: np.uint64, count: np.uint64) -> float:
    """Draw number `count` of `key`: uniform on the open interval (0, 1), 53 bits."""
    bits = mix(key + count * GAMMA) >> np.uint64(11)
    return (np.float64(bits) + 0.5) * 1.1102230246251565e-16


@intrinsic
def _heads(_typing: Any, bits: Any) -> Any:
    """Number of set bits of an integer."""
    return types.int64(bits), lambda _context, builder, _signature, arguments: builder.ctpop(arguments[0])


_COINS = 48
_PART_BITS = np.uint64(64 - _COINS)
_PART_MASK = np.uint64(2 ** (64 - _COINS) - 1)
_SD = math.sqrt(_COINS / 4 + 1 / 12)


@compiled
def normal(key: np.uint64, count: np.uint64) -> float:
    """Draw number `count` of `key`: standard normal, with a distribution function within 0.002 of the normal one."""
    # The number of heads of 48 coins, plus a uniform fraction of one more: no logarithm, root, division or branch.
    # Mean and variance are exact, and no draw is beyond 7.1.
    bits = mix(key + count * GAMMA)
    part = np.float64(np.int64(bits & _PART_MASK)) + 0.5
    return (np.float64(_heads(bits >> _PART_BITS)) + part / 2.0 ** (64 - _COINS) - (_COINS + 1) / 2) / _SD


def key_of(seed: int) -> np.uint64:
    """Key of a seed: the keys of neighbouring seeds are unrelated."""
    with np.errstate(over="ignore"):
        return np.uint64(int(mix(np.uint64(int(seed) % 2**64) * GAMMA + GAMMA)))
