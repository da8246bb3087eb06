"""The compiled planners make the steps of the plain ones, bit for bit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edmsim.controllers.planner.registry import PLANNERS, make_planner

from . import reference_planners

SECOND = 1_000_000_000
NAMES = tuple(reference_planners.PLANNERS)


@st.composite
def paths(draw):
    """Corners near each other or all over the table, what the counters count, and the speed unit."""
    unit = draw(st.sampled_from(["um", "step"]))
    size, reach = (2, 65_535) if unit == "step" else (1, 65_535)
    longest = draw(st.sampled_from([3, 60, 700, 65_535]))
    points = [(draw(st.integers(0, reach)), draw(st.integers(0, reach)))]
    for _ in range(draw(st.integers(1, 6))):
        points.append(tuple(min(max(v + draw(st.integers(-longest, longest)), 0), reach) for v in points[-1]))
    if all(point == points[0] for point in points):
        points.append(((points[0][0] + 9) % reach, points[0][1]))
    return np.array(points, np.int64) * size, unit, draw(st.sampled_from([262.5, 252.6]))


WINDOWS = st.lists(
    st.tuples(
        st.one_of(st.sampled_from([0, 1, -1, 127, -127]), st.integers(-127, 127)),
        st.one_of(st.just(25_500_000), st.integers(0, 40 * SECOND)),
    ),
    min_size=1, max_size=12,
)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=250, deadline=None)
@given(path=paths(), windows=WINDOWS, start=st.sampled_from([0, 7 * 3600 * SECOND + 123]))
def test_the_same_steps_and_places_as_in_plain_python(name, path, windows, start):  # T-69, T-70, T-74
    points, unit, speed_unit = path
    planner = make_planner(name, points, speed_unit, unit)
    plain = reference_planners.PLANNERS[name](points, speed_unit, unit)
    time = start
    for speed, duration in windows:
        assert planner.advance(time, time + duration, speed) == plain.advance(time, time + duration, speed)
        time += duration
        assert (planner.position_um, planner.path_um, planner.done) == (plain.position_um, plain.path_um, plain.done)


def test_every_planner_has_its_plain_one_but_the_exact():
    assert {*NAMES, "exact"} == set(PLANNERS)
