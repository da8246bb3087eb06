"""Tapered walls compared with closed forms: mitres, cones, cylinders, the ellipse, guides; refused walls."""

import math
from dataclasses import replace
from pathlib import Path

import ezdxf
import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from edmsim.errors import InputError
from edmsim.program.offset import leaning_outline
from edmsim.program.outline import Outline, Program, Taper
from edmsim.program.path import load_program, plan_path
from edmsim.program.taper import GuideHeights, leaning, offset_surface, wall_and_wire

EXAMPLES = Path(__file__).parents[2] / "examples"
GUIDES = GuideHeights(-10.0, 20.0, 10.0, 30.0)
OFFSET = 0.164


def polygon(points, side="right", part="left", taper=None):
    closed = np.array([*points, points[0]], float)
    count = len(points)
    return Outline(
        closed, (0,) * count, True, side, part, np.empty((0, 2)), elements=tuple(range(1, count + 1)), taper=taper
    )


def square(angle_deg=3.0, corners="sharp", side="right", part="left", size=6.0, **taper):
    half = size / 2
    points = [(-half, -half), (half, -half), (half, half), (-half, half)]
    return polygon(points, side, part, Taper((angle_deg,) * 4, corners=corners, **taper))


def rounded_square(angle_deg, corners, radius=1.0, size=6.0, part="left"):
    """A square with arcs of one degree per chord, counter-clockwise."""
    inner, points, elements = size / 2 - radius, [], []
    for quarter in range(4):
        at = np.radians(np.linspace(90 * quarter - 90, 90 * quarter, 91))
        centre = inner * np.array([(1, -1), (1, 1), (-1, 1), (-1, -1)])[quarter]
        points += (centre + radius * np.stack([np.cos(at), np.sin(at)], axis=1)).tolist()
        elements += [2 * quarter + 1] * 90 + [2 * quarter + 2]
    closed = np.array([*points, points[0]])
    return Outline(
        closed, (0,) * (len(closed) - 1), True, "right" if part == "left" else "left", part, np.empty((0, 2)),
        elements=tuple(elements), taper=Taper((angle_deg,) * (len(closed) - 1), corners=corners),
    )  # fmt: skip


@pytest.mark.parametrize("angle_deg", [3.0, -3.0, 15.0, -15.0])
def test_sharp_corners_move_by_tan_a_times_the_sum_of_normals(angle_deg):
    # m = tan a (n1 + n2) / (1 + n1.n2); at a right angle both components are tan a
    wall, _ = wall_and_wire(square(angle_deg), OFFSET, GUIDES)
    tan = math.tan(math.radians(angle_deg))
    np.testing.assert_allclose(wall.slope, -tan * np.sign(wall.lower_mm), atol=1e-12)
    np.testing.assert_allclose(wall.at(4.0), wall.lower_mm * (1 - 4.0 * tan / 3.0), atol=1e-12)


@pytest.mark.parametrize("angle_deg", [3.0, 15.0, -15.0])
@pytest.mark.parametrize("height_mm", [0.0, 5.0, 10.0])
def test_the_wire_is_next_to_a_wall_by_the_ellipse(angle_deg, height_mm):
    wall, wire = wall_and_wire(square(angle_deg), OFFSET, GUIDES)
    edge, way = (shapely.LinearRing(of.at(height_mm)) for of in (wall, wire))
    middles = shapely.points((way.coords[:-1] + np.array(way.coords[1:])) / 2)
    np.testing.assert_allclose(edge.distance(middles), OFFSET / math.cos(math.radians(angle_deg)), atol=1e-9)


def test_guides_stand_where_the_wire_would_pass_them():
    path = plan_path(Program((square(3.0),), (), "test"), OFFSET, auto_offset_mm=OFFSET, guides=[GUIDES])
    contour = path.contours[0]
    lead = contour.lean.upper_um[contour.lead_in_moves :]
    # |UV| = (z_U - z_L) tan a, along both axes at a corner
    assert np.abs(np.abs(lead) - 30_000 * math.tan(math.radians(3.0))).max() <= 1.0
    assert (contour.lean.upper_um[0] == 0).all()  # the wire is threaded upright
    slant = contour.wire_path.slant[contour.lead_in_moves :]
    np.testing.assert_allclose(slant, 1 / math.cos(math.radians(3.0)), atol=2e-6)
    on_face = contour.at_height(0.0).points_um[contour.lead_in_moves :]
    ring = shapely.LinearRing(contour.lean.wall.at(0.0) * 1e3)
    gaps = ring.distance(shapely.points((on_face[1:] + on_face[:-1]) / 2))
    assert np.abs(gaps - OFFSET * 1e3 / math.cos(math.radians(3.0))).max() < 2.0


@pytest.mark.parametrize("turned_deg", [30.0, 45.0])
def test_the_slant_of_a_wall_is_across_its_path_in_any_direction(turned_deg):
    turned = square(3.0)
    cosine, sine = math.cos(math.radians(turned_deg)), math.sin(math.radians(turned_deg))
    turned = replace(turned, points_mm=turned.points_mm @ np.array([(cosine, sine), (-sine, cosine)]))
    contour = plan_path(Program((turned,), (), "test"), OFFSET, auto_offset_mm=OFFSET, guides=[GUIDES]).contours[0]
    slant = contour.wire_path.slant[contour.lead_in_moves :]
    np.testing.assert_allclose(slant, 1 / math.cos(math.radians(3.0)), atol=1e-5)


def test_the_bend_of_guides_is_where_stiffness_and_edge_put_it():
    guides = GUIDES._replace(stiff_mm=1.4, radius_mm=2.0)
    slope = np.array([[math.tan(math.radians(30.0)), 0.0], [0.0, 0.0]])
    low, high = guides.bends_mm(slope)[0]
    assert low == pytest.approx(-10 + 1.4 + 2.0 * math.tan(math.radians(15.0)))
    assert high == pytest.approx(20 - 1.4 - 2.0 * math.tan(math.radians(15.0)))
    assert guides.bends_mm(slope)[1].tolist() == pytest.approx([-8.6, 18.6])


@pytest.mark.parametrize("angle_deg", [4.0, -4.0])
@pytest.mark.parametrize("height_mm", [0.0, 3.0, 10.0])
def test_conical_arcs_change_their_radius_about_one_centre(angle_deg, height_mm):
    wall, _ = wall_and_wire(rounded_square(angle_deg, "conical"), OFFSET, GUIDES)
    found = wall.at(height_mm)
    radius = 1.0 - height_mm * math.tan(math.radians(angle_deg))  # R(z) = R +- (z - z_P) tan a
    centre = np.array([2.0, -2.0])
    of_arc = found[np.flatnonzero(np.array(wall.elements) == 1)]
    np.testing.assert_allclose(np.hypot(*(of_arc - centre).T), radius, atol=1e-6)


@pytest.mark.parametrize("height_mm", [0.0, 3.0, 10.0])
def test_cylindrical_arcs_keep_their_radius_and_move_by_the_mitre(height_mm):
    wall, _ = wall_and_wire(rounded_square(-4.0, "cylindrical"), OFFSET, GUIDES)
    of_arc = wall.at(height_mm)[np.flatnonzero(np.array(wall.elements) == 1)]
    d = height_mm * math.tan(math.radians(4.0))
    centre = np.array([2.0 + d, -2.0 - d])  # d (n1 + n2) / (1 + n1.n2)
    np.testing.assert_allclose(np.hypot(*(of_arc - centre).T), 1.0, atol=1e-4)


@pytest.mark.parametrize("corners", ["conical", "rounded"])
def test_a_corner_that_opens_becomes_an_arc_of_radius_d(corners):
    wall, wire = wall_and_wire(square(-5.0, corners), OFFSET, GUIDES)
    d = 10.0 * math.tan(math.radians(5.0))
    corner = np.array([3.0, 3.0])
    fan = np.hypot(*(wall.lower_mm - corner).T) < 1e-9
    assert fan.sum() > 10
    np.testing.assert_allclose(np.hypot(*(wall.at(10.0)[fan] - corner).T), d, atol=1e-9)
    away = shapely.LinearRing(wall.at(5.0)).distance(shapely.points(wire.at(5.0)))
    assert away.min() > OFFSET - 1e-3
    for ruled in (wall, wire):
        np.testing.assert_allclose(ruled.at(10.0)[0], ruled.at(10.0)[-1])


@pytest.mark.parametrize("corners", ["conical", "rounded"])
@pytest.mark.parametrize(("offset_mm", "sharp"), [(OFFSET, True), (0.0, False)])
def test_a_corner_of_a_way_drawn_for_the_wire_opens_where_the_walls_does(corners, offset_mm, sharp):
    wall, wire = wall_and_wire(square(-5.0, corners, side=None), offset_mm, GUIDES)
    assert len(wire.lower_mm) == len(wall.lower_mm)
    assert (len(wall.lower_mm) == 5) is sharp
    away = shapely.LinearRing(wall.at(5.0)).distance(shapely.points(wire.at(5.0)))
    assert away.min() > offset_mm - 1e-3


@pytest.mark.parametrize("corners", ["conical", "rounded"])
@pytest.mark.parametrize("plane_mm", [10.0, 4.0])
def test_the_programs_plane_may_be_the_upper_face_or_within_the_workpiece(corners, plane_mm):
    wall, wire = wall_and_wire(square(-5.0, corners, program_plane_mm=plane_mm), OFFSET, GUIDES)
    for z in (0.0, plane_mm, 10.0):
        half = 3.0 + (z - plane_mm) * math.tan(math.radians(5.0))
        assert np.abs(wall.at(z)).max() == pytest.approx(half)
        away = shapely.LinearRing(wall.at(z)).distance(shapely.LinearRing(wire.at(z)))
        assert away == pytest.approx(OFFSET / math.cos(math.radians(5.0)))


@pytest.mark.parametrize("corners", ["conical", "sharp"])
def test_an_angle_changes_at_a_tangent_by_what_a_wire_can_cut(corners):
    same = rounded_square(2.0, corners)

    def changed(by_deg):
        angles = np.where(np.array(same.elements) > 4, 2.0 + by_deg, 2.0)
        return replace(same, taper=Taper(tuple(angles.tolist()), corners=corners))

    wall, _ = wall_and_wire(changed(0.02), OFFSET, GUIDES)
    leans = np.degrees(np.arctan(np.abs(wall.slope).max(axis=0)))
    np.testing.assert_allclose(leans, 2.02, atol=1e-6)
    assert "the taper changes from 3 to 2 degrees at X2.000 Y-3.000, where two lines" in refused(changed(1.0))


def test_a_notice_says_where_an_arc_of_constant_radius_turns_a_wall():
    same = rounded_square(2.0, "cylindrical")
    angles = np.where(np.array(same.elements) == 1, 3.0, 2.0)
    outline = replace(same, taper=Taper(tuple(angles.tolist()), corners="cylindrical"))
    notices = []
    leaning_outline(outline, OFFSET, GUIDES, notices)
    said = ["from 2 to 3 degrees at X2.000 Y-3.000, beside an arc", "from 3 to 2 degrees at X3.000 Y-2.000, beside"]
    assert [text in notice for text, notice in zip(said, notices, strict=True)] == [True, True]


def test_an_arc_so_small_that_it_has_two_chords_becomes_a_cone():
    fine = rounded_square(-5.0, "conical", radius=0.02)
    chosen = [91 * quarter + i for quarter in range(4) for i in (0, 45, 90)]
    outline = replace(
        fine, points_mm=fine.points_mm[[*chosen, -1]], line_numbers=(0,) * 12, taper=Taper((-5.0,) * 12),
        elements=tuple(fine.elements[i] for i in chosen),
    )  # fmt: skip
    wall, _ = wall_and_wire(outline, OFFSET, GUIDES)
    of_arc = wall.at(10.0)[np.flatnonzero(np.array(wall.elements) == 1)]
    np.testing.assert_allclose(np.hypot(*(of_arc - (2.98, -2.98)).T), 0.02 + 10.0 * math.tan(math.radians(5.0)))


def test_an_arc_that_meets_a_line_at_a_corner_is_cut_off_where_they_meet():
    wall, _ = wall_and_wire(leaning(load_program(EXAMPLES / "punch.ngc").outlines, 3.0, "conical")[0], OFFSET, GUIDES)
    d = 10.0 * math.tan(math.radians(3.0))
    notch = wall.at(10.0)[np.flatnonzero(np.array(wall.line_numbers) == 11)]
    # the line y = 6 - d and the circle of radius 0.8 + d about (5, 6)
    assert notch[0].tolist() == pytest.approx([5.0 - math.sqrt((0.8 + d) ** 2 - d**2), 6.0 - d], abs=1e-6)
    np.testing.assert_allclose(np.hypot(*(notch - (5.0, 6.0)).T), 0.8 + d, atol=1e-6)


@pytest.mark.parametrize(
    ("requested", "said"), [({"corners": "rounded"}, True), ({"taper_deg": 2.0}, True), ({}, False)]
)
def test_a_requested_taper_that_the_programs_own_replaces_is_named(requested, said):
    path = plan_path(Program((square(3.0),), (), "test"), OFFSET, auto_offset_mm=OFFSET, guides=[GUIDES], **requested)
    assert any("tapered by the program itself" in notice for notice in path.notices) is said


@pytest.mark.parametrize(("corners", "radius_mm"), [("conical", 1.651), ("cylindrical", 2.0)])  # 2 mm less 10 tan 2°
def test_the_cut_chooses_the_corners_of_a_program_that_does_not(corners, radius_mm):
    file = EXAMPLES / "dialects" / "taper-fanuc.nc"
    (contour,) = plan_path(file, auto_offset_mm=OFFSET, guides=[GUIDES], corners=corners).contours
    arc = contour.lean.wall.at(10.0)[np.array((*contour.lean.wall.line_numbers, 0)) == 11]
    a, b, c = arc[0], arc[len(arc) // 2], arc[-1]
    sides = [math.dist(*pair) for pair in ((a, b), (b, c), (c, a))]
    assert math.prod(sides) / (4 * shapely.Polygon([a, b, c]).area) == pytest.approx(radius_mm, abs=0.003)


def test_a_die_opens_upwards_where_its_part_is_smaller_above():
    outline = leaning(load_program(EXAMPLES / "die.ngc").outlines, 3.0, "conical")[0]
    wall, _ = wall_and_wire(outline, OFFSET, GUIDES)
    below, above = (np.ptp(wall.at(z), axis=0) for z in (0.0, 10.0))
    np.testing.assert_allclose(above - below, 20.0 * math.tan(math.radians(3.0)), atol=1e-9)


@given(
    sides=st.integers(3, 9), radius=st.floats(2.0, 8.0), angle_deg=st.floats(-8.0, 8.0), turn=st.floats(0, 6.2),
    height_mm=st.integers(0, 10_000).map(lambda um: um * 1e-3),
    corners=st.sampled_from(["sharp", "conical", "cylindrical", "rounded"]),
)
@settings(max_examples=60, deadline=None)
def test_ruled_walls_lean_by_their_angle_at_every_height(sides, radius, angle_deg, turn, height_mm, corners):
    assume(abs(angle_deg) > 0.01)
    at = turn + 2 * np.pi * np.arange(sides) / sides
    points = radius * np.stack([np.cos(at), np.sin(at)], axis=1)
    outline = polygon(points.tolist(), taper=Taper((angle_deg,) * sides, corners=corners))
    vanishes = radius * math.cos(math.pi / sides) < 10.0 * math.tan(math.radians(angle_deg))
    if vanishes:
        assert "vanishes" in refused(outline)
        return
    wall, wire = wall_and_wire(outline, OFFSET, GUIDES)
    d = height_mm * math.tan(math.radians(angle_deg))
    drawn, found = shapely.LinearRing(outline.points_mm), shapely.Polygon(wall.at(height_mm))
    line = wall.at(height_mm)
    away = drawn.distance(shapely.points((line[:-1] + line[1:]) / 2))
    assert np.abs(away - abs(d)).max() < 2e-3  # because arcs are chords
    assert found.is_valid
    centres = shapely.points(wire.at(height_mm))
    assert found.exterior.distance(centres).min() > OFFSET / math.cos(math.radians(angle_deg)) - 2e-3
    assert shapely.distance(shapely.LinearRing(wire.at(height_mm)), found) > OFFSET - 2e-3


@given(st.lists(st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)), min_size=4, max_size=4), st.floats(0, 10))
@settings(max_examples=40, deadline=None)
def test_a_wire_between_two_contours_keeps_the_ellipse_from_both(shifts, height_mm):
    outline = square()
    lower = outline.points_mm
    upper = lower.copy()
    upper[:4] += np.array(shifts)
    upper[4] = upper[0]
    outline = replace(outline, taper=Taper(upper_mm=upper, second_plane_mm=10.0))
    wall, wire = wall_and_wire(outline, OFFSET, GUIDES)
    np.testing.assert_allclose(wall.at(10.0), upper)
    np.testing.assert_allclose(wall.at(height_mm), lower + (upper - lower) * height_mm / 10.0)
    # the wire also touches a twisted wall between its planes, up to the change of lean along a side
    gap = shapely.distance(shapely.LinearRing(wire.at(height_mm)), shapely.Polygon(wall.at(height_mm)))
    assert OFFSET - 1e-3 < gap < OFFSET * 1.02


def test_a_wire_path_as_written_has_its_wall_next_to_it():
    outline = square(3.0, side=None)
    wall, wire = wall_and_wire(outline, OFFSET, GUIDES)
    np.testing.assert_allclose(wire.lower_mm, outline.points_mm)
    assert shapely.Polygon(wire.at(7.0)).contains(shapely.Polygon(wall.at(7.0)))


def refused(outline, guides=GUIDES, offset=OFFSET):
    with pytest.raises(InputError) as caught:
        wall_and_wire(outline, offset, guides)
    return caught.value.reason


def test_a_radius_that_vanishes_names_its_height():
    reason = refused(rounded_square(8.0, "conical"))
    # up to rounding, all chords of the four arcs vanish there; every processor names the beginning of the first arc
    assert "the arc of the wall at X2.000 Y-3.000" in reason
    assert f"at a height of {1.0 / math.tan(math.radians(8.0)):.3f} mm" in reason


def test_angles_beyond_the_guides_say_how_far_they_go():
    reason = refused(square(-40.0), GUIDES._replace(travel_mm=20.0))
    assert "lean by 49.88 degrees" in reason  # with both components at a corner
    assert "it goes 20 mm" in reason
    assert "give angles below 45" in refused(square(50.0))


# two lobes joined by a neck, 2 mm wide below, which vanishes above
NECK = [(side * x, side * y) for side in (1, -1) for x, y in ((1, -0.5), (1, -2), (4, -2), (4, 2), (1, 2), (1, 0.5))]
GROOVE = [(-3, -2), (3, -2), (3, 2), (0.12, 2), (0.12, 0), (-0.12, 0), (-0.12, 2), (-3, 2)]


@pytest.mark.parametrize(("outline", "said"), [
    (polygon(NECK, taper=Taper((5.0,) * 12, corners="sharp")), "crosses itself at a height of"),
    (polygon(GROOVE, taper=Taper((1.0,) * 8, corners="sharp")), "the line of the wire's way at X"),
    (rounded_square(-3.0, "conical", radius=0.1, part="right"), "the arc of the wire's way"),
    (square(program_plane_mm=5.0, second_plane_mm=5.0), "two different heights"),
    (replace(square(), taper=Taper((3.0, 3.0))), "2 angles for 4 elements"),
    (replace(square(), taper=Taper(upper_mm=np.zeros((4, 2)))), "4 elements and the one above 3"),
    (square(30.0, size=3.0), "vanishes at a height of 2.598 mm"),
])  # fmt: skip
def test_what_cannot_be_is_refused_in_one_line(outline, said):
    reason = refused(outline)
    assert said in reason
    assert "\n" not in reason


def test_a_corner_that_became_a_cone_is_an_element_of_its_own():
    wall, _ = wall_and_wire(square(-5.0, "conical"), OFFSET, GUIDES)
    assert sorted(set(wall.elements)) == [1, 2, 3, 4, 5, 6, 7, 8]
    fan = wall.at(10.0)[np.flatnonzero(np.array(wall.elements) == 5)]
    np.testing.assert_allclose(np.hypot(*(fan - (3.0, -3.0)).T), 10.0 * math.tan(math.radians(5.0)))


def test_a_wire_without_a_way_to_its_contour_is_threaded_upright():
    outline = Outline(
        np.array([[0.0, 0.0], [2.0, 0.0]]), (0,), False, "right", "left", np.empty((0, 2)), needs_lead_in=False,
        elements=(1,), taper=Taper((5.0,)),
    )  # fmt: skip
    path = plan_path(Program((outline,), (), "test"), OFFSET, auto_offset_mm=OFFSET, guides=[GUIDES])
    contour = path.contours[0]
    assert contour.lean.upper_um[0].tolist() == [0, 0]
    assert contour.lead_in_moves == 1
    assert contour.wire_path.along_um[1] == pytest.approx(10_000 * math.tan(math.radians(5.0)), abs=2.0)


def test_a_wire_is_threaded_beyond_a_wall_that_leans_over_the_way_to_it():
    path = plan_path(Program((square(-15.0),), (), "test"), OFFSET, auto_offset_mm=OFFSET, guides=[GUIDES])
    contour = path.contours[0]
    thread_mm = contour.points_um[0] / 1000
    for face in (0.0, 10.0):
        assert shapely.LineString(contour.lean.wall.at(face)).distance(shapely.Point(thread_mm)) > 0.3
    assert any("as the wall leans over the way to it" in notice for notice in path.notices)


@pytest.mark.parametrize(("angle", "corners"), [(math.nan, "sharp"), (45.0, "sharp"), (-90.0, "conical")])
def test_an_angle_that_is_none_is_refused(angle, corners):
    with pytest.raises(InputError, match="cannot lean by"):
        leaning((square(),), angle, corners)


def test_two_layers_of_a_drawing_are_the_lower_and_the_upper_contour():
    program = load_program(EXAMPLES / "square_to_round.dxf", upper_layer="UPPER")
    (outline,) = program.outlines
    assert len(set(outline.elements)) == 8
    assert np.abs(outline.points_mm).max() == pytest.approx(2.0, abs=1e-6)
    np.testing.assert_allclose(np.hypot(*outline.taper.upper_mm.T), 1.8, atol=2e-3)
    # lines and arcs are joined to those above them: no ruling turns by more than a few degrees about the axis
    turn = np.angle((outline.taper.upper_mm @ (1, 1j)) / (outline.points_mm @ (1, 1j)))
    assert np.degrees(np.abs(turn)).max() < 10.0


def test_contours_with_unequal_numbers_of_elements_are_refused(tmp_path):
    document = ezdxf.new()
    document.units = 4
    space = document.modelspace()
    corners = [(-2, -2), (2, -2), (2, 2), (-2, 2)]
    space.add_lwpolyline(corners, close=True, dxfattribs={"layer": "BELOW"})
    space.add_circle((0, 0), 1.5, dxfattribs={"layer": "ABOVE"})
    document.saveas(tmp_path / "part.dxf")
    with pytest.raises(InputError, match="it has 4 lines and arcs, and the contour above it 1") as caught:
        load_program(tmp_path / "part.dxf", upper_layer="ABOVE")
    assert "split" in caught.value.reason
    with pytest.raises(InputError, match="no layer nowhere"):
        load_program(tmp_path / "part.dxf", upper_layer="nowhere")


def test_a_hole_that_moves_aside_with_the_height_goes_with_the_hole_above(tmp_path):
    document = ezdxf.new()
    document.units = 4
    space = document.modelspace()
    for layer, middle, half in (("BELOW", 0, 5), ("BELOW", 0, 2), ("ABOVE", 0, 5), ("ABOVE", 0.1, 2)):
        corners = [(middle + x * half, y * half) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        space.add_lwpolyline(corners, close=True, dxfattribs={"layer": layer})
    document.saveas(tmp_path / "part.dxf")
    hole, outside = load_program(tmp_path / "part.dxf", layers=["BELOW"], upper_layer="ABOVE").outlines
    np.testing.assert_allclose(hole.taper.upper_mm - hole.points_mm, [[0.1, 0.0]] * 5, atol=1e-9)
    np.testing.assert_allclose(outside.taper.upper_mm, outside.points_mm)


def test_an_approach_that_leans_into_the_part_is_refused(tmp_path):
    file = tmp_path / "near.ngc"
    file.write_text("G21 G90\nG92 X1 Y-0.8\nG41 D1 G1 X1 Y0\nX0\nY4\nX4\nY0\nX1\nG40 Y-1\nM02\n")
    guides = GuideHeights(-10, 14, 4, 30)
    with pytest.raises(InputError, match="leans into the part"):
        plan_path(file, OFFSET, auto_offset_mm=OFFSET, taper_deg=-15.0, guides=[guides])
    file.write_text(
        "G21 G90\nD1=0.25\nD2=0.2\nG92 X1 Y-3\nG41 D1 G1 X1 Y0\nX0\nY4\nX4\nY0\nX1\nG40 Y-3\n"
        "G0 X3 Y-0.8\nG41 D2 G1 X3 Y0\nX0\nY4\nX4\nY0\nX3\nG40 Y-1\nM02\n"
    )
    with pytest.raises(InputError, match="leans into the part") as caught:  # also by a trim of the program
        plan_path(file, OFFSET, auto_offset_mm=OFFSET, taper_deg=-15.0, guides=[guides])
    assert caught.value.line == 14
    with pytest.raises(InputError, match="no movable upper guide is known"):
        plan_path(file, OFFSET, auto_offset_mm=OFFSET, taper_deg=-5.0)


@pytest.mark.parametrize("angle_deg", [0.0, 2.0, -2.0])
def test_sharp_inner_corners_are_named_as_of_upright_walls(tmp_path, angle_deg):
    file = tmp_path / "corner.ngc"  # one inner corner and five outer ones
    file.write_text("G21 G90\nG0 X1 Y-1\nG42 D1 G1 X1 Y0\nX9\nY9\nX5\nY4\nX0\nY0\nX1\nG40 Y-1\nM2\n")
    path = plan_path(file, OFFSET, auto_offset_mm=OFFSET, taper_deg=angle_deg, guides=[GUIDES])
    named = [notice for notice in path.notices if "inner" in notice]
    assert len(named) == 1
    assert named[0].startswith("1 sharp inner corner")
    assert named[0].endswith("at X5.000 Y4.000 (line 8)")


@pytest.mark.slow
@pytest.mark.parametrize("angle_deg", [-3.0, 0.5])
def test_a_drawing_without_an_approach_tapers_both_ways(angle_deg):
    guides = GuideHeights(-10.0, 12.0, 2.0, 30.0)
    path = plan_path(EXAMPLES / "gear.dxf", OFFSET, auto_offset_mm=OFFSET, taper_deg=angle_deg, guides=[guides])
    assert all(contour.lean is not None for contour in path.contours)


def test_without_taper_a_path_is_what_it_was():
    plain = plan_path(EXAMPLES / "punch.ngc", OFFSET, auto_offset_mm=OFFSET)
    known = plan_path(EXAMPLES / "punch.ngc", OFFSET, auto_offset_mm=OFFSET, guides=[GUIDES], taper_deg=0.0)
    assert (plain.contours[0].points_um == known.contours[0].points_um).all()
    assert known.contours[0].lean is None


def test_next_to_is_the_offset_itself_where_a_wall_is_upright():
    outline = replace(square(), taper=Taper(upper_mm=square().points_mm))
    wall, _ = wall_and_wire(outline, OFFSET, GUIDES)
    for points in (offset_surface(wall, -OFFSET).lower_mm, offset_surface(wall, -OFFSET).upper_mm):
        np.testing.assert_allclose(points, wall.lower_mm * (1 + OFFSET / 3.0))
