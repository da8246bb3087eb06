"""What shuts a UHU off on the bench, what it shows then, and what brings it back."""

import numpy as np
import pytest

from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis.drive import axis_row
from edmsim.controllers.axis.uhu import ERROR_INPUT, INTEGRAL, LATCHED, TARGET, TIMED_OUT, TRACKING, Uhu

from .uhu_bench import (
    BANNER,
    SAMPLE_SET,
    ask,
    bench_with,
    count,
    error,
    moved,
    register,
    start_stream,
    stepped,
    traced,
    tuned,
)


def test_start_up_is_in_order_and_without_a_jerk():  # U-38, U-51
    bench = AxisBench({"x": Uhu(axis_row("bench"), stored={})})
    bench.trace = True
    bench.run(0.05)
    samples = bench.samples("x")
    text = bench.received_at("x")
    assert bytes(byte for byte, _ in text) == BANNER
    assert text[0][1] >= samples["time_ns"][0] * 1e-9
    changes = bench.changes("x")
    assert bench.pins("x").enabled
    assert changes["time_ns"][0] * 1e-9 <= text[-1][1]
    assert np.abs(samples["count"]).max() == 0
    assert not samples["command"].any()


@pytest.mark.parametrize("typed", [b"+\r", b"+\rP600\r"])  # a parameter before the first interval of the restart
def test_a_hard_reset_of_a_moved_axis_does_not_jerk(typed):  # U-32, U-39, U-A25
    bench = tuned()
    stepped(bench, 500, 2000.0, 20_000.0, run_s=0.5)
    bench.drive("x").line(typed)
    samples = traced(bench, 0.2)
    assert np.ptp(samples["count"]) <= 1
    assert abs(count(bench)) <= 1  # it counts from 0 again


def test_a_hard_reset_after_long_travel_switches_on():  # U-32, U-39
    bench = tuned()
    bench.axis("x")["edges"] += 500_000  # 0.1 m of the machine's table
    bench.talk(b"+\r")
    bench.talk(b"G50\r")
    bench.run(0.3)
    assert bench.pins("x").enabled
    assert count(bench) == 50


def test_the_error_input_shuts_off_within_an_interval_and_latches():  # U-6, U-31, U-46, U-66
    for cycle, at_most_s in ((63, 972e-6), (200, 2434e-6)):
        bench = tuned(cycle=cycle)
        bench.wire("x", fault_in=True, fault_out=True)
        bench.received("x")
        bench.changes("x")
        pulled_ns = bench.time_s * 1e9
        bench.pull_fault_net(True)
        bench.run(0.01)
        off_ns = bench.changes("x")["time_ns"][0]
        assert 0 < (off_ns - pulled_ns) * 1e-9 <= at_most_s + 1e-6
        assert ask(bench, "R") == "OK"  # does not last
        bench.run(0.01)
        assert not bench.pins("x").enabled
        bench.received("x")
        bench.pull_fault_net(False)
        bench.run(0.1)
        pins = bench.pins("x")
        assert (pins.enabled, pins.error_led, pins.fault_out_low) == (False, True, False)  # U-A19
        assert register(bench, LATCHED) == ERROR_INPUT
        assert bench.received("x") == b""  # a fault says nothing
        ask(bench, "R")
        assert bench.pins("x").enabled


def test_the_watchdog_shuts_off_after_125_ms_and_keeps_the_parameters():  # U-5, U-44
    bench = tuned(**SAMPLE_SET)
    ask(bench, "P777")
    bench.stall("x", 0.120)
    bench.run(0.3)
    assert bench.pins("x").enabled
    bench.changes("x")
    bench.received("x")
    last_ns = int(bench.drive("x").record["now_ns"][0])
    bench.stall("x", 0.130)
    bench.run(0.2)
    assert bench.changes("x")["time_ns"][0] == last_ns + 125_000_000
    assert register(bench, LATCHED) == TIMED_OUT
    assert bench.received("x") == b""
    assert "(P)rop.      777" in ask(bench, "#")
    assert bench.pins("x").fault_out_low
    ask(bench, "R")
    assert bench.pins("x").enabled
    assert "(P)rop.      777" in ask(bench, "#")


@pytest.mark.parametrize(("cycle", "trips"), [(11_718, False), (11_719, True)])
def test_a_cycle_longer_than_the_watchdog_trips_it(cycle, trips):  # U-45, U-A23
    bench = tuned(torque_limit=0)
    assert ask(bench, f"C{cycle}") == "OK"
    bench.run(0.4)
    assert (register(bench, LATCHED) == TIMED_OUT) == trips
    assert bench.pins("x").enabled != trips


def test_a_tracking_trip_says_nothing_and_r_starts_where_the_axis_is():  # U-31, U-46, U-A21, U-A25
    bench = tuned(error_limit=100)
    bench.hold("x", True)
    bench.received("x")
    moved(bench, 150, run_s=0.1)
    assert register(bench, LATCHED) == TRACKING
    assert bench.received("x") == b""
    bench.hold("x", False)
    assert ask(bench, "G5000") == "OK"  # a move while off
    bench.run(0.1)
    assert abs(count(bench)) <= 1
    assert ask(bench, "R") == "OK"
    bench.run(0.3)
    assert bench.pins("x").enabled
    assert abs(count(bench)) <= 1
    assert abs(error(bench)) <= 1


def test_the_ready_led_is_lit_in_operation_only():  # U-41, U-A1
    bench = tuned()
    assert (bench.pins("x").led, bench.pins("x").error_led) == (True, False)
    ask(bench, "L2")
    assert ask(bench, "R") == "OK"
    assert (bench.pins("x").led, bench.pins("x").error_led) == (True, False)
    bench = bench_with(Uhu(axis_row("bench")))
    assert (bench.pins("x").led, bench.pins("x").error_led) == (False, True)


def test_each_pin_does_what_the_manual_says():  # U-1
    bench = tuned()
    bench.wire("x", fault_in=True, fault_out=True)
    bench.steps("x", 30, 1000.0)
    samples = traced(bench, 0.2)
    assert (register(bench, TARGET), samples["setpoint"][-1]) == (30, 30)  # step 6 and dir 7
    assert abs(samples["count"][-1] - 30) <= 1  # encoder A 12 and B 13
    assert samples["duty"].max() > 0  # PWM 15
    bench.reset_pin("x", low=True)  # reset 1
    assert not bench.pins("x").enabled  # power enable 16
    bench.reset_pin("x", low=False)
    bench.run(0.01)
    assert bench.pins("x").led  # ready LED 18
    bench.pull_fault_net(True)  # error input 14
    bench.run(0.01)
    assert not bench.pins("x").enabled
    bench.pull_fault_net(False)
    bench.talk(b"L2\r")
    assert bench.pins("x").fault_out_low  # error output 17


@pytest.mark.parametrize("wrong", ["unplugged", "swapped"])
def test_without_its_encoder_s_two_phases_the_axis_trips_at_the_first_move(wrong):  # U-43, U-21, U-A26
    bench = tuned(error_limit=100)
    if wrong == "swapped":
        bench.swap_phases("x")
    else:
        bench.unplug("x", "A")
        bench.unplug("x", "B")
    bench.run(0.1)
    assert bench.pins("x").enabled
    stepped(bench, 300, 2000.0, run_s=0.5)
    assert register(bench, LATCHED) == TRACKING


def test_a_dip_of_the_rail_is_a_reset():  # U-48, U-55
    bench = tuned(**SAMPLE_SET)
    ask(bench, "P600")
    bench.received("x")
    bench.rail("x", 4.4)
    bench.run(0.0002)
    assert not bench.pins("x").enabled
    bench.run(0.01)
    assert bench.received("x") == b""
    bench.rail("x", 5.0)
    bench.run(0.05)
    assert bench.received("x") == BANNER
    assert bench.pins("x").enabled
    assert "(P)rop.      900" in ask(bench, "#")


def test_without_motor_supply_the_dialogue_works_and_steps_trip():  # U-64
    bench = tuned(error_limit=100)
    bench.supply("x", 0.0)
    bench.axis("x")["link_V"] = 0.0  # its capacitor is empty, too
    assert "(E)rror      100" in ask(bench, "#")
    stepped(bench, 99, 1000.0, run_s=0.3)
    assert bench.pins("x").enabled
    stepped(bench, 1, 1000.0, run_s=0.1)
    assert register(bench, LATCHED) == TRACKING


def test_too_much_torque_for_the_motor_is_damage():  # U-63
    peaks, damage = [], []
    for limit in (50, 120, 255):
        bench = tuned("low-impedance", torque_limit=limit, error_limit=30_000)
        bench.hold("x", True)
        moved(bench, 5000, run_s=0.2)
        peaks.append(float(bench.axis("x")["peak_A"]))
        damage.append(int(bench.axis("x")["damage"]))
    assert peaks == sorted(peaks)
    assert damage[0] == 0
    assert damage[-1] != 0


def test_a_jerk_by_hand_shows_in_the_stream():  # U-61
    bench = tuned()
    start_stream(bench)
    bench.received("x")
    bench.torque("x", 1.5)
    bench.run(0.05)
    bench.torque("x", 0.0)
    bench.run(0.3)
    errors = np.frombuffer(bench.received("x"), np.uint8).astype(int) - 128 - 63
    assert np.abs(errors).max() >= 3
    assert np.abs(errors[-10:]).max() <= 1


@pytest.mark.parametrize("counts", [300, -32_000])
def test_g_moves_nothing_while_the_output_is_off(counts):  # U-30, U-46, M-A21
    """Neither now nor after R; and it is no tracking error, for which the drive would pull the line low itself."""
    bench = tuned()
    bench.pull_fault_net(True)
    bench.run(0.01)
    bench.pull_fault_net(False)
    place = count(bench)
    assert ask(bench, f"G{counts}") == "OK"
    bench.run(0.05)
    assert register(bench, LATCHED) == ERROR_INPUT
    assert not bench.pins("x").fault_out_low
    ask(bench, "R", run_s=0.3)
    assert abs(count(bench) - place) <= 1
    ask(bench, "G300", run_s=0.5)
    assert abs(count(bench) - place - 300) <= 2


def test_a_move_right_behind_a_reset_is_made():  # U-30, U-31; GU-7: both are answered
    bench = tuned(cycle=200, error_limit=5000)  # an interval takes longer than the line
    assert bench.talk(b"R\rG100\r").endswith(b"OK\r\n>")
    bench.run(0.5)
    assert abs(count(bench) - 100) <= 2


def test_r_clears_the_integrator():  # U-31, U-A25
    """A steady torque has filled it; after R the motor gives way at first, as a loop does that begins."""
    bench = tuned(integral_gain=100, error_limit=5000)
    bench.torque("x", 0.3)
    bench.run(2.0)
    filled, place = register(bench, INTEGRAL), count(bench)
    assert abs(filled) > 1000
    bench.send(b"R\r")
    samples = traced(bench, 0.2)
    assert (samples["count"] != place).any()
    bench.drive("x").soft_reset()
    bench.run(0.0014)  # two intervals
    assert abs(register(bench, INTEGRAL)) < abs(filled) / 5
