"""Random numbers of the pulse loop: counter-based draws, so that the state is one whole number.

Draw ``n`` under a key is the splitmix64 output function (Steele, Lea, Flood, OOPSLA 2014) of
``key + n * gamma``: it depends on nothing but the key and the count.
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
    """Draw number `count` under `key`: uniform on the open interval (0, 1), 53 bits."""
    bits = mix(key + count * GAMMA) >> np.uint64(11)
    return (np.float64(bits) + 0.5) * 1.1102230246251565e-16


@intrinsic
def _heads(_typing: Any, bits: Any) -> Any:
    """How many bits of a whole number are set."""
    return types.int64(bits), lambda _context, builder, _signature, arguments: builder.ctpop(arguments[0])


_COINS = 48
_PART_BITS = np.uint64(64 - _COINS)
_PART_MASK = np.uint64(2 ** (64 - _COINS) - 1)
_SD = math.sqrt(_COINS / 4 + 1 / 12)


@compiled
def normal(key: np.uint64, count: np.uint64) -> float:
    """Draw number `count` under `key`: standard normal, within 0.002 of the normal distribution's shares."""
    # the number of heads of 48 coins, and a uniform share of one more: no logarithm, root or division, and nothing
    # that the processor would have to foresee. Mean and variance are exact, and no draw lies beyond 7.1
    bits = mix(key + count * GAMMA)
    part = np.float64(np.int64(bits & _PART_MASK)) + 0.5
    return (np.float64(_heads(bits >> _PART_BITS)) + part / 2.0 ** (64 - _COINS) - (_COINS + 1) / 2) / _SD


def key_of(seed: int) -> np.uint64:
    """Key of a seed: neighbouring seeds give unrelated keys."""
    with np.errstate(over="ignore"):
        return np.uint64(int(mix(np.uint64(int(seed) % 2**64) * GAMMA + GAMMA)))
