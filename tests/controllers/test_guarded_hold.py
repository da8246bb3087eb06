"""A law that relieves the wire after bursts of discharges in one place: when, for how long, and what it costs."""

import math

import numpy as np
import pytest

from edmsim import controllers
from edmsim.controllers.feed.law import ServoLaw
from edmsim.controllers.feed.periods import GuardedHold, heat_per_ignition_s, stream_share
from edmsim.controllers.protocols import WindowObservation, set_up_controller
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.plant.constants import critical_W_m2
from edmsim.plant.resolution import resolution

EVEN = (45,) * 5
BURST = (40, 40, 100, 25, 20)


def production_machine(**choices):
    options = {"height_mm": 60.0, "tension": 22.0, **choices}
    return Machine.load("production", generator="production", wire="brass-300", **options)


def law_on_production_machine(name, **parameters):
    law = controllers.make(name, **parameters)
    assert isinstance(law, ServoLaw)
    set_up_controller(law, production_machine(), np.zeros((2, 2)), 0.0)
    law.reset(400.0)
    return law


class Cut:
    """A cut whose windows last as long as the law's periods make them."""

    def __init__(self, name="guarded-hold", **parameters):
        self.law = law_on_production_machine(name, **parameters)
        self.period_us, self.time_s = 90.0, 0.0

    @property
    def rule(self):
        assert isinstance(self.law.period, GuardedHold)
        return self.law.period

    def windows(self, count, fifths=EVEN, short=5):
        commands = []
        for _ in range(count):
            duration_s = WINDOW_PULSES * self.period_us * 1e-6
            self.time_s += duration_s
            open_ = WINDOW_PULSES - short - sum(fifths)
            window = WindowObservation(self.time_s, duration_s, short, open_, 30.0, 5.0, 5.0, 10.0, 0.0, fifths)
            commands.append(self.law.update(window))
            self.period_us = commands[-1].t_period_us or 0.0
        return commands

    def periods_us(self, count, fifths=EVEN, short=20):
        return [command.t_period_us or 0.0 for command in self.windows(count, fifths, short)]


@pytest.mark.parametrize("pressures", [(200e3, 200e3), (60e3, 240e3), (250e3, 100e3)])
def test_where_the_stream_bears_more_heat_follows_from_the_pressures_as_in_the_plant(pressures):
    machine = production_machine(flushing_lower_Pa=pressures[0], flushing_upper_Pa=pressures[1])
    ours, plant = stream_share(machine), critical_W_m2(machine, resolution("fast"))
    assert ours / ours.mean() == pytest.approx(plant / plant.mean(), rel=0.05)


def test_without_flushing_the_water_is_still():
    assert stream_share(production_machine(flushing_lower_Pa=0.0, flushing_upper_Pa=0.0)) == pytest.approx(1.0)


@pytest.mark.parametrize("known", [stream_share, heat_per_ignition_s])
def test_constants_of_the_machine_at_work_are_not_looked_at(known):
    parts = ["cooling", "wire", "material", "guides", "dielectric"]
    drawn = production_machine().sample(np.random.default_rng(3), parts)
    assert np.array_equal(known(drawn), known(production_machine()))


def test_one_window_of_long_periods_follows_a_burst_and_the_feed_falls_with_it():
    cut = Cut(gentle_s=0.0)
    usual = cut.windows(600)[-1]
    relief = cut.windows(1, BURST)[0]
    after = cut.windows(1, (20,) * 5)[0]
    assert relief.t_period_us == pytest.approx(200.0)
    assert 0.0 < relief.feed_um_s < 1.3 * usual.feed_um_s * usual.t_period_us / 200.0
    assert after.t_period_us == pytest.approx(usual.t_period_us, rel=0.05)
    assert Cut(reliefs_per_s=0.0, gentle_s=0.0).windows(600)[-1].t_period_us == pytest.approx(usual.t_period_us)


def test_no_burst_is_relieved_where_the_guard_is_off():
    cut = Cut(reliefs_per_s=0.0)
    usual = cut.windows(600)[-1]
    assert cut.windows(1, BURST)[0].t_period_us == pytest.approx(usual.t_period_us, rel=0.3)


def test_the_guard_settles_where_there_are_as_many_bursts_as_its_parameter_says():
    rng, cut = np.random.default_rng(1), Cut(reliefs_per_s=0.5, limit_share=0.1, limit_spread=0.1)
    reliefs, seconds = 0, 0.0
    for k in range(12_000):
        fifths = tuple(np.minimum(rng.poisson(25.0, 5), 51).tolist())
        command = cut.windows(1, fifths, short=0)[0]
        if k > 6_000:
            seconds += WINDOW_PULSES * (command.t_period_us or 0.0) * 1e-6
            reliefs += cut.rule.relieving
    assert reliefs / seconds == pytest.approx(0.5, rel=0.3)
    assert 1.15 <= math.exp(cut.rule.log_guard) < 1.5


def test_pulses_that_all_ignite_after_a_short_reach_no_more_flux_than_the_restart_allows():
    cut = Cut(restart_share=0.7, reliefs_per_s=0.0, limit_share=0.1, limit_spread=0.1, gentle_s=0.0)
    usual = cut.windows(600, (25,) * 5)[-1]  # half of the pulses are open
    assert cut.rule.hold > 0.0
    restarted = cut.windows(3, (0,) * 5, short=255)[-1]
    assert usual.t_period_us is not None
    full = cut.rule.ignition_s * 1e6 / (restarted.t_period_us or 0.0)
    assert full <= cut.rule.hold / 0.7 * 1.001
    assert restarted.t_period_us > 1.2 * usual.t_period_us
    assert cut.windows(100, (25,) * 5)[-1].t_period_us == pytest.approx(usual.t_period_us, rel=0.1)


def test_the_first_wire_finds_its_limit_in_a_ramp_and_later_ones_hold_what_was_learned():
    cut = Cut(limit_share=0.2, limit_spread=0.5, ramp_s=20.0, ramp_per_s=0.1, gentle_s=0.0)
    cut.windows(1)
    first, began_s = cut.rule.hold, cut.time_s
    assert first < Cut(limit_share=0.2, limit_spread=0.5).rule.hold
    while cut.time_s < began_s + 10.0:
        cut.windows(1, (25,) * 5)
    assert cut.rule.hold == pytest.approx(first * math.exp(0.1 * 10.0), rel=0.15)
    broke_at = cut.rule.level
    cut.law.wire_lost()
    held = cut.rule.hold
    assert broke_at is not None
    assert 0.6 < held / math.exp(broke_at) < 1.0
    cut.windows(300, (25,) * 5)
    assert cut.rule.hold == pytest.approx(held, rel=0.1)  # no second ramp
    unbroken = Cut(limit_share=0.2, limit_spread=0.5, ramp_s=20.0, ramp_per_s=0.1, gentle_s=0.0)
    while unbroken.time_s < 25.0:
        unbroken.windows(1, (25,) * 5)
    assert unbroken.rule.hold < first * math.exp(0.1 * 19.0)  # the law decides after the ramp


def test_where_the_hazard_is_steeper_more_of_a_known_limit_is_held():
    known = {"limit_share": 0.2, "limit_spread": 0.02}
    holds = [Cut(steepness=steepness, **known).rule.hold for steepness in (10.0, 20.0, 40.0)]
    assert 0.7 * 0.2 < holds[0] < holds[1] < holds[2] < 0.2


def test_a_new_wire_reaches_the_held_flux_in_some_time():
    cut = Cut(reliefs_per_s=0.0, gentle_s=8.0, gentle_share=0.65)

    def share_after(seconds):
        end_s = cut.time_s + seconds
        while cut.time_s < end_s:
            cut.windows(1)
        return cut.law.gauge.flux.max() / cut.rule.hold

    assert share_after(10.0) == pytest.approx(1.0, rel=0.02)
    cut.law.wire_lost()
    assert share_after(4.0) == pytest.approx(0.65 + 0.35 * 4.0 / 8.0, rel=0.05)
    assert share_after(6.0) == pytest.approx(1.0, rel=0.02)
