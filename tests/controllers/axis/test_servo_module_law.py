"""The servo module's loop on a held rotor: output, clamp, offset, antidither, integral, loop rate, arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis import ServoModule
from edmsim.controllers.axis import servo_module as at
from edmsim.controllers.axis import servo_module as servo_module_law
from edmsim.controllers.axis.drive import axis_row

from .module_bench import NO_TRIP, get, locked, on_bench, say, status
from .uhu_bench import stepped

P_ONLY = {"derivative_gain": 0, "error_limit": NO_TRIP}


@pytest.mark.parametrize(("clamp", "percent"), [
    (400, (30.47, 69.53)), (500, (25.59, 74.41)), (760, (12.89, 87.11)), (860, (8.01, 91.99)), (900, (8.01, 91.99)),
    (65535, (8.01, 91.99)),
])  # fmt: skip
def test_the_clamp_limits_the_duty_to_either_side(clamp, percent):  # M-7, M-47
    for way, duty in zip((-1, 1), percent, strict=True):
        bench = locked(on_bench(clamp=clamp, proportional_gain=5000, error_limit=NO_TRIP), way * 1000)
        bench.run(0.01)
        assert 100 * bench.pins("x").duty == pytest.approx(duty, abs=0.005)
        assert get(bench, "GD") == 1024 + way * min(clamp, 860)


def test_the_clamp_holds_behind_the_offset():  # M-40, M-23
    bench = locked(on_bench(clamp=400, output_offset=500, **P_ONLY), 1000)
    bench.run(0.01)
    assert get(bench, "GD") == 1424
    say(bench, "Q", run_s=0.01)
    assert get(bench, "GD") == 1424
    say(bench, "O-25")
    say(bench, "R")
    say(bench, "Q")
    assert get(bench, "GD") == 999


@pytest.mark.parametrize(("scale", "output"), [(256, 12), (128, 24)])
def test_gains_are_in_256ths_of_a_duty_count_unless_the_law_says_otherwise(scale, output):  # M-A9
    bench = AxisBench({"x": ServoModule(axis_row("table"), {"proportional_gain": 384}, law={"gain_scale": scale})})
    bench.run(0.02)
    bench.received("x")
    locked(bench, 8)
    bench.run(0.01)
    assert get(bench, "GO") == output


def test_the_loop_runs_at_the_duty_s_rate_by_l_plus_7():  # M-21, M-47, M-A2
    listed = (2800, 2450, 2200, 1950, 1800, 1650, 1500, 1400, 1300, 1220, 1220)
    bench = on_bench()
    for divider, rate_Hz in enumerate(listed):
        say(bench, f"L{divider}")
        bench.trace = True
        bench.run(0.05)
        periods_ns = np.diff(bench.samples("x")["time_ns"])
        assert set(periods_ns) == {51_200 * (min(divider, 9) + 7)}
        assert 1e9 / periods_ns[0] == pytest.approx(rate_Hz, rel=0.014)
        bench.trace = False


@pytest.mark.parametrize(("scale", "inside"), [(128, 5), (192, 7), (256, 10), (512, 20)])
def test_antidither_scales_the_gains_up_to_and_with_its_region(scale, inside):  # M-19, M-20, M-54
    bench = locked(on_bench(antidither_region=5, antidither_scale=scale, proportional_gain=512, **P_ONLY), 5)
    bench.run(0.01)
    assert get(bench, "GO") == inside
    say(bench, "+1", run_s=0.01)
    assert get(bench, "GO") == 12


def test_antidither_scales_what_the_integral_gathers_and_the_derivative():  # M-20
    settings = {"proportional_gain": 0, "error_limit": NO_TRIP, "antidither_region": 10}
    for scale in (256, 128):
        bench = on_bench(integral_gain=256, derivative_gain=0, antidither_scale=scale, **settings)
        bench.trace = True
        locked(bench, 10)
        bench.run(0.01)
        steps = np.diff(bench.samples("x")["command"]) * 1024
        assert steps.max() == 10 * scale / 256
        bench = on_bench(derivative_gain=2560, antidither_scale=scale, **settings)
        bench.trace = True
        locked(bench, 10)
        assert bench.samples("x")["command"].max() * 1024 == 100 * scale / 256


def test_the_feed_forwards_know_no_antidither():  # M-20, M-37
    settings = {"proportional_gain": 0, "velocity_feed_forward": 512, "antidither_region": 65535}
    for scale in (0, 256):
        bench = locked(on_bench(antidither_scale=scale, step_multiplier=9, **settings, **P_ONLY))
        bench.trace = True
        stepped(bench, 100, 1e9 / 665_600, run_s=0.06)
        assert bench.samples("x")["command"].max() * 1024 == 20


@pytest.mark.parametrize("interval", [0, 1, 3])
def test_the_integral_is_taken_every_so_many_cycles(interval):  # M-26
    bench = on_bench(proportional_gain=0, integral_gain=256, integral_interval=interval, **P_ONLY)
    bench.trace = True
    locked(bench, 10)
    bench.run(0.02)
    command = bench.samples("x")["command"] * 1024
    rises = np.flatnonzero(np.diff(command))
    assert set(np.diff(command)[rises]) == {10}
    assert set(np.diff(rises)) == {max(interval, 1)}


def test_the_integral_is_held_within_the_clamp():
    bench = locked(on_bench(proportional_gain=0, integral_gain=65535, clamp=300, **P_ONLY), 1000)
    bench.run(0.2)
    assert get(bench, "GO") == 300
    say(bench, "-1001", run_s=0.01)
    assert get(bench, "GO") < 300


@pytest.mark.parametrize("limit", [75, 22])
def test_the_limit_itself_does_not_trip_and_one_count_more_does(limit):  # M-9
    bench = locked(on_bench(error_limit=limit), limit)
    bench.run(0.05)
    assert status(bench) & {0, 1} == set()
    say(bench, "+1", run_s=0.01)
    assert status(bench) >= {0, 1}
    for great, trips in ((32767, True), (32768, False), (65535, False)):  # above 32767 nothing does
        bench = locked(on_bench(error_limit=great), 32768, 32767)
        bench.run(0.01)
        assert (1 in status(bench)) == trips


def _duty_against(gain, error, saturating):
    stored = {"proportional_gain": gain, "derivative_gain": 0, "error_limit": NO_TRIP}
    drive = ServoModule(axis_row("table"), stored)
    drive.extensions["saturating_arithmetic"] = saturating
    bench = AxisBench({"x": drive})
    bench.run(0.02)
    bench.received("x")
    locked(bench, error)
    bench.run(0.01)
    return get(bench, "GD"), status(bench)


@pytest.mark.parametrize(("gain", "error"), [(1000, 10_000), (100, 40_000)])
def test_arithmetic_saturates_and_says_so_and_wraps_in_compatible_mode(gain, error):  # M-35
    assert _duty_against(gain, error, 1) == (1784, {10})
    duty, _ = _duty_against(gain, error, 0)
    assert duty < 1024


def test_saturation_is_remembered_until_a_reset():  # M-55, M-18
    bench = locked(on_bench(proportional_gain=5000, **P_ONLY), 500)
    bench.run(0.01)
    assert 10 in status(bench)
    say(bench, "-500", run_s=0.01)
    assert get(bench, "GE") == 0
    assert 10 in status(bench)
    say(bench, "R")
    assert 10 not in status(bench)


def test_the_direction_bit_follows_the_command():  # M-55
    bench = on_bench(error_limit=NO_TRIP)
    for move, negative in ((-5, True), (5, False), (-1, True)):
        say(bench, f"{move:+d}", run_s=0.05)
        assert (11 in status(bench)) == negative
    say(bench, "R")
    assert 11 in status(bench)


def test_the_limit_is_raised_for_the_cycle_of_a_fast_step():  # M-10, M-A17
    trips_at = []
    for scale in (0, 256):
        bench = locked(on_bench(error_limit=10, error_scale=scale, step_multiplier=67))
        bench.trace = True
        stepped(bench, 1, 1000.0, run_s=0.02)
        rows = bench.samples("x")
        moved = np.flatnonzero(np.diff(rows["setpoint"]))[0]
        off = np.flatnonzero(rows["pins"] & 2)[0]
        trips_at.append(off - moved)
        assert {0, 1} <= status(bench)
    assert trips_at[1] == trips_at[0] + 1


# --- cycle by cycle, on registers of our own: the guide's formulas, worked out by hand ---


def registers(**settings):
    """A module with gains in whole duty counts, its clamp at the greatest, which has not run yet."""
    reg = np.zeros(128, np.int64)
    usual = {"SCALE": 256, "CLAMP": 860, "ERROR_LIMIT": NO_TRIP, "GAIN_SCALE": 1, "STEP_SENSE": 1,
             "ENCODER_SENSE": 1, "DUTY_CENTRE": 1024, "GREATEST_CLAMP": 860, "FRESH": 1}  # fmt: skip
    for name, value in {**usual, **settings}.items():
        reg[getattr(at, name)] = value
    return reg


def cycles(reg, *rows, fault=False):
    """What each cycle returns and puts out, of rows of the encoder's counter and the steps so far."""
    made = []
    for number, (count, edges) in enumerate(rows, 1):
        ran, turned = servo_module_law.cycle(reg, count, edges, fault, 1_000 * number)
        made.append((ran, turned, int(reg[at.OUTPUT])))
    return made


@pytest.mark.parametrize(("value", "divisor", "quotient"), [
    (7, 4, 1), (-7, 4, -1), (8, 4, 2), (-8, 4, -2), (-3, 4, 0),
])  # fmt: skip
def test_what_is_less_than_one_is_dropped_either_way(value, divisor, quotient):
    assert servo_module_law.towards_zero(value, divisor) == quotient


def test_a_cycle_adds_proportional_integral_and_derivative():
    reg = registers(PROPORTIONAL=3, INTEGRAL=2, DERIVATIVE=5)
    made = cycles(reg, (100, 0), (100, 4), (101, 4), (103, 3))
    # errors 0, 4, 3, 0: 3 e, 2 times their sum, 5 times their change
    assert [output for *_, output in made] == [0, 12 + 8 + 20, 9 + 14 - 5, 0 + 14 - 15]
    assert (reg[at.PEAK], reg[at.VELOCITY]) == (4, 2)
    assert reg[at.DUTY] == 1024 - 1


def test_a_cycle_adds_what_is_fed_forward():  # M-6, M-37
    reg = registers(VELOCITY_FF=7, ACCELERATION_FF=11, MULTIPLIER=1)
    made = cycles(reg, (0, 0), (0, 2), (0, 4), (0, 3))
    # two counts a step: velocities 4, 4, -2; accelerations 4, 0, -6
    assert made == [(True, False, 0), (True, False, 28 + 44), (True, False, 28), (True, True, -14 - 66)]


@pytest.mark.parametrize(("fault", "limit", "cause"), [
    (True, NO_TRIP, at.EXTERNAL_BIT), (False, 3, at.FOLLOWING_BIT),
])  # fmt: skip
def test_a_stopped_loop_has_its_cause_and_only_its_offset(fault, limit, cause):
    reg = registers(PROPORTIONAL=10, OFFSET=6, ERROR_LIMIT=limit)
    assert cycles(reg, (0, 3)) == [(True, False, 30)]
    assert reg[at.DUTY] == 1024 + 36
    assert cycles(reg, (0, 4), fault=fault) == [(False, False, 0)]
    assert reg[at.STATUS] == at.FAULT_BIT | cause
    assert reg[at.DUTY] == 1024 + 6
    assert cycles(reg, (0, 9)) == [(False, False, 0)]  # it still counts
    assert (reg[at.ERROR], reg[at.PEAK]) == (9, 4)
