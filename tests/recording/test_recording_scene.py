"""What is drawn: which way is out of the part, how much the error is enlarged, shapely to lines."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from edmsim.recording.figures.palette import ERROR_STOPS, error_rgb, rgb
from edmsim.recording.scene import ErrorMap, polylines, round_factor, round_number


@pytest.mark.parametrize(("side", "radius_mm"), [("left", 5.01), ("right", 4.99)])
def test_metal_left_is_drawn_out_of_the_part(side, radius_mm):
    angle = np.linspace(0, 2 * np.pi, 721)
    circle = 5.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    edge = ErrorMap(circle, side, circle, np.full(721, 1.0))  # counter-clockwise, 1 um of metal left
    np.testing.assert_allclose(np.hypot(*edge.exaggerated_mm(10.0).T), radius_mm, atol=1e-6)
    assert len(edge.pieces(10.0)[0]) == 721  # the last one joins the ends


def test_no_piece_runs_round_a_sharp_corner():
    points = np.array([(x, 0.0) for x in range(5)] + [(4.0, y) for y in range(1, 5)], float)
    edge = ErrorMap(points, "left", points, np.zeros(9))
    pieces, error_um = edge.pieces(10.0)
    assert pieces[:, 0].tolist() == [*points[:3].tolist(), *points[5:8].tolist()]
    assert error_um.tolist() == [0.0] * 6


@given(st.floats(1e-9, 1e12))
def test_round_numbers_are_1_2_or_5(expected):
    found = round_number(expected)
    assert found <= expected * (1 + 1e-9) < 2.6 * found
    assert f"{found:.3e}"[:5] in ("1.000", "2.000", "5.000")


def test_factor_draws_the_error_as_long_as_requested():
    assert round_factor(np.full(100, 10.0), 0.4) == 20.0  # 10 um shown 0.4 mm long would be 40 times
    assert round_factor(np.array([np.nan, 0.0]), 0.4) == 1.0
    assert round_factor(np.zeros(0), 0.4) == 1.0
    assert round_factor(np.full(10, 900.0), 0.4) == 1.0  # never made smaller than it is


def test_lines_of_every_kind_of_geometry():
    ring = shapely.Point(0, 0).buffer(1.0).difference(shapely.Point(0, 0).buffer(0.5))
    lines = shapely.MultiLineString([[(0, 0), (1, 0), (2, 0)], [(5, 5), (6, 6)]])
    assert [len(line) for line in polylines(lines)] == [2, 2]  # the middle point says nothing
    radii = sorted(float(np.hypot(*line.T).mean()) for line in polylines([ring]))
    np.testing.assert_allclose(radii, [0.5, 1.0], atol=1e-3)
    assert polylines(shapely.MultiLineString()) == ()
    assert [len(line) for line in polylines([shapely.LineString(), shapely.LineString([(0, 0), (1, 0)])])] == [2]


def test_error_colours_end_at_the_limits():
    colours = error_rgb(np.array([-9.0, -3.0, 0.0, 3.0]), 3.0)
    np.testing.assert_array_equal(colours, [rgb(ERROR_STOPS[k]) for k in (0, 0, 2, 4)])
