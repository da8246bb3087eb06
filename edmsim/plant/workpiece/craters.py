"""Craters: the metal that a discharge removes.

A crater's area in the metal of its slice is divided among the rays in its width, whose edges recede at once. The
field is carved ray by ray before the next tracing, so a cell is read once for all discharges since the last one.
"""

import math

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.elementary import inverse_cube_root
from edmsim.compiled.jit import compiled, compiled_apart
from edmsim.plant.gap.rays import BARE_UM, gap_of, pack_of, packed_lane, place_of, ray_at, turned
from edmsim.plant.kernel.state import Array, Arrays, Constants
from edmsim.plant.workpiece.kerf_field import FULL, carve_wall

CARVE_BEYOND_UM = 48.0  # distance behind a ray's edge in which its wall is searched
MOST_PARTS = 1e12  # more parts than any wall has, without overflow in products
LEVEL_UM = 6.0  # distance from the wire over which discharges between two rays become rarer by a factor e (ours)


@compiled
def crater_diameter(volume: float, c: Constants) -> float:
    """Return the diameter in um of a half-ellipsoid crater: V = 2/3 area depth, depth = flatness diameter."""
    return 1.0 / inverse_cube_root(volume * c.crater_cube)


@compiled
def _section(x: float, reach: float, curve: float) -> float:
    """Return a crater's area from its middle to `x` over its mean depth, in ray spacings; curve = 1 / (3 reach^2)."""
    # the depth of a half ellipsoid, averaged over the slice's height, is ``1.5 (1 - (x / reach)^2)`` of the mean
    # depth
    inside = min(max(x, -reach), reach)
    return 1.5 * (inside - inside * inside * inside * curve)


@compiled
def _metal_covered(a: Arrays, s: int, middle: int, span: int, jitter: float, reach: float, curve: float) -> float:
    """Return the metal that a crater covers in ray spacings, from its middle ray and `span` rays on each side."""
    # far from rays without metal, all of it is metal
    if middle >= span and middle + span < a.unbroken[s]:
        return 2.0 * reach
    before, covered = -reach, 0.0
    for aside in range(-span, span + 1):
        after = _section(aside + 0.5 - jitter, reach, curve)
        if a.distance[s, turned(middle, aside, a.ray_cosine.shape[0])] < BARE_UM:
            covered += after - before
        before = after
    return covered


@compiled_apart
def distribute_crater(
    a: Arrays, c: Constants, position: Array, s: int, middle: int, volume: float, jitter: float
) -> bool:
    """Divide a crater of `volume` um3 among the rays in its width, whose edges recede by its mean depth."""
    # `jitter` (-0.5..0.5 ray spacings) makes many craters cover the wall evenly. Returns False if there is no metal.
    if volume <= 0.0:
        return False
    n_rays = a.ray_cosine.shape[0]
    spacing = (c.radius_um + gap_of(a, position, s, middle)) * (2.0 * math.pi / n_rays)
    # inverse of half the crater's diameter in ray spacings
    per_reach = max(2.0 * spacing / crater_diameter(volume, c), 1.0 / (0.25 * n_rays - 1.0))
    reach, curve = 1.0 / per_reach, per_reach * per_reach * (1.0 / 3.0)
    if not reach > 0.0:  # the position of the wire is not finite
        return False
    span = int(reach) + 1
    covered = _metal_covered(a, s, middle, span, jitter, reach, curve)
    if covered <= 0.0:
        return False
    metal = np.float64(a.ray_metal[s, ray_at(a, s, middle)])
    # mean depth: volume over the height of metal and the width on metal
    depth = volume / (c.slice_um * metal * spacing * covered)
    before = -reach
    for aside in range(-span, span + 1):
        place = turned(middle, aside, n_rays)
        after = _section(aside + 0.5 - jitter, reach, curve)
        deep, before = depth * (after - before), after
        if a.distance[s, place] < BARE_UM:
            # the edge recedes at once; the field is carved before the next tracing
            a.distance[s, place] += np.float32(deep)
            a.packed_gap[pack_of(s), packed_lane(s, place)] = a.distance[s, place]
            area = deep * spacing
            if metal != 1.0:  # multiplying always would change the rounding in other cuts
                area *= metal
            a.pending_um2[s, place] += area
    return True


@compiled
def _carve_ray(
    a: Arrays, tiles: NDArray[np.uint16], index: NDArray[np.int32], c: Constants, s: int, r: int, parts: int,
    aside: float, rows: Array,
) -> int:
    """Remove `parts` from a ray's wall, shifted by `aside` ray spacings; return the parts that were not found."""
    near = c.radius_um + np.float64(a.edge_um[s, r])
    width = near * (2.0 * math.pi / a.ray_cosine.shape[0])
    cosine, sine = a.across_x[r], a.across_y[r]
    x, y = a.reference_um[0, s], a.reference_um[1, s]
    if a.upright[0] != 1.0:  # in the slice's plane the wall is not perpendicular to the ray
        width /= a.upright[0]
        x += near * (a.reach_x[r] - cosine)
        y += near * (a.reach_y[r] - sine)
    return carve_wall(
        tiles, index, s, c.cell_um, x - aside * width * sine, y + aside * width * cosine, cosine, sine, near,
        c.carve_before_um, LEVEL_UM, CARVE_BEYOND_UM, width, parts, rows,
    )


@compiled
def carve(
    a: Arrays, tiles: NDArray[np.uint16], index: NDArray[np.int32], c: Constants, aside: float, rows: Array
) -> float:
    """Carve the craters of the rays from the field; return the volume in um3 that found no metal."""
    # `aside` (-0.5..0.5 ray spacings) shifts all strips, so that no ridge remains between two rays
    part = c.cell_um**2 / FULL
    missed = 0.0
    for s in range(a.shape.shape[0]):
        for r in range(a.ray_cosine.shape[0]):
            place = place_of(a, s, r)
            if a.pending_um2[s, place] > 0.0:
                metal = np.float64(a.ray_metal[s, r])
                area = a.pending_um2[s, place] + a.carry_um2[s]
                if metal != 1.0:  # dividing always would change the rounding in other cuts
                    area /= metal
                a.pending_um2[s, place] = 0.0
                parts = max(0, int(min(area / part, MOST_PARTS)))
                # the field has whole parts; the rest is kept for the slice
                a.carry_um2[s] = area - parts * part
                left = 0
                if parts != 0:
                    left = _carve_ray(a, tiles, index, c, s, r, parts, aside, rows)
                if metal != 1.0:
                    a.carry_um2[s] *= metal
                if left > 0:
                    # metal that was not found did not become debris
                    lost = left * part * c.slice_um * metal
                    a.debris[s] = max(0.0, a.debris[s] - lost / (c.cavity_um3 * a.metal[s]))
                    missed += lost
    return missed
