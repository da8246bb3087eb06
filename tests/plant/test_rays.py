"""The arc of rays that faces metal has every ray that meets metal once, from any first ray on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.compiled.vectors import EACH, GAPS, filled, packed_lanes
from edmsim.plant.gap.rays import Rays, face, narrowest, pack_rays, packed_lane
from edmsim.plant.kernel.state import NO_METAL_UM

COUNT, RANGE_UM = 22, 80.0
ANGLE = 2 * np.pi * np.arange(COUNT) / COUNT
edges = st.lists(st.one_of(st.just(NO_METAL_UM), st.floats(-5.0, 79.0, width=32)), min_size=COUNT, max_size=COUNT)


def laid_out(edge_um):
    """Two slices, the second with these edges."""
    laid = np.zeros((3, 2, filled(COUNT, GAPS)), np.float32)
    packed = np.zeros((3, 1, packed_lanes(COUNT)), np.float32)
    laid[0] = NO_METAL_UM
    rays = Rays(*laid, *np.full((3, 2), -1), *packed, np.full(1, -1))
    table = np.array([np.full(COUNT, NO_METAL_UM), edge_um], np.float32)
    for s in range(2):
        face(rays, s, table, RANGE_UM, np.cos(ANGLE), np.sin(ANGLE))
    pack_rays(rays)
    return rays, table[1]


@pytest.mark.slow
@given(edges)
def test_the_arc_has_every_ray_that_meets_metal_once(edge_um):
    rays, edge = laid_out(edge_um)
    assert rays.blocks[0] == rays.unbroken[0] == 0  # no metal, no arc
    assert 0 <= rays.first[1] < COUNT
    arc = slice(0, rays.blocks[1] * GAPS)
    faces = rays.distance[1, arc] < RANGE_UM
    ray = (rays.first[1] + np.flatnonzero(faces)) % COUNT
    np.testing.assert_array_equal(np.sort(ray), np.flatnonzero(edge < RANGE_UM))
    np.testing.assert_array_equal(rays.distance[1, arc][faces], edge[ray])
    np.testing.assert_allclose(rays.cosine[1, arc][faces], np.cos(ANGLE[ray]), atol=1e-6)
    np.testing.assert_allclose(rays.sine[1, arc][faces], np.sin(ANGLE[ray]), atol=1e-6)
    assert (rays.distance[1, rays.blocks[1] * GAPS :] == NO_METAL_UM).all()
    assert not np.hypot(rays.cosine[1], rays.sine[1])[rays.distance[1] == NO_METAL_UM].any()
    lanes = [packed_lane(1, place) for place in range(COUNT)]
    both = (rays.distance, rays.packed_gap), (rays.cosine, rays.packed_cosine), (rays.sine, rays.packed_sine)
    for of_slice, of_pack in both:
        np.testing.assert_array_equal(of_slice[1, :COUNT], of_pack[0, lanes])
    # no metal in other slices, nor in the last lane
    elsewhere = np.setdiff1d(np.arange(rays.packed_gap.shape[1]), lanes)
    assert (rays.packed_gap[0, elsewhere] == NO_METAL_UM).all()
    assert (rays.packed_gap[0, rays.packed_blocks[0] * GAPS :] == NO_METAL_UM).all()
    assert rays.unbroken[1] in (0, len(ray))
    assert (rays.unbroken[1] > 0) == (len(ray) > 0 and faces[: len(ray)].all())


@given(st.integers(0, COUNT - 1), st.integers(1, COUNT))
def test_the_arc_is_no_longer_than_it_must_be(first, length):
    edge = np.full(COUNT, NO_METAL_UM)
    edge[(first + np.arange(length)) % COUNT] = 20.0
    rays, _ = laid_out(edge)
    assert rays.blocks[1] == -(-length // GAPS)
    assert rays.packed_blocks[0] == -(-length // EACH)


@pytest.mark.slow
@given(edges, st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_the_narrowest_gap_is_found_where_it_is(edge_um, x, y):
    rays, edge = laid_out(edge_um)
    gaps = np.where(edge < RANGE_UM, edge - x * np.cos(ANGLE) - y * np.sin(ANGLE), NO_METAL_UM)
    place, gap = narrowest(rays, 1, np.float32(x), np.float32(y))
    assert abs(gap - gaps.min()) < 1e-3
    if gap < RANGE_UM:
        assert abs(gaps[(rays.first[1] + place) % COUNT] - gaps.min()) < 1e-3
    assert narrowest(rays, 0, np.float32(x), np.float32(y))[1] == NO_METAL_UM
