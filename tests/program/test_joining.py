"""Short, repeated and doubled entities of drawings are joined, removed, or cut once."""

import math
import warnings
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from edmsim.errors import InputError
from edmsim.program.entities import Chain, joined_contours, without_duplicates
from edmsim.program.outline import JOIN_TOLERANCE_MM
from edmsim.program.path import plan_path


def lines(space, corners):
    """Draw a closed contour of separate lines."""
    for start, end in pairwise([*corners, corners[0]]):
        space.add_line(start, end)


def sizes(program):
    return [tuple(np.ptp(outline.points_mm, axis=0).round(2).tolist()) for outline in program.outlines]


def three_sides(space, gap_mm=0.0):
    """Draw a square of 10 mm whose lower right corner is missing: from (9.998, 0) to (10, 0.002), or farther."""
    for start, end in pairwise([(10, 0.002 + gap_mm), (10, 10), (0, 10), (0, 0), (9.998 - gap_mm, 0)]):
        space.add_line(start, end)


CORNERS = {
    "LINE": lambda m: m.add_line((9.998, 0), (10, 0.002)), "ARC": lambda m: m.add_arc((9.998, 0.002), 0.002, -90, 0),
    "ELLIPSE": lambda m: m.add_ellipse((9.998, 0.002), (0.002, 0), 1, -math.pi / 2, 0),
    "SPLINE": lambda m: m.add_open_spline([(9.998, 0), (9.999, 0), (10, 0.001), (10, 0.002)]),
    "LWPOLYLINE": lambda m: m.add_lwpolyline([(9.998, 0), (10, 0), (10, 0.002)]),
    "POLYLINE": lambda m: m.add_polyline2d([(9.998, 0, 0.4), (10, 0.002, 0)], format="xyb"),
}  # fmt: skip


@pytest.mark.parametrize("gap_mm", [0.0, 0.003])
@pytest.mark.parametrize("kind", CORNERS)
def test_what_is_shorter_than_the_tolerance_is_joined_away(drawing, kind, gap_mm):
    """The ends that it joins are up to 5 um apart, in addition to the tolerance at either end."""
    program = drawing(lambda m: [three_sides(m, gap_mm), CORNERS[kind](m)])
    assert sizes(program) == [(10, 10)]
    assert len(program.outlines[0].points_mm) == 5
    assert any(f"within 0.005 mm are joined with their neighbours: 1 {kind}" in n for n in program.notices)


def test_without_anything_between_ends_that_far_apart_are_open(drawing):
    with pytest.raises(InputError, match=r"a contour is open: a gap of 0\.008 mm"):
        drawing(lambda m: three_sides(m, 0.004))


@pytest.mark.parametrize("step_mm", [0.0, 0.0001, 0.002])
def test_short_lines_in_a_row_lead_on(drawing, step_mm):
    """Lines of 3 um each, with gaps between them, are not short together."""
    low = np.arange(5) * (0.003 + step_mm)

    def draw(space):
        for y in low:
            space.add_line((10, y), (10, y + 0.003))
        for start, end in pairwise([(10, low[-1] + 0.003 + step_mm), (10, 10), (0, 10), (0, 0), (10, 0)]):
            space.add_line(start, end)

    program = drawing(draw)
    assert sizes(program) == [(10, 10)]
    assert any("joined with their neighbours: 5 LINE" in notice for notice in program.notices)


@pytest.mark.parametrize("as_polyline", [False, True])
def test_a_circle_of_short_lines_stays_a_circle(drawing, as_polyline):
    angle = np.linspace(0, math.tau, 700, endpoint=False)
    circle = [(0.4 * math.cos(a), 0.4 * math.sin(a)) for a in angle]

    def draw(space):
        if as_polyline:
            space.add_lwpolyline(circle, close=True)
        else:
            lines(space, circle)

    (outline,) = drawing(draw).outlines
    assert np.hypot(*outline.points_mm.T) == pytest.approx(0.4, abs=1e-6)
    assert np.hypot(*np.diff(outline.points_mm, axis=0).T).max() < 0.011


def test_what_touches_nothing_is_left_out_with_a_notice(drawing):
    def draw(space):
        lines(space, [(0, 0), (10, 0), (10, 10), (0, 10)])
        space.add_circle((3, 3), 0.003)
        space.add_line((6, 6), (6.004, 6))
        space.add_line((10, 0), (10.003, -0.001))  # at a corner where two lines already meet

    program = drawing(draw)
    assert sizes(program) == [(10, 10)]
    assert any("1 CIRCLE, 2 LINE" in notice for notice in program.notices)


def test_a_third_line_that_is_not_short_still_branches(drawing):
    def draw(space):
        lines(space, [(0, 0), (10, 0), (10, 0.002), (10, 10), (0, 10)])
        space.add_line((10, 0.002), (12, 3))

    with pytest.raises(InputError, match=r"3 ends meet at X10\.000"):
        drawing(draw)


@pytest.mark.parametrize("scale", [{}, {"xscale": 2.0, "rotation": 20.0}, {"xscale": -1.0}, {"yscale": 0.5}])
def test_in_blocks_too_arcs_of_equal_angles_are_points(drawing, scale):
    """BricsCAD and TrueView draw them so; the DXF library makes full circles of them, or ellipses if it scales."""

    def draw(space):
        block = space.doc.blocks.new("PART")
        lines(block, [(0, 0), (10, 0), (10, 0.002), (10, 10), (0, 10)])
        block.add_arc((5, 5), 2, 30, 30)
        block.add_arc((10, 10), 0, 0, 90)
        block.add_ellipse((5, 5), (3, 0), 0.5, 1, 1)
        space.add_blockref("PART", (1, 1), dxfattribs=scale)

    program = drawing(draw)
    assert len(program.outlines) == 1
    assert "3 ARC of no length left out" in program.notices


def test_an_arc_from_0_to_360_is_a_circle(drawing):
    assert sizes(drawing(lambda m: m.add_arc((0, 0), 3, 0, 360))) == [(6, 6)]


REPEATS = {
    "start": [(0, 0), (10, 0), (10, 10), (0, 10), (0, 0)],
    "start with noise": [(0, 0), (10, 0), (10, 10), (0, 10), (1e-10, -1e-10)],
    "corner thrice": [(0, 0), (10, 0), (10, 0), (10, 1e-9), (10, 10), (0, 10)],
    "within the tolerance": [(0, 0), (10, 0), (10, 0.002), (10, 10), (0, 10), (0.001, 0)],
}


@pytest.mark.slow
@pytest.mark.parametrize("corners", REPEATS.values(), ids=list(REPEATS))
def test_repeated_points_leave_no_trace(drawing, tmp_path, corners):
    for draw in (
        lambda m: m.add_lwpolyline(corners, close=True),
        lambda m: m.add_polyline2d(corners, close=True),
        lambda m: m.add_polyline3d([(*corner, 4.0) for corner in corners], close=True),
        lambda m: m.add_lwpolyline([*corners, corners[0]]),
        lambda m: lines(m, corners),
    ):
        (outline,) = drawing(draw).outlines
        assert len(outline.points_mm) == 5
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            notices = plan_path(tmp_path / "drawing.dxf", "auto", auto_offset_mm=0.15).notices
        assert not any("stays" in notice for notice in notices)


@pytest.mark.parametrize("at_mm", [0.0, 1.5875, 0.0025, 0.0075, 0.00249999])
def test_a_line_drawn_twice_is_cut_once_wherever_it_lies(drawing, at_mm):
    def draw(space):
        lines(space, [(at_mm + x, at_mm + y) for x, y in [(0, 0), (5, 0), (5, 3), (0, 3)]])
        space.add_line((at_mm + 5 - 1e-9, at_mm - 1e-9), (at_mm + 1e-9, at_mm - 1e-9))

    program = drawing(draw)
    assert sizes(program) == [(5, 3)]
    assert "1 entity drawn twice is cut once" in program.notices


SQUARE = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]
TWICE = {
    "other start and direction": lambda m: [
        m.add_lwpolyline(SQUARE, close=True), m.add_lwpolyline([*SQUARE[1::-1], *SQUARE[:1:-1]], close=True)],
    "polyline and lines": lambda m: [m.add_lwpolyline(SQUARE, close=True), lines(m, SQUARE)],
    "circle and arcs": lambda m: [
        m.add_circle((5, 5), 5), m.add_arc((5, 5), 5, 10, 95), m.add_arc((5, 5), 5, 95, 10)],
    "circles 2 um apart": lambda m: [m.add_circle((5, 5), 5), m.add_circle((5.002, 5), 5)],
    "half the noise": lambda m: [lines(m, SQUARE), m.add_line((0, 1e-9), (10, 0)), m.add_line((10, 10), (10, 0))],
}  # fmt: skip


@pytest.mark.parametrize("draw", TWICE.values(), ids=list(TWICE))
def test_what_is_drawn_twice_is_cut_once(drawing, draw):
    program = drawing(draw)
    assert len(program.outlines) == 1
    assert any("drawn twice" in notice for notice in program.notices)


def test_neighbours_and_other_ways_between_the_same_ends_are_no_duplicates(drawing):
    both = drawing(lambda m: [m.add_arc((0, 0), 5, 0, 180), m.add_arc((0, 0), 5, 180, 360)])
    assert sizes(both) == [(10, 10)]
    assert len(drawing(lambda m: [m.add_circle((0, 0), 5), m.add_circle((0, 0), 5.02)]).outlines) == 2


def chain(points, place=0):
    return Chain.of([np.array(piece, np.float64) for piece in pairwise(points)], place)


@pytest.mark.slow
@settings(suppress_health_check=[HealthCheck.too_slow], max_examples=60)
@given(
    corners=st.lists(st.integers(0, 40), min_size=4, max_size=12, unique=True),
    noise=st.integers(0, 2**32 - 1), radius_mm=st.sampled_from([0.05, 1.0, 30.0]),
)  # fmt: skip
def test_lines_in_any_order_with_noise_short_ones_between_and_copies_join(corners, noise, radius_mm):
    """A polygon on a circle; each corner is left open by up to 4 um, bridged by a short line, or drawn exactly.

    Corners are farther apart than the reach of both together, because an end in between could belong to either.
    """
    draw = np.random.default_rng(noise)
    angle = np.sort(np.array(corners)) * math.tau / 41
    points = radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    assume(np.hypot(*np.diff(points, axis=0, append=points[:1]).T).min() > 3 * JOIN_TOLERANCE_MM)
    pieces = []
    for start, end in pairwise([*points, points[0]]):
        shift = draw.uniform(-0.001, 0.001, 2) * draw.integers(0, 2)
        pieces.append([start, end + shift])
        if draw.random() < 0.4:
            pieces.append([end + shift, end + shift + draw.uniform(-0.002, 0.002, 2)])
        if draw.random() < 0.3:
            pieces.append([end + shift + draw.normal(0, 1e-9, 2), start])
    order = draw.permutation(len(pieces))
    chains = [chain([tuple(p) for p in pieces[i]][:: draw.choice([1, -1])], k) for k, i in enumerate(order)]
    (contour,) = joined_contours(without_duplicates(chains))
    far = [np.hypot(*(contour.points - corner).T).min() for corner in points]
    assert max(far) < 0.008
    assert len(contour.points) == len(points) + 1
