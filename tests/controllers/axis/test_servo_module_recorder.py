"""The servo module's data recorder: triggers, rates, sources, the dump, and faults while it records."""

from __future__ import annotations

import numpy as np
import pytest

from .module_bench import NO_TRIP, get, locked, on_bench, say, status

CYCLE_S = 51.2e-6 * 13


def dumped(bench, seconds):
    """What the module sends by itself over some time, as numbers."""
    bench.received("x")
    bench.run(seconds)
    text = bench.received("x").decode("ascii")
    assert text.endswith("\r\n")
    return [int(line) for line in text.split("\r\n")[:-1]]


def test_z_alone_aborts_and_z0_starts():  # M-30, M-A7, M-57
    bench = on_bench()
    assert say(bench, "Z0") == "Recorder ON"
    assert status(bench) & {7, 8} == {7}
    assert say(bench, "Z") == "Recorder OFF"
    assert status(bench) & {7, 8} == set()


def test_the_printed_example_records_the_duty_at_once():  # M-31, M-A18, M-30: Z157 = 5 + 24 + 128
    bench = locked(on_bench(loop_divider=9))
    say(bench, "O100")
    say(bench, "Z157")
    assert status(bench) & {7, 8} == {7, 8}
    assert dumped(bench, 128 * 32 / 1220.7 + 0.2) == [1124] * 128
    assert status(bench) & {7, 8} == set()


@pytest.mark.parametrize(("divider", "rate"), [(6, 0), (4, 4), (0, 2), (9, 7)])
def test_the_memory_is_full_after_128_entries_of_2_to_the_n_cycles(divider, rate):  # M-31, M-57, M-A4
    bench = on_bench(loop_divider=divider)
    asked = bench.time_s
    bench.send(f"Z{24 + rate}\r".encode(), axis="x")
    full_s = 128 * 2**rate * (divider + 7) / 19531.25
    bench.run(full_s + 0.3)
    heard = bench.received_at("x")
    text, times = bytes(byte for byte, _ in heard), [at_s for _, at_s in heard]
    answer = b"Recorder ON\r\n"
    assert text.startswith(answer)
    begins = times[len(answer)] - asked
    assert begins == pytest.approx(full_s, abs=2.5e-3)
    assert text[len(answer) :].count(b"\r\n") == 128


@pytest.mark.parametrize(("source", "letters"), [(0, "GE"), (96, "GO"), (128, "GD"), (160, "GF")])
def test_each_source_is_what_its_g_command_shows(source, letters):  # M-30
    bench = locked(on_bench(error_scale=75, output_offset=7), 20)
    bench.run(0.05)
    say(bench, f"Z{24 + source}")
    assert dumped(bench, 0.4) == [get(bench, letters)] * 128


def test_velocities_of_motor_and_command_are_recorded():  # M-30, M-11
    for source in (32, 64):
        bench = on_bench(step_multiplier=9, integral_gain=10, error_limit=NO_TRIP)
        bench.steps("x", -3000, 1e9 / 665_600, 20_000.0)
        bench.run(0.5)
        shown = get(bench, "GV")
        say(bench, f"Z{24 + source}")
        values = dumped(bench, 0.4)
        assert np.mean(values) == pytest.approx(-10, abs=0.3)
        assert shown == pytest.approx(-10, abs=3)


@pytest.mark.parametrize("move", [30, -30])
def test_trigger_0_waits_for_a_commanded_move_either_way(move):  # M-30, M-61, M-A17
    bench = on_bench()
    say(bench, "Z0")
    bench.run(0.3)
    assert status(bench) & {7, 8} == {7}
    bench.send(f"{move:+d}\r".encode(), axis="x")
    bench.run(0.01)
    answer = bench.received("x")
    assert answer == f"Move {move:+d}\r\n".encode()
    values = dumped(bench, 0.3)
    assert len(values) == 128
    assert values[0] == move
    assert abs(values[-1]) < 10


def test_trigger_8_waits_for_the_direction_to_change():  # M-30
    bench = on_bench()
    say(bench, "+10")
    say(bench, "Z72")
    say(bench, "+10")
    bench.run(0.1)
    assert status(bench) & {7, 8} == {7}
    say(bench, "-10")
    assert dumped(bench, 0.3) == [-10] + 127 * [0]


def test_a_fault_pauses_the_recording_and_reset_resumes_it():  # M-32, M-45
    bench = on_bench()
    say(bench, "Z26")  # every fourth cycle
    bench.run(0.1)
    say(bench, "Q")
    bench.received("x")
    bench.run(0.5)
    assert bench.received("x") == b""
    assert status(bench) & {0, 7, 8} == {0, 7, 8}
    say(bench, "R")
    assert status(bench) & {0, 7, 8} == {7, 8}
    assert len(dumped(bench, 0.6)) == 128


def test_z_before_reset_aborts_a_paused_recording():  # M-32
    bench = on_bench()
    say(bench, "Z26")
    bench.run(0.1)
    say(bench, "Q")
    say(bench, "Z")
    say(bench, "R")
    bench.received("x")
    bench.run(0.6)
    assert bench.received("x") == b""


def test_an_answer_during_the_dump_is_a_transmit_error():  # M-18
    bench = on_bench()
    say(bench, "Z24")
    bench.run(128 * CYCLE_S + 0.02)
    bench.send(b"P\r", axis="x")
    bench.run(0.4)
    assert 15 in status(bench)
    say(bench, "R")
    assert 15 not in status(bench)
