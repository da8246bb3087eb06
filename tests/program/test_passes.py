"""Passes of a contour: offsets, tab, overlap, directions, and passes of the program itself."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import shapely

from edmsim.closed_loop.passes import legs_of
from edmsim.errors import InputError
from edmsim.program.passes import PassPlan
from edmsim.program.path import load_program, plan_path
from edmsim.program.taper import GuideHeights

SQUARE = "G21 G90\nG0 X-1.5 Y2\nG41 G1 X0\n{}G40\nM2\n"
ROUND = "Y4\nX4\nY0\nX0\nY2\n"
AROUND = SQUARE.format(ROUND)
OFFSETS_MM = (0.25, 0.2, 0.15)


def plan(folder, text=AROUND, passes=None, **settings):
    file = folder / "a.ngc"
    file.write_text(text)
    return plan_path(file, auto_offset_mm=0.2, passes=passes, **settings)


def of_square(folder, offsets_mm=OFFSETS_MM, **plan_options):
    return plan(folder, passes=PassPlan(offsets_mm, **plan_options)).contours[0]


def test_rough_forward_trims_to_and_fro_then_the_tab(tmp_path):
    """Usual order: the profile without the tab, forwards and backwards, then the tab, rough pass first."""
    contour = of_square(tmp_path, tab_mm=1.5)
    assert [(p.number, p.piece, p.reversed, p.frees) for p in contour.passes] == [
        (1, "profile", False, False), (2, "profile", True, False), (3, "profile", False, False),
        (1, "tab", False, True), (2, "tab", True, False), (3, "tab", False, False),
    ]  # fmt: skip
    assert contour.offset_um == 150.0  # the offset of the last pass
    for before, now in zip(contour.passes, contour.passes[1:], strict=False):
        np.testing.assert_array_equal(before.points_um[-1], now.points_um[0])  # the wire stays threaded


def test_offsets_of_planned_passes_win_over_a_register_with_a_notice(tmp_path):
    text = AROUND.replace("G41", "G10 L12 P1 R0.19\nD1 G41")
    path = plan(tmp_path, text, PassPlan(OFFSETS_MM))
    assert [one.offset_um for one in path.contours[0].passes] == [250.0, 200.0, 150.0] * 2
    assert "the passes have the offsets 0.25, 0.2, 0.15 mm, not the 0.19 mm of the register" in path.notices
    assert not [notice for notice in plan(tmp_path, AROUND, PassPlan(OFFSETS_MM)).notices if "not the" in notice]


def test_the_tab_stays_until_its_own_passes(tmp_path):
    contour = of_square(tmp_path, tab_mm=1.5)
    around = 16.0
    rough, tab = contour.passes[0], contour.passes[3]
    corners = 3 * np.pi / 2 * 0.25  # of three corners; the path goes round the fourth, too
    assert rough.length_mm == pytest.approx(around - 1.5 + corners + np.pi / 2 * 0.25, abs=0.01)
    assert tab.length_mm == pytest.approx(1.5 + 2 * 0.1, abs=0.01)
    trims = [p.length_mm for p in contour.passes if p.piece == "profile"]
    assert trims[0] > trims[1] > trims[2]  # each ends before the round front of the rough pass
    assert contour.passes[5].length_mm > contour.passes[4].length_mm > tab.length_mm


def test_without_a_tab_passes_go_all_round(tmp_path):
    contour = of_square(tmp_path, tab_mm=0.0)
    assert [(p.number, p.reversed, p.frees) for p in contour.passes] == [
        (1, False, True), (2, True, False), (3, False, False),
    ]  # fmt: skip
    assert all(p.length_mm > 16.0 for p in contour.passes)


def test_one_offset_is_one_pass(tmp_path):
    path = plan(tmp_path, passes=PassPlan((0.2,)))
    assert path.passes == 1
    assert path.contours[0].passes == ()
    np.testing.assert_array_equal(path.contours[0].points_um, plan(tmp_path).contours[0].points_um)


def test_a_contour_that_a_program_with_passes_cuts_once_has_a_rough_pass(tmp_path):
    head, rough = "G21 G90\nD1=0.25\nD2=0.2\nG0 X2 Y-1\n", "G41 D1 G1 X2 Y0\nX0\nY4\nX4\nY0\nX2\nG40\n"
    trim, apart = "G42 D2 G1 X2 Y0\nX4\nY4\nX0\nY0\nX2\nG40\n", "G0 X12 Y-1\n"
    once, drawn = rough.replace("X", "X1"), "G0 X20 Y0\nG1 X22\n"
    path = plan(tmp_path, head + rough + "G1 Y-1\n" + trim + apart + once + drawn + "M2\n")
    passes = [[(p.number, p.frees) for p in contour.passes] for contour in path.contours]
    assert passes == [[(1, True), (2, False)], [(1, True)], []]
    (alone,) = plan(tmp_path, head + apart + once + "M2\n").contours
    (again,) = path.contours[1].passes
    moved = again.points_um - again.points_um[0]
    np.testing.assert_array_equal(moved, alone.points_um - alone.points_um[0])


@pytest.mark.parametrize("offsets_mm", [(0.25, 0.2), (0.25, 0.2, 0.15)])
def test_points_are_on_the_grid_and_within_the_table(tmp_path, offsets_mm):
    fine, contour = (plan(tmp_path, passes=PassPlan(offsets_mm), grid_um=um).contours[0] for um in (1, 2))
    for way, fine_way in zip(contour.guide_paths_um, fine.guide_paths_um, strict=True):
        assert not (way % 2).any()
        np.testing.assert_allclose(np.ptp(way, axis=0), np.ptp(fine_way, axis=0), atol=2.0)
        assert way.min() >= 0
        assert way.max() <= 65_000


@pytest.mark.parametrize("offsets_mm", [OFFSETS_MM, OFFSETS_MM[:2]])
def test_a_long_overlap_leads_no_pass_once_more_round_the_contour(tmp_path, offsets_mm):
    """The move there would cut the tab before the stop."""
    contour = of_square(tmp_path, offsets_mm, overlap_mm=3.0)
    for one in contour.passes[1:]:
        assert one.wire_path.along_um[one.approach_moves] < 5000


@pytest.mark.parametrize("tab_mm", [0.0, 0.5, 1.0, 1.8, 1.9, 1.95, 2.0, 2.05, 3.0])
@pytest.mark.parametrize(
    "begin", ["X-1.5 Y2\nG41 G1 X0\nY4\nX4\nY0\nX0\nY2", "X-1 Y-1\nG41 G1 X0 Y0\nY4\nX4\nY0\nX0"]
)
def test_no_way_from_one_pass_to_the_next_cuts_a_corner(tmp_path, tab_mm, begin):
    """If a tab ends just after an outer corner, the wire goes round the corner to the next pass, not straight."""
    offsets_mm = (0.27, 0.203, 0.158, 0.14)
    text = f"G21 G90\nG0 {begin}\nG40\nM2\n"
    contour = plan(tmp_path, text, passes=PassPlan(offsets_mm, tab_mm=tab_mm)).contours[0]
    edge = shapely.LineString(contour.nominal_mm)
    for before, one in pairwise(contour.passes):
        nearest = min(before.offset_um, one.offset_um) * 1e-3
        assert edge.distance(shapely.LineString(one.points_um * 1e-3)) > nearest - 2e-3
        place = shapely.Point(one.points_um[one.approach_moves] * 1e-3)
        assert edge.distance(place) == pytest.approx(one.offset_um * 1e-3, abs=2e-3)


@pytest.mark.parametrize("tab_mm", [0.0, 1.5])
def test_a_dwell_is_waited_for_in_every_pass_that_comes_by(tmp_path, tab_mm):
    text = SQUARE.format("Y3\nG4 P2.5\nY4\nX4\nY0\nX0\nY2\n")
    path = plan(tmp_path, text, passes=PassPlan(OFFSETS_MM, tab_mm=tab_mm))
    (contour,) = path.contours
    profile = [one for one in contour.passes if one.piece == "profile"]
    corner = contour.nominal_mm[0] + (0.0, 1.0)
    for one in profile:
        ((i, seconds),) = one.dwells
        assert seconds == 2.5
        np.testing.assert_allclose(one.points_um[i], 1e3 * (corner - (one.offset_um * 1e-3, 0.0)), atol=1.0)
    assert all(not one.dwells for one in contour.passes if one.piece == "tab")
    assert contour.waiting_s == 2.5 * len(profile)
    legs = legs_of(path)
    assert [leg.dwell_s for leg in legs if leg.dwell_s] == [2.5] * len(profile)
    for before, leg in pairwise(legs):
        np.testing.assert_array_equal(before.points_um[-1], leg.points_um[0])
    # a pass that runs against the contour's direction has the part on its other side
    other = {"left": "right", "right": "left"}
    for leg in legs:
        assert leg.part_side == (other[contour.part_side] if leg.cut_pass.reversed else contour.part_side)


def test_dwells_of_a_program_stay_in_its_passes(tmp_path):
    """Dwells on the move to each pass, and within the second pass alone."""
    back = "Y0\nX4\nG4 P3\nY4\nX0\nY2\n"
    text = "G21 G90\nD1=0.25\nD2=0.2\nG0 X-1.5 Y2\nG41 D1 G1 X-1\nG4 P1\nX0\n" + ROUND + "G40\n"
    again = AGAIN.format("G42", "D2", back).replace("Y2\n", "Y2\nG4 P2\n", 1)
    contour = plan(tmp_path, text + again + "M2\n").contours[0]
    first, second = contour.passes
    assert [seconds for _, seconds in first.dwells] == [1.0]
    place = first.points_um[first.dwells[0][0]] * 1e-3 - contour.nominal_mm[0]
    np.testing.assert_allclose(place, (-1.0, 0.25))  # at the offset, because of G41
    assert [seconds for _, seconds in second.dwells] == [2.0, 3.0]
    assert second.dwells[0][0] == second.approach_moves  # the wire stays threaded, and waits where this pass begins
    place = second.points_um[second.dwells[1][0]] * 1e-3 - contour.nominal_mm[0]
    np.testing.assert_allclose(place, (4.2, -2.0), atol=0.21)


GUIDES = GuideHeights(-10.0, 20.0, 10.0, 30.0)


@pytest.mark.parametrize("corners", ["conical", "sharp"])
@pytest.mark.parametrize("angle_deg", [3.0, -3.0])
def test_passes_of_a_leaning_wire_keep_their_offsets_at_every_height(tmp_path, angle_deg, corners):
    """In a horizontal plane, the wire's centre is offset / cos a from a wall that leans by a."""
    path = plan(
        tmp_path, passes=PassPlan(OFFSETS_MM, tab_mm=1.2), taper_deg=angle_deg, corners=corners, guides=[GUIDES]
    )
    (contour,) = path.contours
    assert [(p.number, p.piece, p.reversed) for p in contour.passes] == [
        (1, "profile", False), (2, "profile", True), (3, "profile", False),
        (1, "tab", False), (2, "tab", True), (3, "tab", False),
    ]  # fmt: skip
    cosine = np.cos(np.radians(angle_deg))
    for one, leg in zip(contour.passes, legs_of(path)[1:], strict=True):
        for z in (0.0, 5.0, 10.0):
            wall = shapely.LineString(contour.at_height(z).nominal_mm)
            way = one.at_height(z).points_um[one.approach_moves :] * 1e-3
            assert wall.distance(shapely.LineString(way)) == pytest.approx(one.offset_um * 1e-3 / cosine, abs=3e-3)
        np.testing.assert_array_equal(leg.lead_um[-1], one.lean.upper_um[-1])
    for before, now in pairwise(contour.passes):
        np.testing.assert_array_equal(before.points_um[-1], now.points_um[0])
        np.testing.assert_array_equal(before.lean.upper_um[-1], now.lean.upper_um[0])


@pytest.mark.parametrize("corners", ["conical", "sharp"])
def test_every_place_of_a_leaning_wall_is_passed_by_every_pass(tmp_path, corners):
    contour = plan(
        tmp_path, passes=PassPlan(OFFSETS_MM, tab_mm=1.2), taper_deg=3.0, corners=corners, guides=[GUIDES]
    ).contours[0]
    for number in (1, 2, 3):
        for z in (0.0, 10.0):
            wall = shapely.LineString(contour.at_height(z).nominal_mm)
            ways = [p.at_height(z).points_um[p.approach_moves :] * 1e-3 for p in contour.passes if p.number == number]
            lines = shapely.union_all([shapely.LineString(way) for way in ways])
            places = shapely.line_interpolate_point(wall, np.arange(0.0, wall.length, 0.02))
            corner_mm = np.sqrt(2) if corners == "sharp" else 1.0
            assert shapely.distance(places, lines).max() < OFFSETS_MM[number - 1] * corner_mm + 3e-3


def test_the_passes_of_two_contours_go_round_as_often(tmp_path):
    file = Path(__file__).parents[2] / "examples" / "square_to_round.dxf"
    program = load_program(file, upper_layer="UPPER")
    path = plan_path(program, auto_offset_mm=0.2, passes=PassPlan(OFFSETS_MM), guides=[GUIDES])
    contour = path.contours[0]
    assert [one.number for one in contour.passes] == [1, 2, 3, 1, 2, 3]
    assert path.leans
    assert contour.length_um == pytest.approx(sum(one.wire_path.along_um[-1] for one in contour.passes))


AGAIN = "G0 X-1.5 Y2\n{} G1 X0 {}\n{}G40\n"


def twice(first_mm, second_mm, code="G41", way=ROUND):
    """Return a program that cuts a square, and then cuts again with a code and along a path."""
    head = f"G21 G90\nD1={first_mm}\nD2={second_mm}\n"
    return head + AGAIN.format("G41", "D1", ROUND) + AGAIN.format(code, "D2", way) + "M2\n"


THREADED, ON_CONTOUR = "G0 X{hole} Y2\n{code} {d} G1 X{x}\n", "{code} {d} G0 X{x} Y2\nG1\n"
STAYS = {0: "G1 X7\nY6\nX-1\nY2\n{code} {d} X{x}\n", 8: "G1 X-1\nY6\nX7\nY2\n{code} {d} X{x}\n"}


def two_squares(order, way=THREADED, later=None):
    """Return a program that cuts two squares rough and back, in an order of (left edge, pass)."""
    text = "G21 G90\nD1=0.25\nD2=0.2\n"
    for k, (x, number) in enumerate(order):
        to = (later or {}).get(x, way) if k else way
        text += to.format(hole=x - 1.5, x=x, d=f"D{number}", code="G41" if number == 1 else "G42")
        y, back = (4, 0) if number == 1 else (0, 4)
        text += f"Y{y}\nX{x + 4}\nY{back}\nX{x}\nY2\nG40\n"
    return text + "M2\n"


SHOP, BY_CONTOUR = ((0, 1), (8, 1), (0, 2), (8, 2)), ((0, 1), (0, 2), (8, 1), (8, 2))


@pytest.mark.parametrize("way", [THREADED, ON_CONTOUR])
def test_all_rough_passes_may_come_before_the_trims(tmp_path, way):
    """The passes are those of a program that trims each contour at once; a trim is threaded where it says."""
    path, known = (plan(tmp_path, two_squares(order, way)) for order in (SHOP, BY_CONTOUR))
    assert [notice.split(": ")[1] for notice in path.notices] == [n.split(": ")[1] for n in known.notices]
    for contour, other in zip(path.contours, known.contours, strict=True):
        assert [(p.offset_um, p.reversed) for p in other.passes] == [(250.0, False), (200.0, True)]
        assert other.offset_um == 200.0
        np.testing.assert_array_equal(contour.points_um, other.points_um)
        for one, same in zip(contour.passes, other.passes, strict=True):
            what = one.number, one.piece, one.offset_um, one.reversed, one.frees
            assert what == (same.number, same.piece, same.offset_um, same.reversed, same.frees)
            np.testing.assert_array_equal(one.points_um[one.approach_moves :], same.points_um[same.approach_moves :])
            start = contour.points_um[0] if one.threads else same.points_um[0]
            np.testing.assert_array_equal(one.points_um[0], start)
        assert (contour.threads, other.threads) == ((True, True), (True, False))
    threaded = [leg.cut_pass for leg in legs_of(path) if leg.threads]
    assert threaded == [path.contours[k].passes[number] for k, number in ((0, 0), (1, 0), (0, 1), (1, 1))]


def test_trims_after_other_contours_may_be_reached_with_a_threaded_wire(tmp_path):
    path = plan(tmp_path, two_squares(SHOP, later=STAYS))
    assert [contour.threads for contour in path.contours] == [(True, False), (False, False)]
    begins = [contour.guide_paths_um[number][0] * 1e-3 - path.origin_mm for contour, number in path.cuts]
    np.testing.assert_allclose(begins, [(-1.5, 2), (-1, 2), (7, 2), (-1, 2)], atol=1e-9)
    legs = legs_of(path)
    assert [leg.cut_pass.number for leg in legs if not leg.leads_in] == [1, 1, 2, 2]
    assert [leg.threads for leg in legs] == [True, *[False] * 5]


def test_passes_of_a_contour_are_found_in_any_order(tmp_path):
    order = (8, 1), (0, 1), (0, 2), (8, 2)
    path = plan(tmp_path, two_squares(order))
    assert [[one.number for one in contour.passes] for contour in path.contours] == [[1, 2], [1, 2]]
    cuts = [(float(contour.nominal_mm[0, 0]) - path.origin_mm[0], number + 1) for contour, number in path.cuts]
    assert cuts == [(pytest.approx(x), number) for x, number in order]


ELSEWHERE = AGAIN.format("G41", "D1", ROUND) + "X-1\n{}G42 D2 G1 Y4\nX0\nY0\nX4\nY4\nX2\nG40\nM2\n"
"""A square whose second pass runs backwards, from the middle of its upper side."""


@pytest.mark.parametrize(("way", "threads"), [("Y5\nX2\n", False), ("G0 X2 Y5.5\n", True)])
def test_a_trim_that_begins_elsewhere_goes_there_as_the_program_says(tmp_path, way, threads):
    path = plan(tmp_path, "D1=0.25\nD2=0.2\n" + ELSEWHERE.format(way))
    (contour,) = path.contours
    rough, trim = contour.passes
    origin_um = 1e3 * np.array(path.origin_mm)
    ways = [(2, 5.5), (2, 4.2)] if threads else [(-0.25, 2), (-1, 2), (-1, 5), (2, 5), (2, 4.2)]
    np.testing.assert_allclose(trim.points_um[: trim.approach_moves + 1] - origin_um, 1e3 * np.array(ways), atol=1)
    edge = shapely.LineString(contour.nominal_mm)
    assert edge.distance(shapely.LineString(trim.points_um * 1e-3)) == pytest.approx(0.2, abs=2e-3)
    assert (trim.reversed, trim.threads, contour.threads) == (True, threads, (True, threads))
    assert [leg.threads for leg in legs_of(path)] == [True, False, threads]
    assert len(path.start_holes_um) == 1 + threads
    # the edge has the direction of the contour, also if the last pass has not
    np.testing.assert_allclose(contour.nominal_mm[:3] - path.origin_mm, [(0, 2), (0, 4), (4, 4)])
    assert [element for element, _ in contour.elements] == [1, 2, 3, 4, 5]
    rough_end, begin = rough.points_um[-1], trim.points_um[0]
    assert threads != bool((rough_end == begin).all())


def test_a_trim_cannot_be_reached_through_the_part(tmp_path):
    with pytest.raises(InputError, match=r"the approach from X-1\.000 Y2\.000 cuts into the part"):
        plan(tmp_path, "D1=0.25\nD2=0.2\n" + ELSEWHERE.format("X2\nY5\n"))


@pytest.mark.parametrize(
    ("angles", "named"), [((0, 2), "1 is vertical and pass 2 tilted"), ((2, 0), "1 is tilted and pass 2 vertical")]
)
def test_passes_of_an_edge_are_all_tilted_or_none(tmp_path, angles, named):
    again = "\n".join(f"G0 X-1.5 Y2\nG41 G51 T{deg} G1 X0 D{n}\n{ROUND}G40 G50" for n, deg in enumerate(angles, 1))
    file = tmp_path / "a.nc"
    file.write_text(f"D1=0.25\nD2=0.2\n{again}\nM2\n")
    with pytest.raises(InputError, match=named):
        plan_path(load_program(file, dialect="fanuc"), auto_offset_mm=0.2, guides=[GUIDES])


def test_where_the_wire_goes_on_there_is_no_start_hole(tmp_path):
    """The wire stops in its kerf 0.2 mm from the part, where no hole of 0.25 mm fits, and cuts the tab from there."""
    text = "G0 X2 Y-1.5\nG41 G1 Y0\nX0\nY4\nX4\nY0\nX3\nG40 Y-0.2\nG41 G1 Y0\nX2\nG40\nM2\n"
    path = plan(tmp_path, text)
    assert [contour.threads for contour in path.contours] == [(True,), (False,)]
    np.testing.assert_array_equal(path.start_holes_um, path.contours[0].points_um[:1])


def test_a_program_with_passes_cannot_have_others(tmp_path):
    with pytest.raises(InputError, match="cuts it 2 times, in passes of its own: give no number of passes"):
        plan(tmp_path, twice(0.25, 0.2, "G42", "Y0\nX4\nY4\nX0\nY2\n"), PassPlan(OFFSETS_MM))


def test_the_part_on_the_other_side_is_another_cut(tmp_path):
    text = "G21 G90\nD1=0.25\nD2=0.2\n" + AGAIN.format("G41", "D1", ROUND) + "G0 X2 Y2\nG42 G1 X0 D2\n" + ROUND
    assert len(plan(tmp_path, text + "G40\nM2\n").contours) == 2


@pytest.mark.parametrize(("options", "named"), [
    ({"offsets_mm": (0.15, 0.2)}, "the offset grows from pass 1 to pass 2, 0.15 to 0.2 mm"),
    ({"offsets_mm": ()}, "1 to 9 passes, not in 0"),
    ({"offsets_mm": (0.2, 0.0)}, "an offset of 0 mm leaves no room for a wire"),
    ({"tab_mm": 16.5}, "the tab of 16.5 mm is longer than the contour, 16.000 mm"),
    ({"tab_mm": 15.9}, "leaves 0.100 mm of the contour to cut"), ({"tab_mm": -1.0}, "tab_mm is -1.0"),
    ({"overlap_mm": float("nan")}, "overlap_mm is nan"),
    ({"overlap_mm": 16.5}, "the overlap of 16.5 mm is longer than the contour, 16.000 mm"),
    ({"after_tab": "glue"}, "after_tab is 'glue': the machine can stop before the tab, or cut on"),
])  # fmt: skip
def test_what_cannot_be_cut_is_refused_in_one_line(tmp_path, options, named):
    with pytest.raises(InputError) as refused:
        of_square(tmp_path, options.pop("offsets_mm", OFFSETS_MM), **options)
    assert named in str(refused.value)
    assert "\n" not in str(refused.value)


def test_passes_want_an_edge(tmp_path):
    text = AROUND.replace("G41 ", "")
    with pytest.raises(InputError, match="passes run beside an edge: use G41 or G42"):
        plan(tmp_path, text, passes=PassPlan(OFFSETS_MM))


def test_offsets_of_a_program_may_not_grow(tmp_path):
    with pytest.raises(InputError, match="the offset grows from pass 1 to pass 2") as refused:
        plan(tmp_path, twice(0.2, 0.25))
    assert refused.value.line == 14


def test_planned_trims_go_straight_past_outer_corners_no_further_out_than_the_rough_pass(tmp_path):
    """On an arc a trim stays before the corner's point, and rounds it (row "error of an outer corner")."""
    sharp = "Y4\nX4\nY0\nX2\nY-3\nX0\nY2\n"  # with an inner corner, and one sharper than a right angle
    contour = plan(tmp_path, SQUARE.format(sharp), passes=PassPlan(OFFSETS_MM, tab_mm=0.0)).contours[0]
    edge = shapely.LineString(contour.nominal_mm)
    rough, *trims = contour.passes
    for one in trims:
        points = one.points_um[one.approach_moves :] * 1e-3
        away_mm = shapely.distance(edge, shapely.points(points))
        assert away_mm.min() == pytest.approx(one.offset_um * 1e-3, abs=2e-3)
        assert away_mm.max() == pytest.approx(min(np.sqrt(2) * one.offset_um, rough.offset_um) * 1e-3, abs=2e-3)
        corner = contour.nominal_mm[0] + (-one.offset_um * 1e-3, 2.0 + one.offset_um * 1e-3)
        reaches = shapely.LineString(points).distance(shapely.Point(corner))
        assert reaches == pytest.approx(max(np.sqrt(2) * one.offset_um - rough.offset_um, 0.0) * 1e-3, abs=2e-3)
    places = shapely.distance(edge, shapely.points(rough.points_um[rough.approach_moves :] * 1e-3))
    np.testing.assert_allclose(places, rough.offset_um * 1e-3, atol=2e-3)


def test_a_tab_that_the_rough_pass_cuts_through_is_named(tmp_path):
    """At an inner corner the wire cuts an edge of 0.2 mm without a move along it."""
    inside = "G21 G90\nG0 X2 Y2\nG42 G1 X0 Y0\nY4\nX4\nY0\nX0\nG40\nM2\n"
    for tab_mm, held in ((1.5, True), (0.6, False), (0.2, False)):
        path = plan(tmp_path, inside, passes=PassPlan(OFFSETS_MM, tab_mm=tab_mm))
        named = "the rough pass leaves nothing of the tab of the contour from X0.000 Y0.000"
        assert any(named in notice for notice in path.notices) is not held
    with pytest.raises(InputError, match=r"the tab of 0\.1 mm lies in an inner corner"):
        plan(tmp_path, inside, passes=PassPlan(OFFSETS_MM, tab_mm=0.1, overlap_mm=0.0))


def test_a_planned_trim_does_not_cut_into_the_part_at_a_notch_in_an_outer_corner(tmp_path):
    notched = SQUARE.format("Y4\nX2\nX2.13 Y3.74\nX2.22 Y3.87\nX3 Y1\nX0\nY2\n")
    contour = plan(tmp_path, notched, passes=PassPlan(OFFSETS_MM, tab_mm=0.0)).contours[0]
    edge = shapely.LineString(contour.nominal_mm)
    for one in contour.passes:
        way = shapely.LineString(one.points_um[one.approach_moves :] * 1e-3)
        assert way.distance(edge) > one.offset_um * 1e-3 - 2e-3


def test_a_programs_own_trims_go_round_as_its_rough_pass_does(tmp_path):
    contour = plan(tmp_path, twice(0.25, 0.2)).contours[0]
    edge = shapely.LineString(contour.nominal_mm)
    for one in contour.passes:
        places = shapely.points(one.points_um[one.approach_moves :] * 1e-3)
        np.testing.assert_allclose(shapely.distance(edge, places), one.offset_um * 1e-3, atol=2e-3)
