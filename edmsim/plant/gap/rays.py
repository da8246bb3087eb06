"""The rays of a slice: distances from the wire to the metal around it, traced and then increased by craters."""

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
    """Rays of every slice in order of angle, beginning at the first ray of the arc that *faces* metal."""

    # Rays without metal have no effect, so the loop works on this arc only, in blocks of `vectors.GAPS`; the arrays
    # are padded to whole blocks. For the sums of every pulse there is a packed copy of the rays, with five slices in
    # a block: few lanes are unused, and the sums of the slices are added together.
    # (slices, places): gap in um when traced; `NO_METAL_UM` without metal
    distance: NDArray[np.float32]
    # (slices, places): direction; 0 without metal
    cosine: NDArray[np.float32]
    sine: NDArray[np.float32]
    # (slices,): first ray of the arc, and its number of blocks
    first: NDArray[np.int64]
    blocks: NDArray[np.int64]
    unbroken: NDArray[np.int64]  # (slices,): number of rays of the arc if all meet metal, otherwise 0
    # (packs of slices, lanes): copies of the first three, `EACH` places of every slice in a block
    packed_gap: NDArray[np.float32]
    packed_cosine: NDArray[np.float32]
    packed_sine: NDArray[np.float32]
    packed_blocks: NDArray[np.int64]  # (packs of slices,)


_PACK, _EACH, _OTHERS = np.uint64(PACK), np.uint64(EACH), np.uint64(GAPS - EACH)  # unsigned divisions are faster


@compiled
def pack_of(s: int) -> int:
    """Return the pack of a slice."""
    return int(np.uint64(s) // _PACK)


@compiled
def packed_lane(s: int, place: int) -> int:
    """Return the lane of a slice's ray in its pack, by its place."""
    block = np.uint64(place) // _EACH
    return int(np.uint64(place) + block * _OTHERS + np.uint64(s) % _PACK * _EACH)


@compiled
def facing_blocks(rays: Rays, s: int) -> range:
    """Return the first places of the blocks of a slice's arc."""
    return range(0, rays.blocks[s] * GAPS, GAPS)


@compiled
def gaps_of(rays: Rays, s: int, at: int, shift_x: np.float32, shift_y: np.float32) -> Any:
    """Return the gaps of a block of rays, starting at a place, after a motion of the wire since they were traced."""
    across = load(rays.cosine, (s, at)) * shift_x + load(rays.sine, (s, at)) * shift_y
    return load(rays.distance, (s, at)) - across


@compiled
def narrowest(rays: Rays, s: int, shift_x: np.float32, shift_y: np.float32) -> tuple[int, float]:
    """Return the place of the smallest gap in a slice, and the gap; `NO_METAL_UM` if no ray meets metal."""
    place, gap = 0, np.float32(NO_METAL_UM)
    for at in facing_blocks(rays, s):
        smallest, lane = least(gaps_of(rays, s, at, shift_x, shift_y))
        if smallest < gap:
            place, gap = at + lane, smallest
    return place, float(gap)


@compiled
def turned(ray: int, by: int, count: int) -> int:
    """Return ``(ray + by) mod count`` for `by` within less than a turn."""
    ray += by
    if ray >= count:
        ray -= count
    elif ray < 0:
        ray += count
    return ray


@compiled
def face(rays: Rays, s: int, edge_um: NDArray[np.float32], range_um: float, ray_cosine: Any, ray_sine: Any) -> None:
    """Store a slice's traced rays in order; those whose edge is within the range meet metal."""
    count = edge_um.shape[1]
    run, longest, met = 0, 0, 0
    after = 0  # the ray after the longest run of rays without metal
    # two turns, because a run may contain ray 0
    for k in range(2 * count):
        if edge_um[s, k if k < count else k - count] < range_um:
            run = 0
            met += 1
        else:
            run += 1
            if run > longest:
                longest, after = run, k + 1
    # beginning after the longest run without metal, the arc needs the fewest blocks
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
    """Copy the rays of every slice into packs for a window; craters then change both copies."""
    slices, width = rays.distance.shape
    for pack in range(rays.packed_gap.shape[0]):
        faced = 0  # number of blocks of the widest arc
        for block in range(rays.packed_gap.shape[1] // GAPS):
            for k in range(GAPS):
                s, place, lane = pack * PACK + k // EACH, block * EACH + k % EACH, block * GAPS + k
                # slices beyond the last one, and the last lane, have no metal
                there = k < PACK * EACH and s < slices and place < width
                gap = rays.distance[s, place] if there else np.float32(NO_METAL_UM)
                rays.packed_gap[pack, lane] = gap
                rays.packed_cosine[pack, lane] = rays.cosine[s, place] if there else 0.0
                rays.packed_sine[pack, lane] = rays.sine[s, place] if there else 0.0
                if gap < NO_METAL_UM:
                    faced = block + 1
        rays.packed_blocks[pack] = faced


def rays_with(gaps_um: ArrayLike, angles: ArrayLike) -> Rays:
    """Return the rays of one slice for gaps in um and angles in rad; all meet metal."""
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


OVERLAP_UM = 8.0  # depth inside the wire at which a ray begins, to detect overlap with metal
AHEAD_UM = 6.0  # tracing of a known edge starts this far before its expected place (metal only recedes)
KNOWN_MOVE_UM = 20.0  # greatest motion of the wire after which known edges are used
BARE_UM = np.float32(0.5 * NO_METAL_UM)  # greater gaps are those of rays without metal
BLIND_PULSES = 32 * WINDOW_PULSES
"""Pulses until a ray without metal is traced again: metal that comes into its range meanwhile is still far away."""


@compiled
def _trace_ray(
    a: Arrays, tiles: NDArray[np.uint16], index: NDArray[np.int32], c: Constants, s: int, r: int, expected_um: float
) -> float:
    """Trace one ray from shortly before its expected edge, or else from the wire; return the gap."""
    cosine, sine = a.reach_x[r], a.reach_y[r]
    x, y = a.reference_um[0, s], a.reference_um[1, s]
    least = c.radius_um - OVERLAP_UM
    # metal only recedes, so begin shortly before the known edge
    start = max(least, c.radius_um + expected_um - AHEAD_UM)
    end = c.radius_um + c.range_um
    edge = trace(tiles, index, s, c.cell_um, x, y, cosine, sine, start, end)
    if edge <= start and start > least:  # metal at the beginning: the edge is nearer
        edge = trace(tiles, index, s, c.cell_um, x, y, cosine, sine, least, end)
    return edge if edge == NO_METAL_UM else edge - c.radius_um


@compiled
def rays_of(a: Arrays) -> Rays:
    """Return the rays in the order of the loop."""
    return Rays(
        a.distance, a.cosine, a.sine, a.first, a.blocks, a.unbroken,
        a.packed_gap, a.packed_cosine, a.packed_sine, a.packed_blocks,
    )  # fmt: skip


@compiled
def meets_metal(a: Arrays, c: Constants, s: int, r: int) -> bool:
    """Return whether a ray met metal when it was traced."""
    return bool(a.edge_um[s, r] < c.range_um)


@compiled
def tilt_rays(a: Arrays, slope_x: float, slope_y: float) -> None:
    """Turn the rays into the plane perpendicular to a wire with a slope."""
    rise2 = slope_x * slope_x + slope_y * slope_y
    upright = 1.0 / math.sqrt(1.0 + rise2)
    a.upright[0] = upright
    # in the direction of the tilt, a length in the slice's plane is 1 / cos times that perpendicular to the wire
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
    """Trace the rays from the wire's position (2, slices), and store those that meet metal."""
    rays, blind_turns = rays_of(a), np.uint64(max(BLIND_PULSES // c.trace_pulses, 1))
    for s in range(a.shape.shape[0]):
        dx, dy = place[0, s] - a.reference_um[0, s], place[1, s] - a.reference_um[1, s]
        known = math.hypot(dx, dy) < KNOWN_MOVE_UM
        a.reference_um[0, s], a.reference_um[1, s] = place[0, s], place[1, s]
        for r in range(a.ray_cosine.shape[0]):
            expected = -OVERLAP_UM
            if known:
                if meets_metal(a, c, s, r):
                    # to first order the gap changes by the component of the motion along the ray
                    expected = a.edge_um[s, r] - dx * a.across_x[r] - dy * a.across_y[r]
                # rays without metal are traced in turn
                elif np.uint64(turn + r) % blind_turns != 0:
                    continue
            a.edge_um[s, r] = _trace_ray(a, tiles, index, c, s, r, expected)
        face(rays, s, a.edge_um, c.range_um, a.across_x, a.across_y)


@compiled
def weigh(a: Arrays, index: NDArray[np.int32], levels: NDArray[np.float32], c: Constants) -> None:
    """Find the height of the metal of every ray, and its mean over each slice, weighted by inverse squared gaps."""
    inside = c.radius_um + 0.5 * c.cell_um  # at this distance behind the edge there is metal
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
    """Return the share of the wire's circumference that faces metal, and a vector to it, of length 1 for one half."""
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
    """Return the number of the ray, counted from +x, at a place in the arrays of `rays.Rays`."""
    return turned(a.first[s], place, a.ray_cosine.shape[0])


@compiled
def place_of(a: Arrays, s: int, r: int) -> int:
    """Return the place of a ray: the inverse of `ray_at`."""
    return turned(r, -a.first[s], a.ray_cosine.shape[0])


@compiled
def gap_of(a: Arrays, position: Array, s: int, place: int) -> float:
    """Return the present gap of the ray at a place."""
    return np.float64(
        a.distance[s, place]
        - (position[0, s] - a.reference_um[0, s]) * a.cosine[s, place]
        - (position[1, s] - a.reference_um[1, s]) * a.sine[s, place]
    )


@compiled
def moved(a: Arrays, position: Array, s: int) -> tuple[np.float32, np.float32]:
    """Return the motion of a slice's wire since its rays were traced."""
    return np.float32(position[0, s] - a.reference_um[0, s]), np.float32(position[1, s] - a.reference_um[1, s])


@compiled
def narrowest_now(a: Arrays, position: Array, s: int) -> tuple[int, float]:
    """Return the place of the smallest gap in a slice at the wire's present position, and the gap."""
    sx, sy = moved(a, position, s)
    return narrowest(rays_of(a), s, sx, sy)
