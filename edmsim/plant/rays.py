"""The rays of a slice: how far it is from the wire to the metal, all around the wire."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .compiled import compiled
from .vectors import GAPS, least, load
from .workpiece import NO_METAL_UM


class Rays(NamedTuple):
    """Rays of every slice, in order of angle, twice around, so that an arc of them lies together in memory.

    A ray that meets no metal takes no part in anything, so the loop works on the arc that *faces* metal only, in
    blocks of `vectors.GAPS`.

    Attributes
    ----------
    distance : float32 (slices, 2 rays)
        Gap in um from where they were traced; `NO_METAL_UM` for one that meets no metal.
    cosine, sine : float32 (slices, 2 rays)
        Direction; 0 for one that meets no metal.
    first, blocks : int64 (slices,)
        First ray of the arc, and how many blocks it has.
    """

    distance: NDArray[np.float32]
    cosine: NDArray[np.float32]
    sine: NDArray[np.float32]
    first: NDArray[np.int64]
    blocks: NDArray[np.int64]


@compiled
def arc(rays: Rays, s: int) -> range:
    """Places of the blocks of a slice's rays that face metal."""
    return range(rays.first[s], rays.first[s] + rays.blocks[s] * GAPS, GAPS)


@compiled
def gaps_of(rays: Rays, s: int, at: int, shift_x: np.float32, shift_y: np.float32) -> Any:
    """Gaps of a block of a slice's rays from a place on, the wire having moved by `shift` since they were traced."""
    across = load(rays.cosine, (s, at)) * shift_x + load(rays.sine, (s, at)) * shift_y
    return load(rays.distance, (s, at)) - across


@compiled
def once_around(rays: Rays, place: int) -> int:
    """Ray at a place of the arrays, which go around twice."""
    count = rays.distance.shape[1] // 2
    return place - count if place >= count else place


@compiled
def narrowest(rays: Rays, s: int, shift_x: np.float32, shift_y: np.float32) -> tuple[int, float]:
    """Ray with the smallest gap in a slice, and that gap; `NO_METAL_UM` if none faces metal."""
    place, gap = rays.first[s], np.float32(NO_METAL_UM)
    for at in arc(rays, s):
        smallest, lane = least(gaps_of(rays, s, at, shift_x, shift_y))
        if smallest < gap:
            place, gap = at + lane, smallest
    return once_around(rays, place), float(gap)


@compiled
def face(rays: Rays, s: int, edge_um: NDArray[np.float32], range_um: float, ray_cosine: Any, ray_sine: Any) -> None:
    """Lay out a slice's rays as they were traced: edges (slices, rays) within a range are metal."""
    count = edge_um.shape[1]
    run, longest = 0, 0
    after = 0  # the ray after the longest run of rays that meet no metal
    for place in range(2 * count):
        r = once_around(rays, place)
        if edge_um[s, r] < range_um:
            rays.distance[s, place] = edge_um[s, r]
            rays.cosine[s, place], rays.sine[s, place] = ray_cosine[r], ray_sine[r]
            run = 0
        else:
            rays.distance[s, place] = NO_METAL_UM
            rays.cosine[s, place] = rays.sine[s, place] = 0.0
            run += 1
            if run > longest:
                longest, after = run, place + 1
    longest = min(longest, count)
    rays.first[s] = after % count
    rays.blocks[s] = (count - longest + GAPS - 1) // GAPS


def rays_with(gaps_um: ArrayLike, angles: ArrayLike) -> Rays:
    """Rays of one slice with given gaps in um, along given angles in rad, all of which meet metal."""
    blocks = -(-np.size(gaps_um) // GAPS)
    around = np.zeros((3, 1, 2, blocks * GAPS), np.float32)
    around[0] = NO_METAL_UM
    around[..., : np.size(gaps_um)] = np.reshape([gaps_um, np.cos(angles), np.sin(angles)], (3, 1, 1, -1))
    distance, cosine, sine = around.reshape(3, 1, -1)
    return Rays(distance, cosine, sine, np.zeros(1, np.int64), np.full(1, blocks))
