"""Shares of the profile error, and errors within reach of a round wire, against closed forms."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from edmsim.controllers.axis.elcam.file import Cam, ErrorTable, TableRows, load_tables
from edmsim.geometry import Polyline
from edmsim.machine.components import Constant, Geometry
from edmsim.machine.machine import Machine
from edmsim.metrology.error_budget import (
    SHARES,
    error_shares,
    mean_error_um,
    motor_offsets_um,
    share_stats,
    table_error,
    unreachable_um,
    worst_place,
)
from edmsim.metrology.profile import ProfileError, element_errors
from edmsim.plant.axes.geometric_errors import StillTable
from edmsim.program.passes import CutPass
from edmsim.program.path import WireContour
from edmsim.program.taper import Lean, Ruled

OFFSET_UM = 155.0
SQUARE_MM = np.array([(2.0, 2.0), (6.0, 2.0), (6.0, 6.0), (2.0, 6.0), (2.0, 2.0)])
PATH_UM = 1000 * (4.0 + (SQUARE_MM - 4.0) * (2.0 + OFFSET_UM / 1000) / 2.0)
"""Round the square, the part on its left."""
ALONG = np.linspace(0.25, 0.75, 11)
"""Places on every side, far from its corners, as shares of it."""
NORMALS = np.repeat([(0.0, -1.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)], len(ALONG), axis=0)
CONTOUR = WireContour(np.round(PATH_UM).astype(np.int64), 0, SQUARE_MM, True, "left", offset_um=OFFSET_UM)

move = st.tuples(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0))


def measured(error_um):
    points = np.concatenate([a + ALONG[:, None] * (b - a) for a, b in pairwise(SQUARE_MM)])
    s = np.arange(len(points), dtype=float)
    return ProfileError(points, s, np.atleast_2d(error_um), np.zeros(len(points), bool))


def way(moved):
    """A dense way round the square, a window every 0.8 um or so, moved by some um."""
    share = np.linspace(0.0, 4.0, 22_000)
    return np.column_stack([np.interp(share, range(5), PATH_UM[:, k]) for k in (0, 1)]) + moved


@pytest.mark.slow
@settings(max_examples=5, deadline=None)
@given(move, move, move, st.floats(-20.0, 20.0))
def test_a_way_that_is_moved_leaves_what_it_is_further_off_each_side(planner, drive, wire, gap):
    moves = np.cumsum([planner, drive, wire], axis=0)
    off = NORMALS @ np.array([planner, drive, wire]).T
    error = off.sum(axis=1) + gap
    shares = error_shares(measured(error), CONTOUR, [way(moved) for moved in moves])
    assert shares.shape == (len(SHARES), len(error))
    np.testing.assert_allclose(shares[0], 0.0, atol=1e-6)
    np.testing.assert_allclose(shares[1:4].T, off, atol=1e-6)
    np.testing.assert_allclose(shares[4], gap, atol=1e-6)
    np.testing.assert_allclose(shares.sum(axis=0), error, atol=1e-6)
    stats = share_stats(shares, error)
    assert stats["gap"]["mean"] == pytest.approx(gap, abs=1e-6)
    assert stats["wire"]["max"] == pytest.approx(np.abs(off[:, 2]).max(), abs=1e-6)
    if np.abs(error).max() > 1e-3:
        assert sum(share["of_mean_square"] for share in stats.values()) == pytest.approx(1.0)


def test_an_inner_corner_the_wire_cannot_reach_belongs_to_the_path():
    inner = WireContour(np.round(_inside()).astype(np.int64), 0, SQUARE_MM, True, "right", offset_um=OFFSET_UM)
    corner = ProfileError(SQUARE_MM[:1], np.zeros(1), np.array([[64.2]]), np.zeros(1, bool))
    dense = np.concatenate([np.linspace(a, b, 5000) for a, b in pairwise(_inside())])
    shares = error_shares(corner, inner, [dense] * 3)
    assert shares[0, 0] == pytest.approx(OFFSET_UM * (2**0.5 - 1), abs=1e-6)
    assert shares[1:4, 0] == pytest.approx(np.zeros(3), abs=0.1)


def test_the_table_errs_by_its_errors_where_the_wire_passes_and_not_where_the_wall_is():
    machine = Machine.load("worn-table")
    around = replace(measured(np.zeros(len(NORMALS))), s_mm=4.0 * (np.arange(4)[:, None] + ALONG).ravel())
    places, table = around.points_mm * 1e3 + OFFSET_UM * NORMALS, StillTable(machine)
    moved = [((np.array(table.move(place)) - place) @ normal) for place, normal in zip(places, NORMALS, strict=True)]
    found = table_error(machine, CONTOUR, around, None, np.zeros(1))
    np.testing.assert_allclose(found.without_um, moved, atol=0.01)
    np.testing.assert_array_equal(found.left_um, found.without_um)


def leaning_diagonal(lead_um):
    """A wall at 45 degrees with the part on its left, cut by a leaning wire over 20 mm of the table's middle."""
    edge_mm = np.array([(22.5, 22.5), (42.5, 42.5)])
    path_um = np.round(1000 * edge_mm + OFFSET_UM * np.array([1.0, -1.0]) / 2**0.5).astype(np.int64)
    wall = Ruled(edge_mm, edge_mm, 0.0, 10.0, (1,), (1,), (0, 1))
    lean = Lean(np.array([lead_um] * 2), np.array([(0.0, 10.0)] * 2), wall, 10.0)
    return WireContour(path_um, 0, edge_mm, False, "left", offset_um=OFFSET_UM, lean=lean)


SKEW, CHANGE_PER_MM = 400e-6, 0.1


def machine_turned_by_u():
    """A machine out of square, the more the further out its u is."""
    values = {"squareness_um_m": SKEW * 1e6, "change_per_mm": CHANGE_PER_MM}
    geometry = Geometry(**{name: Constant(value=value, source="ours") for name, value in values.items()})
    machine = Machine.load()
    return machine.model_copy(update={"base": machine.base.model_copy(update={"geometry": geometry})})


def test_errors_that_change_with_u_are_those_of_a_leaning_wire():
    u_um, v_um = 4_000, -2_000
    contour, s_mm = leaning_diagonal((u_um, v_um)), np.array([5.0, 10.0, 20.0])
    points = contour.nominal_mm[0] + s_mm[:, None] / 2**0.5
    profile = ProfileError(points, s_mm, np.zeros((1, 3)), np.zeros(3, bool))
    # at half the height the wire is ahead of the lower guide by half the lead's part along the wall
    lower_x_um = 1000 * points[:, 0] + OFFSET_UM / 2**0.5 - 0.25 * (u_um + v_um)
    expected = SKEW * (1.0 + CHANGE_PER_MM * u_um * 1e-3) * (lower_x_um - 32_500.0) / 2**0.5
    rows = [(x_mm, factor * SKEW * 1e3 * (x_mm - 32.5)) for factor in (1.0, 1.5) for x_mm in (0.0, 65.0)]
    exact = ErrorTable("y", "x", np.array(rows), rows=TableRows("u", 0.0, 5.0, 2, interpolated=True))
    found = table_error(machine_turned_by_u(), contour, profile, load_tables([exact]), np.zeros(1))
    np.testing.assert_allclose(found.without_um, expected, atol=0.01)
    np.testing.assert_allclose(found.left_um, 0.0, atol=0.75)  # half a motor step, at 45 degrees


def test_errors_that_change_with_u_follow_a_cam():
    motors = np.array([(42_500.0, 32_500.0)] * 2)
    cam = load_tables([Cam("u", "path", np.array([(0.0, 0.0), (50.0, 5.0)]))])
    program, table = motor_offsets_um(machine_turned_by_u(), motors, motors, np.array([0.0, 40_000.0]), cam)
    np.testing.assert_array_equal(program, 0.0)
    np.testing.assert_allclose(table, [(0.0, 4.0), (0.0, 5.6)])


def test_what_trims_leave_is_the_share_of_their_path_and_its_ends_are_out_of_reach():
    """A trim of an open edge ends before the round front of the rough pass."""
    edge_mm, rough_um, ends_um = SQUARE_MM[:2], 240.0, (2200, 5800)
    passes = tuple(
        CutPass(number, "profile", np.array([(a, 2000 - um), (b, 2000 - um)]), 0, um, number == 2)
        for number, um, (a, b) in ((1, rough_um, (2000, 6000)), (2, OFFSET_UM, ends_um))
    )
    path_um = np.array([(2000, 2000 - OFFSET_UM), (6000, 2000 - OFFSET_UM)])
    trimmed = WireContour(path_um.astype(np.int64), 0, edge_mm, False, "left", offset_um=OFFSET_UM, passes=passes)
    points = np.array([(2.0, 2.0), (4.0, 2.0)])
    corner_um = math.hypot(ends_um[0] - 2000, OFFSET_UM) - OFFSET_UM
    found = ProfileError(points, np.array([0.0, 2.0]), np.array([[80.0, 3.0]]), np.zeros(2, bool))
    assert unreachable_um(found, trimmed) == pytest.approx([corner_um, 0.0])
    for last, path in ((1, [rough_um - OFFSET_UM] * 2), (None, [corner_um, 0.0])):
        dense = np.linspace(*passes[(last or 2) - 1].points_um, 5000)
        shares = error_shares(found, trimmed, [dense] * 3, last)
        assert shares[0] == pytest.approx(path)
        assert shares[1:4] == pytest.approx(np.zeros((3, 2)), abs=1e-6)
        stopped = error_shares(found, trimmed, [dense[:1000]] * 3, last)  # before it came to the second place
        assert np.isnan(stopped).all(axis=0).tolist() == [False, True]


def _inside():
    return 1000 * (4.0 + (SQUARE_MM - 4.0) * (2.0 - OFFSET_UM / 1000) / 2.0)


def test_an_interrupted_track_is_not_joined_across_a_corner():
    corner_mm = SQUARE_MM[1:2]  # the corner between the sides that the track follows, 0.2 mm short of it on both
    corner = ProfileError(corner_mm, np.zeros(1), np.zeros((1, 1)), np.zeros(1, bool))
    short_um = np.array([(5800.0, 2000.0 - OFFSET_UM), (6000.0 + OFFSET_UM, 2200.0)])
    track = np.insert(np.concatenate([[PATH_UM[0]], short_um, [PATH_UM[2]]]), 2, np.nan, axis=0)
    shares = error_shares(corner, CONTOUR, [track] * 3)
    assert shares[1, 0] == pytest.approx(math.hypot(200.0, OFFSET_UM) - OFFSET_UM, abs=1.0)


@pytest.mark.slow
def test_what_was_not_measured_has_no_shares():
    error = np.zeros(len(NORMALS))
    error[3] = np.nan
    shares = error_shares(measured(error), CONTOUR, [way(np.zeros(2))] * 3)
    assert np.isnan(shares[:, 3]).all()
    assert np.isfinite(np.delete(shares, 3, axis=1)).all()
    before_start = error_shares(measured(error), CONTOUR, [np.zeros((0, 2))] * 3)
    assert np.isnan(before_start).all()
    assert all(np.isnan(value) for share in share_stats(before_start, error).values() for value in share.values())


ELL_OFFSET_UM = 150.0
ELL_MM = np.array([(0, 0), (4, 0), (4, 2), (2, 2), (2, 4), (0, 4), (0, 0)], float)  # the part on its left
INNER_MM = np.array([2.0, 2.0])
LEFT_UM = ELL_OFFSET_UM * (math.sqrt(2) - 1)


def contour():
    ring = shapely.Polygon(ELL_MM).buffer(ELL_OFFSET_UM / 1e3, quad_segs=64).exterior
    path = np.round(shapely.get_coordinates(ring.reverse() if not ring.is_ccw else ring) * 1e3).astype(np.int64)
    elements = tuple((k + 1, 10 + k) for k in range(6))
    return WireContour(path, 0, ELL_MM, True, "left", elements=elements, offset_um=ELL_OFFSET_UM)


def profile(error_um=0.0):
    line = Polyline(ELL_MM, closed=True)
    s = line.stations(0.02, line.corners(15.0))
    error = np.broadcast_to(error_um, (3, len(s))).astype(float)
    return ProfileError(line.at(s), s, error, line.distance_along(s, np.array([1.0])) <= 0.25)


def place_of(found, x, y):
    return int(np.hypot(*(found.points_mm - (x, y)).T).argmin())


def test_only_the_inner_corner_is_out_of_reach():
    found = profile()
    left = unreachable_um(found, contour())
    assert left[place_of(found, *INNER_MM)] == pytest.approx(LEFT_UM, abs=1.0)
    assert left.max() == left[place_of(found, *INNER_MM)]
    # the fillet touches both sides at the offset from the corner
    assert np.hypot(*(found.points_mm[left > 0] - INNER_MM).T).max() < ELL_OFFSET_UM / 1e3
    assert (left >= 0).all()


def test_a_wire_on_its_path_has_no_error_within_reach_and_says_why_there_is_one_against_the_drawing():
    bare = profile()
    left = unreachable_um(bare, contour())
    found = profile(left)
    against, within = (
        worst_place([contour()], [found], [left], [None], reachable=reachable) for reachable in (False, True)
    )
    assert (against.x_mm, against.y_mm, against.why) == (2.0, 2.0, "out of reach")
    assert against.error_um == pytest.approx(LEFT_UM, abs=1.0)
    assert within.error_um == 0.0


@pytest.mark.parametrize(
    ("place_mm", "why"),
    [((4.0, 2.0), "outer corner"), ((2.0, 2.0), "inner corner"), ((1.0, 0.0), "start mark"), ((0.0, 2.0), "edge")],
)
def test_the_largest_error_says_what_lies_there(place_mm, why):
    found = profile()
    error = np.zeros_like(found.error_um)
    error[1, place_of(found, *place_mm)] = -30.0
    found = ProfileError(found.points_mm, found.s_mm, error, found.at_lead_in)
    shares = np.zeros((5, len(found.s_mm)))
    shares[3] = -30.0
    worst = worst_place([contour()], [found], [np.zeros(len(found.s_mm))], [shares], reachable=True)
    assert (worst.error_um, worst.why, worst.made_by) == (-30.0, why, "wire")


def test_what_is_out_of_reach_does_not_make_the_error_within_reach():
    bare = profile()
    left = unreachable_um(bare, contour())
    gap_um = 0.2 * left
    shares = np.array([left, 0.0 * left, 0.0 * left, 0.0 * left, gap_um])
    against, within = (
        worst_place([contour()], [profile(left + gap_um)], [left], [shares], reachable=reachable)
        for reachable in (False, True)
    )
    assert (against.made_by, within.made_by) == ("path", "gap")


def test_the_mean_error_is_that_of_the_walls_between_corners():
    bare = profile()
    left = unreachable_um(bare, contour())
    line = Polyline(ELL_MM, closed=True)
    at_corner = line.distance_along(bare.s_mm, line.s[line.corners(15.0)]) < 0.1
    found = profile(np.where(at_corner | bare.at_lead_in, -40.0, 4.0))
    assert mean_error_um([contour()], [found], [left]) == pytest.approx(4.0)
    assert math.isnan(mean_error_um([contour()], [profile(math.nan)], [left]))


def test_elements_are_the_lines_of_the_program():
    bare = profile()
    left = unreachable_um(bare, contour())
    found = profile(left + 2.0)
    rows = element_errors(3, contour(), found, left)
    assert [(row.contour, row.element, row.line, row.kind) for row in rows] == [
        (3, k + 1, 10 + k, "line") for k in range(6)
    ]
    assert [row.length_mm for row in rows] == [4.0, 2.0, 2.0, 2.0, 2.0, 4.0]
    for row in rows:
        assert (row.mean_um, row.rms_um, row.low_um, row.high_um) == pytest.approx((2.0,) * 4)


@pytest.mark.parametrize(("turn", "high_mm", "kind"), [
    (math.tau, 1.5, "arc"), (2.0, 1.5, "arc"), (2.0, 1.4, "curve"), (math.tau, 1.4, "curve"), (2.0, 0.0, "line"),
])  # fmt: skip
def test_an_arc_has_its_radius(turn, high_mm, kind):
    angle = np.linspace(0, turn, 60)
    points = np.column_stack([1.5 * np.cos(angle), high_mm * np.sin(angle)]) + 20.0
    arc = WireContour(np.round(points * 1e3).astype(np.int64), 0, points, False, "left", elements=((1, 4),) * 59)
    s = np.linspace(0, 1.5 * turn, 100)
    found = ProfileError(np.zeros((100, 2)), s, np.zeros((2, 100)), np.zeros(100, bool))
    (row,) = element_errors(1, arc, found, np.zeros(100))
    assert (row.kind, row.line) == (kind, 4)
    if kind == "arc":
        assert row.radius_mm == pytest.approx(1.5, abs=1e-6)
        assert row.length_mm == pytest.approx(1.5 * turn, rel=1e-3)
    else:
        assert row.radius_mm is None
