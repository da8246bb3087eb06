"""Random numbers of the pulse loop: counter-based draws, so that the state is one whole number.

Draw ``n`` under a key is the splitmix64 output function (Steele, Lea, Flood, OOPSLA 2014) of
``key + n * gamma``: it depends on nothing but the key and the count.
"""

from __future__ import annotations

import numpy as np

from .compiled import compiled

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


def key_of(seed: int) -> np.uint64:
    """Key of a seed: neighbouring seeds give unrelated keys."""
    with np.errstate(over="ignore"):
        return np.uint64(int(mix(np.uint64(seed % 2**64) * GAMMA + GAMMA)))
