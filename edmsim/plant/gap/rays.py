"""The rays of a slice: distances from the wire to the metal all around it, traced, and receding with every crater."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edmsim.compiled.jit import compiled
from edmsim.compiled.vectors import EACH, GAPS, PACK, filled, least, load, packed_lanes, passed, spread, total
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.plant.kernel.state import NO_METAL_UM, Array, Arrays, Constants
from edmsim.plant.workpiece.kerf_field import metal_height, trace


class Rays(NamedTuple):
    """Rays of every slice, in order of angle from the first of the arc on that *faces* metal."""

    # a ray that meets no metal takes no part in anything, so the loop works on that arc only, in blocks of
    # `vectors.GAPS`; the arrays are filled up to whole blocks. For the sums of every pulse the same rays are there a
    # second time, packed: those of five slices in one block, so that few lanes are bare and the slices' sums are
    # added up together
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


_PACK, _EACH, _OTHERS = np.uint64(PACK), np.uint64(EACH), np.uint64(GAPS - EACH)  # unsigned: divisions cost half


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
def facing_blocks(rays: Rays, s: int) -> range:
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
    for at in facing_blocks(rays, s):
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
    laid = np.zeros((3, 1, filled(count, GAPS)), np.float32)
    packed = np.zeros((3, 1, packed_lanes(count)), np.float32)
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


OVERLAP_UM = 8.0  # how far inside the wire's surface a ray begins, so that overlap with metal is seen
AHEAD_UM = 6.0  # a known edge is looked for again from this far before where it is expected (metal only recedes)
KNOWN_MOVE_UM = 20.0  # known edges are of use only while the wire moved less than this since
BARE_UM = np.float32(0.5 * NO_METAL_UM)  # a gap beyond this is that of a ray that meets no metal
BLIND_PULSES = 32 * WINDOW_PULSES
"""Pulses until a ray that met no metal is traced again: what comes within its range at the feed of
such a machine is then still far away."""


@compiled
def _trace_ray(
    a: Arrays, tiles: NDArray[np.uint16], index: NDArray[np.int32], c: Constants, s: int, r: int, expected_um: float
) -> float:
    """Gap of one ray, looked for from shortly before where it is expected, from the wire on if there is no edge."""
    cosine, sine = a.reach_x[r], a.reach_y[r]
    x, y = a.reference_um[0, s], a.reference_um[1, s]
    least = c.radius_um - OVERLAP_UM
    # metal only recedes: begin shortly before the edge that is known
    start = max(least, c.radius_um + expected_um - AHEAD_UM)
    end = c.radius_um + c.range_um
    edge = trace(tiles, index, s, c.cell_um, x, y, cosine, sine, start, end)
    if edge <= start and start > least:  # metal where it begins: the edge lies nearer
        edge = trace(tiles, index, s, c.cell_um, x, y, cosine, sine, least, end)
    return edge if edge == NO_METAL_UM else edge - c.radius_um


@compiled
def rays_of(a: Arrays) -> Rays:
    """Look at what the loop sees of the rays."""
    return Rays(
        a.distance, a.cosine, a.sine, a.first, a.blocks, a.unbroken,
        a.packed_gap, a.packed_cosine, a.packed_sine, a.packed_blocks,
    )  # fmt: skip


@compiled
def meets_metal(a: Arrays, c: Constants, s: int, r: int) -> bool:
    """Whether a ray met metal when it was traced."""
    return bool(a.edge_um[s, r] < c.range_um)


@compiled
def tilt_rays(a: Arrays, slope_x: float, slope_y: float) -> None:
    """Turn the rays into the plane square to a wire that leans by so much per height."""
    rise2 = slope_x * slope_x + slope_y * slope_y
    upright = 1.0 / math.sqrt(1.0 + rise2)
    a.upright[0] = upright
    # along the lean, a way in the slice's plane is 1 / cos of that square to the wire
    longer = (1.0 / upright - 1.0) / rise2 if rise2 > 0.0 else 0.0
    shorter = (1.0 - upright) / rise2 if rise2 > 0.0 else 0.0
    for r in range(a.ray_cosine.shape[0]):
        along = a.ray_cosine[r] * slope_x + a.ray_sine[r] * slope_y
        a.reach_x[r] = a.ray_cosine[r] + longer * along * slope_x
        a.reach_y[r] = a.ray_sine[r] + longer * along * slope_y
        a.across_x[r] = a.ray_cosine[r] - shorter * along * slope_x
        a.across_y[r] = a.ray_sine[r] - shorter * along * slope_y


@compiled
def retrace(
    a: Arrays, tiles: NDArray[np.uint16], index: NDArray[np.int32], c: Constants, place: Array, turn: int
) -> None:
    """Trace the rays from the place (2, slices) the wire swings around, and store those that meet metal."""
    rays, blind_turns = rays_of(a), np.uint64(max(BLIND_PULSES // c.trace_pulses, 1))
    for s in range(a.shape.shape[0]):
        dx, dy = place[0, s] - a.reference_um[0, s], place[1, s] - a.reference_um[1, s]
        known = math.hypot(dx, dy) < KNOWN_MOVE_UM
        a.reference_um[0, s], a.reference_um[1, s] = place[0, s], place[1, s]
        for r in range(a.ray_cosine.shape[0]):
            expected = -OVERLAP_UM
            if known:
                if meets_metal(a, c, s, r):
                    # to first order the gap changes by the part of the motion along the ray
                    expected = a.edge_um[s, r] - dx * a.across_x[r] - dy * a.across_y[r]
                # a ray without metal waits its turn, each ray at another one
                elif np.uint64(turn + r) % blind_turns != 0:
                    continue
            a.edge_um[s, r] = _trace_ray(a, tiles, index, c, s, r, expected)
        face(rays, s, a.edge_um, c.range_um, a.across_x, a.across_y)


@compiled
def weigh(a: Arrays, index: NDArray[np.int32], levels: NDArray[np.float32], c: Constants) -> None:
    """Find how high the metal is that the rays have met, and its mean over each slice, by the square of nearness."""
    inside = c.radius_um + 0.5 * c.cell_um  # so far behind the edge there is metal
    for s in range(a.shape.shape[0]):
        sum_ = weights = 0.0
        for r in range(a.ray_cosine.shape[0]):
            if meets_metal(a, c, s, r):
                reach = np.float64(a.edge_um[s, r]) + inside
                x, y = a.reference_um[0, s] + reach * a.reach_x[r], a.reference_um[1, s] + reach * a.reach_y[r]
                a.ray_metal[s, r] = metal_height(index, levels, s, c.cell_um, x, y)
                near = 1.0 / max(np.float64(a.edge_um[s, r]), 1.0)
                sum_ += near * near * a.ray_metal[s, r]
                weights += near * near
        a.metal[s] = sum_ / weights if weights > 0.0 else 1.0
        for side in range(2):
            a.entering[side, s] = a.flow_share[side, s] / a.metal[s]


@compiled
def closed_side(a: Arrays, s: int) -> tuple[float, float, float]:
    """Share of the wire's girth that metal faces in a slice, and the direction to it: 1 long for a half circle."""
    rays = rays_of(a)
    facing, x, y = 0, spread(np.float32(0.0)), spread(np.float32(0.0))
    for at in facing_blocks(rays, s):
        facing += passed(load(rays.distance, (s, at)), BARE_UM)
        x += load(rays.cosine, (s, at))
        y += load(rays.sine, (s, at))
    per_ray = 1.0 / a.ray_cosine.shape[0]
    return facing * per_ray, math.pi * per_ray * total(x), math.pi * per_ray * total(y)


@compiled
def ray_at(a: Arrays, s: int, place: int) -> int:
    """Ray, counted from +x, at a place of the arrays of `rays.Rays`."""
    return turned(a.first[s], place, a.ray_cosine.shape[0])


@compiled
def place_of(a: Arrays, s: int, r: int) -> int:
    """Place of a ray, the other way."""
    return turned(r, -a.first[s], a.ray_cosine.shape[0])


@compiled
def gap_of(a: Arrays, position: Array, s: int, place: int) -> float:
    """Gap of the ray at a place where the wire is now."""
    return np.float64(
        a.distance[s, place]
        - (position[0, s] - a.reference_um[0, s]) * a.cosine[s, place]
        - (position[1, s] - a.reference_um[1, s]) * a.sine[s, place]
    )


@compiled
def moved(a: Arrays, position: Array, s: int) -> tuple[np.float32, np.float32]:
    """How far a slice's wire has moved from where its rays were traced."""
    return np.float32(position[0, s] - a.reference_um[0, s]), np.float32(position[1, s] - a.reference_um[1, s])


@compiled
def narrowest_now(a: Arrays, position: Array, s: int) -> tuple[int, float]:
    """Place of the smallest gap in a slice where the wire is now, and that gap; see `rays.narrowest`."""
    sx, sy = moved(a, position, s)
    return narrowest(rays_of(a), s, sx, sy)
