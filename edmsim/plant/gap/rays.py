"""The rays of a slice: distances from the wire to the metal, all around the wire."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edmsim.compiled.jit import compiled
from edmsim.compiled.vectors import EACH, GAPS, PACK, filled, least, load, packed_lanes
from edmsim.plant.kernel.state import NO_METAL_UM


class Rays(NamedTuple):
    """Rays of every slice, in order of angle from the first of the arc on that *faces* metal.

    A ray that meets no metal takes no part in anything, so the loop works on that arc only, in blocks of
    `vectors.GAPS`; the arrays are filled up to whole blocks. For the sums of every pulse the same rays are there a
    second time, packed: those of five slices in one block, so that few lanes are bare and the slices' sums are added
    up together.
    """

    # (slices, places): gap in um from where they were traced; `NO_METAL_UM` for one that meets no metal
    distance: NDArray[np.float32]
    # (slices, places): direction; 0 for one that meets no metal
    cosine: NDArray[np.float32]
    sine: NDArray[np.float32]
    # (slices,): first ray of the arc, and how many blocks it has
    first: NDArray[np.int64]
    blocks: NDArray[np.int64]
    unbroken: NDArray[np.int64]  # (slices,): rays of the arc if all of them meet metal, otherwise 0
    # (packs of slices, lanes): the first three above, `EACH` places of every slice in a block
    packed_gap: NDArray[np.float32]
    packed_cosine: NDArray[np.float32]
    packed_sine: NDArray[np.float32]
    packed_blocks: NDArray[np.int64]  # (packs of slices,)


@compiled
def places(rays: int) -> int:
    """Places of the arrays for a number of rays: whole vectors."""
    return filled(rays, GAPS)


_PACK, _EACH, _OTHERS = np.uint64(PACK), np.uint64(EACH), np.uint64(GAPS - EACH)
"""Unsigned: divisions by them cost half."""


@compiled
def pack_of(s: int) -> int:
    """Pack that a slice belongs to."""
    return int(np.uint64(s) // _PACK)


@compiled
def packed_lane(s: int, place: int) -> int:
    """Lane in its pack of a slice's ray at a place."""
    block = np.uint64(place) // _EACH
    return int(np.uint64(place) + block * _OTHERS + np.uint64(s) % _PACK * _EACH)


@compiled
def arc(rays: Rays, s: int) -> range:
    """Places of the blocks of a slice's rays that face metal."""
    return range(0, rays.blocks[s] * GAPS, GAPS)


@compiled
def gaps_of(rays: Rays, s: int, at: int, shift_x: np.float32, shift_y: np.float32) -> Any:
    """Gaps of a block of a slice's rays from a place on, the wire having moved by `shift` since they were traced."""
    across = load(rays.cosine, (s, at)) * shift_x + load(rays.sine, (s, at)) * shift_y
    return load(rays.distance, (s, at)) - across


@compiled
def narrowest(rays: Rays, s: int, shift_x: np.float32, shift_y: np.float32) -> tuple[int, float]:
    """Place of the smallest gap in a slice, and that gap; `NO_METAL_UM` if no ray faces metal."""
    place, gap = 0, np.float32(NO_METAL_UM)
    for at in arc(rays, s):
        smallest, lane = least(gaps_of(rays, s, at, shift_x, shift_y))
        if smallest < gap:
            place, gap = at + lane, smallest
    return place, float(gap)


@compiled
def turned(ray: int, by: int, count: int) -> int:
    """``(ray + by) mod count``, for a `by` of less than a turn either way."""
    ray += by
    if ray >= count:
        ray -= count
    elif ray < 0:
        ray += count
    return ray


@compiled
def face(rays: Rays, s: int, edge_um: NDArray[np.float32], range_um: float, ray_cosine: Any, ray_sine: Any) -> None:
    """Lay out a slice's rays as they were traced: edges (slices, rays) within a range are metal."""
    count = edge_um.shape[1]
    run, longest, met = 0, 0, 0
    after = 0  # the ray after the longest run of rays that meet no metal
    # twice around, so that a run over ray 0 is found whole
    for k in range(2 * count):
        if edge_um[s, k if k < count else k - count] < range_um:
            run = 0
            met += 1
        else:
            run += 1
            if run > longest:
                longest, after = run, k + 1
    # begin behind the longest bare run: rays that face metal then lie together, in few blocks
    faced = max(0, count - longest)
    rays.first[s] = after % count
    rays.blocks[s] = (faced + GAPS - 1) // GAPS
    rays.unbroken[s] = faced if met == 2 * faced else 0
    for place in range(count):
        r = turned(rays.first[s], place, count)
        meets = edge_um[s, r] < range_um
        rays.distance[s, place] = edge_um[s, r] if meets else np.float32(NO_METAL_UM)
        rays.cosine[s, place] = ray_cosine[r] if meets else 0.0
        rays.sine[s, place] = ray_sine[r] if meets else 0.0


@compiled
def pack_rays(rays: Rays) -> None:
    """Pack the rays of every slice for a window, in which craters change the gaps in both places."""
    slices, width = rays.distance.shape
    for pack in range(rays.packed_gap.shape[0]):
        faced = 0  # blocks that the slice with the widest arc needs
        for block in range(rays.packed_gap.shape[1] // GAPS):
            for k in range(GAPS):
                s, place, lane = pack * PACK + k // EACH, block * EACH + k % EACH, block * GAPS + k
                # slices beyond the last one meet no metal, nor does the last lane
                there = k < PACK * EACH and s < slices and place < width
                gap = rays.distance[s, place] if there else np.float32(NO_METAL_UM)
                rays.packed_gap[pack, lane] = gap
                rays.packed_cosine[pack, lane] = rays.cosine[s, place] if there else 0.0
                rays.packed_sine[pack, lane] = rays.sine[s, place] if there else 0.0
                if gap < NO_METAL_UM:
                    faced = block + 1
        rays.packed_blocks[pack] = faced


def rays_with(gaps_um: ArrayLike, angles: ArrayLike) -> Rays:
    """Rays of one slice with given gaps in um, along given angles in rad, all of which meet metal."""
    count = np.size(gaps_um)
    laid, packed = np.zeros((3, 1, places(count)), np.float32), np.zeros((3, 1, packed_lanes(count)), np.float32)
    laid[0] = NO_METAL_UM
    laid[:, 0, :count] = np.stack(np.broadcast_arrays(gaps_um, np.cos(angles), np.sin(angles)))
    first, blocks, unbroken, packed_blocks = np.array([[0], [-(-count // GAPS)], [count], [0]])
    distance, cosine, sine = laid
    packed_gap, packed_cosine, packed_sine = packed
    rays = Rays(
        distance, cosine, sine, first, blocks, unbroken, packed_gap, packed_cosine, packed_sine, packed_blocks
    )
    pack_rays(rays)
    return rays
