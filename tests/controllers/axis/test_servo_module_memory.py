"""The servo module's EEPROM, its save, its serial line under faults, and garbage at its parser."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from edmsim.controllers.axis import ServoModule
from edmsim.controllers.axis import servo_module as at
from edmsim.controllers.axis.drive import axis_row

from .module_bench import on_bench, say, status, words
from .uhu_bench import stepped


def restarted(bench):
    """What the module says after its power was off."""
    bench.received("x")
    bench.power_cycle("x", 0.05)
    bench.run(0.1)
    return bench.received("x")


def test_what_was_saved_is_there_after_power_up():  # M-25, M-45, M-5, M-A3
    bench = on_bench()
    say(bench, "P1234")
    say(bench, "O-25")
    assert say(bench, "S") == "Parameters saved"
    bench.run(0.05)
    say(bench, "P1")
    assert restarted(bench) == b"Servo processor module, rev. A\r\n"
    assert say(bench, "P") == "(P) - Kp: 1234"
    assert say(bench, "O") == "(O) - Output Offset: -25"
    say(bench, "O0")


def test_a_save_is_refused_while_the_motor_is_commanded_to_move():  # M-25, M-A16
    bench = on_bench(step_multiplier=9)
    stepped(bench, 600, 2000.0, 50_000.0, run_s=0.1)
    assert say(bench, "S") == "Motor moving, not saved"
    bench.run(0.25)
    assert say(bench, "S") == "Motor moving, not saved"  # less than 100 ms ago
    bench.run(0.12)
    assert say(bench, "S") == "Parameters saved"


def test_the_duty_is_frozen_while_a_save_lasts_and_the_encoder_counts():  # M-52, M-25
    bench = on_bench()
    bench.send(b"S\r", axis="x")
    bench.run(0.002)
    bench.trace = True
    bench.torque("x", 0.05)
    bench.run(0.015)
    rows = bench.samples("x")
    assert set(rows["command"]) == {0.0}
    assert rows["count"][-1] - rows["count"][0] > 5
    bench.torque("x", 0.0)
    bench.run(0.02)
    assert bench.samples("x")["command"].min() < 0.0
    assert status(bench) & {0} == set()


def test_two_flipped_bits_in_a_byte_are_noticed():  # M-A16
    bench = on_bench(proportional_gain=1234)
    bench.flip_bits("x", (160, 163))
    assert restarted(bench) == b"Servo processor module, rev. A\r\nEEPROM error, defaults loaded\r\n"
    assert say(bench, "P") == "(P) - Kp: 600"
    assert not bench.pins("x").enabled
    assert status(bench) == {0}
    say(bench, "R", run_s=0.01)
    assert bench.pins("x").enabled


def test_power_that_fails_in_a_save_leaves_old_and_new_bytes():  # M-25, M-A16
    bench = on_bench()
    for letter in "ADIPV":
        say(bench, f"{letter}43690")
    bench.send(b"S\r", axis="x")
    bench.run(0.010)
    assert restarted(bench).endswith(b"EEPROM error, defaults loaded\r\n")
    assert say(bench, "P") == "(P) - Kp: 600"


def test_a_wrong_baud_rate_sets_the_receive_bit_and_moves_nothing():  # M-48, M-18
    bench = on_bench()
    before = words(bench, "GP"), words(bench, "GT")
    bench.host_baud(38_400.0)
    for typed in (b"P600\r", b"G100\r", b"+\r", b"R\r", b"A\r", b"?\r"):
        bench.talk(typed, axis="x")
    bench.host_baud(57_600.0)
    bench.talk(b"\r", axis="x")
    assert 14 in status(bench)
    assert (words(bench, "GP"), words(bench, "GT")) == before
    say(bench, "R")
    assert 14 not in status(bench)


COMMANDS = st.one_of(
    st.binary(max_size=40),
    st.text("ACDEFGIJKLOPQRSTVXYZ?+-.0123456789 \b\r\n", max_size=24).map(str.encode),
)


@pytest.mark.slow
@given(st.lists(COMMANDS, max_size=6))
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_no_input_crashes_the_parser_and_only_moves_move(lines):
    drive = ServoModule(axis_row("table"))
    reg = drive.record["reg"][0]
    for line in lines:
        before = reg.copy()
        answer = drive.line(line + b"\r")
        assert answer == b"" or answer.endswith(b"\r\n")
        if b"+" not in line and b"-" not in line:
            assert reg[at.SETPOINT] == before[at.SETPOINT]
        assert all(0 <= reg[k] <= 65535 for k in at.PARAMETERS if k != at.OFFSET)
        assert -32768 <= reg[at.OFFSET] <= 32767


@given(st.binary(max_size=60).filter(lambda line: not set(line) & set(b"+-Oo")))
@settings(max_examples=25, deadline=None)
def test_no_bytes_but_moves_and_the_offset_move_a_running_motor(line):
    bench = on_bench()
    bench.send(line + b"\r")
    bench.run(0.05)
    assert abs(int(bench.axis("x")["true_count"])) <= 1


@pytest.mark.parametrize("script", [
    b"P600\rI24\rD260\rH400\rX300\rT255\rN150\rE2000\rM0\rC50\rL0\rL1\rG100\rG-100\rZ\rA\r#\rR\r", b"+\r",
    b"?\rO0\rC\r",
])  # fmt: skip
def test_the_script_of_a_uhu_does_not_move_the_motor(script):  # M-51
    bench = on_bench()
    before = words(bench, "GP")
    for line in script.split(b"\r")[:-1]:
        bench.talk(line + b"\r", axis="x")
        bench.run(0.02)
        assert abs(words(bench, "GP") - before) <= 75
