"""The rays that face metal: traced from where the wire is, receding with every crater."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import compiled
from edmsim.compiled.vectors import load, passed, spread, total
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.plant.gap.rays import Rays, arc, face, narrowest, turned
from edmsim.plant.kernel.state import NO_METAL_UM, Array, Arrays, Constants
from edmsim.plant.workpiece.kerf_field import metal_height, trace

OVERLAP_UM = 8.0
"""How far inside the wire's surface a ray begins, so that overlap with metal is seen."""
AHEAD_UM = 6.0
"""A known edge is looked for again from this far before where it is expected (metal only recedes)."""
KNOWN_MOVE_UM = 20.0
"""Known edges are of use only while the wire moved less than this since."""
BARE_UM = np.float32(0.5 * NO_METAL_UM)
"""A gap beyond this is that of a ray that meets no metal."""
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
    for at in arc(rays, s):
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
