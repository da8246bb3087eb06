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


class _Drawn(Snapshots):
    """A fault with a chance, whose state is how often it was drawn."""

    def __init__(self, seed: int, chance: float) -> None:
        self._random = random.Random(seed)
        self._seed, self.chance, self.drawn = seed, chance, 0

    def draw(self) -> bool:
        """Return whether the fault occurs."""
        self.drawn += 1
        return self._random.random() < self.chance

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue where `snapshot` was taken."""
        super().restore(state)
        self._random, drawn, self.drawn = random.Random(self._seed), self.drawn, 0
        for _ in range(drawn):
            self.draw()


class SerialNoise(_Drawn):
    """Turns a bit of a character over, with a chance (ours), while the mean current is above 1.5 A."""

    STATE = ("drawn", "disturbed")

    def __init__(self, seed: int, chance: float = 0.05) -> None:
        super().__init__(seed, chance)
        self.disturbed = self._bit = 0

    def draw(self) -> bool:
        """Draw the bit as well."""
        hit = super().draw()
        self._bit = self._random.randrange(8)
        return hit

    def __call__(self, byte: int, mean_current_A: float) -> int:
        """Return the character as it arrives."""
        if mean_current_A <= NOISE_FROM_A:
            return byte
        if not self.draw():
            return byte
        self.disturbed += 1
        return byte ^ 1 << self._bit


class DropOut(_Drawn):
    """The generator stops below 6.5 V of V(t(p)), between 6.5 and 7 V with a chance (ours), until it is 7 V again."""

    STATE = ("drawn", "out")

    def __init__(self, seed: int, chance: float = 0.5) -> None:
        super().__init__(seed, chance)
        self.out = False

    def set(self, volts: float) -> bool:
        """Take a new voltage; return whether the generator is out."""
        if volts >= RUNS_FROM_V:
            self.out = False
        elif volts < DROPS_BELOW_V:
            self.out = True
        elif not self.out:
            self.out = self.draw()
        return self.out
