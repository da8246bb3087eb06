"""Arcs of the 1982 controller against the true circle."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st

from edmsim.controllers.mcu.firmware.arcs import arc_points, chord_walk
from edmsim.controllers.planner.registry import make_planner
from edmsim.errors import InputError

SECOND = 1_000_000_000
CENTRE = (32_768, 32_767)


def on_circle(radius, degrees):
    angle = math.radians(degrees)
    return CENTRE[0] + round(radius * math.cos(angle)), CENTRE[1] + round(radius * math.sin(angle))


def sweep_deg(points):
    """Angle run through about the centre, counter-clockwise positive."""
    x, y = (points - CENTRE).T.astype(float)
    return math.degrees(np.unwrap(np.arctan2(y, x))[[0, -1]] @ [-1, 1])


def off_circle_um(positions, radius):
    return float(np.abs(np.hypot(*(positions - CENTRE).T) - radius).max())


@pytest.mark.slow
@settings(max_examples=150)
@given(
    radius=st.one_of(st.integers(2, 400), st.integers(2, 32_000)),
    start=st.floats(0, 360), sweep=st.floats(1, 359), clockwise=st.booleans(),
)  # fmt: skip
@example(radius=32_000, start=0.0, sweep=359.0, clockwise=False)
@example(radius=2, start=45.0, sweep=180.0, clockwise=True)
@example(radius=2, start=0.0, sweep=1.0, clockwise=False)  # ends where it begins: a full circle
def test_chords_lie_within_1_um_of_the_circle_and_sweep_the_angle(radius, start, sweep, clockwise):  # T-18, T-60
    turn = -1 if clockwise else 1
    first, last = on_circle(radius, start), on_circle(radius, start + turn * sweep)
    points = arc_points(first, CENTRE, last, clockwise)
    assert tuple(points[0]) == first
    assert tuple(points[-1]) == last
    true = math.dist(first, CENTRE)
    chords = points if last == first else points[:-1]  # the last chord goes where the end was rounded to
    dense = np.linspace(chords[:-1], chords[1:], 8).reshape(-1, 2) if len(chords) > 1 else chords
    assert off_circle_um(dense, true) <= 1.0
    expected_deg = turn * math.degrees(
        (turn * (math.atan2(last[1] - CENTRE[1], last[0] - CENTRE[0])
                 - math.atan2(first[1] - CENTRE[1], first[0] - CENTRE[0]))) % math.tau or math.tau
    )  # fmt: skip
    assert sweep_deg(points) == pytest.approx(expected_deg, abs=1e-6)


@pytest.mark.parametrize("name", ["poscal", "dda", "sine-table"])
@pytest.mark.parametrize("radius", [5, 20, 77, 300, 1500])
def test_the_steps_stay_within_one_step_of_the_circle(name, radius):  # T-16, T-18
    for start, sweep in ((3.0, 360.0), (100.0, 90.0), (211.0, -360.0), (330.0, -75.0)):
        first, last = on_circle(radius, start), on_circle(radius, start + sweep)
        points = arc_points(first, CENTRE, last, sweep < 0)
        planner = make_planner(name, points)
        positions, time = [points[0]], 0
        while not planner.done:
            for step in planner.advance(time, time + 60 * SECOND, 127):
                position = positions[-1].copy()
                position[step.axis] += 2 * step.direction
                positions.append(position)
            time += 60 * SECOND
        positions = np.array(positions)
        assert off_circle_um(positions, math.dist(first, CENTRE)) <= 2.0
        assert np.abs(positions[-1] - last).max() <= 1
        assert shapely.LineString(positions).hausdorff_distance(shapely.LineString(points)) < 3


def test_a_circle_of_4_um_is_walked_point_by_point():
    """Golden vector: the radius at which the faster axis is a tie."""
    x = [4, 3, 2, 0, -2, -3, -4, -3, -2, 0, 2, 3, 4]
    y = [0, 2, 4, 4, 3, 2, 0, -2, -4, -4, -3, -2, 0]
    start = CENTRE[0] + 4, CENTRE[1]
    assert (arc_points(start, CENTRE, start, False) - CENTRE).T.tolist() == [x, y]


def test_few_points_do_for_a_large_circle():
    length, (x, y) = chord_walk(32_767, 0), (32_767, 0)
    assert length == 181
    points = arc_points((CENTRE[0] + x, CENTRE[1] + y), CENTRE, (CENTRE[0] + x, CENTRE[1] + y), False)
    assert 1000 < len(points) < 2000


@pytest.mark.parametrize(("start", "centre", "end", "words"), [
    ((5, 5), (5, 5), (9, 5), "starts on its centre"),
    ((0, 0), (1000, 0), (2003, 0), r"1000\.0 um from its centre and its end 1003\.0 um"),
    ((0, 0), (1000, -1), (2000, 0), r"centre lies at \(1000, -1\) um"),
    ((65_536, 0), (1000, 0), (2000, 0), r"start lies at \(65536, 0\) um, outside the table's 0\.\.65535 um"),
    ((0, 0), (1000, 0), (2000, 70_000), "end lies at"),
])  # fmt: skip
def test_an_arc_that_cannot_be_is_refused(start, centre, end, words):  # T-60, T-61
    with pytest.raises(InputError, match=words):
        arc_points(start, centre, end, False)
