"""Planners of a leaning wire: four axes on their line, whatever windows they are asked in, and what is refused."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edmsim.controllers.planner.four_axes import check_lead, make_leaning_planner
from edmsim.controllers.planner.registry import make_planner
from edmsim.errors import InputError

STEP_UM = 2.0
POINTS = np.array([[30_000, 30_000], [30_400, 30_000], [30_400, 30_300]])
LEADS = np.array([[0, 0], [200, 100], [-200, 100]])
ALONG = np.array([0.0, 500.0, 1000.0])
NS = 10**9


def places(steps, axes=4):
    """Counts of every axis after every step, and the steps' times."""
    moved = np.zeros((len(steps), axes), int)
    moved[np.arange(len(steps)), [step.axis for step in steps]] = [step.direction for step in steps]
    return np.cumsum(moved, axis=0), np.array([step.time_ns for step in steps])


def run(planner, seconds, feed_um_s=20.0, windows=1):
    ends = np.linspace(0, round(seconds * NS), windows + 1).astype(int).tolist()
    units = round(feed_um_s * 1e3 / planner.speed_unit_nm_s)
    return [step for a, b in pairwise(ends) for step in planner.advance(a, b, units)]


def assert_alike(found, expected):
    """Times are rounded up to whole ns, from where a window begins."""
    assert [(step.axis, step.direction) for step in found] == [(step.axis, step.direction) for step in expected]
    times = np.array([[step.time_ns for step in steps] for steps in (found, expected)])
    assert np.abs(np.diff(times, axis=0)).max(initial=0) <= 3


def test_exact_keeps_all_axes_within_half_a_step_of_the_line():
    planner = make_leaning_planner("exact", POINTS, LEADS, ALONG, step_um=STEP_UM)
    counts, times = places(run(planner, 60.0))
    assert planner.done
    assert planner.position_um == (30_400, 30_300)
    assert (np.diff(times) >= 0).all()
    at = times * 1e-9 * 20.0
    for axis, line in enumerate(np.concatenate([POINTS - POINTS[0], LEADS], axis=1).T):
        away = counts[:, axis] * STEP_UM - np.interp(at, ALONG, line)
        assert np.abs(away).max() <= 0.5 * STEP_UM + 1e-6


def test_feed_is_that_of_the_path_that_is_given():
    planner = make_leaning_planner("exact", POINTS, LEADS, ALONG, step_um=STEP_UM)
    run(planner, 10.0)
    assert planner.path_um == pytest.approx(200.0)
    counted = make_leaning_planner("poscal", POINTS, LEADS, ALONG, step_um=STEP_UM)
    run(counted, 10.0)
    assert counted.path_um == pytest.approx(200.0, rel=0.02)  # speeds in units of 262.5 nm/s


@given(st.integers(1, 40), st.lists(st.integers(-60, 60), min_size=1, max_size=12))
@settings(max_examples=30, deadline=None)
def test_windows_may_be_cut_anywhere_and_the_way_back_undoes_the_way_there(windows, feeds):
    whole = make_leaning_planner("exact", POINTS, LEADS, ALONG, step_um=STEP_UM)
    cut = make_leaning_planner("exact", POINTS, LEADS, ALONG, step_um=STEP_UM)
    assert_alike(run(whole, 30.0), run(cut, 30.0, windows=windows))
    wanders, start_ns, counts = make_leaning_planner("exact", POINTS, LEADS, ALONG, step_um=STEP_UM), 0, np.zeros(4)
    for feed in feeds:
        for step in wanders.advance(start_ns, start_ns + NS, feed * 1000):
            counts[step.axis] += step.direction
        start_ns += NS
    line = np.concatenate([POINTS - POINTS[0], LEADS], axis=1)
    at = [np.interp(wanders.path_um, ALONG, column) for column in line.T]
    assert np.abs(counts * STEP_UM - at).max() <= STEP_UM


def test_exact_on_two_axes_is_the_planner_of_two_axes():
    still, planar = np.zeros_like(LEADS), np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(POINTS, axis=0).T))])
    four = make_leaning_planner("exact", POINTS, still, planar, step_um=STEP_UM)
    two = make_planner("exact", POINTS, step_um=STEP_UM)
    assert_alike(run(four, 40.0), run(two, 40.0))


@pytest.mark.parametrize("name", ["poscal", "dda", "sine-table"])
def test_u_and_v_follow_planners_that_count(name):
    planner = make_leaning_planner(name, POINTS, LEADS, ALONG, step_um=STEP_UM)
    steps = run(planner, 80.0, windows=400)
    counts, times = places(steps)
    assert planner.done
    assert (np.diff(times) >= 0).all()
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(POINTS, axis=0).T))])
    planar = make_planner(name, POINTS, step_um=STEP_UM)
    own = run(planar, 80.0, windows=400)
    assert [(s.axis, s.direction) for s in steps if s.axis < 2] == [(s.axis, s.direction) for s in own]
    behind = np.abs(counts[:, :2]).sum(axis=1) * STEP_UM  # both moves lie along an axis
    for axis in (2, 3):
        away = counts[:, axis] * STEP_UM - np.interp(behind, way, LEADS[:, axis - 2])
        assert np.abs(away).max() <= 3.0 * STEP_UM


@pytest.mark.parametrize("name", ["exact", "poscal"])
def test_a_planner_continues_where_its_snapshot_was_taken(name):
    planner, again = (make_leaning_planner(name, POINTS, LEADS, ALONG, step_um=STEP_UM) for _ in range(2))
    run(planner, 17.3)
    again.restore(planner.snapshot())
    units = round(20e3 / planner.speed_unit_nm_s)
    assert planner.advance(18 * NS, 25 * NS, units) == again.advance(18 * NS, 25 * NS, units)


def test_upper_guides_that_run_away_from_the_lower_one_are_refused():
    with pytest.raises(InputError, match=r"4 times as far at most.*--planner exact"):
        check_lead("poscal", [[0, 0], [100, 0]], [[0, 0], [0, 500]])
    with pytest.raises(InputError, match=r"moves two axes.*--planner exact"):
        check_lead("poscal-literal", POINTS, LEADS)
    check_lead("exact", [[0, 0], [0, 0]], [[0, 0], [0, 500]])
