"""What a drive does beyond its manual, on the bench: off unless it is asked for."""

import numpy as np
import pytest

from edmsim.controllers import axis
from edmsim.controllers.axis.servo_chip import SAMPLES
from edmsim.controllers.axis.uhu import Uhu
from edmsim.errors import InputError

from .uhu_bench import ask, bench_with, error, moved, stepped, traced


def running(**settings):
    bench = bench_with(Uhu.tuned("bench"))
    bench.drive("x").extensions.update(settings)
    return bench


def following_errors(bench, rate_Hz=5000.0, accel_Hz_s=40_000.0):
    bench.steps("x", 3000, rate_Hz, accel_Hz_s)
    samples = traced(bench, 0.5)
    return np.asarray(samples["setpoint"] - samples["count"])


def test_nothing_is_on_at_first():
    assert set(Uhu().extensions.values()) == {0}
    bench = running()
    plain = following_errors(bench)
    assert bench.drive("x").extensions.recording() is None
    assert np.array_equal(plain, following_errors(running(command_filter=3)))  # which nothing uses


def test_anti_windup_lessens_the_overshoot_after_a_stall():
    def overshoot(**settings):
        bench = running(**settings)
        bench.hold("x", True)
        moved(bench, 200, run_s=0.5)
        bench.hold("x", False)
        return int(traced(bench, 0.5)["count"].max()) - 200

    assert overshoot(anti_windup=1) < 0.5 * overshoot()


def test_the_time_at_the_limit_is_counted():
    bench = running(anti_windup=1)
    extensions = bench.drive("x").extensions
    assert extensions.longest_limited_s == 0.0
    bench.hold("x", True)
    moved(bench, 500, run_s=0.25)
    assert extensions.limited_s == pytest.approx(0.25, abs=0.002)
    moved(bench, -500, run_s=0.2)
    assert (extensions.limited_s, extensions.longest_limited_s) == (0.0, pytest.approx(0.25, abs=0.003))


def test_velocity_feed_forward_takes_the_error_of_constant_speed_away():
    bench = running()
    ask(bench, "I0")
    plain = np.abs(following_errors(bench)[300:700]).mean()
    errors = {}
    for gain in (12_000, 16_000, 18_000):
        bench = running(velocity_feed_forward=gain, command_filter=2)
        ask(bench, "I0")
        errors[gain] = np.abs(following_errors(bench)[300:700]).mean()
    assert min(errors.values()) < 0.3 * plain


def test_acceleration_feed_forward_acts_on_ramps_only():
    def mean_errors(gain):
        bench = running(acceleration_feed_forward=gain)
        ask(bench, "I0")
        errors = following_errors(bench, 5000.0, 150_000.0)
        return float(errors[20:60].mean()), float(errors[600:900].mean())

    (ramp, flat), (helped_ramp, helped_flat) = mean_errors(0), mean_errors(32_000)
    assert helped_ramp < ramp - 0.4
    assert helped_flat == pytest.approx(flat, abs=0.3)


def test_jerk_feed_forward_acts_where_a_ramp_begins():
    plain, helped = following_errors(running(command_filter=4)), following_errors(
        running(command_filter=4, jerk_feed_forward=30_000)
    )
    assert not np.array_equal(plain[:60], helped[:60])
    assert helped[400:450].mean() == pytest.approx(plain[400:450].mean(), abs=0.5)


def test_the_recorder_keeps_what_was_before_its_trigger():
    bench = running()
    extensions = bench.drive("x").extensions
    extensions.record_on("move", before=100)
    bench.run(0.2)
    assert extensions.recording() is None
    samples_before = traced(bench, 0.0)
    bench.steps("x", 500, 4000.0)
    samples = np.concatenate([samples_before, traced(bench, 0.3)])
    recording = extensions.recording()
    assert recording is not None
    assert len(recording.time_s) == SAMPLES
    assert recording.time_s[100] == 0.0
    assert np.diff(recording.time_s) == pytest.approx(50 * 256 / 24e6)
    assert not recording.command_velocity[:100].any()
    assert recording.command_velocity[100] != 0
    first = int(np.argmax(samples["setpoint"] != 0))
    later = slice(first, first + SAMPLES - 100)
    assert np.array_equal(recording.error[100:], samples["setpoint"][later] - samples["count"][later])
    assert recording.output[100:] == pytest.approx(samples["command"][later] / 0.74 * 255, abs=1e-6)
    assert recording.velocity[101:] == pytest.approx(np.diff(samples["count"][later]))


@pytest.mark.parametrize("wait", range(5))
def test_samples_before_the_trigger_have_their_own_times(wait):
    bench, interval_s = running(), 50 * 256 / 24e6
    extensions = bench.drive("x").extensions
    bench.hold("x", True)
    extensions.record_on("error", level=30, before=20, every=5)
    samples_before = traced(bench, 0.1 + wait * interval_s)  # the trigger is any number of intervals after a sample
    bench.steps("x", 100, 1000.0)
    samples = np.concatenate([samples_before, traced(bench, 1.1)])
    recording, error = extensions.recording(), samples["setpoint"] - samples["count"]
    trigger = int(np.argmax(error >= 30))
    places = trigger + np.round(recording.time_s / interval_s).astype(int)
    assert recording.time_s[20] == 0.0
    assert np.array_equal(recording.error, error[places])
    assert np.all(np.diff(recording.error[12:20]) > 0)  # it grows before the trigger


@pytest.mark.parametrize(("trigger", "level", "counts"), [
    ("at once", 0, 30), ("error", 20, 30), ("output limit", 0, 600), ("fault", 0, 1200),
])  # fmt: skip
def test_every_trigger_starts_a_recording(trigger, level, counts):
    bench = running()
    extensions = bench.drive("x").extensions
    extensions.record_on(trigger, before=10, every=2, level=level)
    bench.run(0.05)
    bench.hold("x", True)
    moved(bench, counts, run_s=0.6)
    recording = extensions.recording()
    assert recording is not None
    assert (recording.error[0], recording.error[-1]) == (0, counts)


def test_a_change_of_direction_starts_a_recording():
    bench = running()
    bench.drive("x").extensions.record_on("direction change", before=0)
    stepped(bench, 200, 2000.0, run_s=0.15)
    stepped(bench, -200, 2000.0, run_s=0.6)
    recording = bench.drive("x").extensions.recording()
    assert recording is not None
    assert recording.command_velocity[0] < 0


def test_a_hard_reset_keeps_the_settings():
    bench = running(anti_windup=1)
    bench.talk(b"+\r")
    assert bench.drive("x").extensions["anti_windup"] == 1
    bench.run(0.1)
    assert error(bench) == 0


@pytest.mark.parametrize(("name", "value", "said"), [
    ("windup", 1, "has no 'windup'; it has anti_windup"),
    ("anti_windup", 2, "anti_windup is 2; it must be a whole number 0 to 1"),
    ("velocity_feed_forward", 0.5, "must be a whole number -32767 to 32767"),
    ("saturating_arithmetic", 1, "has no"),  # the UHU's arithmetic never wraps
])  # fmt: skip
def test_a_wrong_setting_is_refused(name, value, said):
    with pytest.raises(InputError, match=said):
        Uhu().extensions[name] = value


def test_a_wrong_recording_is_refused():
    extensions = Uhu().extensions
    with pytest.raises(InputError, match="has no trigger 'never'; it has at once"):
        extensions.record_on("never")
    with pytest.raises(InputError, match="0 to 383 before"):
        extensions.record_on("move", before=384)
    with pytest.raises(InputError, match=r"every is 1\.5: give a whole number"):
        extensions.record_on("move", every=1.5)
    with pytest.raises(InputError, match="trigger cannot be"):
        extensions.record_on(["move"])


def test_parameters_are_refused_alike():
    drive = Uhu()
    with pytest.raises(InputError, match="proportional_gain is 65536; it must be a whole number 0 to 65535"):
        drive.parameters["proportional_gain"] = 65536
    for name, value in (("cycle", "63"), ("cycle", None), ("proportional_gain", np.nan)):
        with pytest.raises(InputError, match="must be a whole number 0 to 65535"):
            drive.parameters[name] = value
    for name, value, said in (("encoder_sense", 0, "1 or -1"), ("pwm_Hz", 0, "1 to"), ("pwm_Hz", "9", "1 to")):
        with pytest.raises(InputError, match=said):
            Uhu(law={name: value})
    with pytest.raises(InputError, match="cannot be taken away"):
        del drive.parameters["cycle"]
    assert "cycle" in drive.parameters
    assert "C" not in drive.parameters
    assert "jerk" not in drive.extensions
    with pytest.raises(InputError, match="has no 'gain'; it has proportional_gain"):
        Uhu(stored={"gain": 1})
    with pytest.raises(InputError, match="no UHU is tuned for an axis 'z'; there are: table, bench"):
        Uhu.tuned("z")


@pytest.mark.parametrize(("text", "said"), [
    ("uhu:P=1,proportional_gain=2", "drive's proportional_gain is given twice"),
    ("servo-module:p=1,P=2", "drive's proportional_gain is given twice"),
    ("eanpos:PGAIN=1,pgain=2", "device's pgain is given twice"),
])  # fmt: skip
def test_a_parameter_by_two_of_its_names_is_refused(text, said):
    with pytest.raises(InputError, match=said):
        axis.from_text(text)
