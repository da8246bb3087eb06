"""Planners: what every one promises, how true each is to the line, and four axes."""

import json
import math
import pickle
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st

from edmsim.controllers.planner.four_axes import check_lead, make_leaning_planner
from edmsim.controllers.planner.registry import PLANNERS, make_planner
from edmsim.errors import InputError

SECOND = 1_000_000_000
WINDOW = 25_500_000
NAMES = tuple(PLANNERS)
COUNTING = tuple(name for name, kind in PLANNERS.items() if kind.counts)
UNIT_NM_S = 262.5
SPEEDS = st.integers(-127, 127)
DURATIONS = st.integers(0, 3 * SECOND)


@st.composite
def polylines(draw, longest=120):
    """Paths of 1 to 6 moves somewhere on the table, also along its edges."""
    points = [(draw(st.integers(0, 65_535)), draw(st.integers(0, 65_535)))]
    for _ in range(draw(st.integers(1, 6))):
        x = points[-1][0] + draw(st.integers(-longest, longest))
        y = points[-1][1] + draw(st.integers(-longest, longest))
        points.append((min(max(x, 0), 65_535), min(max(y, 0), 65_535)))
    if all(point == points[0] for point in points):
        points.append((points[0][0], points[0][1] + (9 if points[0][1] < 60_000 else -9)))
    return np.array(points, dtype=np.int64)


class Rated:
    """A planner that takes speeds in units of 262.5 nm/s, whichever its own is."""

    def __init__(self, name, points):
        self.planner = make_planner(name, points)

    def advance(self, start_ns, end_ns, speed):
        return self.planner.advance(start_ns, end_ns, round(speed * UNIT_NM_S / self.planner.speed_unit_nm_s))

    def __getattr__(self, name):
        return getattr(self.planner, name)


def follow(points, steps):
    """Positions after every step, from the path's first point."""
    moves = np.zeros((len(steps) + 1, 2), dtype=np.int64)
    for i, step in enumerate(steps):
        moves[i + 1, step.axis] = 2 * step.direction
    return points[0] + np.cumsum(moves, axis=0)


def run_to_end(planner, start_ns=0, speed=127, limit_s=100_000):
    """All steps until the planner is done, in windows of 10 s."""
    steps, time = [], start_ns
    while not planner.done:
        assert time < start_ns + limit_s * SECOND, "the end is never reached"
        steps += planner.advance(time, time + 10 * SECOND, speed)
        time += 10 * SECOND
    return steps


def run_plan(planner, plan):
    """Steps of windows (speed, duration) one after the other, and the time at their end."""
    steps, time = [], 0
    for speed, duration in plan:
        window = planner.advance(time, time + duration, speed)
        assert all(time <= step.time_ns < time + duration for step in window)
        steps += window
        time += duration
    return steps, time


def same(name, steps, others):
    """The same steps; those of `exact`, whose lengths are rounded to 64 bits, of each axis and within 2 ns."""
    if name != "exact":
        assert steps == others
        return
    for axis in (0, 1):
        one, other = ([step for step in found if step.axis == axis] for found in (steps, others))
        assert [step.direction for step in one] == [step.direction for step in other]
        assert [step.time_ns for step in one] == pytest.approx([step.time_ns for step in other], rel=0, abs=2)


def deviation_um(points, positions):
    return float(shapely.distance(shapely.points(positions), shapely.LineString(points)).max())


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=25)
@given(points=polylines(), plan=st.lists(st.tuples(SPEEDS, DURATIONS), max_size=12))
def test_steps_add_up_and_the_end_is_reached(name, points, plan):  # T-16, T-17, T-18, T-70
    planner = Rated(name, points)
    steps, time = run_plan(planner, plan)
    assert [step.time_ns for step in steps] == sorted(step.time_ns for step in steps)
    assert planner.position_um == tuple(follow(points, steps)[-1])
    steps += run_to_end(planner, time)
    end = follow(points, steps)[-1]
    assert planner.position_um == tuple(end)
    assert np.abs(end - points[-1]).max() <= 1
    assert planner.path_um == pytest.approx(shapely.LineString(points).length, abs=2)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "limit"), [
    ("dda", math.sqrt(2) + 1e-9), ("exact", math.sqrt(2) + 1e-9), ("poscal", 2.0), ("sine-table", 2.0),
])  # fmt: skip
@settings(max_examples=25)
@given(points=polylines(500), plan=st.lists(st.tuples(SPEEDS, DURATIONS), max_size=12))
def test_default_and_dda_keep_the_line_forwards_and_backwards(name, limit, points, plan):  # T-G11, T-G12
    planner = Rated(name, points)
    steps, time = run_plan(planner, plan)
    steps += run_to_end(planner, time)
    assert deviation_um(points, follow(points, steps)) <= limit


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=15)
@given(points=polylines(), plan=st.lists(st.tuples(st.integers(0, 127), DURATIONS), max_size=8), at=st.integers(1, 5))
def test_a_planner_that_begins_later_on_its_path_can_run_back_to_the_first_point(name, points, plan, at):
    start = min(at, len(points) - 2)
    if start < 1 or (points[start:] == points[start]).all():
        return
    planner, alone = make_planner(name, points, start=start), make_planner(name, points[start:])
    units = [(round(speed * UNIT_NM_S / planner.speed_unit_nm_s), duration) for speed, duration in plan]
    steps, time = run_plan(planner, units)
    assert (steps, time) == run_plan(alone, units)  # forwards, equal to the bit
    assert (planner.path_um, planner.done) == (alone.path_um, alone.done)
    back = -round(127 * UNIT_NM_S / planner.speed_unit_nm_s)
    steps += planner.advance(time, time + 100 * SECOND, back)
    assert planner.path_um == pytest.approx(-shapely.LineString(points[: start + 1]).length, abs=2)
    assert np.abs(follow(points[start:], steps)[-1] - points[0]).max() <= 2
    assert planner.advance(time + 100 * SECOND, time + 101 * SECOND, back) == []  # no further
    if name != "poscal-literal":  # whose way back does not undo the way there
        run_to_end(planner, time + 101 * SECOND, -back)
        assert np.abs(np.subtract(planner.position_um, points[-1])).max() <= 1


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=20)
@given(points=polylines(), plan=st.lists(st.tuples(SPEEDS, DURATIONS, DURATIONS), min_size=1, max_size=8))
@example(  # `exact` makes the last steps of both axes in the same ns, in either order
    points=np.array([[7712, 120], [7730, 134]]),
    plan=[(86, 15_672_406, 0), (-41, 2_894, 0), (-52, 1_048_575, 0), (114, 5_037, 0), (83, 507_717_238, 1)],
)
def test_a_window_cut_in_two_gives_the_same_steps(name, points, plan):
    whole, cut = Rated(name, points), Rated(name, points)
    time = 0
    for speed, duration, part in plan:
        middle, end = time + min(part, duration), time + duration
        halves = cut.advance(time, middle, speed) + cut.advance(middle, end, speed)
        same(name, whole.advance(time, end, speed), halves)
        time = end


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=20)
@given(points=polylines(), plan=st.lists(st.tuples(SPEEDS, DURATIONS), min_size=2, max_size=10), at=st.integers(0, 9))
def test_a_snapshot_continues_identically(name, points, plan, at):
    original = Rated(name, points)
    time = 0
    for speed, duration in plan[:at]:
        original.advance(time, time + duration, speed)
        time += duration
    copy = Rated(name, points)
    copy.restore(json.loads(json.dumps(original.snapshot())))
    for speed, duration in [*plan[at:], (127, 60 * SECOND)]:
        assert copy.advance(time, time + duration, speed) == original.advance(time, time + duration, speed)
        time += duration
    assert copy.snapshot() == original.snapshot()
    state = copy.position_um, copy.path_um, copy.done
    assert state == (original.position_um, original.path_um, original.done)


@pytest.mark.parametrize("name", NAMES)
def test_speed_zero_stands_still_and_loses_nothing(name):  # T-76
    points = np.array([(1000, 1000), (1300, 1000)])
    planner = Rated(name, points)
    before = planner.advance(0, SECOND, 127)
    assert planner.advance(SECOND, 2 * SECOND, 0) == []
    after = planner.advance(2 * SECOND, 3 * SECOND, 127)
    unbroken = Rated(name, points).advance(0, 2 * SECOND, 127)
    assert [s.time_ns for s in before] + [s.time_ns - SECOND for s in after] == pytest.approx(
        [s.time_ns for s in unbroken], abs=2 * 116_300
    )


@pytest.mark.parametrize(("unit", "interval"), [(262.5, 59_992_501), (252.6, 62_343_747)])
@pytest.mark.parametrize("name", ["poscal", "dda", "sine-table"])
def test_step_interval_at_full_speed(name, unit, interval):  # T-73, T-A1
    steps = make_planner(name, np.array([(0, 0), (2002, 0)]), unit).advance(0, 90 * SECOND, 127)
    assert len(steps) == 1001
    assert (steps[-1].time_ns - steps[0].time_ns) / 1000 == pytest.approx(interval, rel=4e-6)


@pytest.mark.parametrize("speed", [1, 2, 3, 5, 8, 16, 40, 64, 127])
@pytest.mark.parametrize("name", ["poscal", "dda", "sine-table"])
def test_path_speed_and_straightness_in_any_direction(name, speed):  # T-G9, T-G10, T-G12
    for degrees in (0.05, 0.6, 13.0, 30.0, 45.0, 88.9, 137.0, 201.5, 270.3, 333.3):
        angle = math.radians(degrees)
        target = 30_001 + round(800 * math.cos(angle)), 30_000 + round(800 * math.sin(angle))
        points = np.array([(30_001, 30_000), target])
        steps = run_to_end(make_planner(name, points), speed=speed)
        positions = follow(points, steps)
        assert deviation_um(points, positions) < 2
        length = math.dist(positions[-1], positions[0])
        assert length / (steps[-1].time_ns * 1e-9) == pytest.approx(speed * 0.2625, rel=0.015)


def test_default_planner_rounds_no_corner_and_keeps_pace_on_short_chords():
    angles = np.linspace(0, 2 * np.pi, 126)
    points = np.rint(np.c_[5001 + 200 * np.cos(angles), 5000 + 200 * np.sin(angles)]).astype(np.int64)
    steps = run_to_end(make_planner("poscal", points), speed=76)
    positions = follow(points, steps)
    assert deviation_um(points, positions) < 2
    misses = np.abs(positions[None, :, :] - points[:, None, :]).max(axis=2).min(axis=1)
    assert misses.max() <= 1
    assert shapely.LineString(points).length / (steps[-1].time_ns * 1e-9) == pytest.approx(19.95, rel=0.02)


def one_pass_deviation(x, y, x_speed, y_speed):
    """Closed form of T-G12: both axes run until the first arrives; there the wire is furthest off."""
    time = min(x / x_speed, y / y_speed)
    return abs(x_speed * time * y - y_speed * time * x) / math.hypot(x, y)


@pytest.mark.parametrize(("target", "speed", "axis_speeds", "row_um"), [
    ((10_000, 5_000), 4, (3, 1), 1492), ((10_000, 5_000), 127, (113, 56), 41),
    ((20_000, 12_345), 127, (108, 66), 106),
])  # fmt: skip
def test_literal_planner_leaves_the_line_as_in_1982(target, speed, axis_speeds, row_um):  # T-G12
    points = np.array([(0, 0), target])
    steps = run_to_end(make_planner("poscal-literal", points), speed=speed)
    found = deviation_um(points, follow(points, steps))
    assert one_pass_deviation(*target, *axis_speeds) == pytest.approx(row_um, abs=2)
    # The reload counts are whole ticks (T-76), which turns the direction by up to 0.17 % more.
    assert found == pytest.approx(row_um, abs=0.0017 * math.hypot(*target) / 2)
    default = make_planner("poscal", points)
    steps = [step for i in range(100) for step in default.advance(i * SECOND, (i + 1) * SECOND, speed)]
    assert deviation_um(points, follow(points, steps)) < 2


def test_literal_planner_loses_a_small_component():  # T-G11
    points = np.array([(0, 0), (60_000, 200)])
    literal = make_planner("poscal-literal", points)
    steps = run_to_end(literal)
    assert literal.position_um == (60_000, 0)
    assert {step.axis for step in steps} == {0}
    default = make_planner("poscal", points)
    run_to_end(default)
    assert default.position_um == (60_000, 200)


def test_default_planner_takes_a_new_speed_at_once():  # T-A13
    planner = make_planner("poscal", np.array([(0, 0), (100, 0)]))
    assert planner.advance(0, SECOND, 1) == []
    assert planner.advance(SECOND, 2 * SECOND, 127)[0].time_ns < 1.1 * SECOND


@pytest.mark.parametrize(("points", "words"), [
    ([(0, 0)], "two different points"), ([(5, 5), (5, 5)], "two different points"),
    ([(0, 0), (70_000, 0)], "point 1 of the path lies at (70000, 0) um"),
    ([(-1, 0), (7, 0)], "point 0 of the path lies at (-1, 0) um"),
    ([(0, 0, 0), (1, 2, 3)], "shape (n, 2)"), ([(0.5, 0.0), (9.0, 0.0)], "whole um"),
])  # fmt: skip
def test_a_path_that_cannot_be_used_is_refused(points, words):  # T-61, T-A11
    for name in COUNTING:
        with pytest.raises(InputError) as refused:
            make_planner(name, np.array(points))
        assert words in str(refused.value)


def test_orders_that_cannot_be_used_are_refused():
    points = np.array([(0, 0), (9, 9)])
    with pytest.raises(InputError, match="no planner 'bresenham'; choose one of poscal, poscal-literal, dda"):
        make_planner("bresenham", points)
    with pytest.raises(InputError, match="speed unit must be above 0"):
        make_planner("dda", points, speed_unit_nm_s=0.0)
    for name in COUNTING:
        with pytest.raises(InputError, match=r"-127\.\.127 units, not 128"):
            make_planner(name, points).advance(0, WINDOW, 128)
        with pytest.raises(InputError, match="must not end before it starts"):
            make_planner(name, points).advance(WINDOW, 0, 1)


@pytest.mark.parametrize("name", NAMES)
def test_a_planner_tells_its_speed_unit_and_greatest_feed(name):  # T-A1
    planner = make_planner(name, np.array([(0, 0), (9, 9)]))
    limits = (planner.speed_unit_nm_s, planner.max_feed_um_s)
    assert limits == ((1.0, math.inf) if name == "exact" else (262.5, 33.3375))


def test_exact_takes_any_corner_and_any_feed():
    points = np.array([(1000.25, 1000.0), (1010.0, 1000.7), (1013.3, 1008.1)])
    planner = make_planner("exact", points)
    steps = planner.advance(0, SECOND, 100_000)
    assert planner.done
    assert np.abs(follow(points, steps)[-1] - points[-1]).max() <= 1 + 1e-6
    with pytest.raises(InputError, match="nm/s"):
        make_planner("exact", points, 262.5)
    with pytest.raises(InputError, match="finite"):
        make_planner("exact", np.array([(0.0, 0.0), (math.nan, 1.0)]))


@pytest.mark.parametrize("step_um", [1, 3, 5, 8, 16])
@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=12, deadline=None)
@given(points=polylines(150), speed=st.integers(20, 127))
def test_steps_of_another_length_lead_to_the_end_too(name, step_um, points, speed):  # T-16
    points = np.clip(points, 4000, 60_000) + np.arange(len(points))[:, None]
    planner = make_planner(name, points, step_um=step_um)
    steps = run_to_end(planner, speed=round(speed * UNIT_NM_S / planner.speed_unit_nm_s), limit_s=3000)
    positions = points[0] + (follow(points, steps) - points[0]) // 2 * step_um
    assert planner.position_um == tuple(positions[-1])
    assert np.abs(positions[-1] - points[-1]).max() <= 5 / 8 * step_um + 0.25
    if name != "poscal-literal":
        assert deviation_um(points, positions) <= step_um * (1 if step_um > 1 else 1.5)


@pytest.mark.parametrize("name", ["dda", "exact"])
def test_steps_of_a_fraction_of_a_um_too(name):
    points = np.array([(1000, 1000), (1400, 1150)])
    planner = make_planner(name, points, step_um=2.5)
    steps = planner.advance(0, 60 * SECOND, 127 if name == "dda" else 33_337)
    assert planner.done
    assert planner.position_um == (1400, 1150)
    assert len(steps) == (400 + 150) / 2.5


@pytest.mark.parametrize(("name", "step_um", "words"), [
    ("poscal", 2.5, "table.step_um is 2.5: give the machine steps of 1 to 16 whole um, or choose"),
    ("poscal-literal", 17, "table.step_um is 17"), ("sine-table", 0, "table.step_um is 0"),
    ("dda", 2.0005, "whole nm, and table.step_um is 2.0005"), ("exact", math.inf, "table.step_um is inf"),
])  # fmt: skip
def test_steps_a_planner_cannot_count_are_refused_by_name(name, step_um, words):
    with pytest.raises(InputError) as refused:
        make_planner(name, np.array([(0, 0), (9, 9)]), step_um=step_um)
    assert words in str(refused.value)


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


def test_feed_is_measured_along_the_path_of_the_program():
    planner = make_leaning_planner("exact", POINTS, LEADS, ALONG, step_um=STEP_UM)
    assert planner.advance(0, NS // 16, 20_000) == []  # half a step at the window's end is the next one's
    assert planner.advance(NS // 16, 10 * NS, 20_000)[0].time_ns == NS // 16
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


@pytest.mark.parametrize(("along_um", "share"), [(ALONG, 0.7), (0.5 * ALONG, 1.3)])
def test_a_speed_that_x_and_y_cannot_run_is_noted(along_um, share):
    planner = make_leaning_planner("poscal", POINTS, LEADS, along_um, step_um=STEP_UM)
    slowed = []
    for units in (0, 70, 127, -127):
        planner.advance(0, NS, units)
        slowed.append(planner.slowed)
    assert slowed == [False, False, share > 1.0, share > 1.0]


@pytest.mark.parametrize("name", ["exact", "poscal"])
def test_all_axes_run_back_over_where_they_began(name):
    ahead = make_leaning_planner(name, POINTS[1:], LEADS[1:], ALONG[1:] - ALONG[1], step_um=STEP_UM)
    planner = make_leaning_planner(name, POINTS, LEADS, ALONG - ALONG[1], step_um=STEP_UM)
    steps = run(planner, 5.0)
    assert steps == run(ahead, 5.0)
    units, behind = round(20e3 / planner.speed_unit_nm_s), np.zeros(4)
    steps += planner.advance(5 * NS, 200 * NS, -units)
    assert planner.path_um == pytest.approx(-ALONG[1], abs=2.0)
    for step in steps:
        behind[step.axis] += step.direction * STEP_UM
    assert np.abs(behind + np.append(POINTS[1] - POINTS[0], LEADS[1] - LEADS[0])).max() <= 2.0 * STEP_UM
    planner.advance(200 * NS, 400 * NS, units)
    assert planner.done


@pytest.mark.parametrize("name", PLANNERS)
def test_a_copy_makes_the_same_steps_however_many_a_window_has(name):
    planner = make_planner(name, [(0, 0), (300, 100)])
    again = pickle.loads(pickle.dumps(planner))
    units = round(30e3 / planner.speed_unit_nm_s)
    assert again.advance(0, 20 * NS, units) == planner.advance(0, 20 * NS, units)
    assert again.position_um == planner.position_um == (300, 100)


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
