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
"""A known edge is looked for again from this far before where it is expected (metal only recedes)."""
KNOWN_MOVE_UM = 20.0
"""Known edges are of use only while the wire moved less than this since."""
BLIND_TURNS = np.uint64(4)
"""A ray that met no metal is looked along again only every so many windows: what comes within its range at the
feed of such a machine is then still far away."""
_GAP_PARTS, _PLACES = 4096.0, 256
"""`narrowest` compares gaps in parts of a um, and counts packed rays (at most 128) below that."""


@compiled
def _trace_ray(
    a: Arrays, tiles: NDArray[np.uint16], index: NDArray[np.int32], c: Constants, s: int, r: int, expected_um: float
) -> float:
    """Gap of one ray, looked for from shortly before where it is expected, from the wire on if there is no edge."""
    cosine, sine = a.ray_cosine[r], a.ray_sine[r]
    x, y = a.reference_um[0, s], a.reference_um[1, s]
    least = c.radius_um - OVERLAP_UM
    start = max(least, c.radius_um + expected_um - AHEAD_UM)
    end = c.radius_um + c.range_um
    edge = trace(tiles, index, s, c.cell_um, x, y, cosine, sine, start, end)
    if edge <= start and start > least:  # metal where it begins: the edge lies nearer
        edge = trace(tiles, index, s, c.cell_um, x, y, cosine, sine, least, end)
    return edge if edge == NO_METAL_UM else edge - c.radius_um


@compiled
def _pack(a: Arrays, c: Constants, s: int) -> None:
    """Pack the rays of a slice that meet metal, and fill up to whole lanes."""
    k = 0
    for r in range(a.ray_cosine.shape[0]):
        a.place[s, r] = -1
        if a.edge_um[s, r] < c.range_um:
            a.ray[s, k] = r
            a.place[s, r] = k
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
    a: Arrays, tiles: NDArray[np.uint16], index: NDArray[np.int32], c: Constants, place: Array, turn: int
) -> None:
    """Trace the rays from the place (2, slices) the wire swings around, and pack those that meet metal.

    `turn` counts the windows. What the wire is away from there shifts the gaps to first order.
    """
    for s in range(a.shape.shape[0]):
        dx, dy = place[0, s] - a.reference_um[0, s], place[1, s] - a.reference_um[1, s]
        known = math.hypot(dx, dy) < KNOWN_MOVE_UM
        a.reference_um[0, s], a.reference_um[1, s] = place[0, s], place[1, s]
        for r in range(a.ray_cosine.shape[0]):
            expected = -OVERLAP_UM
            if known:
                if a.edge_um[s, r] < c.range_um:
                    expected = a.edge_um[s, r] - dx * a.ray_cosine[r] - dy * a.ray_sine[r]
                elif np.uint64(turn + r) % BLIND_TURNS != 0:
                    continue
            a.edge_um[s, r] = _trace_ray(a, tiles, index, c, s, r, expected)
        _pack(a, c, s)


@compiled
def gap_of(a: Arrays, position: Array, s: int, k: int) -> float:
    """Gap of packed ray `k` where the wire is now."""
    return np.float64(
        a.distance[s, k]
        - (position[0, s] - a.reference_um[0, s]) * a.cosine[s, k]
        - (position[1, s] - a.reference_um[1, s]) * a.sine[s, k]
    )


@compiled
def narrowest(a: Arrays, position: Array, s: int) -> tuple[int, float]:
    """Packed ray with the smallest gap in a slice, and that gap; (0, `NO_METAL_UM`) if none faces metal.

    Gap and place are packed into one whole number, whose minimum is found in one vectorised pass; that of a
    floating-point number and its place is not.
    """
    sx, sy = np.float32(position[0, s] - a.reference_um[0, s]), np.float32(position[1, s] - a.reference_um[1, s])
    least = int(NO_METAL_UM * _GAP_PARTS) * _PLACES
    for k in range(a.facing[s]):
        gap = a.distance[s, k] - sx * a.cosine[s, k] - sy * a.sine[s, k]
        least = min(least, int(gap * np.float32(_GAP_PARTS)) * _PLACES + k)
    k = least % _PLACES
    return k, gap_of(a, position, s, k) if a.facing[s] > 0 else NO_METAL_UM
