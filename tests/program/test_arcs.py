"""Arcs as chords: closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.program.arcs import CHORD_TOLERANCE_UM, arc_points, centre_from_radius

TOLERANCE_MM = 0.005
RADII = st.floats(0.01, 60)
ANGLES = st.floats(-math.pi, math.pi)


@given(radius=RADII, start=ANGLES, sweep=st.floats(0.01, math.tau), turn=st.sampled_from([1, -1]))
def test_chords_stay_within_the_tolerance_and_turn_the_right_way(radius, start, sweep, turn):
    centre = 3 - 7j
    first = centre + radius * np.exp(1j * start)
    last = centre + radius * np.exp(1j * (start + turn * sweep))
    points = np.array([first, *arc_points(first, last, centre, turn, abs(last - first) < 1e-6)])
    middles = (points[1:] + points[:-1]) / 2
    assert np.allclose(abs(points - centre), radius, atol=1e-9)
    assert (radius - abs(middles - centre)).max() <= CHORD_TOLERANCE_UM / 1000 * (1 + 1e-6)
    assert points[-1] == last
    turned = np.angle((points[1:] - centre) / (points[:-1] - centre)).sum()
    assert turned == pytest.approx(turn * sweep, abs=1e-5)


@given(radius=st.floats(1, 50), share=st.floats(0.01, 0.99), turn=st.sampled_from([1, -1]))
def test_a_positive_radius_gives_the_short_arc_and_a_negative_one_the_long(radius, share, turn):
    start, end = 1 + 2j, 1 + 2j + 2 * radius * share * np.exp(0.7j)
    lengths = []
    for signed in (radius, -radius):
        centre = centre_from_radius(start, end, signed, turn, TOLERANCE_MM)
        assert abs(centre - start) == pytest.approx(radius)
        assert abs(centre - end) == pytest.approx(radius)
        lengths.append(abs(np.diff([start, *arc_points(start, end, centre, turn, False)])).sum())
    half = math.pi * radius
    assert lengths[0] < half < lengths[1] * (1 + 1e-3)


def test_too_small_a_radius_has_no_centre():
    assert centre_from_radius(0j, 10 + 0j, 4.9, 1, TOLERANCE_MM) is None
    assert centre_from_radius(1j, 1j, 5.0, 1, TOLERANCE_MM) is None
