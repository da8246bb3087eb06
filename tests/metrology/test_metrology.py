"""Metrology against exact geometry: kerfs carved as swept discs, whose walls are known in closed form."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from shapely.geometry import LineString, MultiLineString, Polygon

from edmsim.errors import InputError
from edmsim.metrology.edges import contour as kerf_polygons
from edmsim.metrology.edges import cut_edges, filled
from edmsim.metrology.kerf import kerf_width, wall_error, width_stats
from edmsim.metrology.profile import corners, depth_in_blank, profile_error
from edmsim.metrology.roughness import ra_over_depth, roughness_um
from edmsim.plant.workpiece.kerf_field import FULL, TILE, KerfField, Stock
from edmsim.program.passes import CutPass
from edmsim.program.path import WireContour

RADIUS = 155.0
BLANK = Stock((1_000.0, 1_000.0, 9_000.0, 9_000.0))


def distance_to(path_um, x, y):
    """Distance of points from a path of straight moves."""
    nearest = np.full(x.shape, np.inf)
    for (ax, ay), (bx, by) in pairwise(path_um):
        dx, dy = bx - ax, by - ay
        share = np.clip(((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
        nearest = np.minimum(nearest, np.hypot(x - ax - share * dx, y - ay - share * dy))
    return nearest


def carve(field, path_um, radii_um):
    """Sweep a disc of one radius per slice along a path: cells lose the share of 20 x 20 points it covers."""
    line = LineString(path_um)
    for s in np.arange(0.0, line.length + 60.0, 60.0):
        field.allocate(*line.interpolate(s).coords[0], max(radii_um) + 60.0)
    cell, fine = field.cell_um, (np.arange(20) + 0.5) / 20 - 0.5
    dx, dy = (grid.ravel() * field.cell_um for grid in np.meshgrid(fine, fine))
    for tx, ty, place in field.tile_places():
        x, y = ((t * TILE + np.arange(TILE) + 0.5) * cell for t in (tx, ty))
        x, y = np.meshgrid(x, y, indexing="ij")
        distance = distance_to(path_um, x, y)
        for number, radius in enumerate(radii_um):
            covered = (distance < radius).astype(float)
            rim = np.abs(distance - radius) < cell
            fine_distance = distance_to(path_um, x[rim][:, None] + dx, y[rim][:, None] + dy)
            covered[rim] = (fine_distance < radius).mean(axis=1)
            tile = field.tiles[place, number]
            tile[:] = np.minimum(tile, np.round((1 - covered) * FULL))


def cut(path_um, radii_um=(RADIUS,), stock=BLANK):
    field = KerfField(len(radii_um), stock)
    carve(field, np.asarray(path_um, float), radii_um)
    return field


def make_contour(path_um, nominal_mm, part_side="left", closed=False, lead_in_moves=0):
    points = np.round(np.asarray(path_um, float)).astype(np.int64)
    return WireContour(points, lead_in_moves, np.asarray(nominal_mm, float), closed, part_side)


def straight(angle_deg=0.0, part_side="left", length=1_600.0, offset=RADIUS):
    """A straight contour from (4, 4) mm, the part's edge at `offset` beside the wire's path."""
    angle = math.radians(angle_deg)
    along = np.array([math.cos(angle), math.sin(angle)])
    left = np.array([-along[1], along[0]])
    path = np.round(4_000.0 + np.array([[0.0], [length]]) * along)
    side = 1.0 if part_side == "left" else -1.0
    return make_contour(path, (path + side * offset * left) / 1000, part_side)


def square(half, side_of_part, offset=RADIUS):
    """A closed square contour round (4, 4) mm, counter-clockwise, with a lead-in to the middle of one side.

    `half` is the half side of the part's edge in um; the wire runs outside a punch and inside a die.
    """
    punch = side_of_part == "left"
    wire = half + offset if punch else half - offset
    ring = np.array([[0, -1], [1, -1], [1, 1], [-1, 1], [-1, -1], [0, -1]], float)
    start = np.array([[0.0, -wire - 400.0 if punch else -wire + 300.0]])
    path = 4_000.0 + np.concatenate([start, ring * wire])
    return make_contour(path, 4.0 + ring * half / 1000, side_of_part, closed=True, lead_in_moves=1)


@pytest.fixture(scope="module")
def punch():
    """Give the contour of a square punch of 1 mm and the field that it was cut from; no test may change that."""
    line = square(500.0, "left")
    return line, cut(line.points_um)


# --- kerf width ---


@pytest.mark.parametrize("angle_deg", [10.0, 33.0, 77.0])
def test_straight_kerf_is_as_wide_as_the_swept_disc(angle_deg):
    line = straight(angle_deg)
    kerf = width_stats(kerf_width(cut(line.points_um), line, wire_diameter_um=250.0).width_um)
    assert kerf["mean"] == pytest.approx(2 * RADIUS, abs=0.3)
    assert kerf["min"] > 2 * RADIUS - 0.8
    assert kerf["max"] < 2 * RADIUS + 0.8


@pytest.mark.parametrize("part_side", ["left", "right"])
def test_a_kerf_off_its_path_has_one_wall_nearer(part_side):
    line = straight(0.0, part_side)
    kerf = kerf_width(cut(np.add(line.points_um, (0.0, 20.0))), line, 250.0)
    nearer = -20.0 if part_side == "right" else 20.0  # +Y is on the left of +X
    np.testing.assert_allclose(kerf.part_um.mean(), RADIUS + nearer, atol=0.5)
    np.testing.assert_allclose((kerf.width_um - kerf.part_um).mean(), RADIUS - nearer, atol=0.5)


@pytest.mark.slow
@settings(max_examples=8, suppress_health_check=[HealthCheck.too_slow])
@given(st.floats(0.0, 90.0), st.floats(130.0, 190.0))
def test_any_straight_kerf_is_as_wide_as_the_swept_disc(angle_deg, radius):
    line = straight(angle_deg, length=1_300.0, offset=radius)
    field = cut(line.points_um, (radius,))
    # along a wall parallel to the grid the half-full level is off by up to 0.35 um on either side
    assert width_stats(kerf_width(field, line, 250.0).width_um)["mean"] == pytest.approx(2 * radius, abs=0.9)
    assert profile_error(field, line).stats()["max"] < 1.2


def test_kerf_keeps_away_from_ends_and_corners():
    bent = make_contour([[2_000, 4_000], [4_500, 4_000], [4_500, 6_500]], [[2.0, 4.155], [4.345, 4.155]])
    kerf = kerf_width(cut(bent.points_um), bent, 250.0)
    assert len(kerf.s_mm)
    for mark in (0.0, 2.5, 5.0):
        assert np.abs(kerf.s_mm - mark).min() >= 0.45
    assert width_stats(kerf.width_um)["max"] - width_stats(kerf.width_um)["min"] < 1.5


def test_kerf_leaves_out_what_another_cut_opened():
    line = straight(length=3_000.0)
    field = cut(line.points_um)
    carve(field, np.array([[5_500.0, 4_000.0], [5_500.0, 5_000.0]]), (RADIUS,))
    kerf = kerf_width(field, line, 250.0)
    assert width_stats(kerf.width_um)["max"] < 2 * RADIUS + 0.8
    assert not ((kerf.s_mm > 1.3) & (kerf.s_mm < 1.7)).any()
    assert len(kerf.s_mm)


def test_what_is_not_cut_yet_has_neither_kerf_nor_error():
    line = straight(length=3_000.0)
    field = cut([[4_000, 4_000], [5_800, 4_000]])
    kerf = kerf_width(field, line, 250.0)
    assert 1.2 < kerf.s_mm.max() < 1.5
    assert width_stats(kerf.width_um)["min"] > 2 * RADIUS - 0.8
    profile = profile_error(field, line)
    assert 1.6 < profile.s_mm[np.isfinite(profile.error_um[0])].max() <= 1.8
    assert profile.stats()["max"] < 0.6


def test_kerf_and_error_of_an_untouched_blank_are_not_numbers():
    kerf, profile = kerf_width(KerfField(2, BLANK), straight(), 250.0), profile_error(KerfField(2, BLANK), straight())
    assert all(math.isnan(value) for value in (*width_stats(kerf.width_um).values(), *profile.stats().values()))
    assert not np.isfinite(profile.error_um).any()


@pytest.mark.parametrize(("heights", "places"), [(1, 1), (2, 4), (3, 4)])
def test_a_wall_of_too_few_heights_or_places_has_no_straightness_bow_or_ripple(heights, places):
    length = 800.0 + 50.0 * places
    points = np.array([(4_000, 4_000), (4_000 + round(length), 4_000)])
    field = cut(np.add(points, [(-200, 0), (200, 0)]), (RADIUS, RADIUS - 4.0, RADIUS)[:heights])
    wall = wall_error(field, CutPass(1, "profile", points, 0, RADIUS, False), "left", 250.0)
    assert (wall.places, wall.mean_um) == (places, pytest.approx(4.0 * (heights > 1) / heights, abs=0.5))
    expected = 4.0 if heights > 1 else math.nan, 4.0 if heights > 2 else math.nan, 0.0 if places > 1 else math.nan
    assert (wall.straightness_um, wall.bow_um, wall.ripple_um) == pytest.approx(expected, abs=0.5, nan_ok=True)


def test_wire_diameter_must_be_positive():
    with pytest.raises(InputError, match="wire diameter of 0"):
        kerf_width(KerfField(1, BLANK), straight(), 0.0)


# --- profile error ---


@pytest.mark.parametrize("part_side", ["left", "right"])
@pytest.mark.parametrize("angle_deg", [0.0, 25.0])
def test_exact_cut_has_no_profile_error(part_side, angle_deg):
    line = straight(angle_deg, part_side)
    profile = profile_error(cut(line.points_um), line)
    assert profile.stats()["max"] < 0.6
    assert profile.s_mm[-1] == pytest.approx(1.6, abs=0.001)
    assert np.diff(profile.s_mm).max() <= 0.02 + 1e-9


@pytest.mark.parametrize(("part_side", "expected"), [("left", -5.0), ("right", 5.0)])
def test_cut_shifted_to_the_left_eats_a_left_part_and_spares_a_right_one(part_side, expected):
    line = straight(30.0, part_side)
    shift = 5.0 * np.array([-0.5, math.sqrt(0.75)])
    profile = profile_error(cut(line.points_um + shift), line)
    inner = np.abs(profile.s_mm - 0.8) < 0.6
    np.testing.assert_allclose(profile.error_um[:, inner], expected, atol=0.6)
    assert profile.stats()["rms"] == pytest.approx(5.0, abs=0.3)


def test_wire_on_the_nominal_edge_undercuts_by_half_the_kerf():
    line = straight(15.0, offset=0.0)
    profile = profile_error(cut(line.points_um), line)
    np.testing.assert_allclose(profile.error_um, -RADIUS, atol=0.6)


def test_every_slice_is_measured():
    line = straight(40.0)
    field = cut(line.points_um, (150.0, 155.0, 165.0))
    np.testing.assert_allclose(kerf_width(field, line, 250.0).width_um.mean(axis=1), [300.0, 310.0, 330.0], atol=0.4)
    profile = profile_error(field, line)
    np.testing.assert_allclose(np.median(profile.error_um, axis=1), [5.0, 0.0, -10.0], atol=0.3)
    np.testing.assert_allclose(np.median(profile.mean_um), -5 / 3, atol=0.3)


def test_a_slice_that_is_not_there_is_refused():
    field = KerfField(3, BLANK)
    with pytest.raises(InputError, match=r"slices 0 to 2"):
        cut_edges(field, -1)


@pytest.mark.slow
def test_a_circle_is_exact_on_either_side_and_has_no_corners():
    turn = np.linspace(0.0, 2 * np.pi, 61)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    ring[-1] = ring[0]
    field = cut(np.round(4_000 + 600 * ring))
    for part_side, radius_mm in (("left", 0.445), ("right", 0.755)):
        line = make_contour(4_000 + 600 * ring, 4 + radius_mm * ring, part_side, closed=True)
        profile = profile_error(field, line)
        assert profile.stats()["max"] < 1.5  # the path is rounded to whole um
        assert corners(line, profile) == []
        assert width_stats(kerf_width(field, line, 250.0).width_um)["mean"] == pytest.approx(2 * RADIUS, abs=0.6)


def test_the_far_wall_of_the_kerf_is_no_part_wall():
    """Undercut by more than half the kerf: the far wall is nearer than the part's, and must not be taken."""
    line = straight(part_side="left", offset=-100.0)
    profile = profile_error(cut(line.points_um), line)
    between_ends = np.abs(profile.s_mm - 0.8) < 0.7  # before and behind, the round end of the kerf is nearer
    np.testing.assert_allclose(profile.error_um[:, between_ends], -(RADIUS + 100.0), atol=0.6)


def test_the_blank_own_edges_are_left_out():
    stock = Stock((3_000.0, 3_000.0, 9_000.0, 9_000.0), ((5_000.0, 4_100.0, 300.0),))
    path = [[2_000, 4_000], [6_500, 4_000]]
    line = make_contour(path, np.array(path) / 1000 + (0, 0.155))
    profile = profile_error(cut(path, stock=stock), line)
    x = profile.points_mm[np.isfinite(profile.error_um[0]), 0]
    assert 3.15 <= x.min() < 3.2
    assert not ((x > 4.6) & (x < 5.4)).any()
    assert profile.stats()["max"] < 0.6
    places = np.array([(3.2, 5.0), (8.9, 5.0), (5.0, 8.7), (6.0, 3.05), (5.0, 4.5), (5.0, 4.1), (2.0, 5.0)])
    assert depth_in_blank(stock, places) == pytest.approx([0.2, 0.1, 0.3, 0.05, 0.1, -0.3, -1.0])


def test_loose_grains_in_the_kerf_are_no_walls():
    line = straight(30.0)
    field = cut(line.points_um)
    clean = profile_error(field, line), kerf_width(field, line, 250.0)
    along = np.array([math.cos(math.pi / 6), 0.5])
    for s in np.arange(200.0, 1_400.0, 70.0):  # single full cells all along, some on the path, some off it
        at = (4_000.0 + s * along + (0.0, s % 100)) // field.cell_um
        tile, cell = (at // TILE).astype(int), (at % TILE).astype(int)
        field.tiles[field.index[tuple(tile)], 0, *cell] = FULL
    np.testing.assert_array_equal(profile_error(field, line).error_um, clean[0].error_um)
    np.testing.assert_array_equal(kerf_width(field, line, 250.0).width_um, clean[1].width_um)


# --- corners ---


def test_inner_corners_keep_what_the_round_wire_cannot_reach():
    line = square(500.0, "right")
    profile = profile_error(cut(line.points_um), line)
    found = corners(line, profile)
    places = {(c.x_mm, c.y_mm) for c in found}
    assert places == {(3.5, 3.5), (3.5, 4.5), (4.5, 3.5), (4.5, 4.5)}
    assert len(found) == 4
    for corner in found:
        assert corner.turn_deg == pytest.approx(90.0)
        assert corner.error_um == pytest.approx((math.sqrt(2) - 1) * RADIUS, abs=0.6)


@pytest.mark.slow
def test_outer_corners_stay_sharp(punch):
    line, field = punch
    profile = profile_error(field, line)
    found = corners(line, profile)
    assert len(found) == 4
    # a cell's corner cannot be drawn sharper than the half-full level does: 0.2 cells
    assert max(abs(corner.error_um) for corner in found) < 2.5
    assert profile.stats()["p95"] < 0.6


@pytest.mark.slow
def test_outer_corner_cut_short_is_undercut():
    """The path takes a chamfer round the corner; the wall then lies behind the corner as drawn."""
    line = square(500.0, "left")
    path = line.points_um[1:].astype(float)
    early = 120.0  # the wire leaves the one side, and reaches the other, this far from the path's corner
    short = np.insert(np.delete(path, 1, axis=0), 1, [path[1] - (early, 0), path[1] + (0, early)], axis=0)
    found = {(c.x_mm, c.y_mm): c.error_um for c in corners(line, profile_error(cut(short), line))}
    from_corner_to_chamfer = math.sqrt(2) * RADIUS - early / math.sqrt(2)
    assert found[4.5, 3.5] == pytest.approx(from_corner_to_chamfer - RADIUS, abs=0.6)
    assert abs(found[4.5, 4.5]) < 2.5


def test_corner_turns_are_signed_and_the_seam_is_a_corner_too():
    ring = np.array([[3, 3], [5, 3], [5, 5], [3, 3]], float)
    line = make_contour(ring * 1000, ring, closed=True)
    backward = make_contour(ring[::-1] * 1000, ring[::-1], closed=True)
    for way, turns in ((line, [135.0, 90.0, 135.0]), (backward, [-135.0, -135.0, -90.0])):
        found = corners(way, profile_error(KerfField(1, BLANK), way))
        assert [c.turn_deg for c in found] == pytest.approx(turns)
        assert all(math.isnan(c.error_um) for c in found)


def test_chords_of_a_small_arc_are_no_corners():
    turn = np.radians(np.arange(-90.0, 1.0, 18.0))
    arc = np.stack([4.95 + 0.05 * np.cos(turn), 3.05 + 0.05 * np.sin(turn)], axis=1)
    edge = np.concatenate([[(3.0, 5.0), (3.0, 3.0)], arc, [(5.0, 5.0), (3.0, 5.0)]])
    lines = (1, 2, *(3,) * (len(arc) - 1), 4, 5)
    way = replace(make_contour(edge * 1000, edge, closed=True), elements=tuple((k, k) for k in lines))
    found = corners(way, profile_error(KerfField(1, BLANK), way))
    assert [(c.x_mm, c.y_mm) for c in found] == [(3.0, 5.0), (3.0, 3.0), (5.0, 5.0)]


def test_a_corner_between_a_line_and_an_arc_turns_by_the_angle_to_the_tangent():
    turn = np.radians(np.arange(0.0, 181.0, 9.0))
    arc = np.stack([4.0 + np.cos(turn), 3.0 + np.sin(turn)], axis=1)
    edge = np.concatenate([[(3.0, 3.0)], arc])
    way = replace(make_contour(edge * 1000, edge, closed=True), elements=((1, 1), *((2, 2),) * (len(arc) - 1)))
    found = corners(way, profile_error(KerfField(1, BLANK), way))
    assert [(c.x_mm, c.turn_deg) for c in found] == [(3.0, pytest.approx(90.0)), (5.0, pytest.approx(90.0))]


@pytest.mark.slow
def test_the_lead_in_is_marked(punch):
    line, whole = punch
    field = KerfField(1, BLANK)
    field.restore(whole.snapshot())
    carve(field, np.array([[4_000.0, 3_345.0], [4_000.0, 3_375.0]]), (RADIUS,))  # a mark 30 um deep
    profile = profile_error(field, line)
    assert profile.stats()["max"] == pytest.approx(30.0, abs=0.6)
    assert np.nanmax(np.abs(profile.error_um[:, ~profile.at_lead_in])) < 2.5
    np.testing.assert_allclose(profile.points_mm[profile.at_lead_in].mean(axis=0), [4.0, 3.5], atol=0.02)
    assert 0.48 <= 0.02 * profile.at_lead_in.sum() <= 0.54


# --- contours ---


@pytest.mark.slow
def test_contour_is_the_kerf_with_the_part_as_its_hole(punch):
    line, field = punch
    edges = cut_edges(field, 0)
    assert len(edges.geoms) == 2
    assert all(edge.is_closed for edge in edges.geoms)  # across tiles
    area = kerf_polygons(field, 0)
    exact = LineString(line.points_um / 1000).buffer(RADIUS / 1000, quad_segs=64)
    assert len(area.geoms) == 1
    assert len(area.geoms[0].interiors) == 1
    assert area.symmetric_difference(exact).area < 0.0005 * exact.length
    removed_mm2 = field.removed_parts * field.part_area_um2 * 1e-6
    assert area.area == pytest.approx(removed_mm2, rel=2e-4)


def test_start_holes_and_air_are_no_removed_metal():
    stock = Stock((3_000.0, 3_000.0, 9_000.0, 9_000.0), ((5_000.0, 5_000.0, 500.0),))
    area = kerf_polygons(cut([[2_000, 5_000], [5_000, 5_000]], stock=stock), 0)
    x0, _, x1, _ = area.bounds
    assert x0 == pytest.approx(3.0, abs=1e-3)
    assert x1 == pytest.approx(5.0 - math.sqrt(0.5**2 - 0.155**2), abs=0.005)


def test_nothing_cut_gives_an_empty_contour():
    field = KerfField(1, BLANK)
    field.allocate(4_000.0, 4_000.0, 300.0)
    assert kerf_polygons(field, 0).is_empty
    assert cut_edges(field, 0).is_empty


def test_a_cell_that_has_lost_exactly_half_has_no_edge():
    field = KerfField(1, BLANK)
    field.allocate(4_000.0, 4_000.0, 300.0)
    field.tiles[:, 0, TILE // 2, TILE // 2] = FULL - FULL // 2
    assert cut_edges(field, 0).is_empty
    field.tiles[:, 0, TILE // 2, TILE // 2] -= 1
    assert len(cut_edges(field, 0).geoms) == field.count


def test_edges_that_cross_count_even_odd():
    """Of edges rounded for a recording; shapely's way to build areas fails at these."""
    a, b, c = [
        [(0.342, -0.304), (0.857, 1.35), (1.244, 0.886)],
        [(0.624, 0.589), (0.518, 0.353), (0.551, 0.342)],
        [(0.47, 0.539), (0.461, 0.554), (0.477, 0.558)],
    ]
    area = filled(MultiLineString([[*corners, corners[0]] for corners in (a, b, c)]))
    whole, small = Polygon(a), [Polygon(b), Polygon(c)]
    assert area.area == pytest.approx(
        whole.area + sum(part.area - 2 * part.intersection(whole).area for part in small)
    )


def test_saddles_are_cut_apart_or_joined_by_their_mean():
    """Two nearly empty cells that touch at a corner: two pits in full metal, one between thin neighbours."""
    for neighbours, pieces in ((FULL, 2), (FULL // 2 + 1, 1)):
        field = KerfField(1, BLANK)
        field.allocate(2_100.0, 2_100.0, 10.0)
        cells = field.tiles[0, 0]
        cells[10, 10] = cells[11, 11] = FULL // 8
        cells[10, 11] = cells[11, 10] = neighbours
        assert len(kerf_polygons(field, 0).geoms) == pieces


# --- roughness ---


def test_roughness_is_that_of_overlapping_craters_of_the_measured_depth():
    """ETH's 110 A row: its depth is found again, and Ra lies between craters side by side and bowls of that depth."""
    area_um2, depth_um = 2484.0, 3.7556  # crater_single_discharge_eth.csv, row I9
    ratio = depth_um / (2 * math.sqrt(area_um2 / math.pi))
    ra_um = roughness_um(2 / 3 * area_um2 * depth_um, ratio)
    assert ra_um == pytest.approx(ra_over_depth() * depth_um, rel=1e-4)
    assert 16 / 81 * depth_um < ra_um < depth_um / 2


def test_the_surface_of_craters_is_known_to_a_hundredth():
    assert ra_over_depth(1) == pytest.approx(ra_over_depth(2), rel=0.01)


@given(st.floats(0.0, 1e6), st.floats(1.01, 100.0))
def test_roughness_rises_with_the_cube_root_of_the_volume(volume, factor):
    assert roughness_um(volume * factor, 0.065) == pytest.approx(roughness_um(volume, 0.065) * factor ** (1 / 3))


@pytest.mark.parametrize(("volume", "ratio"), [(-1.0, 0.065), (float("nan"), 0.065), (100.0, 0.0)])
def test_impossible_craters_are_refused(volume, ratio):
    with pytest.raises(InputError, match="cannot be"):
        roughness_um(volume, ratio)
