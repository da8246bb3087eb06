"""The servo module moving an axis: feed-forwards, derivative, scaled limit, multiplier, load, encoder."""

from __future__ import annotations

import numpy as np
import pytest

from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis import ServoModule, Uhu
from edmsim.controllers.axis.drive import axis_row
from edmsim.errors import InputError

from .module_bench import NO_TRIP, get, locked, on_bench, say, status, words
from .uhu_bench import stepped

CYCLE_NS = 51_200 * 13
ONE_STEP_HZ = 1e9 / CYCLE_NS
FAST = {"proportional_gain": 100, "derivative_gain": 800, "integral_gain": 2, "velocity_feed_forward": 210}
"""Gains for the axis ``fast``."""


def steady_error(rate_Hz, **stored):
    """Mean error in counts while the axis moves steadily, from the recorder."""
    bench = on_bench(error_limit=NO_TRIP, **stored)
    bench.trace = True
    stepped(bench, round(rate_Hz), rate_Hz, 10 * rate_Hz, run_s=0.8)
    rows = bench.samples("x")[-300:]
    multiplier = 1 + stored.get("step_multiplier", 0)
    return float(np.mean(rows["setpoint"] * multiplier - rows["count"]))


def test_velocity_feed_forward_takes_the_error_at_speed_away():  # M-27, M-37
    without = steady_error(20_000.0)
    tuned = steady_error(20_000.0, velocity_feed_forward=2600)
    assert without > 30
    assert abs(tuned) < 0.2 * without
    assert steady_error(20_000.0, velocity_feed_forward=5200) < -0.5 * without


def test_the_derivative_acts_on_the_error_and_does_not_drag():  # M-36
    errors = [steady_error(20_000.0, derivative_gain=gain) for gain in (5000, 9000)]
    assert errors[1] == pytest.approx(errors[0], abs=1.5)


def errors_on_a_ramp(**stored):
    """Mean errors while speeding up, at speed, and while slowing down."""
    bench = on_bench(error_limit=NO_TRIP, velocity_feed_forward=2600, **stored)
    bench.trace = True
    rate, accel = 40_000.0, 200_000.0
    bench.steps("x", 16_000, rate, accel)  # 0.2 s up, 0.2 s at speed, 0.2 s down
    start = bench.time_s
    bench.run(0.7)
    rows = bench.samples("x")
    time_s = rows["time_ns"] * 1e-9 - start
    error = rows["setpoint"] - rows["count"]
    spans = ((0.08, 0.18), (0.3, 0.38), (0.48, 0.58))
    return [float(np.mean(error[(time_s > a) & (time_s < b)])) for a, b in spans]


def test_acceleration_feed_forward_pushes_when_speeding_up_and_pulls_when_slowing_down():  # M-6, M-37
    without, helped = errors_on_a_ramp(), errors_on_a_ramp(acceleration_feed_forward=40_000)
    assert without[0] - helped[0] > 3
    assert without[2] - helped[2] < -3
    assert helped[1] == pytest.approx(without[1], abs=1.5)


@pytest.mark.parametrize(
    ("velocity", "limit"), [(0, 10), (68, 29), (137, 50), (90, 36), (-68, 29), (-137, 50), (-90, 36)]
)
def test_the_limit_grows_with_the_commanded_velocity(velocity, limit):  # M-10, M-15, M-58, appendix B
    """Either way: F goes by the size of the velocity."""
    bench = on_bench("fast", error_limit=NO_TRIP, step_multiplier=max(abs(velocity) - 1, 0), loop_divider=9, **FAST)
    if velocity:
        rate_Hz = 1e9 / (51_200 * 16)
        stepped(bench, 1500 if velocity > 0 else -1500, rate_Hz, 4 * rate_Hz, run_s=0.6)
    say(bench, "F75")
    say(bench, "E10")
    assert say(bench, "GF") == f"Scaled limit: {limit}"


def test_the_velocity_is_that_of_the_motor_in_counts_per_cycle():  # M-11, M-A8
    bench = on_bench("fast", step_multiplier=62, error_limit=NO_TRIP, **FAST)
    stepped(bench, -2000, ONE_STEP_HZ, 4 * ONE_STEP_HZ, run_s=0.7)
    assert np.mean([get(bench, "GV") for _ in range(10)]) == pytest.approx(-63, abs=1)
    bench.run(3.0)
    assert abs(get(bench, "GV")) <= 1


@pytest.mark.parametrize("multiplier", [0, 4, 9])
def test_a_step_counts_one_more_than_the_multiplier_and_a_move_does_not(multiplier):  # M-28, M-34
    bench = on_bench(step_multiplier=multiplier, error_limit=NO_TRIP)
    bench.steps("x", 10, 500.0)
    stepped(bench, -3, 500.0, run_s=0.1)
    assert words(bench, "GT") == 7 * (1 + multiplier)
    say(bench, "+20")
    assert words(bench, "GT") == 7 * (1 + multiplier) + 20
    say(bench, "X9")  # counts for later steps only
    stepped(bench, 1, 500.0, run_s=0.1)
    assert words(bench, "GT") == 7 * (1 + multiplier) + 30


def test_the_offset_holds_a_hanging_load():  # M-22, M-53
    load = {"changes": {"load_N": 300.0}, "integral_gain": 0}
    bench = on_bench(**load)
    bench.run(0.5)
    hanging, output = get(bench, "GE"), get(bench, "GO")
    assert abs(hanging) > 2
    say(bench, f"O{output}", run_s=0.2)
    say(bench, "R", run_s=0.5)
    assert abs(get(bench, "GE")) < 0.5 * abs(hanging)
    assert abs(get(bench, "GO")) < 0.5 * abs(output)
    assert get(bench, "GD") == 1024 + get(bench, "GO") + output


def test_a_finer_encoder_with_a_multiplier_rests_nearer_to_its_place():  # M-60
    rest_um = []
    for lines, multiplier, scale in ((500, 0, 1), (2500, 4, 5)):
        counts_per_rad = 4 * lines / (2 * np.pi)
        bench = on_bench(
            changes={"counts_per_rad": counts_per_rad}, step_multiplier=multiplier, error_limit=NO_TRIP,
            proportional_gain=600, derivative_gain=7000 // scale,
        )  # fmt: skip
        errors = []
        for _ in range(6):
            stepped(bench, 37, 2000.0, run_s=0.2)
            errors.append(abs(get(bench, "GE")))
        rest_um.append(np.mean(errors) * bench.motor("x")["um_per_rad"] / counts_per_rad)
    assert 0.0 < rest_um[1] < 0.5 * rest_um[0]


@pytest.mark.parametrize(("divider", "lost"), [(0, False), (3, False), (5, True), (6, True), (9, True)])
def test_the_encoder_filter_loses_what_is_faster_than_it(divider, lost):  # M-29, M-47
    bench = on_bench("fast", encoder_filter=divider, error_limit=NO_TRIP, step_multiplier=9, **FAST)
    stepped(bench, 6000, 6000.0, 24_000.0, run_s=2.0)
    axis = bench.axis("x")
    assert (abs(int(axis["true_count"]) - int(axis["count"])) > 4) == lost


def test_a_million_counts_a_second_are_followed_where_the_chip_loses_them():  # M-50, M-28
    bench = on_bench("fast", error_limit=NO_TRIP, step_multiplier=9, **FAST)
    bench.steps("x", 200_000, 100_000.0, 50_000.0)
    bench.trace = True
    bench.run(5.0)
    rows = bench.samples("x")
    assert np.max(np.diff(rows["count"])) > 0.98e6 * CYCLE_NS * 1e-9
    axis = bench.axis("x")
    assert int(axis["true_count"]) == int(axis["count"])
    assert abs(words(bench, "GP") - 2_000_000) < 10


def test_the_clamp_of_760_gives_the_uhu_s_force():  # M-39
    module = locked(on_bench(proportional_gain=5000, error_limit=NO_TRIP), 500)
    module.run(0.05)
    chip = AxisBench({"x": Uhu(stored={"error_limit": 5000, "proportional_gain": 30_000})})
    chip.run(0.05)
    chip.hold("x", True)
    chip.steps("x", 4000, 10_000.0)
    chip.run(0.6)
    assert float(module.axis("x")["current_A"]) == pytest.approx(float(chip.axis("x")["current_A"]), rel=3e-3)


def test_one_board_takes_either_chip():  # M-49, M-1
    for drive in (ServoModule.tuned(), Uhu.tuned()):
        bench = AxisBench({"x": drive})
        bench.run(0.05)
        bench.wire("x", fault_in=True, fault_out=True)
        assert bench.pins("x").enabled
        stepped(bench, 40, 1000.0, run_s=0.5)
        assert int(bench.axis("x")["count"]) == pytest.approx(400, abs=20)
        bench.unplug("x", "step")
        stepped(bench, 40, 1000.0, run_s=0.5)
        assert int(bench.axis("x")["count"]) == pytest.approx(400, abs=20)
        bench.pull_fault_net(True)
        bench.run(0.01)
        assert not bench.pins("x").enabled


def test_a_trip_limit_of_two_degrees_is_22_counts_of_4000():  # M-59
    bench = on_bench(changes={"counts_per_rad": 4000 / (2 * np.pi)}, error_limit=22, proportional_gain=300)
    stepped(bench, 2000, 4000.0, 20_000.0, run_s=1.0)
    assert status(bench) & {0} == set()
    bench.torque("x", 0.5)
    bench.run(0.1)
    assert status(bench) >= {0, 1}


def bench_with(stored, **extensions):
    drive = ServoModule(axis_row("table"), {"error_limit": NO_TRIP, **stored})
    drive.extensions.update(extensions)
    bench = AxisBench({"x": drive})
    bench.run(0.02)
    bench.received("x")
    return bench


def test_the_third_feed_forward_acts_on_the_change_of_acceleration():
    outputs = []
    for gain in (0, 256):
        bench = bench_with({"proportional_gain": 0, "derivative_gain": 0}, jerk_feed_forward=gain)
        bench.hold("x", True)
        bench.trace = True
        bench.step_times("x", [30_000_000], 1)
        bench.run(0.05)
        outputs.append(np.round(bench.samples("x")["command"] * 1024).astype(int))
    assert set(outputs[0]) == {0}
    pulse = outputs[1][np.flatnonzero(outputs[1])]
    assert list(pulse) == [1, -2, 1]  # a step's third difference


def test_the_filtered_command_makes_the_feed_forward_smoother():
    rough = []
    for smoothing in (0, 4):
        gains = {"proportional_gain": 0, "derivative_gain": 0, "step_multiplier": 9}
        bench = bench_with(gains, velocity_feed_forward=2600, command_filter=smoothing)
        bench.hold("x", True)
        stepped(bench, 1000, 1100.0, 20_000.0, run_s=0.3)
        bench.trace = True
        bench.run(0.3)
        rough.append(float(np.std(bench.samples("x")["command"])))
    assert 0 < rough[1] < 0.5 * rough[0]


def test_parameters_are_set_by_name_and_shown_by_letter():
    bench = bench_with({})
    bench.drive("x").parameters["proportional_gain"] = 900
    bench.drive("x").parameters["output_offset"] = -3
    assert say(bench, "P") == "(P) - Kp: 900"
    assert say(bench, "O") == "(O) - Output Offset: -3"
    say(bench, "L2")
    assert bench.drive("x").parameters["loop_divider"] == 2


@pytest.mark.parametrize(("arguments", "says"), [
    ({"stored": {"gain": 1}}, "gain"), ({"stored": {"clamp": -1}}, "0 to 65535"), ({"law": {"speed": 1}}, "speed"),
    ({"stored": {"clamp": 1.5}}, "whole number"), ({"stored": {"output_offset": 40_000}}, "-32768 to 32767"),
])  # fmt: skip
def test_what_python_may_not_set_is_refused_in_one_line(arguments, says):
    with pytest.raises(InputError, match=says) as caught:
        ServoModule(**arguments)
    assert "\n" not in str(caught.value)
