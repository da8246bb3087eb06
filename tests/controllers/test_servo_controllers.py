"""The servos: which way they answer, how they leave a short, and what they do with a window that tells nothing."""

import math
from dataclasses import fields
from typing import ClassVar

import pytest

from edmsim import controllers
from edmsim.controllers import WindowObservation
from edmsim.controllers.feed.law import OpenShare, ServoLaw
from edmsim.errors import InputError
from edmsim.job.plan import make_controller
from edmsim.machine.pulse_window import PulseWindow

MAX_FEED = 100.0
WINDOW_S = 0.0255
SERVOS = ("voltage", "delay", "fuzzy", "adaptive-off-time")
WIDE = {"short": 0, "open": 200, "voltage_V": 26.0, "delay_us": 15.0}
CLOSE = {"short": 60, "open": 0, "voltage_V": 3.0, "delay_us": 1.0}
SHORTED = {"short": 255, "open": 0, "voltage_V": 0.0, "delay_us": math.nan}


def observed(short=0, open=0, voltage_V=15.0, delay_us=9.0, feed_um_s=10.0, current_A=1.0, period_us=100.0):
    return WindowObservation(0.0, 255e-6 * period_us, short, open, voltage_V, current_A, delay_us, feed_um_s, 0.0)


def truth(gap_um=10.0, temperature_K=320.0, short=0, open=50):
    return PulseWindow(
        0, 25_500_000, short, open, 255 - short - open, 0, 15.0, 1.0, 9.0, gap_um, (0.0, 0.0), 0.0, temperature_K,
        0.0, 0.0, 0.0, 0.0, False,
    )  # fmt: skip


def started(name, **parameters):
    controller = controllers.make(name, **parameters)
    controller.reset(MAX_FEED)
    return controller


def after(controller, windows, **what):
    return [controller.update(observed(**what)) for _ in range(windows)]


@pytest.mark.parametrize("name", SERVOS)
def test_a_wide_gap_is_followed_and_a_close_one_is_not(name):
    wide = [command.feed_um_s for command in after(started(name), 200, **WIDE)]
    close = [command.feed_um_s for command in after(started(name), 60, **CLOSE)]
    assert wide[-1] > 2 * controllers.make(name).start_feed_um_s
    assert close[-1] < 0.5 * controllers.make(name).start_feed_um_s


@pytest.mark.parametrize("name", SERVOS)
def test_a_short_that_stays_is_met_by_running_back_and_then_more_slowly(name):
    controller = started(name)
    after(controller, 100, **WIDE)
    before = controller.snapshot()["servo"]["integral_um_s"]
    feeds = [command.feed_um_s for command in after(controller, 20, **SHORTED)]
    patience = math.ceil(controller.patience_s / WINDOW_S)
    assert all(feed == -controller.retract_feed_um_s for feed in feeds[patience:])
    controller.update(observed(**WIDE))
    assert 0.0 < controller.snapshot()["servo"]["integral_um_s"] < 0.7 * before


def test_a_law_made_for_a_faster_machine_retracts_as_fast_as_this_one_runs():
    controller = controllers.make("adaptive-hold")
    controller.reset(33.3)
    assert controller.retract_feed_um_s > 33.3
    feeds = [command.feed_um_s for command in after(controller, 20, **SHORTED)]
    assert feeds[-1] == -33.3


@pytest.mark.parametrize("name", SERVOS)
def test_a_short_that_never_clears_stops_the_machine(name):
    controller = started(name, give_up_s=2.0)
    commands = after(controller, 90, **SHORTED)
    alarms = [command.alarm for command in commands]
    first = alarms.index("persistent short")
    assert first == math.ceil(2.0 / WINDOW_S) - 1
    assert commands[first].feed_um_s == 0.0


def test_giving_up_at_once_takes_a_short():
    controller = started("voltage", give_up_s=0.0)
    assert {command.alarm for command in after(controller, 5, **WIDE)} == {None}
    assert after(controller, 1, **SHORTED)[0].alarm == "persistent short"


@pytest.mark.parametrize("name", SERVOS)
def test_a_window_without_numbers_leaves_finite_feeds(name):
    controller = started(name)
    after(controller, 5, **WIDE)
    nothing = observed(short=100, open=50, voltage_V=math.nan, delay_us=math.nan, current_A=math.nan)
    assert math.isfinite(controller.update(nothing).feed_um_s)
    assert all(math.isfinite(command.feed_um_s) for command in after(controller, 50, **WIDE))


def test_the_voltage_servo_stands_still_at_its_reference():
    controller = started("voltage", reference_V=15.0, proportional_um_s_V=2.0, integral_um_s2_V=0.0, filter_s=0.0)
    assert controller.update(observed(voltage_V=15.0)).feed_um_s == controller.start_feed_um_s
    assert controller.update(observed(voltage_V=18.0)).feed_um_s == controller.start_feed_um_s + 6.0


def test_the_mean_delay_counts_shorts_as_none_and_opens_as_the_on_time():
    controller = started("delay", reference_us=0.0, open_delay_us=30.0)
    assert controller.measure.error(observed(short=255, delay_us=math.nan), controller.servo) == 0.0
    assert controller.measure.error(observed(open=255, delay_us=math.nan), controller.servo) == 30.0
    mixed = controller.measure.error(observed(short=51, open=51, delay_us=10.0), controller.servo)
    assert mixed == pytest.approx(0.2 * 30 + 0.6 * 10)


def test_fuzzy_rules_are_ordered_and_shorts_overrule_them():
    def says(open_share, change_s=0.0, short_share=0.0):
        controller = started("fuzzy", filter_s=0.0)
        window = observed(short=round(short_share * 255), open=round(open_share * 255))
        controller.measure.open = window.open / 255 - change_s * WINDOW_S
        return controller.measure.error(window, controller.servo)

    target = controllers.make("fuzzy").open_target_share
    ratios = [says(share) for share in (0.0, target, min(1.0, target + 0.5), 1.0)]
    assert ratios == sorted(ratios)
    assert abs(ratios[1]) < 0.1
    assert ratios[-1] == 1.0
    assert says(target, 5.0) == pytest.approx(0.5, abs=0.1)
    assert says(target, -5.0) == pytest.approx(-0.5, abs=0.1)
    assert says(0.0, short_share=1.0) == -2.0


def test_too_many_normal_pulses_stretch_the_period_but_never_shorten_the_operators():
    controller = started("adaptive-off-time", normal_at_10mm=300.0)
    busy = [c.t_period_us for c in after(controller, 200, open=20, feed_um_s=40.0, current_A=1.4)]
    assert busy[0] == 100.0
    assert busy[-1] > 150.0
    assert max(busy) <= 100.0 * controller.longest_factor
    quiet = after(controller, 400, open=250, feed_um_s=40.0, current_A=0.1, period_us=busy[-1])
    assert quiet[-1].t_period_us == 100.0


def test_a_thick_workpiece_bears_more_normal_pulses():  # Sato: the threshold rises with thickness
    periods = []
    for feed_um_s in (100.0, 10.0):  # the same current at a tenth of the speed: ten times as thick
        controller = started("adaptive-off-time", normal_at_10mm=400.0)
        periods.append(after(controller, 200, open=40, feed_um_s=feed_um_s, current_A=1.2)[-1].t_period_us)
    assert periods[0] > periods[1]


def test_standing_still_tells_no_thickness():
    controller = started("adaptive-off-time")
    after(controller, 100, open=40, feed_um_s=0.0)
    assert controller.snapshot()["period"]["height_mm"] == 0.0
    assert controller.snapshot()["period"]["period_us"] == 100.0


def test_the_oracle_follows_the_true_gap_and_slows_down_for_a_hot_wire():
    def feed(**what):
        controller = started("oracle", gap_target_um=8.0)
        for _ in range(100):
            controller.see(truth(**what))
            command = controller.update(observed(open=50))
        return command.feed_um_s

    assert feed(gap_um=14.0) > feed(gap_um=8.0) > feed(gap_um=4.0) >= -20.0
    assert feed(gap_um=14.0, temperature_K=900.0) < feed(gap_um=8.0)
    assert feed(gap_um=math.nan, open=255) > feed(gap_um=math.nan, short=255, open=0)


def test_the_oracle_must_be_shown_the_truth():
    with pytest.raises(InputError, match="call see"):
        started("oracle").update(observed())
    with pytest.raises(InputError, match="looks at the true gap, which no machine shows"):
        make_controller("oracle")


def test_a_trim_keeps_its_feed_is_slowed_by_shorts_and_runs_back_from_one_that_stays():
    trim = controllers.make("trim", feed_um_s=60.0, stop_share=0.4, filter_s=0.0)
    assert trim.reset(400.0).feed_um_s == 60.0
    feeds = [trim.update(observed(short=short)).feed_um_s for short in (0, 51, 102, 0)]
    assert feeds == pytest.approx([60.0, 30.0, 0.0, 60.0])
    steady = controllers.make("trim", feed_um_s=60.0)
    steady.reset(400.0)
    feeds = [command.feed_um_s for command in after(steady, 12, short=255)]
    assert feeds[0] > 0 > feeds[-1]


def test_an_own_law_has_its_own_parameter_and_those_of_its_parts():
    class Own(ServoLaw, measure=OpenShare):
        name: ClassVar[str] = "own"
        margin_share: float = 0.1

    assert {"margin_share", "open_target_share", "filter_s"} <= {field.name for field in fields(Own)}
    assert Own(margin_share=0.2).margin_share == 0.2
