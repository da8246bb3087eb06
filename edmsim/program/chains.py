"""Chains: lines and arcs of a drawing that follow one another, as points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray

from edmsim.program.outline import JOIN_TOLERANCE_MM

SAME_MM = 1e-6
"""Points closer than this many mm are one (ours: what arithmetic leaves of equal numbers)."""


@dataclass(frozen=True)
class Chain:
    """Points of one entity, or of several joined.

    Attributes
    ----------
    points : float64 array (n, 2)
        In mm, none within `SAME_MM` of the one before.
    elements : int64 array (n - 1,)
        Which line or arc each of the chords belongs to; neighbours differ.
    place : int
        Place of its first entity in the drawing.
    """

    points: NDArray[np.float64]
    elements: NDArray[np.int64]
    place: int

    @classmethod
    def of(cls, pieces: Sequence[NDArray[np.float64]], place: int) -> Self:
        """Join lines and arcs that follow each other."""
        points = np.concatenate([pieces[0], *(piece[1:] for piece in pieces[1:])])
        elements = np.repeat(np.arange(len(pieces)), [len(piece) - 1 for piece in pieces])
        return cls(points, elements, place)._without_repeats()

    @classmethod
    def joined(cls, chains: Sequence[Self]) -> Self:
        """Join chains, each turned to run on where the one before ends."""
        counts = np.cumsum([0, *(int(chain.elements.max()) + 1 for chain in chains[:-1])])
        points = np.concatenate([chains[0].points, *(chain.points[1:] for chain in chains[1:])])
        elements = np.concatenate([chain.elements + count for chain, count in zip(chains, counts, strict=True)])
        return cls(points, elements, min(chain.place for chain in chains))._without_repeats()

    def reversed(self) -> Self:
        """Return it run through from its end."""
        return type(self)(self.points[::-1], self.elements[::-1], self.place)

    def ring(self) -> Self:
        """Return a closed one with its last point on its first."""
        points = np.concatenate([self.points[:-1], self.points[:1]])
        return type(self)(points, self.elements, self.place)._without_repeats()

    @property
    def closed(self) -> bool:
        """Whether its ends are joined."""
        return float(np.hypot(*(self.points[0] - self.points[-1]))) <= JOIN_TOLERANCE_MM

    @property
    def is_short(self) -> bool:
        """Whether it lies within the tolerance that joins ends."""
        return is_short(self.points)

    def parts(self) -> list[tuple[NDArray[np.float64], bool]]:
        """Return the points of its lines and arcs, the ends of each included, and whether each is short."""
        bounds = [0, *(np.flatnonzero(np.diff(self.elements)) + 1).tolist(), len(self.elements)]
        near = np.hypot(*np.diff(self.points[bounds], axis=0).T) <= JOIN_TOLERANCE_MM
        parts = (self.points[a : b + 1] for a, b in pairwise(bounds))
        return [(part, close and is_short(part)) for part, close in zip(parts, near.tolist(), strict=True)]

    def without_short_elements(self) -> Self:
        """Return a ring without lines and arcs that lie within the tolerance: their ends are one point.

        Of many in a row, those stay whose ends are farther from the last point that stayed, as straight lines.
        """
        parts = self.parts()
        if not any(short for _, short in parts):
            return self
        kept = [self.points[:1]]
        for part, short in parts:
            if not short or np.hypot(*(part[-1] - kept[-1][-1])) > JOIN_TOLERANCE_MM:
                kept.append(np.concatenate([kept[-1][-1:], part[-1:] if short else part[1:]]))
        return type(self).of(kept[1:], self.place).ring() if len(kept) > 1 else self

    def _without_repeats(self) -> Self:
        moves = np.hypot(*np.diff(self.points, axis=0).T) > SAME_MM
        if moves.all():
            return self
        return type(self)(self.points[np.concatenate([[True], moves])], self.elements[moves], self.place)


def is_short(points: NDArray[np.float64]) -> bool:
    """Say whether points (n, 2) in mm lie within the tolerance of the first or, where they close, of their middle."""
    closes = np.hypot(*(points[0] - points[-1])) <= JOIN_TOLERANCE_MM
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return any(
        np.hypot(*(points - centre).T).max() <= JOIN_TOLERANCE_MM
        for centre in ((points[0], middle) if closes else points[:1])
    )
