"""Chains: lines and arcs of a drawing that follow one another, joined into closed contours; what is drawn twice."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Self

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.program.outline import JOIN_TOLERANCE_MM

SAME_MM = 1e-6  # points closer than this many mm are one (ours: what arithmetic leaves of equal numbers)


@dataclass(frozen=True)
class Chain:
    """Points of one entity, or of several joined."""

    points: NDArray[np.float64]  # (n, 2): in mm, none within `SAME_MM` of the one before
    elements: NDArray[np.int64]  # (n - 1,): which line or arc each of the chords belongs to; neighbours differ
    place: int  # place of its first entity in the drawing

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
        """Return a ring without lines and arcs that lie within the tolerance: their ends are one point."""
        # of many in a row, those stay whose ends are farther from the last point that stayed, as straight lines
        parts = self.parts()
        if not any(short for _, short in parts):
            return self
        pieces = [self.points[:1]]
        for part, short in parts:
            if not short or np.hypot(*(part[-1] - pieces[-1][-1])) > JOIN_TOLERANCE_MM:
                pieces.append(np.concatenate([pieces[-1][-1:], part[-1:] if short else part[1:]]))
        return type(self).of(pieces[1:], self.place).ring() if len(pieces) > 1 else self

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


_NEIGHBOURS = 8
_WIDEST_MM = 3 * JOIN_TOLERANCE_MM
"""Two ends with something short between them: its length and the tolerance at either end."""

_End = tuple[int, int]  # an end of a chain: which chain, and 0 or -1


def joined_contours(chains: Sequence[Chain]) -> list[Chain]:
    """Join chains into closed contours, in the order of their first entities."""
    # a chain that lies within the tolerance is joined away: the ends it meets are one place. Short ones in a
    # row that lead farther than the tolerance are a chain like any other
    runs = _runs([chain for chain in chains if chain.is_short])
    whole = [*(chain for chain in chains if not chain.is_short), *(run for run in runs if not run.is_short)]
    loose = sorted((chain for chain in whole if not chain.closed), key=lambda chain: chain.place)
    partner = _partners(loose, [run for run in runs if run.is_short])
    contours = [*(chain for chain in whole if chain.closed), *_followed(loose, partner)]
    return [chain.ring().without_short_elements() for chain in sorted(contours, key=lambda chain: chain.place)]


def _runs(short: list[Chain]) -> list[Chain]:
    """Join short chains with each other, the nearest first."""
    count = 0
    while len(short) not in (0, count):
        count = len(short)
        short = _followed(short, _nearest_partners(short))
    return short


def _nearest_partners(short: Sequence[Chain]) -> dict[_End, _End]:
    """Return pairs of ends that are nearest to each other, leaving out the other end of the same short chain."""
    ends, places = _ends(short)
    still_short = [chain.is_short for chain in short]
    nearest: dict[int, int] = {}
    for k, other in _near(places):
        if ends[k][0] != ends[other][0] or not still_short[ends[k][0]]:
            nearest.setdefault(k, other)
    return {ends[k]: ends[other] for k, other in nearest.items() if nearest.get(other) == k}


def _partners(loose: Sequence[Chain], short: Sequence[Chain]) -> dict[_End, _End]:
    """Return for every end of the loose chains the one that meets it, there or past something short."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not loose:
        return {}
    ends, places = _ends([*loose, *short])
    links = [*_near(places), *((k, k + 1) for k in range(2 * len(loose), len(ends), 2))]
    rows, columns = np.array(links, np.intp).reshape(-1, 2).T
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), (len(ends), len(ends)))
    _, labels = connected_components(graph, directed=False)
    meeting: dict[int, list[int]] = {}
    for k, label in enumerate(labels[: 2 * len(loose)].tolist()):
        meeting.setdefault(label, []).append(k)
    for group in meeting.values():
        if len(group) > 2:
            raise InputError(f"{len(group)} ends meet at {spot(places[group[0]])}: a contour must not branch")
    partner: dict[_End, _End] = {}
    open_ends = []
    for group in meeting.values():
        if len(group) == 1 or np.hypot(*(places[group[0]] - places[group[1]])) > _WIDEST_MM:
            open_ends += group
        else:
            first, second = (ends[k] for k in group)
            partner |= {first: second, second: first}
    if open_ends:
        raise InputError(_open_reason(places[open_ends]))
    return partner


def _ends(chains: Sequence[Chain]) -> tuple[list[_End], NDArray[np.float64]]:
    ends = [(i, end) for i in range(len(chains)) for end in (0, -1)]
    return ends, np.concatenate([chain.points[[0, -1]] for chain in chains])


def _near(places: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Return pairs of different places within the tolerance, for each the nearest first; of a crowd, some."""
    from scipy.spatial import KDTree

    reach_mm = np.nextafter(JOIN_TOLERANCE_MM, 1)
    found = KDTree(places).query(places, k=_NEIGHBOURS, distance_upper_bound=reach_mm)
    distances, others = (np.atleast_2d(values) for values in found)
    own = np.broadcast_to(np.arange(len(places))[:, None], others.shape)
    within = np.isfinite(distances) & (others != own)
    return list(zip(own[within].tolist(), others[within].tolist(), strict=True))


def _open_reason(ends: NDArray[np.float64]) -> str:
    from scipy.spatial import KDTree

    distances, nearest = (np.atleast_2d(values) for values in KDTree(ends).query(ends, k=2))
    k = int(np.argmin(distances[:, 1]))
    first, second = sorted(nearest[k].tolist())
    return (f"a contour is open: a gap of {distances[k, 1]:.3f} mm between {spot(ends[first])} and "
            f"{spot(ends[second])}; close it within {JOIN_TOLERANCE_MM} mm")


def _followed(chains: Sequence[Chain], partner: dict[_End, _End]) -> list[Chain]:
    """Join chains as their ends meet; each result begins with its first chain, or at an open end."""
    left = dict(enumerate(chains))
    found = []
    for first in range(len(chains)):
        if first in left:
            ahead = _walk(left, partner, (first, -1))
            behind = _walk(left, partner, (first, 0))
            pieces = [*(chain.reversed() for chain in reversed(behind)), left.pop(first), *ahead]
            found.append(Chain.joined(pieces))
    return found


def _walk(left: dict[int, Chain], partner: dict[_End, _End], end: _End) -> list[Chain]:
    """Take the chains that follow an end, turned to run on from it, until it is open or round."""
    first, pieces = end[0], []
    while end in partner:
        number, begin = partner[end]
        if number == first or number not in left:
            break
        chain = left.pop(number)
        pieces.append(chain if begin == 0 else chain.reversed())
        end = (number, -1 - begin)
    return pieces


def spot(point: NDArray[np.float64]) -> str:
    """Return a place in the words of a message."""
    return f"X{point[0]:.3f} Y{point[1]:.3f} mm"


_CELL_MM = 16 * JOIN_TOLERANCE_MM
_Box = tuple[float, float, float, float]
_LEAST_SHARE = 0.25
"""Lines that lie apart by more of their own extent than this are two, however short they are (ours)."""


def without_duplicates(chains: Sequence[Chain]) -> list[Chain]:
    """Return the chains without those that lie on an earlier one from end to end, whatever their direction."""
    # candidates share the box around them; boxes are looked up through a grid, with the cells beside it
    cells: dict[tuple[int, ...], list[tuple[_Box, Chain]]] = {}
    distinct = []
    for chain in chains:
        box = (*chain.points.min(axis=0).tolist(), *chain.points.max(axis=0).tolist())
        low, high = (
            [math.floor((c + step) / _CELL_MM) for c in box] for step in (-JOIN_TOLERANCE_MM, JOIN_TOLERANCE_MM)
        )
        near = product(*({a, b} for a, b in zip(low, high, strict=True)))
        if not any(_are_same(chain, box, *other) for cell in near for other in cells.get(cell, ())):
            distinct.append(chain)
            cells.setdefault(tuple(math.floor(c / _CELL_MM) for c in box), []).append((box, chain))
    return distinct


def _are_same(one: Chain, box: _Box, other_box: _Box, other: Chain) -> bool:
    """Compare by the distance of every point and middle of a chord of each from the other."""
    extent = min(max(x1 - x0, y1 - y0) for x0, y0, x1, y1 in (box, other_box))
    reach = min(JOIN_TOLERANCE_MM, _LEAST_SHARE * extent)
    if any(abs(a - b) > reach for a, b in zip(box, other_box, strict=True)) or one.closed != other.closed:
        return False
    if not one.closed:
        ends = one.points[[0, -1]]
        if min(np.hypot(*(ends - other.points[[a, -1 - a]]).T).max() for a in (0, -1)) > reach:
            return False
    return _lies_on(one.points, other.points, reach) and _lies_on(other.points, one.points, reach)


def _lies_on(points: NDArray[np.float64], line: NDArray[np.float64], reach: float) -> bool:
    spots = np.concatenate([points, (points[1:] + points[:-1]) / 2])
    drawn = shapely.LineString(line)
    shapely.prepare(drawn)
    return bool(shapely.dwithin(drawn, shapely.points(spots), reach).all())
