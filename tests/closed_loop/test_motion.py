"""Evenly spaced steps, and a planner's: at the asked speed, either way, however the windows are cut."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim import Machine, Plant
from edmsim.closed_loop.cycle import CycleResult, EvenSteps, PlannerMotion
from edmsim.closed_loop.passes import Sums
from edmsim.closed_loop.straight import Traverse, cut_straight
from edmsim.controllers.planner.registry import PathOffset
from edmsim.controllers.protocols import FeedCommand, Step
from edmsim.errors import InputError
from edmsim.validation.setups import FRAIL, altered, in_a_hole


@pytest.mark.slow
@given(feed=st.floats(0.5, 400.0), windows=st.lists(st.integers(10_000, 30_000_000), min_size=1, max_size=40))
def test_steps_are_evenly_spaced_whatever_the_windows_are(feed, windows):
    motion, now, times = EvenSteps(2.0, feed), 0, []
    for length in windows:
        steps = [step for step in motion.plan(now, now + 30_000_000) if step[0] < now + length]
        motion.keep(now, now + length)
        times += [time for time, _, _ in steps]
        now += length
    every_ns = 2.0 / feed * 1e9
    assert times == pytest.approx([every_ns * (k + 1) for k in range(len(times))], abs=3)
    assert len(times) == pytest.approx(now / every_ns, abs=1)
    assert motion.path_um == pytest.approx(feed * now * 1e-9)


@pytest.mark.parametrize(("feed_um_s", "direction"), [(40.0, 1), (-40.0, -1)])
@pytest.mark.parametrize("axis", [0, 1])
def test_steps_go_the_way_of_the_feed_along_the_axis(feed_um_s, direction, axis):
    motion = EvenSteps(2.0, feed_um_s)
    motion.axis = axis
    assert motion.plan(5_000, 100_005_000) == [(50_005_000, axis, direction), (100_005_000, axis, direction)]
    motion.keep(5_000, 75_005_000)  # one and a half steps
    assert motion.path_um == pytest.approx(3.0 * direction)
    assert motion.plan(75_005_000, 125_005_000) == [(100_005_000, axis, direction)]


def test_no_feed_makes_no_steps():
    assert EvenSteps(2.0, 0.0).plan(0, 10**9) == []


def drive(plant, feed_um_s, seconds, axis):
    motion, end_ns = EvenSteps(plant.machine.base.table.step_um.value, feed_um_s), plant.time_ns + seconds * 1e9
    motion.axis = axis
    while plant.time_ns < end_ns:
        start_ns = plant.time_ns
        plant.advance(motion.plan(start_ns, start_ns + plant.window_ns))
        motion.keep(start_ns, plant.time_ns)


def test_a_plant_is_driven_either_way_along_either_axis():
    plant = Plant(Machine.load(height_mm=5.0), seed=1, resolution="fast")
    x, y = plant.commanded_um
    drive(plant, -25.0, 1.0, 0)
    drive(plant, 10.0, 1.0, 1)
    assert plant.commanded_um == pytest.approx((x - 25.0, y + 10.0), abs=2.0)


def test_a_straight_cut_ends_when_the_wire_breaks():
    frail = in_a_hole(altered(Machine.load(height_mm=5.0), FRAIL), 10.0, 1)
    assert Traverse(frail, 1.0).run(5.0)[-1].broken
    assert frail.time_ns < 1e9


def test_charge_and_vibration_of_a_straight_cut_are_those_of_its_windows():
    cut = cut_straight(Machine.load(height_mm=5.0), 15.0, seed=1, settle_s=3.0, seconds=1.5)
    clean = [window for window in cut.windows if not window.short and window.spark]
    share = sum(window.energy_J for window in clean) / cut.energy
    sums = Sums()
    for window in cut.windows:
        sums.add(CycleResult(window, 0, 0.0, 0.0))
    assert 0.0 < math.sqrt(sums.vibration2_pulses / sums.pulses) == pytest.approx(cut.vibration_um)
    measured_C = sum(window.mean_current_A * window.duration_ns * 1e-9 for window in clean)
    assert share > 0.3
    assert cut.charge * share == pytest.approx(measured_C, rel=1e-6)


class Clockwork:
    """A planner of units of 100 nm/s that makes a step at the begin of every stretch it runs, and notes it."""

    speed_unit_nm_s = 100.0

    def __init__(self):
        self.ran = []
        self.path_um = 0.0

    def advance(self, start_ns, end_ns, speed_units):
        self.ran.append((start_ns, end_ns, speed_units))
        self.path_um += speed_units * 1e-10 * (end_ns - start_ns)
        return [Step(start_ns, 0, 1)] if speed_units else []

    def snapshot(self):
        return [*self.ran]

    def restore(self, ran):
        self.ran = [*ran]


class Lines:
    """A controller with lines to the motors, which makes every step a microsecond later."""

    def __init__(self):
        self.driven = []

    def drive(self, steps):
        self.driven.append(steps)
        return [Step(step.time_ns + 1_000, step.axis, step.direction) for step in steps]


def planned(command, lines=None, rest_until_ns=0):
    return PlannerMotion(Clockwork(), lines, 7.0, rest_until_ns, command, 50.0, along_x())


def along_x():
    """An offset whose leg has begun: before, there is no path to lie beside."""
    offset = PathOffset(2.0)
    offset.begin_leg(np.array([(0.0, 0.0), (100.0, 0.0)]))
    return offset


def ran(motion):
    assert isinstance(motion.planner, Clockwork)
    return motion.planner.ran


def test_a_new_feed_counts_when_its_latency_is_over():
    motion = planned(FeedCommand(20.0))
    motion.plan(0, 1_000_000, certain=True)
    motion.keep(0, 1_000_000)
    assert ran(motion) == [(0, 1_000_000, 200)]
    assert motion.feed_um_s == pytest.approx(20.0)
    motion.command = FeedCommand(-30.0, latency_s=400e-6)
    motion.plan(1_000_000, 2_000_000, certain=True)
    motion.keep(1_000_000, 2_000_000)
    assert ran(motion)[1:] == [(1_000_000, 1_400_000, 200), (1_400_000, 2_000_000, -300)]
    assert motion.feed_um_s == pytest.approx(-30.0)
    assert motion.path_um == pytest.approx(7.0 + 0.02 + 0.008 - 0.018)


def test_a_latency_longer_than_the_window_leaves_the_feed_as_it_was():
    motion = planned(FeedCommand(20.0, latency_s=2e-3))
    motion.plan(0, 1_000_000, certain=True)
    motion.keep(0, 1_000_000)
    assert ran(motion) == [(0, 1_000_000, 0)]
    assert motion.feed_um_s == 0.0


@pytest.mark.parametrize(("requested_um_s", "units"), [(80.0, 500), (-80.0, -500), (12.34, 123), (49.96, 500)])
def test_feeds_are_whole_units_up_to_the_greatest_either_way(requested_um_s, units):
    motion = planned(FeedCommand(requested_um_s))
    motion.plan(0, 1_000, certain=True)
    motion.keep(0, 1_000)
    assert ran(motion) == [(0, 1_000, units)]
    assert motion.feed_um_s == pytest.approx(0.1 * units)


def test_the_wire_rests_until_its_time():
    motion = planned(FeedCommand(20.0), rest_until_ns=2_000)
    for start_ns in (1_999, 2_000):
        motion.plan(start_ns, start_ns + 1, certain=True)
        motion.keep(start_ns, start_ns + 1)
    assert ran(motion) == [(1_999, 2_000, 0), (2_000, 2_001, 200)]


def test_where_a_window_may_end_early_its_steps_are_driven_when_its_end_is_known():
    lines = Lines()
    motion = planned(FeedCommand(20.0), lines)
    assert motion.plan(0, 1_000_000, certain=False) == [Step(0, 0, 1)]
    assert lines.driven == []
    motion.keep(0, 600_000)
    assert ran(motion) == [(0, 600_000, 200)]
    assert lines.driven == [[Step(0, 0, 1)]]
    assert motion.plan(600_000, 1_600_000, certain=True) == [Step(601_000, 0, 1)]
    motion.keep(600_000, 1_600_000)
    assert ran(motion) == [(0, 600_000, 200), (600_000, 1_600_000, 200)]


def test_no_steps_are_not_driven():
    lines = Lines()
    motion = planned(FeedCommand(0.0), lines)
    assert motion.plan(0, 1_000_000, certain=True) == []
    assert lines.driven == []


def test_the_guides_take_their_lateral_offset_before_they_go_along_the_path():
    offset = along_x()
    motion = PlannerMotion(Clockwork(), None, 0.0, 0, FeedCommand(20.0, offset_um=6.0), 50.0, offset)
    assert motion.plan(0, 1_000, certain=True) == [Step(0, 1, 1), Step(0, 0, 1)]
    assert offset.lateral_um == (0.0, 2.0)


def test_a_motion_goes_on_from_its_snapshot():
    motion = planned(FeedCommand(20.0), rest_until_ns=5)
    motion.plan(5, 1_000, certain=True)
    motion.keep(5, 1_000)
    state = motion.snapshot()
    motion.command, motion.rest_until_ns = FeedCommand(-3.0), 9_000
    motion.plan(1_000, 9_000, certain=True)
    motion.keep(1_000, 9_000)
    motion.restore(state)
    assert (motion.feed_um_s, motion.command, motion.rest_until_ns) == (pytest.approx(20.0), FeedCommand(20.0), 5)
    assert ran(motion) == [(5, 1_000, 200)]


def test_a_straight_cut_takes_times_above_zero():
    times: dict[str, float]
    for times in ({"settle_s": 0, "seconds": 1.0}, {"settle_s": 1.0, "seconds": 0.0}):
        with pytest.raises(InputError, match="give a time above 0 s"):
            cut_straight(Machine.load(height_mm=5.0), 15.0, seed=1, **times)
