"""Loose lines and arcs of a drawing joined into closed contours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.program.chains import Chain
from edmsim.program.outline import JOIN_TOLERANCE_MM

_NEIGHBOURS = 8
_WIDEST_MM = 3 * JOIN_TOLERANCE_MM
"""Two ends with something short between them: its length and the tolerance at either end."""

_End = tuple[int, int]
"""An end of a chain: which chain, and 0 or -1."""


def joined_contours(chains: Sequence[Chain]) -> list[Chain]:
    """Join chains into closed contours, in the order of their first entities.

    A chain that lies within the tolerance is joined away: the ends it meets are one place. Short ones in a row that
    lead farther than the tolerance are a chain like any other.

    Raises
    ------
    InputError
        A contour that is open or branches.
    """
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
