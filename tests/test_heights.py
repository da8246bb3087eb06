"""Changing heights: regions along the path, what a cut across a step does, what is refused."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import shapely

import edmsim
from edmsim.errors import InputError
from edmsim.job.cut import CHECKPOINT
from edmsim.metrology.kerf import kerf_width
from edmsim.metrology.profile import profile_error
from edmsim.plant.workpiece.height_steps import Relief
from edmsim.program.heights import WIRE_MARGIN_MM, Heights, parse_height
from edmsim.program.path import CutPath, WireContour

from .conftest import FILES, timeless

REACH_UM = 125.0 + 1e3 * WIRE_MARGIN_MM


def path_of(*lines):
    contours = []
    for line in lines:
        points = np.array(line, np.int64) + 30_000
        contours.append(WireContour(points, 0, points * 1e-3, False, "left"))
    return CutPath(tuple(contours), (20.0, 20.0, 45.0, 45.0), 0.5, (30.0, 30.0), (), "test")


def relief(heights, path, n_slices=10):
    return Relief(heights.lower_regions(path, 250.0), heights.greatest_mm, n_slices)


def height_at(found, *points):
    return found.heights_mm(np.array(points) + 30_000.0).round(9).tolist()


def test_the_height_changes_square_across_the_path():
    found = relief(Heights(10.0, [(2.0, 5.0), (3.0, 7.0)]), path_of([(0, 0), (6_000, 0)]))
    for across in (0.0, -REACH_UM + 1, REACH_UM - 1):
        assert height_at(found, (1_999, across), (2_001, across), (2_999, across), (3_001, across)) == [10, 5, 5, 7]
    assert height_at(found, (-REACH_UM + 5, 0), (6_000 + REACH_UM - 5, 0)) == [10, 7]  # before and after the path
    assert height_at(found, (2_500, REACH_UM + 1)) == [10]


def test_heights_count_from_the_start_over_all_contours():
    path = path_of([(0, 0), (2_000, 0)], [(0, 5_000), (3_000, 5_000)])
    found = relief(Heights(10.0, [(0.0, 5.0), (2.5, 10.0)], []), path)
    assert height_at(found, (100, 0), (1_900, 0), (400, 5_000), (600, 5_000)) == [5, 5, 5, 10]


def test_outside_of_a_corner_nothing_is_left_unclaimed():
    """At a corner where the height changes, all metal in reach of the wire has one of the two heights."""
    for end in ([2_000, 3_000], [2_000, -3_000], [4_000, 1_500]):
        path = path_of([(0, 0), (2_000, 0), (end[0], end[1])])
        found = relief(Heights(5.0, [(2.0, 7.0), (3.0, 10.0)], []), path)
        angles = np.linspace(0, 2 * np.pi, 64, endpoint=False)
        ring = [(2_000 + r * np.cos(a), r * np.sin(a)) for a in angles for r in (50.0, 200.0, 400.0)]
        assert set(height_at(found, *ring)) == {5.0, 7.0}
        onward = np.array(end) - [2_000, 0]
        x, y = onward / np.hypot(*onward) * 300.0
        assert height_at(found, (2_000 + x, y), (1_700, 0)) == [7, 5]


def test_inside_a_corner_the_nearer_stretch_holds():
    found = relief(Heights(10.0, [(2.0, 5.0)], []), path_of([(0, 0), (2_000, 0), (2_000, 3_000)]))
    for away in (60.0, 150.0, 350.0):
        near, far = away - 45, away + 45  # distances from the two sides
        assert height_at(found, (2_000 - far, near), (2_000 - near, far)) == [10, 5]


def test_where_a_contour_closes_the_nearer_stretch_holds():
    path = path_of([(0, 0), (4_000, 0), (4_000, 4_000), (0, 4_000), (0, 0)])
    found = relief(Heights(10.0, [(12.5, 5.0)], []), path)
    assert height_at(found, (0, 3_600), (0, 3_400), (0, 60), (60, 0), (300, 100), (100, 300)) == [10, 5, 5, 10, 10, 5]


def test_a_region_whose_border_touches_itself_in_um_is_one_still():
    """If lengths in mm are rounded again, the border crosses itself, and the cut cannot begin."""
    for place, x, y in ((0.5, 2_046, 1_772), (1.63, 1_869, 1_618)):
        corner = [(x, 0), (-x // 2, y), (-x // 2, -y), (x, 0)]
        found = relief(Heights(20.0, [(place, 10.0)]), path_of(corner))
        assert height_at(found, (x - 10, 5), (-x // 2, 0), (x - 800, -500)) == [20, 10, 10]


def test_areas_lie_in_the_programs_coordinates_and_hold_before_lengths():
    square = [(1.0, -1.0), (2.0, -1.0), (2.0, 1.0), (1.0, 1.0)]
    heights = Heights(10.0, [(1.5, 5.0)], [(shapely.Polygon(square), 20.0), (shapely.box(0.5, -1, 2.5, 1), 15.0)])
    assert (heights.greatest_mm, heights.lowest_mm) == (20.0, 5.0)
    found = relief(heights, path_of([(0, 0), (6_000, 0)]), n_slices=20)
    assert height_at(found, (100, 0), (600, 0), (1_100, 0), (1_600, 0), (2_100, 0), (3_000, 0)) == [
        10, 15, 20, 20, 15, 5,
    ]  # fmt: skip
    assert height_at(found, (-5_000, 5_000)) == [10]  # the rest of the blank


def test_no_change_of_height_is_no_step():
    path = path_of([(0, 0), (6_000, 0)])
    assert Heights(10.0, [], []).lower_regions(path, 250.0) == ()
    assert Heights(10.0, [(2.0, 10.0)], []).lower_regions(path, 250.0) == ()


@pytest.mark.parametrize(("text", "pair"), [("12.5:30", (12.5, 30.0)), ("0:5", (0.0, 5.0)), (" 1 : 2 ", (1.0, 2.0))])
def test_an_option_is_a_length_and_a_height(text, pair):
    assert parse_height(text) == pair


@pytest.mark.parametrize("text", ["", "5", "5:", ":5", "5;30", "a:b", "1:2:3"])
def test_an_option_that_is_none_is_refused(text):
    with pytest.raises(InputError, match=r"reads MM:MM.*as 12\.5:30"):
        parse_height(text)


BAD: list[tuple[dict[str, Any], str]] = [
    ({"heights": [(1.0, 0.0)]}, "0 mm from 1 mm of path"), ({"heights": [(1.0, -5.0)]}, "-5 mm from 1 mm of path"),
    ({"heights": [(1.0, 400.5)]}, "400.5 mm from 1 mm of path"), ({"heights": [(1.0, float("nan"))]}, "nan mm"),
    ({"heights": [(2.0, 6.0), (1.0, 7.0)]}, "1 mm follows 2 mm"),
    ({"heights": [(1.0, 6.0), (1.0, 7.0)]}, "1 mm follows 1 mm"),
    ({"heights": [(-1.0, 6.0)]}, "-1 mm of path"), ({"heights": [(float("nan"), 6.0)]}, "nan mm of path"),
    ({"heights": [(99.0, 6.0)]}, "99 mm: the wire's path is"),
    ({"heights": [(99.0, 5.0)]}, "99 mm: the wire's path is"), ({"heights": [7.0]}, "not 7.0"),
    ({"heights": [(1.0, "high")]}, "'high'"), ({"heights": [(1.0, 50.0)]}, "5 mm high is lost"),
    ({"height_mm": 401.0, "heights": [(1.0, 5.0)]}, "401 mm is not"),
    ({"height_areas": [([(0, 0), (1, 0), (1, 1)], 0.1)]}, "0.1 mm of area 1"),
    ({"height_areas": [([(0, 0), (1, 0)], 6.0)]}, "area 1"),
    ({"height_areas": [([(0, 0), (1, 1), (1, 0), (0, 1)], 6.0)]}, "Self-intersection"),
    ({"height_areas": [([(0, 0), (1, 1), (2, 2)], 6.0)]}, "area 1"),
    ({"height_areas": [("square", 6.0)]}, "area 1"),
    ({"height_areas": [([(0, 0), (np.nan, 0), (1, 1)], 6.0)]}, "Invalid Coordinate[nan 0]"),
    ({"height_areas": [(shapely.box(0, 0, 1, 1), 6.0), (shapely.box(50, 50, 51, 51), 6.0)]}, "area 2"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "named"), BAD)
def test_bad_heights_are_reported_and_nothing_is_written(cut_small, tmp_path, options, named):
    with pytest.raises(InputError) as caught:
        cut_small(out=tmp_path / "out", **options)
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


# --- a cut over a ridge: 4 mm high, from 0.9 mm of path on 10 mm, from 1.7 mm on 4 mm again ---

LOW, HIGH, UP_MM, DOWN_MM, LENGTH_MM = 4.0, 10.0, 0.9, 1.7, 2.6


@pytest.fixture(scope="module")
def ridge(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ridge")
    program = folder / "line.ngc"
    program.write_text(f"G0 X0 Y0\nG1 X{LENGTH_MM}\nM2\n")
    result = edmsim.cut(
        program, height_mm=LOW, heights=[(UP_MM, HIGH), (DOWN_MM, LOW)], resolution="fast", offset="none",
        controller="fixed:feed_um_s=30", seed=3, out=folder / "out",
    )  # fmt: skip
    windows = {name: result.windows.column(name).to_numpy() for name in result.windows.column_names}
    return SimpleNamespace(result=result, report=result.report, windows=windows, folder=folder / "out")


def between(ridge, name, start_mm, stop_mm):
    place = ridge.windows["path_um"] / 1000
    return float(ridge.windows[name][(place >= start_mm) & (place < stop_mm)].mean())


STRETCHES = ((0.5, 0.7), (1.0, 1.5), (1.8, 2.5))
"""Parts of the path: low, high, low; the front of the kerf is about 0.15 mm ahead of the wire's centre."""


@pytest.mark.slow
def test_the_ridge_is_cut(ridge):
    assert ridge.report["outcome"] == "finished"
    assert ridge.report["notices"] == []
    assert ridge.report["settings"]["height_mm"] == LOW
    assert ridge.report["settings"]["heights"] == [[UP_MM, HIGH], [DOWN_MM, LOW]]


@pytest.mark.slow
def test_discharges_follow_the_height_where_the_front_meets_the_step(ridge):
    """At constant feed the area cut in a second is proportional to the height, and so is nearly the number of sparks.

    Not quite: a larger area ignites sooner, and the longer rest of the on-time makes a larger spark.
    """
    before, on, after = (between(ridge, "spark", *stretch) for stretch in STRETCHES)
    assert 0.8 * HIGH / LOW < on / before < HIGH / LOW
    assert 0.8 * HIGH / LOW < on / after < HIGH / LOW
    # halfway between both when the front, half a kerf ahead, has passed half of the step
    place = ridge.windows["path_um"] / 1000
    front_mm = 0.125 + 0.03
    for step, low in ((UP_MM, before), (DOWN_MM, after)):
        near = np.abs(place - step) < 0.35
        smooth = np.convolve(ridge.windows["spark"], np.full(41, 1 / 41), "same")
        level = (on + low) / 2
        crossed = place[near][np.flatnonzero(np.diff(np.sign(smooth[near] - level)))]
        assert step - front_mm - 0.05 < crossed.min() <= crossed.max() < step + 0.05


@pytest.mark.slow
def test_shorts_rise_on_the_ridge_and_fall_behind_it(ridge):
    before, on, after = (between(ridge, "short", *stretch) for stretch in STRETCHES)
    assert on > 1.5 * before
    assert on > 1.5 * after
    before, on, after = (between(ridge, "open", *stretch) for stretch in STRETCHES)
    assert on < 0.9 * min(before, after)


@pytest.mark.slow
def test_upper_slices_are_cut_on_the_ridge_only(ridge):
    result = ridge.result
    start = result.path.contours[0].points_um[0, 0] / 1000
    areas = []
    for number in range(5):
        removed = result.contour(number, coordinates="table")
        areas.append(removed.area)
        x0, _, x1, _ = removed.bounds
        low = start + (0.0 if number < 2 else UP_MM), start + (LENGTH_MM + 0.2 if number < 2 else DOWN_MM)
        assert low[0] - 0.003 < x0 < x1 < low[1] + 0.003
        if number >= 2:
            assert (x0, x1) == pytest.approx(low, abs=0.003)
    assert sum(areas) * HIGH / 5 == pytest.approx(ridge.report["removed_mm3"], rel=0.01)
    # the level of half-removed metal is at most half a cell from the step
    kerf_mm = ridge.report["kerf_um"]["mean"] / 1000
    assert areas[2] == pytest.approx((DOWN_MM - UP_MM) * kerf_mm, rel=0.05)


@pytest.mark.slow
def test_rate_counts_the_area_cut(ridge):
    report = ridge.report
    length_mm = report["path_length_mm"] - ridge.result.path.start_hole_radius_mm
    area = length_mm * LOW + (DOWN_MM - UP_MM) * (HIGH - LOW)
    assert report["overall_rate_mm2_min"] == pytest.approx(area / report["machining_time_s"] * 60, rel=5e-3)
    assert report["cutting_rate_mm2_min"] == pytest.approx(area / report["cutting_time_s"] * 60, rel=5e-3)


@pytest.mark.slow
def test_kerf_and_profile_are_measured_where_there_is_metal(ridge):
    contour = ridge.result.path.contours[0]
    kerf = kerf_width(ridge.result.field, contour, 250.0)
    known = np.isfinite(kerf.width_um)
    assert known[:2].all()
    assert not known[2:, (kerf.s_mm < UP_MM) | (kerf.s_mm > DOWN_MM)].any()
    assert 280 < ridge.report["kerf_um"]["min"] <= ridge.report["kerf_um"]["max"] < 400
    profile = profile_error(ridge.result.field, contour)
    known = np.isfinite(profile.error_um)
    on_ridge = (profile.s_mm > UP_MM + 0.16) & (profile.s_mm < DOWN_MM - 0.16)
    off_ridge = (profile.s_mm < UP_MM + 0.14) | (profile.s_mm > DOWN_MM - 0.14)
    assert known[2:, on_ridge].all()
    assert not known[2:, off_ridge].any()
    assert known[:2, (profile.s_mm > 0.8) & (profile.s_mm < 2.2)].all()
    assert profile.stats()["max"] < 200  # no distance to a wall that does not exist


@pytest.mark.slow
def test_pictures_show_the_steps(ridge):
    scene = ridge.result.scene
    assert [terrace.height_mm for terrace in scene.terraces] == pytest.approx([LOW, HIGH])
    assert (scene.height_mm, scene.middle_slice()) == (HIGH, 1)
    assert scene.middle_mm() == 3.0
    top = np.concatenate(scene.terraces[1].outlines_mm)
    start = ridge.result.path.contours[0].points_um[0, 0] / 1000
    assert (top[:, 0].min(), top[:, 0].max()) == pytest.approx((start + UP_MM, start + DOWN_MM), abs=1e-3)
    assert sorted(f.name for f in ridge.folder.iterdir()) == FILES


@pytest.mark.slow
def test_an_interrupted_stepped_cut_goes_on_bit_for_bit(cut_small, tmp_path):
    options = {
        "heights": [(0.45, 10.0)], "max_time_s": 22.0, "height_areas": [(shapely.box(-2.5, 0, -1.5, 1), 6.0)],
        "controller": "fixed:feed_um_s=30",
    }  # fmt: skip

    def stop(progress):
        if progress.time_s > 14.0:
            raise KeyboardInterrupt

    whole = cut_small(**options)
    assert whole.report["removed_mm3"] > 0.1
    with pytest.raises(KeyboardInterrupt):
        cut_small(out=tmp_path, watch=stop, **options)
    for changed, named in (({"heights": [(0.45, 9.0)]}, "heights"), ({"height_areas": []}, "height_areas")):
        with pytest.raises(InputError, match=f"was made with {named} "):
            cut_small(out=tmp_path, resume=True, **{**options, **changed})
    assert (tmp_path / CHECKPOINT).exists()
    resumed = cut_small(out=tmp_path, resume=True, **options)
    assert timeless(resumed.report) == timeless(whole.report)
    np.testing.assert_array_equal(resumed.field.tiles[: resumed.field.count], whole.field.tiles[: whole.field.count])
