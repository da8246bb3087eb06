"""Injection of the two faults that the 1982 machine still had (rows T-29, T-30).

Their probabilities are ours. Draws are numbered, so the same seed and history repeat the same faults.
"""

from __future__ import annotations

import random
from collections.abc import Mapping
from typing import Any

from edmsim.snapshots import Snapshots

NOISE_FROM_A = 1.5  # mean current above which sparks disturb the serial lines (row T-29)
DROPS_BELOW_V, RUNS_FROM_V = 6.5, 7.0
"""V(t(p)) below which the generator drops out, and from which it surely runs (row T-A5)."""


class SerialNoise(Snapshots):
    """Turns a bit of a character over, with a chance (ours), while the mean current is above 1.5 A."""

    STATE = ("drawn", "disturbed")

    def __init__(self, seed: int, chance: float = 0.05) -> None:
        self._random = random.Random(seed)
        self.chance = chance
        self.drawn = 0
        self.disturbed = 0
        self._seed = seed

    def __call__(self, byte: int, mean_current_A: float) -> int:
        """Return the character as it arrives."""
        if mean_current_A <= NOISE_FROM_A:
            return byte
        self.drawn += 1
        hit, bit = self._random.random() < self.chance, self._random.randrange(8)
        if not hit:
            return byte
        self.disturbed += 1
        return byte ^ 1 << bit

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue where `snapshot` was taken."""
        super().restore(state)
        self._random = random.Random(self._seed)
        for _ in range(self.drawn):
            self._random.random()
            self._random.randrange(8)


class DropOut(Snapshots):
    """The generator stops below 6.5 V of V(t(p)), between 6.5 and 7 V with a chance (ours), until it is 7 V again."""

    STATE = ("drawn", "out")

    def __init__(self, seed: int, chance: float = 0.5) -> None:
        self._random = random.Random(seed)
        self.chance = chance
        self.drawn = 0
        self.out = False
        self._seed = seed

    def set(self, volts: float) -> bool:
        """Take a new voltage; return whether the generator is out."""
        if volts >= RUNS_FROM_V:
            self.out = False
        elif volts < DROPS_BELOW_V:
            self.out = True
        elif not self.out:
            self.drawn += 1
            self.out = self._random.random() < self.chance
        return self.out

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue where `snapshot` was taken."""
        super().restore(state)
        self._random = random.Random(self._seed)
        for _ in range(self.drawn):
            self._random.random()
