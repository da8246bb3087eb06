"""Steps along a path: close to it, in order of time, never off its ends."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edmsim.evaluation.track import GRID_UM, MARGIN, Track

WINDOW_NS = 25_500_000
ZIGZAG = [(1000.0, 1000.0), (1100.0, 1053.0), (1040.0, 1160.0), (920.0, 1160.0)]


@given(st.lists(st.floats(-100, 100), min_size=1, max_size=60))
@settings(max_examples=40, deadline=None)
def test_the_axes_follow_the_path_both_ways(feeds: list[float]) -> None:
    track, place, now = Track(ZIGZAG, 2.0), np.array(ZIGZAG[0]), 0
    for feed in feeds:
        before = track.path_um
        steps = track.advance(now, WINDOW_NS, feed)
        times = [time for time, _, _ in steps]
        assert times == sorted(times)
        assert all(now <= time < now + WINDOW_NS for time in times)
        for _, axis, direction in steps:
            place[axis] += 2.0 * direction
        now += WINDOW_NS
        wanted = before + feed * WINDOW_NS * 1e-9
        assert track.path_um == pytest.approx(min(max(wanted, 0.0), track.length_um))
        ideal = [np.interp(track.path_um, track._at, track.points_um[:, k]) for k in (0, 1)]
        assert np.abs(place - ideal).max() <= MARGIN * 2.0 + GRID_UM


def test_the_path_ends_where_it_ends() -> None:
    track = Track(ZIGZAG, 2.0)
    assert track.advance(0, WINDOW_NS, -50.0) == []
    assert not track.done
    for number in range(400):
        track.advance(number * WINDOW_NS, WINDOW_NS, 100.0)
    assert track.done
    assert track.path_um == track.length_um


def test_a_straight_path_steps_evenly() -> None:
    track = Track([(0.0, 0.0), (1000.0, 0.0)], 2.0)
    times = [t for k in range(200) for t, _, _ in track.advance(k * WINDOW_NS, WINDOW_NS, 40.0)]
    assert np.diff(times).tolist() == pytest.approx([50e6] * (len(times) - 1), abs=GRID_UM / 40.0 * 1e9)
