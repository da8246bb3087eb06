"""The loop: planner, plant and controller stay in step, and every way a cut can end is reported."""

from typing import ClassVar

import numpy as np
import pytest

from edmsim.closed_loop.passes import legs_of
from edmsim.closed_loop.simulation import Simulation
from edmsim.controllers import FeedCommand, make
from edmsim.controllers.planner.registry import PLANNERS
from edmsim.machine.machine import Machine
from edmsim.machine.options import available
from edmsim.program.path import CutPath, WireContour
from edmsim.recording.windows import WindowTable

START = (30_000, 30_000)


def contour(points, dwells=()):
    """Open contour without offset; the points are relative to the middle of the table."""
    points_um = np.array(points, np.int64) + START
    return WireContour(points_um, 0, points_um * 1e-3, False, "left", dwells, (1,) * (len(points) - 1))


def path_of(*contours, hole_mm=0.5):
    return CutPath(contours, (25.0, 25.0, 40.0, 40.0), hole_mm, (30.0, 30.0), (), "test")


def simulation(*contours, controller=None, hole_mm=0.5, **options):
    machine = options.pop("machine", None) or Machine.load(height_mm=5)
    law = controller or make("fixed", feed_um_s=30.0)
    path = path_of(*contours, hole_mm=hole_mm)
    return Simulation(machine, path, law, recorders=[WindowTable()], **{"resolution": "fast", "seed": 1, **options})


def windows_of(sim):
    """Return the table of windows that observed the simulation."""
    (table,) = sim.recorders
    assert isinstance(table, WindowTable)
    return table


def run(sim, at_most=3000):
    """Run to the end, within a bound."""
    observed = []
    while sim.outcome is None:
        observed.append(sim.step())
        assert len(observed) < at_most
    return observed


class Script:
    """Commands a sequence of feeds repeatedly, and stores its observations."""

    name: ClassVar[str] = "script"

    def __init__(self, feeds, alarm_at=-1):
        self.feeds, self.alarm_at = feeds, alarm_at
        self.observed = []
        self.resets = 0

    def reset(self, max_feed_um_s):
        self.resets += 1
        self.max_feed_um_s = max_feed_um_s
        return FeedCommand(self.feeds[0])

    def update(self, window):
        self.observed.append(window)
        alarm = "the script says stop" if len(self.observed) == self.alarm_at else None
        return FeedCommand(self.feeds[len(self.observed) % len(self.feeds)], alarm)

    def snapshot(self):
        return {}

    def restore(self, state): ...


ZIGZAG = [(0, 0), (101, 53), (40, 160), (-77, 160), (-77, 31)]


@pytest.mark.slow
@pytest.mark.parametrize(("generator", "planner"), [
    *((generator, "poscal") for generator in available("generators")),
    *(("iso-pulse", planner) for planner in PLANNERS if planner != "poscal"),
    *(("production", planner) for planner in PLANNERS if planner != "poscal"),
])  # fmt: skip
def test_position_is_start_and_2_um_for_every_step(generator, planner):  # T-16
    period_us = 9.4 if generator == "production" else None  # also windows shorter than the computer's routine
    machine = Machine.load(height_mm=5, generator=generator, t_period_us=period_us)
    sim = simulation(contour(ZIGZAG), planner=planner, machine=machine, controller=Script([30, 12.5, 30, -7]))
    expected, advance = list(START), sim.plant.advance

    def count(steps=()):
        begin = sim.plant.time_ns
        window = advance(steps)
        assert [s[0] for s in steps] == sorted(s[0] for s in steps)
        for time_ns, axis, direction in steps:
            assert time_ns >= begin
            if time_ns < sim.plant.time_ns:  # later steps, up to the longest possible window, are planned again
                expected[axis] += 2 * direction
        return window

    sim.plant.advance = count
    for _ in range(700):
        if sim.outcome is not None:
            break
        sim.step()
        assert sim.plant.commanded_um == tuple(expected) == sim.position_um
    requested_um = 16.4e-9 * sim.plant.time_ns  # at the mean of the feeds; the windows of a fine generator are short
    assert abs(np.array(expected) - START).max() > min(60.0, 0.2 * requested_um)


def test_controller_sees_what_the_windows_record():
    law = Script([20.0, 10.0])
    sim = simulation(contour(ZIGZAG), controller=law)
    for _ in range(60):
        sim.step()
    windows = windows_of(sim).to_arrow()
    for observed, recorded in (("time_s", "t_s"), ("short", "short"), ("open", "open"), ("path_um", "path_um"),
                           ("mean_voltage_V", "mean_voltage_V"), ("mean_current_A", "mean_current_A")):  # fmt: skip
        assert [getattr(w, observed) for w in law.observed] == windows.column(recorded).to_pylist()
    assert [w.duration_s for w in law.observed] == pytest.approx([0.0255] * 60, rel=1e-12)  # T-42
    assert law.max_feed_um_s == 33.3375  # T-76: 127 units of 262.5 nm/s
    assert windows.column("feed_um_s").to_pylist() == [w.feed_um_s for w in law.observed]
    assert set(windows.column("feed_um_s").to_numpy()[::2]) == {76 * 0.2625}  # 20 um/s in whole units


@pytest.mark.parametrize(("planner", "limit_um_s"), [("poscal", 33.3375), ("exact", 400.0)])
def test_the_feed_ends_with_the_table_or_the_planner(planner, limit_um_s):
    law = Script([30.0])
    simulation(contour(ZIGZAG), machine=Machine.load("production", height_mm=5), planner=planner, controller=law)
    assert law.max_feed_um_s == limit_um_s


class Late(Script):
    """A script whose feeds take effect some time after the window's end."""

    latency_s = 0.0

    def update(self, window):
        return super().update(window)._replace(latency_s=self.latency_s)


@pytest.mark.parametrize(("latency_s", "new_share"), [(0.0, 1.0), (0.01, 1 - 0.01 / 0.0255), (0.03, 0.0)])
def test_a_late_controller_leaves_the_old_feed_in_force(latency_s, new_share):  # T-77
    law = Late([33.3375, 0.0])
    law.latency_s = latency_s
    sim = simulation(contour([(0, 0), (2000, 0)]), controller=law)
    sim.step()  # the first feed has effect from the leg's beginning
    assert sim.step().feed_um_s == (0.0 if new_share else 33.3375)
    way = sim.plant.commanded_um[0] - START[0]
    assert way == pytest.approx(33.3375 * 0.0255 * (2 - new_share), abs=2)
    for _ in range(38):
        sim.step()
    if 0 < new_share < 1:  # alternately on and off: both changes are late, so the feed is on half of the time
        way = sim.plant.commanded_um[0] - START[0]
        assert way == pytest.approx(33.3375 * 0.0255 * 20, abs=2)
    assert sim.overtaken == (0 if new_share else 39)  # every window but the first ends with another feed


def test_feed_stays_within_the_speed_word():
    sim = simulation(contour([(0, 0), (2000, 0)]), controller=Script([1e6, -1e6]))
    assert [sim.step().feed_um_s for _ in range(2)] == [33.3375, -33.3375]


def test_legs_end_at_dwells():
    dwells = ((2, 1.5), (1, 0.5), (2, 1.0), (3, 4.0), (0, 0.25))
    legs = legs_of(path_of(contour([(0, 0), (10, 0), (20, 0), (30, 0)], dwells)))
    assert [(leg.points_um[:, 0] - START[0]).tolist() for leg in legs] == [[0, 10], [10, 20], [20, 30]]
    assert [leg.threads for leg in legs] == [True, False, False]
    assert [leg.rest_s for leg in legs] == [0.25, 0, 0]
    assert [leg.dwell_s for leg in legs] == [0.5, 2.5, 4.0]


@pytest.mark.parametrize(("point", "x_um"), [(0, 0), (1, 60), (2, 90)])
def test_wire_rests_for_the_dwell_with_the_pulses_on(point, x_um):
    sim = simulation(contour([(0, 0), (60, 0), (90, 60)], ((point, 2.0),)))
    run(sim)
    windows = windows_of(sim).to_arrow()
    t_s, x, feed = (windows.column(name).to_numpy() for name in ("t_s", "x_um", "feed_um_s"))
    resting = feed == 0
    assert np.ptp(x[resting]) == 0
    assert x[resting][0] == pytest.approx(START[0] + x_um, abs=1)
    # whole windows of 25.5 ms
    assert 2.0 <= resting.sum() * 0.0255 < 2.0 + 0.0255
    assert sim.sums.pulses == 255 * len(t_s)


@pytest.mark.parametrize("planner", list(PLANNERS))
def test_dwells_lose_no_place(planner):
    points = [(7 * i + 2 * (i % 2), 5 * i) for i in range(40)]
    sim = simulation(contour(points, tuple((i, 0.01) for i in range(1, 39))), planner=planner, hole_mm=2.0)
    run(sim)
    assert sim.outcome == "finished"
    assert sim.plant.commanded_um == pytest.approx(np.add(points[-1], START), abs=1)


def test_contours_are_joined_by_a_rapid_and_a_fresh_wire():
    first, second = contour([(0, 0), (60, 0)]), contour([(3000, 4000), (3060, 4000)])
    law = Script([30.0])
    sim = simulation(first, second, controller=law)
    observed = run(sim)
    assert sim.outcome == "finished"
    assert law.resets == 2
    windows = windows_of(sim).to_arrow()
    t_s, x, path = (windows.column(name).to_numpy() for name in ("t_s", "x_um", "path_um"))
    jump = int(np.argmax(np.diff(x)))
    table = sim.machine.base.table
    distance_um = np.hypot(33_000 - x[jump], 4000)
    pause_s = distance_um / table.rapid_um_s.value + table.threading_s.value
    assert t_s[jump + 1] - t_s[jump] == pytest.approx(pause_s + 0.0255, abs=1e-6)
    assert sum(np.diff(t_s) > 0.03) == 1
    assert np.diff(path).min() >= 0
    assert observed[-1].path_um == pytest.approx(observed[-1].total_um, abs=3)
    assert sim.plant.commanded_um == pytest.approx((33_060, 34_000), abs=1)


def test_alarm_of_the_controller_stops_the_machine():
    sim = simulation(contour([(0, 0), (2000, 0)]), controller=Script([20.0], alarm_at=7))
    assert len(run(sim)) == 7
    assert (sim.outcome, sim.reason) == ("persistent-short", "the script says stop")


def test_short_that_never_clears_ends_with_the_alarm_of_counts(own_file):
    """With metal on every side, of which nothing is removed, every pulse is a short."""
    steel = own_file(
        "materials", "tool-steel",
        ("removal_mm3_J = { value = 9.3e-3, range = [5.6e-3, 1.13e-2],", "removal_mm3_J = { value = 1.0e-12,"),
    )  # fmt: skip
    machine = Machine.load(height_mm=5, material=steel)
    sim = simulation(contour([(0, 0), (2000, 0)]), machine=machine, controller=make("counts"), hole_mm=0.126)
    run(sim)
    assert sim.outcome == "persistent-short"
    assert sim.reason == "persistent short"
    assert sim.sums.short > 0.9 * sim.sums.pulses
    path = windows_of(sim).to_arrow().column("path_um").to_numpy()
    assert path[-1] < 60


def test_end_switch_stops_the_machine(own_file):
    small = own_file("machines", "agiecut-dem15", ("travel_mm = { value = 65.0,", "travel_mm = { value = 30.05,"))
    sim = simulation(contour([(0, 0), (100, 0)]), machine=Machine.load(small, height_mm=5))
    run(sim)
    assert sim.outcome == "limit-switch"
    assert "x 30.05" in str(sim.reason)
    assert sim.plant.commanded_um[0] == 30_052


def test_wire_that_grows_too_hot_breaks(hot_machine):
    machine = Machine.load(hot_machine, height_mm=20, tension=35.0)
    sim = simulation(contour([(0, 0), (3000, 0)]), machine=machine, hole_mm=0.16)
    run(sim)
    assert sim.outcome == "wire-break"
    height = float(sim.reason.split()[3])
    assert 0 < height < 20
    windows = windows_of(sim).to_arrow()
    counts = sum(windows.column(name).to_numpy().astype(int) for name in ("short", "open", "spark", "arc"))
    assert set(counts[:-1]) == {255}
    assert counts[-1] < 255  # it broke within the window
    assert sim.sums.pulses == counts.sum()
    assert windows.column("wire_temperature_K").to_numpy().max() > 350


@pytest.mark.slow
def test_snapshot_continues_bit_for_bit_across_threading_and_dwells():
    parts = contour([(0, 0), (41, 0), (41, 33)], ((1, 0.3),)), contour([(900, 0), (951, 27)], ((0, 0.3),))
    machine = Machine.load(height_mm=5, generator="iso-energetic")
    whole = simulation(*parts, machine=machine, controller=make("counts"))
    run(whole)
    rows = windows_of(whole).rows
    threading = int(np.argmax(np.diff(rows[:, 0])))
    for stop in (10, 60, threading, threading + 1, threading + 9, len(rows) - 1):
        first, second = (simulation(*parts, machine=machine, controller=make("counts")) for _ in range(2))
        for _ in range(stop):
            first.step()
        second.restore(*first.snapshot())
        run(second)
        np.testing.assert_array_equal(windows_of(second).rows, rows)
        assert second.sums == whole.sums


class Settings(Script):
    """Commands a generator setting with every feed."""

    def __init__(self, settings):
        super().__init__([20.0])
        self.settings = settings

    def update(self, window):
        command = super().update(window)
        t_on_us, t_period_us = self.settings[(len(self.observed) - 1) % len(self.settings)]
        return command._replace(t_on_us=t_on_us, t_period_us=t_period_us)


def test_a_controller_may_set_the_generator():
    sim = simulation(contour([(0, 0), (200, 0)]), controller=Settings([(None, 150.0), (20.0, None), (None, None)]))
    durations = []
    for _ in range(3):
        start = sim.plant.time_ns
        sim.step()
        durations.append(sim.plant.time_ns - start)
    assert durations == [25_500_000, 38_250_000, 38_250_000]
    assert (sim.plant.machine.t_on_us, sim.plant.machine.t_period_us) == (20.0, 150.0)
    assert sim.refused is None


def test_a_refused_setting_changes_nothing_and_is_reported():
    sim = simulation(contour([(0, 0), (200, 0)]), controller=Settings([(60.0, None)]))
    sim.step()
    sim.step()
    assert (sim.plant.machine.t_on_us, sim.plant.machine.t_period_us) == (30.0, 100.0)
    assert "above the generator's 2 A" in sim.refused
    twin = simulation(contour([(0, 0), (200, 0)]), controller=Settings([(60.0, None)]))
    twin.restore(*sim.snapshot())
    assert twin.refused == sim.refused


def test_every_leg_begins_with_the_setting_of_the_set_up():
    sim = simulation(contour([(0, 0), (20, 0), (40, 0)], dwells=((1, 0.05),)), controller=Settings([(None, 150.0)]))
    before, periods = sim.leg, []
    while sim.outcome is None:
        sim.step()
        if sim.leg != before:
            periods.append(sim.plant.machine.t_period_us)
            before = sim.leg
    assert periods == [100.0]
