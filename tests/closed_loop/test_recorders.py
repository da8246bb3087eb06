"""Recorders see every window before anything is decided, change nothing, and are saved; why a machine stops."""

import itertools
from typing import ClassVar

import numpy as np
import pytest

from edmsim.closed_loop.cycle import Recorder
from edmsim.closed_loop.simulation import Simulation
from edmsim.closed_loop.stops import WORDS, StopCause, stop_cause, switches_open
from edmsim.controllers import FeedCommand
from edmsim.controllers.feed.laws import FixedController
from edmsim.machine.machine import Machine
from edmsim.program.path import CutPath, WireContour


class Periods(Recorder):
    """Keeps the generator's period of every window, and where legs began."""

    name: ClassVar[str] = "periods"

    def __init__(self):
        self.periods_us = []
        self.starts_um = []

    def leg(self, points_um, start_um):
        self.starts_um.append(start_um)

    def window(self, result, plant):
        self.periods_us.append(plant.machine.t_period_us)

    def snapshot(self):
        return {"periods_us": np.array(self.periods_us)}

    def restore(self, state):
        self.periods_us = state["periods_us"].tolist()


class Slower(FixedController):
    """Asks for a longer period after every window."""

    def update(self, window):
        return FeedCommand(self.feed_um_s, t_period_us=round(window.duration_s / 255e-6) + 10.0)


def simulation(*recorders):
    points = np.array([(30_000, 30_000), (30_020, 30_000), (30_060, 30_000)])
    contour = WireContour(points, 0, points * 1e-3, False, "left", ((1, 0.05),), (1, 1))
    path = CutPath((contour,), (25.0, 25.0, 40.0, 40.0), 0.5, (30.0, 30.0), (), "test")
    return Simulation(Machine.load(height_mm=5), path, Slower(), seed=1, resolution="fast", recorders=recorders)


def test_a_window_is_observed_with_the_setting_it_was_fired_with():
    periods = Periods()
    cut = simulation(periods)
    for _ in range(4):
        cut.step()
    assert periods.periods_us == [100.0, 110.0, 120.0, 130.0]
    assert cut.plant.machine.t_period_us == 140.0


def test_legs_begin_where_the_ones_before_ended():
    periods = Periods()
    simulation(periods).run()
    assert periods.starts_um == [0.0, pytest.approx(20.0, abs=2)]


def test_a_cut_is_the_same_with_and_without_them():
    watched, alone = simulation(Periods()), simulation()
    watched.run()
    alone.run()
    assert (watched.plant.time_ns, watched.sums) == (alone.plant.time_ns, alone.sums)


def test_a_snapshot_holds_them_under_their_names():
    whole, first, second = Periods(), Periods(), Periods()
    simulation(whole).run()
    cut = simulation(first)
    for _ in range(7):
        cut.step()
    arrays, values = cut.snapshot()
    assert arrays["periods.periods_us"].tolist() == first.periods_us
    resumed = simulation(second)
    resumed.restore(arrays, values)
    resumed.run()
    assert second.periods_us == whole.periods_us


ORDER = (
    StopCause.WIRE_BREAK, StopCause.LIMIT_SWITCH, StopCause.DRIVE_TRIP, StopCause.PERSISTENT_SHORT,
    StopCause.TIME_LIMIT, StopCause.FINISHED,
)  # fmt: skip


def test_of_several_causes_the_first_in_order_counts():
    for flags in itertools.product([False, True], repeat=6):
        causes = [cause for cause, flag in zip(ORDER, flags, strict=True) if flag]
        assert stop_cause(*flags) == (causes[0] if causes else StopCause.RUNNING)


@pytest.mark.parametrize(
    ("place_um", "open_"), [(-2.1, -1), (-2.0, 0), (0.0, 0), (30_000.0, 0), (65_002.0, 0), (65_002.1, 1)]
)
def test_a_switch_opens_one_step_beyond_its_end(place_um, open_):
    assert switches_open(place_um, 65_000.0, 2.0) == open_


def test_every_cause_has_its_words():
    assert set(WORDS) == set(StopCause)
    reports = [words.report for words in WORDS.values()]
    assert len(set(reports)) == len(reports)
