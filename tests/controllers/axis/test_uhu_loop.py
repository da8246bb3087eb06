"""The UHU's recalculation on the bench: interval, gains, limits, steps, its letters, and how it is tuned."""

import numpy as np
import pytest

from edmsim.controllers.axis.drive import axis_row
from edmsim.controllers.axis.uhu import LATCHED, REFERENCE, SPEED_DIVISOR, TARGET, TRACKING, Uhu
from edmsim.controllers.axis.uhu import O as OVERRUNS
from edmsim.errors import InputError

from .uhu_bench import ask, bench_with, count, error, moved, register, start_stream, stepped, traced, tuned

P_ONLY = {"integral_gain": 0, "speed_gain": 0, "acceleration_gain": 0, "output_filter": 65535, "error_limit": 30000}
"""One gain at a time, and hardly any smoothing."""
FAST = {
    "proportional_gain": 50, "integral_gain": 1, "speed_gain": 0, "acceleration_gain": 200, "speed_limit": 5000,
    "error_limit": 5000,
}  # fmt: skip
"""For the axis "fast" on 6 V, whose 140 000 counts/s are no more than an UHU can follow."""


def control_in(command):
    """The control variable in units of T."""
    return np.asarray(command) / 0.74 * 255


@pytest.mark.parametrize("cycle", [30, 50, 63, 200])
def test_the_interval_is_c_times_256_clocks(cycle):  # U-4, U-23, U-A3
    times = traced(tuned(cycle=cycle), 0.2)["time_ns"]
    assert np.ptp(np.diff(times)) <= 1
    assert np.mean(np.diff(times)) == pytest.approx(cycle * 256e9 / 24e6, abs=0.01)


def test_a_new_c_acts_at_once_and_changes_what_gains_mean():  # U-23, U-65, U-A9
    bench = tuned()
    assert ask(bench, "C50") == "OK"
    assert np.mean(np.diff(traced(bench, 0.1)["time_ns"])) == pytest.approx(533_333.3, abs=1)
    assert ask(bench, "C0") == "OK"  # U-A23: as 1, and then the calculation takes its time
    assert np.mean(np.diff(traced(bench, 0.1)["time_ns"])) >= 300_000


def test_below_30_timing_is_lost():  # U-52, U-51
    for cycle, exact in ((20, False), (30, True)):
        bench = tuned(cycle=cycle, error_limit=30000)
        bench.steps("x", 2000, 4000.0)
        intervals = np.diff(traced(bench, 0.3)["time_ns"])
        assert intervals.min() >= 300_000  # never begun before the last one has ended
        assert (np.ptp(intervals) <= 1) == exact
        assert (intervals.mean() == pytest.approx(320_000.0, abs=0.1)) == exact


def test_the_output_is_proportional_to_the_error():  # U-12, U-14, U-A12
    bench = tuned(**P_ONLY, proportional_gain=640)
    bench.hold("x", True)
    for counts in (1, 3, -13, 40):
        ask(bench, "R")
        ask(bench, f"G{counts}")
        command = traced(bench, 0.05)["command"][-1]
        assert control_in(command) == pytest.approx(640 / 256 * counts, abs=0.51)


def test_an_error_of_one_count_grows_the_output_by_i_over_256_and_is_removed():  # U-15, U-A17
    bench = tuned(**{**P_ONLY, "integral_gain": 64}, proportional_gain=256)
    bench.hold("x", True)
    ask(bench, "G1")
    control = control_in(traced(bench, 0.3)["command"])
    grown = np.diff(control[[10, 410]])[0]
    assert grown == pytest.approx(400 * 64 / 256, abs=1.1)
    bench = tuned()
    moved(bench, 1, run_s=1.0)
    assert error(bench) == 0


def test_integration_stops_at_the_torque_limit():  # U-A32
    bench = tuned(**{**P_ONLY, "integral_gain": 100}, proportional_gain=256, torque_limit=80)
    bench.hold("x", True)
    ask(bench, "G50", run_s=2.0)
    ask(bench, "G-50")
    assert control_in(traced(bench, 0.01)["command"]).max() <= 80.01


def steady_error(rate_Hz=2000.0, **parameters):
    bench = tuned(**{**P_ONLY, "output_filter": 100, "proportional_gain": 1000, **parameters})
    stepped(bench, int(rate_Hz), rate_Hz, 20_000.0, run_s=0.5)
    samples = traced(bench, 0.3)
    return float(np.mean(samples["setpoint"] - samples["count"]))


def test_d_makes_an_error_that_grows_with_speed_and_h_does_not():  # U-16, U-17
    plain, damped, higher = steady_error(), steady_error(speed_gain=8000), steady_error(acceleration_gain=8000)
    intervals_per_s = 24e6 / 256 / 63
    assert damped - plain == pytest.approx(8.0 * 2000 / intervals_per_s, rel=0.1)
    assert higher == pytest.approx(plain, abs=0.3)
    at_255 = steady_error(10_000.0, speed_gain=255) - steady_error(10_000.0)
    assert at_255 == pytest.approx(255 / 1000 * 10_000 / intervals_per_s, rel=0.2)  # U-A6: no special case
    assert steady_error(1000.0, speed_gain=8000) == pytest.approx(damped / 2, rel=0.25)


def test_more_cycle_means_more_damping_per_speed_and_less_integral_per_second():  # U-65
    def growth(cycle):
        bench = tuned(**{**P_ONLY, "integral_gain": 32}, proportional_gain=256, cycle=cycle)
        bench.hold("x", True)
        ask(bench, "G2")
        samples = traced(bench, 0.3)
        control, time_s = control_in(samples["command"]), samples["time_ns"] * 1e-9
        return float(np.polyfit(time_s[20:], control[20:], 1)[0])

    by_speed = [steady_error(speed_gain=8000, cycle=c) - steady_error(cycle=c) for c in (50, 100)]
    assert by_speed[1] / by_speed[0] == pytest.approx(2.0, rel=0.1)
    assert growth(100) / growth(50) == pytest.approx(0.5, rel=0.05)


def test_t_limits_the_duty():  # U-2, U-19, U-49
    bench = tuned(**P_ONLY, proportional_gain=5000)
    bench.hold("x", True)
    assert int(bench.drive("x").record["pwm_ns"][0]) == 50_000  # 20 kHz
    for limit, percent in ((50, 57.25), (128, 68.57), (255, 87.0), (65535, 87.0)):
        for sign in (1, -1):
            ask(bench, f"T{limit}")
            ask(bench, "R")
            ask(bench, f"G{1000 * sign}", run_s=0.05)
            assert bench.pins("x").duty * 100 == pytest.approx(50 + sign * (percent - 50), abs=0.01)


def test_the_higher_n_the_sharper():  # U-20, U-A7, U-A28
    taken = []
    for n in (50, 100, 150, 300, 600, 1000):
        bench = tuned(**{**P_ONLY, "output_filter": n}, proportional_gain=500)
        bench.hold("x", True)
        ask(bench, "R")
        bench.drive("x").go(100)
        control = control_in(traced(bench, 0.1)["command"])
        first = float(control[np.argmax(control > 0)])
        assert first == pytest.approx(500 / 256 * 100 * n / (n + 256), abs=1)
        taken.append(int(np.argmax(control >= 0.9 * 500 / 256 * 100)) - int(np.argmax(control > 0)))
    assert taken == sorted(taken, reverse=True)
    assert taken[0] > taken[-1]


@pytest.mark.parametrize("sign", [1, -1])
def test_the_output_goes_off_when_the_error_reaches_e(sign):  # U-21, U-30, U-40
    bench = tuned(error_limit=200, torque_limit=10)
    bench.hold("x", True)
    moved(bench, 199 * sign, run_s=0.5)
    pins = bench.pins("x")
    assert (pins.enabled, pins.error_led, pins.fault_out_low, pins.led) == (True, False, False, True)
    moved(bench, sign, run_s=0.01)
    pins = bench.pins("x")
    assert (pins.enabled, pins.error_led, pins.fault_out_low, pins.led) == (False, True, True, False)
    moved(bench, -150 * sign, run_s=0.5)
    assert not bench.pins("x").enabled  # latched


@pytest.mark.parametrize("multiplier", [0, 2, 20])
def test_a_step_moves_m_plus_one_counts(multiplier):  # U-22
    bench = tuned(step_multiplier=multiplier)
    bench.steps("x", 50, 200.0)
    stepped(bench, -20, 200.0, run_s=1.0)
    assert register(bench, TARGET) == 30 * (multiplier + 1)
    assert abs(error(bench)) <= 1
    ask(bench, "M2")  # counts for new steps only
    stepped(bench, 10, 1000.0, run_s=0.3)
    assert register(bench, TARGET) == 30 * (multiplier + 1) + 30


def test_e_not_above_m_plus_one_trips_at_the_first_step():  # U-68
    for limit, stays in ((21, False), (22, True)):
        bench = tuned(step_multiplier=20, error_limit=limit)
        bench.hold("x", True)
        stepped(bench, 1, 100.0, run_s=0.05)
        assert (register(bench, LATCHED) == 0) == stays


def test_short_step_pulses_count():  # U-70
    bench = tuned()
    now_ns = round(bench.time_s * 1e9)
    bench.step_times("x", [now_ns + 1000 + 500 * k for k in range(20)], 1)
    bench.run(0.2)
    assert register(bench, TARGET) == 20


def test_g_moves_at_the_speed_of_x():  # U-18, U-30
    bench = tuned(speed_limit=64, error_limit=5000)
    bench.drive("x").go(1000)
    samples = traced(bench, 0.15)
    speed = np.polyfit(np.arange(100), samples["count"][100:200], 1)[0]
    assert speed == pytest.approx(64 / 16, rel=0.05)
    bench.run(0.5)
    assert abs(error(bench)) <= 1
    assert ask(bench, "G-32000") == "OK"  # E is smaller
    bench.run(0.01)
    assert register(bench, LATCHED) == TRACKING


def test_x_below_the_step_rate_trips():  # U-18, U-A10, U-A29
    for limit, trips in ((16, True), (5000, False)):
        bench = tuned(speed_limit=limit, error_limit=500)
        stepped(bench, 4000, 4000.0, 20_000.0, run_s=1.2)
        assert (register(bench, LATCHED) == TRACKING) == trips


@pytest.mark.parametrize("cycle", [30, 200])
def test_no_edge_is_lost_at_100_000_steps_per_second(cycle):  # U-3, U-18, U-54, U-A11
    bench = tuned("fast", changes={"supply_V": 6.0}, **FAST, cycle=cycle)
    start_stream(bench)
    bench.steps("x", 30_000, 100_000.0, 400_000.0)
    for _ in range(5):
        bench.send(b"#\r", axis="x")
        bench.run(0.1)
        assert register(bench, TARGET) == register(bench, REFERENCE) // register(bench, SPEED_DIVISOR)
    bench.run(0.4)
    assert register(bench, TARGET) == 30_000
    axis = bench.axis("x")
    assert int(axis["true_count"]) == int(axis["count"])
    assert cycle > 30 or abs(count(bench) - 30_000) <= 10  # a slow cycle takes longer to settle
    assert (register(bench, LATCHED), register(bench, OVERRUNS), int(axis["missed"])) == (0, 0, 0)


def test_a_false_transition_counts_in_o_and_moves_nothing():  # U-24, U-50, U-62
    bench = tuned(torque_limit=0)
    before = count(bench)
    bench.slip_encoder("x", 2)
    bench.run(0.05)
    assert (register(bench, OVERRUNS), count(bench)) == (1, before)
    assert ask(bench, "O500") == "OK"
    bench.slip_encoder("x", 2)
    bench.run(0.05)
    assert "(O)verrun    501" in ask(bench, "#")
    assert ask(bench, "O0") == "OK"
    bench.run(0.05)
    assert "(O)verrun    0" in ask(bench, "#")


def test_faster_edges_than_the_input_takes_are_overruns():  # U-A30
    bench = tuned("fast", **{**FAST, "speed_limit": 65535, "error_limit": 65535, "proportional_gain": 500})
    stepped(bench, 400_000, 400_000.0, 4_000_000.0, run_s=0.6)
    assert register(bench, OVERRUNS) > 0


@pytest.mark.parametrize(("cycle", "period_ms"), [(63, 3.36), (30, 1.6)])
def test_the_stream_sends_a_byte_every_five_intervals(cycle, period_ms):  # U-33, U-34, U-A9, U-A31
    bench = tuned(cycle=cycle)
    bench.received("x")
    bench.send(b"A\r", axis="x")
    bench.run(0.5)
    sent = bench.received_at("x")
    assert bytes(byte for byte, _ in sent[:4]) == b"A\r\n>"
    assert min(byte for byte, _ in sent[4:]) >= 128
    assert np.diff([time_s for _, time_s in sent[-20:]]) * 1e3 == pytest.approx(np.full(19, period_ms), abs=0.01)
    bench.send(b"Z\r", axis="x")
    bench.run(0.05)
    assert bytes(byte for byte in bench.received("x") if byte < 128) == b"Z\r\nOK\r\n>"
    bench.run(0.1)
    assert bench.received("x") == b""


def test_the_stream_is_63_for_no_error_and_limited():  # U-35, U-36, U-A8, U-A27
    bench = tuned(torque_limit=0, error_limit=30000)
    bench.hold("x", True)
    start_stream(bench)
    for counts, byte in zip((0, 1, -1, -63, -64, 64, 65, -999), b"\xbf\xc0\xbe\x80\x80\xff\xff\x80", strict=True):
        moved(bench, counts - error(bench), run_s=0.02)
        bench.received("x")
        bench.run(0.02)
        assert set(bench.received("x")) == {byte}


def test_the_stream_goes_on_in_a_fault_until_a_reset():  # U-31, U-32, U-A27
    bench = tuned(error_limit=20)
    for reset in (b"R\r", b"+\r"):
        bench.hold("x", True)
        start_stream(bench)
        moved(bench, 30, run_s=0.05)
        assert not bench.pins("x").enabled
        bench.received("x")
        bench.run(0.05)
        assert set(bench.received("x")) == {0x80 + 63 + 30}
        bench.talk(reset)
        bench.received("x")
        bench.run(0.1)
        assert bench.received("x") == b""


def test_what_the_manual_leaves_open_can_be_set_otherwise():  # U-A2, U-A5, U-A8, U-A26
    def growth(**law):
        drive = Uhu(axis_row("bench"), stored={**P_ONLY, "integral_gain": 8, "proportional_gain": 0}, law=law)
        bench = bench_with(drive)
        bench.hold("x", True)
        bench.drive("x").go(10)
        return float(np.diff(control_in(traced(bench, 0.2)["command"])[[10, 110]])[0])

    assert growth(integral_divisor=64) == pytest.approx(4 * growth(), rel=0.05)
    law = {"encoder_sense": -1, "step_sense": -1, "stream_zero": 64}
    turned = bench_with(Uhu(axis_row("bench"), stored={}, law=law))
    turned.swap_phases("x")
    turned.steps("x", 200, 2000.0)
    start_stream(turned)
    turned.run(0.5)
    assert register(turned, TARGET) == -200
    assert abs(error(turned)) <= 1
    assert turned.received("x")[-1] in (0xBF, 0xC0, 0xC1)
    assert turned.axis("x")["place_um"] < -1000
    with pytest.raises(InputError, match="the law of the UHU has no 'sense'; it has control_full"):
        Uhu(law={"sense": -1})


START = {  # "pretty safe" starting values
    "proportional_gain": 1000, "integral_gain": 25, "speed_gain": 255, "acceleration_gain": 1000, "speed_limit": 3000,
    "torque_limit": 255, "output_filter": 100, "error_limit": 5000,
}  # fmt: skip


def oscillation(bench, counts=40):
    """Jerk the axis by a move, and return how many counts it still swings half a second later."""
    moved(bench, counts, run_s=0.5)
    return float(np.ptp(traced(bench, 0.2)["count"]))


def oscillation_with(**parameters):
    return oscillation(tuned(**{**START, **parameters}))


def test_the_starting_values_are_stable():  # U-25, U-58
    bench = tuned(**START)
    assert oscillation(bench) <= 1
    assert error(bench) == 0


@pytest.mark.parametrize(("good", "bad"), [
    ({"proportional_gain": 1000}, {"proportional_gain": 6000}), ({"integral_gain": 25}, {"integral_gain": 400}),
    ({"speed_gain": 6000, "proportional_gain": 3000}, {"speed_gain": 0}),
    ({"acceleration_gain": 10_000, "proportional_gain": 3000}, {"acceleration_gain": 0}),
])  # fmt: skip
def test_too_much_p_or_i_and_too_little_d_or_h_oscillate(good, bad):  # U-57
    assert oscillation_with(**good) <= 2
    assert oscillation_with(**{**good, **bad}) > 10


def test_a_senseless_set_is_stored_and_activated():  # U-47
    bench = tuned(**{**START, "error_limit": 30})
    assert ask(bench, "P20000") == "OK"
    assert ask(bench, "S0") == "OK"
    bench.talk(b"+\r")
    moved(bench, 20, run_s=1.0)
    assert register(bench, LATCHED) != 0


def test_play_before_the_encoder_cannot_be_tuned_away():  # U-59
    behind = {"backlash_um": 150.0, "on_table": 1.0}
    for gains in ({}, {"acceleration_gain": 5000}, {"proportional_gain": 500}):
        assert oscillation_with(**gains) <= 2
        assert oscillation(tuned(changes=behind, **{**START, **gains})) > 2


def test_the_bridge_needs_more_than_the_motor_s_voltage():  # U-49, U-A20
    bench = tuned(**{**START, "error_limit": 65535, "speed_limit": 65535})
    moved(bench, 32_000, run_s=0.3)
    motor = bench.motor("x")
    samples = traced(bench, 0.05)
    back_emf_V = float(np.mean(samples["speed_rad_s"])) * float(motor["torque_Nm_A"])
    assert 0.65 <= back_emf_V / float(motor["supply_V"]) <= 0.74
