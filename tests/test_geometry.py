"""The path of a wire that follows its guides at a constant lag."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.errors import InputError
from edmsim.geometry import pursuit


def corner(turn_deg, side=2_000.0):
    turn = math.radians(turn_deg)
    return np.array([[-side, 0.0], [0.0, 0.0], [side * math.cos(turn), side * math.sin(turn)]])


def test_a_straight_path_is_followed_a_lag_behind():
    wire = pursuit([(0.0, 0.0), (300.0, 400.0)], 50.0)
    np.testing.assert_allclose(wire[0], [-30.0, -40.0])
    np.testing.assert_allclose(wire[-1], [270.0, 360.0])


def test_a_quarter_turn_follows_the_tractrix():
    """The tractrix of a start at right angles to the motion: x = s - lag tanh(s / lag), y = lag / cosh(s / lag)."""
    wire = pursuit(corner(90.0), 50.0)[1:-1]
    aside = -wire[:, 0] / 50.0  # distance from the second side, in lags
    s = np.arccosh(1.0 / aside[1:])
    np.testing.assert_allclose(wire[1:, 1] / 50.0, s - np.tanh(s), atol=1e-7)


@pytest.mark.slow
@given(st.floats(-90.0, 90.0), st.floats(1.0, 100.0))
def test_what_is_left_uncut_in_a_corner_is_half_the_turn_times_the_lag_squared(turn, lag):
    guides = corner(turn, side=40 * lag)
    outline = np.concatenate([pursuit(guides, lag), guides[:0:-1]])
    x, y = outline.T
    area = abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2
    assert area == pytest.approx(abs(math.radians(turn)) / 2 * lag**2, rel=1e-3, abs=3e-5 * lag**2)


@pytest.mark.slow
@given(st.lists(st.tuples(st.floats(-500.0, 500.0), st.floats(-500.0, 500.0)), min_size=3, max_size=8, unique=True))
def test_the_wire_is_never_further_than_the_lag_from_its_guides_and_only_pulled(points):
    lag = 40.0
    guides = np.array(points)
    wire = pursuit(guides, lag)
    assert np.hypot(*(wire[-1] - guides[-1])) <= lag * (1 + 1e-9)
    steps = np.hypot(*np.diff(guides, axis=0).T).sum()
    assert np.hypot(*np.diff(wire, axis=0).T).sum() <= steps * (1 + 1e-9)


def test_a_wire_rests_in_its_kerf_while_the_guides_come_back():
    wire = pursuit([(0.0, 0.0), (100.0, 0.0), (70.0, 0.0)], 20.0)  # back by less than two lags
    np.testing.assert_allclose(wire[-1], [80.0, 0.0])
    wire = pursuit([(0.0, 0.0), (100.0, 0.0), (0.0, 0.0)], 20.0)
    np.testing.assert_allclose(wire[-1], [20.0, 0.0], atol=1e-9)


@pytest.mark.slow
def test_in_a_circle_the_wire_settles_on_a_smaller_one():
    """Physics: radius sqrt(R^2 - lag^2)."""
    angle = np.linspace(0.0, 6 * math.pi, 6_001)
    wire = pursuit(500.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1), 100.0)
    assert np.hypot(*wire[-1]) == pytest.approx(math.sqrt(500.0**2 - 100.0**2), rel=1e-5)


def test_no_lag_is_the_path_itself_without_repeated_points():
    path = [(0.0, 0.0), (0.0, 0.0), (5.0, 0.0)]
    np.testing.assert_array_equal(pursuit(path, 0.0), [(0.0, 0.0), (5.0, 0.0)])


@pytest.mark.parametrize(("path", "lag", "message"), [
    ([(0, 0), (1, 0)], -1.0, "lag is -1 um; it must be 0 or more"),
    ([(0, 0), (1, 0)], math.nan, "lag is nan um"),
    ([(1, 1), (1, 1)], 1.0, "two different points"),
    ([(1, 1)], 1.0, "two different points"), ([1.0, 2.0], 1.0, "list of points"),
    ([(0, 0), (math.inf, 0)], 1.0, "list of points"),
])  # fmt: skip
def test_impossible_paths_are_reported(path, lag, message):
    with pytest.raises(InputError, match=message):
        pursuit(path, lag)
