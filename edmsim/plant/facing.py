"""The rays that face metal: traced once per window, packed for the pulse loop, receding with every crater."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .compiled import compiled
from .state import LANES, Array, Arrays, Constants
from .workpiece import NO_METAL_UM, trace

OVERLAP_UM = 8.0
"""How far inside the wire's surface a ray begins, so that overlap with metal is seen."""
AHEAD_UM = 6.0
"""A known edge is looked for again from this far before it (metal only recedes, the wire moves little)."""
KNOWN_MOVE_UM = 3.0
"""Known edges are of use only while the wire moved less than this since."""
BLIND_TURNS = np.uint64(4)
"""A ray that met no metal is looked along again only every so many windows: what comes within its range at the
feed of such a machine is then still far away."""


@compiled
def _trace_ray(
    a: Arrays, tiles: NDArray[np.uint16], index: NDArray[np.int32], c: Constants, s: int, r: int, ahead_um: float
) -> float:
    """Gap of one ray; with `ahead_um` >= 0 begin that far before the edge known so far."""
    start = c.radius_um - OVERLAP_UM
    if ahead_um >= 0.0 and a.edge_um[s, r] < c.range_um:
        start = max(start, c.radius_um + a.edge_um[s, r] - ahead_um)
    edge = trace(
        tiles, index, s, c.cell_um, a.reference_um[s, 0], a.reference_um[s, 1],
        a.ray_cosine[r], a.ray_sine[r], start, c.radius_um + c.range_um,
    )
    return edge if edge == NO_METAL_UM else edge - c.radius_um


@compiled
def _pack(a: Arrays, c: Constants, s: int) -> None:
    """Pack the rays of a slice that meet metal, and fill up to whole lanes."""
    k = 0
    for r in range(a.ray_cosine.shape[0]):
        if a.edge_um[s, r] < c.range_um:
            a.ray[s, k] = r
            a.distance[s, k] = a.edge_um[s, r]
            a.cosine[s, k] = a.ray_cosine[r]
            a.sine[s, k] = a.ray_sine[r]
            k += 1
    a.facing[s] = (k + LANES - 1) // LANES * LANES
    for fill in range(k, a.facing[s]):
        a.ray[s, fill] = -1
        a.distance[s, fill] = NO_METAL_UM
        a.cosine[s, fill] = 0.0
        a.sine[s, fill] = 0.0


@compiled
def refer(
    a: Arrays, tiles: NDArray[np.uint16], index: NDArray[np.int32], c: Constants, position: Array, turn: int
) -> None:
    """Trace the rays from where the wire is now, and pack those that meet metal; `turn` counts the windows."""
    for s in range(a.shape.shape[0]):
        moved = math.hypot(position[s, 0] - a.reference_um[s, 0], position[s, 1] - a.reference_um[s, 1])
        known = moved < KNOWN_MOVE_UM
        a.reference_um[s, 0] = position[s, 0]
        a.reference_um[s, 1] = position[s, 1]
        for r in range(a.ray_cosine.shape[0]):
            blind = known and a.edge_um[s, r] >= c.range_um
            if not blind or np.uint64(turn + r) % BLIND_TURNS == 0:
                a.edge_um[s, r] = _trace_ray(a, tiles, index, c, s, r, AHEAD_UM if known else -1.0)
        _pack(a, c, s)


@compiled
def recede(a: Arrays, s: int, k: int, reach: int, depth_um: float) -> None:
    """Let the edge of packed ray `k` and `reach` neighbours on either side recede by a crater's mean depth.

    That is a fraction of a um, right on average; the next window traces the edge as it really is.
    """
    count, n_rays, ray = a.facing[s], a.ray_cosine.shape[0], a.ray[s, k]
    for aside in range(-reach, reach + 1):
        j, r = k + aside, ray + aside  # wrapped by hand: division is dear here
        j += count if j < 0 else 0
        j -= count if j >= count else 0
        r += n_rays if r < 0 else 0
        r -= n_rays if r >= n_rays else 0
        if a.ray[s, j] == r:
            a.distance[s, j] += depth_um


@compiled
def gap_of(a: Arrays, position: Array, s: int, k: int) -> float:
    """Gap of packed ray `k` where the wire is now."""
    return np.float64(
        a.distance[s, k]
        - (position[s, 0] - a.reference_um[s, 0]) * a.cosine[s, k]
        - (position[s, 1] - a.reference_um[s, 1]) * a.sine[s, k]
    )


@compiled
def narrowest(a: Arrays, position: Array, s: int) -> tuple[int, float]:
    """Packed ray with the smallest gap in a slice, and that gap; (0, `NO_METAL_UM`) if none faces metal."""
    best, place = NO_METAL_UM, 0
    for k in range(a.facing[s]):
        gap = gap_of(a, position, s, k)
        if gap < best:
            best, place = gap, k
    return place, best
