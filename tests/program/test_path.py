"""The wire's path: at the offset from the edge, in the waste, in whole um on the table."""

import math

import ezdxf
import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from edmsim.errors import InputError
from edmsim.program import load_program, plan_path
from edmsim.program.outline import signed_area
from edmsim.program.path import STOCK_MARGIN_MM

OFFSET_MM = 0.155
TABLE_UM = 65_000
PUNCH = "G92 X5 Y-2\nG41 D0 G1 X5 Y0\nX0\nY8\nX10\nY0\nX5\nG40 Y-2\nM02\n"
ROBOFIL = "G92\nG42 D0\nG90\nG0 X5.0 Y0\nG1 X0\nY8\nX10\nY0\nX5\nM02\n"
ROUNDING_MM = 0.002
"""Greatest deviation of the offset by whole um, simplification, and chords round corners."""


@pytest.fixture
def plan(tmp_path):
    def plan_text(text, offset="auto", name="part.ngc", **settings):
        file = tmp_path / name
        file.write_text(text)
        return plan_path(file, offset, **{"auto_offset_mm": OFFSET_MM, **settings})

    return plan_text


@pytest.fixture
def plan_drawing(tmp_path):
    def plan_drawn(draw, offset="auto", **settings):
        document = ezdxf.new()
        document.units = 4
        draw(document.modelspace())
        document.saveas(tmp_path / "part.dxf")
        return plan_path(tmp_path / "part.dxf", offset, **{"auto_offset_mm": OFFSET_MM, **settings})

    return plan_drawn


def cut_points(contour):
    return contour.points_um[contour.lead_in_moves :] / 1000


def distances(contour, points):
    return shapely.distance(shapely.LineString(contour.nominal_mm), shapely.points(points))


def check_offset(contour, offset_mm):
    """Check the offset at all points and middles of moves, its side, and the lead-in."""
    path = cut_points(contour)
    middles = (path[1:] + path[:-1]) / 2
    assert abs(distances(contour, path) - offset_mm).max() < ROUNDING_MM
    assert abs(distances(contour, middles) - offset_mm).max() < ROUNDING_MM
    lead = contour.points_um[: contour.lead_in_moves + 1] / 1000
    if len(lead) > 1:
        edge = shapely.LineString(contour.nominal_mm)
        assert shapely.LineString(lead).distance(edge) > offset_mm - ROUNDING_MM
    if contour.closed:
        polygon = shapely.Polygon(contour.nominal_mm)
        part_inside = (signed_area(contour.nominal_mm) > 0) == (contour.part_side == "left")
        assert (shapely.contains_xy(polygon, *path.T) != part_inside).all()
        assert polygon.contains(shapely.Point(lead[0])) != part_inside
        assert (path[0] == path[-1]).all()
        assert np.sign(signed_area(path)) == np.sign(signed_area(contour.nominal_mm))


def check_job(path):
    """Check properties of all planned paths."""
    for contour in path.contours:
        points = contour.points_um
        assert points.dtype == np.int64
        assert points.min() >= 0
        assert points.max() <= TABLE_UM
        assert (np.diff(points, axis=0) != 0).any(axis=1).all()
        assert len(contour.line_numbers) == len(points) - 1
        assert all(0 <= i < len(points) and seconds >= 0 for i, seconds in contour.dwells)
    every = np.concatenate([contour.points_um for contour in path.contours])
    assert abs(every.min(axis=0) + every.max(axis=0) - TABLE_UM).max() <= 1
    low, high = every.min(axis=0) / 1000, every.max(axis=0) / 1000
    assert (np.array(path.stock_mm[:2]) <= np.maximum(low - STOCK_MARGIN_MM, 0) + 1e-9).all()
    assert (np.array(path.stock_mm[2:]) >= np.minimum(high + STOCK_MARGIN_MM, TABLE_UM / 1000) - 1e-9).all()


def test_a_punch_by_hand(plan):
    """Compensation left of a clockwise square: outside, beginning at the offset from the start, round the corners."""
    path = plan(PUNCH)
    (contour,) = path.contours
    check_job(path)
    check_offset(contour, OFFSET_MM)
    origin = np.array(path.origin_mm)
    drawn = contour.points_um / 1000 - origin
    assert drawn[0] == pytest.approx([5, -2])
    assert drawn[1] == pytest.approx([5, -OFFSET_MM])
    assert drawn[-1] == pytest.approx([5, -OFFSET_MM])
    assert contour.lead_in_moves == 1
    assert (contour.closed, contour.part_side) == (True, "right")
    assert (contour.nominal_mm - origin).tolist() == pytest.approx(
        np.array([[5, 0], [0, 0], [0, 8], [10, 8], [10, 0], [5, 0]]))
    length = np.hypot(*np.diff(cut_points(contour), axis=0).T).sum()
    assert length == pytest.approx(36 + math.tau * OFFSET_MM, abs=0.01)
    assert path.offset_um == pytest.approx(155)
    assert list(dict.fromkeys(contour.line_numbers)) == [2, 3, 4, 5, 6, 7]
    assert list(contour.line_numbers) == sorted(contour.line_numbers)


def test_a_program_without_approach_gets_one_on_the_waste_side_and_says_so(plan):
    path = plan(ROBOFIL)
    (contour,) = path.contours
    check_job(path)
    check_offset(contour, OFFSET_MM)
    assert contour.part_side == "left"
    drawn = contour.points_um[:2] / 1000 - np.array(path.origin_mm)
    assert drawn == pytest.approx(np.array([[5, OFFSET_MM + 1.0], [5, OFFSET_MM]]))
    assert contour.line_numbers[0] == 0
    assert any("lead-in" in notice for notice in path.notices)


polygons = st.lists(st.floats(4.0, 12.0), min_size=4, max_size=9)


@pytest.mark.slow
@given(
    radii=polygons, clockwise=st.booleans(), side=st.sampled_from(["G41", "G42"]), offset=st.floats(0.05, 0.4)
)
def test_every_point_keeps_the_offset_on_the_right_side(tmp_path_factory, radii, clockwise, side, offset):
    angles = np.linspace(0, math.tau, len(radii), endpoint=False) * (-1 if clockwise else 1)
    corners = np.round(np.column_stack([radii * np.cos(angles), radii * np.sin(angles)]), 3)
    moves = "".join(f"G1 X{x:.3f} Y{y:.3f}\n" for x, y in [*corners[1:], corners[0]])
    file = tmp_path_factory.mktemp("star") / "star.iso"
    file.write_text(f"{side} D1\nG0 X{corners[0][0]:.3f} Y{corners[0][1]:.3f}\n{moves}M02\n")
    path = plan_path(file, offset, auto_offset_mm=1.0)
    check_job(path)
    check_offset(path.contours[0], offset)
    assert path.contours[0].part_side == ("right" if side == "G41" else "left")


def test_the_modes_of_offset(plan):
    drawn = plan(PUNCH, "none")
    assert drawn.offset_um == 0
    contour = drawn.contours[0]
    assert distances(contour, cut_points(contour)).max() < 1e-6
    assert plan(PUNCH, 0.3).offset_um == pytest.approx(300)
    assert plan(PUNCH, "0.3").offset_um == pytest.approx(300)
    check_offset(plan(PUNCH, 0.3).contours[0], 0.3)


@pytest.mark.parametrize(("thread", "part_side", "inside"), [("X5 Y-2", "right", True), ("X5 Y4.0", "left", False)])
def test_without_compensation_the_wire_is_as_programmed(plan, thread, part_side, inside):
    text = PUNCH.replace("G41 D0", "").replace("X5 Y-2", thread, 1)
    path = plan(text)
    contour = path.contours[0]
    drawn = cut_points(contour) - np.array(path.origin_mm)
    assert drawn == pytest.approx(np.array([[5, 0], [0, 0], [0, 8], [10, 8], [10, 0], [5, 0]]))
    assert contour.part_side == part_side
    assert list(dict.fromkeys(line for _, line in contour.elements)) == [3, 4, 5, 6, 7]
    size = np.ptp(contour.nominal_mm, axis=0)
    sign = -1 if inside else 1
    assert size == pytest.approx([10 + sign * 2 * OFFSET_MM, 8 + sign * 2 * OFFSET_MM], abs=1e-6)
    assert path.offset_um == pytest.approx(155)


def test_an_open_slot(plan):
    path = plan("G0 X0 Y0\nG1 X4.0\nG4 P1.5\nG1 X8\nY5\n")
    (contour,) = path.contours
    check_job(path)
    drawn = contour.points_um / 1000 - np.array(path.origin_mm)
    assert drawn == pytest.approx(np.array([[0, 0], [4, 0], [8, 0], [8, 5]]))
    assert (contour.closed, contour.part_side, contour.lead_in_moves) == (False, "left", 0)
    assert contour.dwells == ((1, 1.5),)
    assert contour.line_numbers == (2, 4, 5)
    nominal = contour.nominal_mm - np.array(path.origin_mm)
    assert nominal == pytest.approx(np.array([[0, 0.155], [7.845, 0.155], [7.845, 5]]))


def test_dwells_stay_at_their_corner_next_to_the_edge(plan):
    path = plan(PUNCH.replace("X0\n", "X2.5\nG4 P2\nX0\nG4 X3\n", 1).replace("G41", "G4 P1\nG1 X4\nG41", 1))
    (contour,) = path.contours
    spots = [(contour.points_um[i] / 1000 - np.array(path.origin_mm)).tolist() for i, _ in contour.dwells]
    assert [seconds for _, seconds in contour.dwells] == [1, 2, 3]
    assert spots[0] == pytest.approx([5, -2])
    assert spots[1] == pytest.approx([2.5, -OFFSET_MM])
    assert spots[2] == pytest.approx([0, -OFFSET_MM], abs=2e-3)


def test_a_rounded_lead_in_is_offset_like_the_contour(plan):
    path = plan("G92 X3 Y-3.0\nG41 G1 X4 Y-1\nX6\nG3 X5 Y0 I-1 J0\nG1 X0\nY8\nX10\nY0\nX5\nM02\n")
    (contour,) = path.contours
    check_job(path)
    check_offset(contour, OFFSET_MM)
    assert contour.lead_in_moves > 3
    assert set(contour.line_numbers[: contour.lead_in_moves]) == {2, 3, 4}
    before, after = np.diff(contour.points_um[contour.lead_in_moves - 1 : contour.lead_in_moves + 2], axis=0)
    turn = math.atan2(before[0] * after[1] - before[1] * after[0], before @ after)
    assert abs(turn) < 0.15


def test_drawings_hole_first_then_outside(plan_drawing):
    def draw(space):
        space.add_circle((0, 0), 10)
        space.add_circle((0, 0), 2)

    path = plan_drawing(draw)
    check_job(path)
    for contour, radius in zip(path.contours, (2 - OFFSET_MM, 10 + OFFSET_MM), strict=True):
        check_offset(contour, OFFSET_MM)
        assert contour.part_side == "left"
        distance = np.hypot(*(cut_points(contour) - np.array(path.origin_mm)).T)
        assert distance == pytest.approx(np.full(len(distance), radius), abs=3e-3)
        hole = shapely.Point(contour.points_um[0] / 1000).buffer(path.start_hole_radius_mm)
        assert all(hole.distance(shapely.LineString(other.nominal_mm)) > 0 for other in path.contours)


def test_a_lead_in_without_room_is_shortened_and_reported(plan_drawing):
    path = plan_drawing(lambda space: (space.add_circle((0, 0), 0.6), space.add_circle((0, 0), 9)))
    check_offset(path.contours[0], OFFSET_MM)
    assert any("as there is no more room" in notice for notice in path.notices)


def narrow_neck(space):
    right = [(8, 2), (8, 0), (13, 0), (13, 5), (8, 5), (8, 2.2)]
    space.add_lwpolyline([(0, 0), (5, 0), (5, 2), *right, (5, 2.2), (5, 5), (0, 5)], close=True)
    space.add_lwpolyline([(-5, -5), (20, -5), (20, 10), (-5, 10)], close=True)


def narrow_slot(space):
    slotted = [(0, 0), (4.9, 0), (4.9, 3), (5.1, 3), (5.1, 0), (10, 0), (10, 5), (0, 5)]
    space.add_lwpolyline(slotted, close=True)


def pinched_pocket(space):
    left, right = [(0, 0), (4.9, 0), (4.9, 2), (3, 2), (3, 4)], [(7, 4), (7, 2), (5.1, 2), (5.1, 0), (10, 0)]
    space.add_lwpolyline([*left, *right, (10, 6), (0, 6)], close=True)


def tiny_hole(space):
    space.add_circle((0, 0), 0.15)
    space.add_circle((0, 0), 9)


def no_room(space):
    space.add_circle((0, 0), 0.29)
    space.add_circle((0, 0), 9)


def neighbours(space):
    space.add_circle((0, 0), 3)
    space.add_circle((6.25, 0), 3)


@pytest.mark.parametrize(("draw", "words"), [
    (narrow_neck, ("too narrow", "0.1550", "pieces")), (narrow_slot, ("too narrow", "metal would stay at X5.0")),
    (pinched_pocket, ("too narrow", "X5.000 Y3.000")), (tiny_hole, ("too narrow",)), (neighbours, ("too near",)),
    (no_room, ("no room for a start hole of 0.25",)),
    (lambda space: space.add_circle((0, 0), 33), ("66.", "65 x 65")),
])  # fmt: skip
def test_where_the_wire_does_not_fit_it_says_so(plan_drawing, draw, words):
    with pytest.raises(InputError) as caught:
        plan_drawing(draw)
    for word in words:
        assert word in caught.value.reason


def test_a_slot_as_wide_as_the_wire_needs_is_cut(plan_drawing):
    check_offset(plan_drawing(narrow_slot, 0.095).contours[0], 0.095)


@pytest.mark.parametrize(("old", "new", "word"), [
    ("G41", "G42", "exchange G41 and G42"), ("G92 X5 Y-2", "G92 X5 Y-0.2", "is 0.200 mm from the part"),
    ("G92 X5 Y-2", "G92 X12 Y12", "cuts into the part"),
])  # fmt: skip
@pytest.mark.parametrize("offset", ["auto", "none"])
def test_an_approach_through_the_part_is_refused(plan, old, new, word, offset):
    with pytest.raises(InputError) as caught:
        plan(PUNCH.replace(old, new, 1), offset)
    assert caught.value.line == 3
    assert word in caught.value.reason


def test_an_approach_in_line_with_the_first_side_is_cut(plan):
    text = "G92 X0 Y{}\nG41 G1 Y0\nY6\nX10\nY0\nX0\nG40\nM2\n"
    assert plan(text.format("-1.")).contours[0].lead_in_moves == 1
    with pytest.raises(InputError, match=r"cuts into the part.* further away"):
        plan(text.format("-0.3"))


@pytest.mark.parametrize(("thread", "crosses"), [("X2 Y2", True), ("X7 Y2", False)])
def test_a_way_to_a_contour_through_another_ones_part_is_named(plan, thread, crosses):
    first, second = ("G41 G1 X{0} Y2\nY4\nX{1}\nY0\nX{0}\nY2\nG40\n".format(*sides) for sides in ((0, 4), (10, 14)))
    notices = plan(f"G21 G90\nG0 X-1.5 Y2\n{first}G0 {thread}\n{second}M2\n").notices
    assert any("wire cuts into the contour from X0.000 Y2.000" in notice for notice in notices) is crosses


@pytest.mark.parametrize(("settings", "word"), [
    ({"offset": "wide"}, "'wide'"), ({"offset": -0.1}, "-0.1"), ({"offset": math.nan}, "nan"),
    ({"auto_offset_mm": math.inf}, "inf"), ({"lead_in_mm": 0.0}, "lead_in_mm is 0.0"),
    ({"start_hole_radius_mm": -1.0}, "start_hole_radius_mm is -1.0"),
])  # fmt: skip
def test_bad_settings_are_refused(plan, settings, word):
    with pytest.raises(InputError, match=word):
        plan(PUNCH, **settings)


@pytest.mark.parametrize("name", ["part.ngc", "part.dxf"])
def test_missing_files_and_directories_are_refused(tmp_path, name):
    with pytest.raises(InputError, match="no such file"):
        load_program(tmp_path / name)
    (tmp_path / name).mkdir()
    with pytest.raises(InputError, match="directory"):
        load_program(tmp_path / name)


def test_other_suffixes_are_refused(plan):
    with pytest.raises(InputError, match=r"unknown suffix '\.step'"):
        plan(PUNCH, name="part.step")


def test_a_contour_within_a_micrometre_is_refused(plan):
    with pytest.raises(InputError, match="moves the wire by less than a um") as caught:
        plan("G0 X-5. Y0\nG1 X-2.\nG0 X0 Y0\nG1 X.0004\nM2\n")
    assert caught.value.line == 4
    assert len(plan("G0 X0 Y0\nG1 X.001\nM2\n").contours[0].points_um) == 2


def test_options_of_the_other_kind_of_file_are_refused():
    with pytest.raises(InputError, match=r"a\.ngc: layers: a drawing has this, leave it out here"):
        load_program("a.ngc", layers=["0"])
    with pytest.raises(InputError, match=r"a\.dxf: ignore and offsets and dialect and conditions: G-code has this"):
        load_program("a.dxf", ignore=["M77"], offsets="a.toml", dialect="sodick", conditions="b.toml")


@pytest.mark.parametrize("suffix", [".ngc", ".NC", ".gcode", ".ISO", ".txt"])
def test_the_suffix_chooses_the_reader(tmp_path, suffix):
    file = tmp_path / f"part{suffix}"
    file.write_text(PUNCH)
    assert load_program(file).outlines[0].closed
