"""The servo module's serial dialogue on the running drive, to the character."""

from __future__ import annotations

import re

import pytest

from edmsim.axis_bench import AxisBench
from edmsim.controllers import axis

from .module_bench import NO_TRIP, get, locked, on_bench, preset, say, words


@pytest.mark.parametrize(("typed", "answer"), [
    ("P1234", "(P) - Kp: 1234"), ("D1234", "(D) - Kd: 1234"), ("A100", "(A) - A.ff: 100"),
    ("C500", "(C) - Max PWM: 500"), ("E75", "(E) - Error limit: 75"), ("F256", "(F) - Error scale: 256"),
    ("L7", "(L) - Loop: 7"), ("O-25", "(O) - Output Offset: -25"), ("T3", "(T) - Ti: 3"), ("V750", "(V) - V.ff: 750"),
    ("P1250", "(P) - Kp: 1250"), ("I105", "(I) - Ki: 105"),
])  # fmt: skip
def test_a_setting_is_confirmed_as_the_guide_prints_it(typed, answer):  # M-4, M-6..M-10, M-21, M-22, M-26, M-27
    bench = on_bench()
    assert bench.talk(typed.encode() + b"\r", axis="x") == answer.encode() + b"\r\n"
    assert say(bench, typed[0]) == answer  # a letter alone shows, and changes nothing (M-A14)


@pytest.mark.parametrize(("scale", "typed", "answer"), [
    (205, "P1250", "(P) - Kp: 1250 (1000)"), (183, "I105", "(I) - Ki: 105 (75)"), (185, "I105", "(I) - Ki: 105 (75)"),
    (209, "D1100", "(D) - Kd: 1100 (898)"), (512, "P100", "(P) - Kp: 100 (200)"), (256, "P1250", "(P) - Kp: 1250"),
])  # fmt: skip
def test_the_bracket_shows_the_gain_within_the_antidither_region(scale, typed, answer):  # M-8, M-A1, M-A11
    assert say(on_bench(antidither_scale=scale), typed) == answer


@pytest.mark.parametrize("letter", "JKXY")
def test_settings_without_a_printed_answer_are_confirmed_alike(letter):  # M-A12
    assert re.fullmatch(rf"\({letter}\) - [\w ]+: 3", say(on_bench(), f"{letter}3"))


def test_nothing_is_echoed_and_there_is_no_prompt():  # M-2
    bench = on_bench()
    assert bench.talk(b"P12", axis="x") == b""
    assert bench.talk(b"34\n\r", axis="x") == b"(P) - Kp: 1234\r\n"
    assert bench.talk(b"\r\r\n", axis="x") == b""


def test_the_answer_comes_at_57600_baud():  # M-2
    bench = on_bench()
    bench.send(b"?\r")
    bench.run(0.2)
    times = [at_s for _, at_s in bench.received_at("x")]
    assert (times[-1] - times[0]) / (len(times) - 1) == pytest.approx(10 / 57600, rel=1e-3)


def test_a_message_is_sent_at_power_up():  # M-38
    bench = AxisBench({"x": axis.make("servo-module")})
    bench.run(0.05)
    assert bench.received("x") == b"Servo processor module, rev. A\r\n"


def test_the_menu_shows_all_settings_and_the_peak_error_last():  # M-33, M-A13, M-A19
    lines = say(on_bench(), "?").split("\r\n")
    assert [line[1] for line in lines[:-1]] == list("ACDEFIJKLOPTVXY")
    assert {"(C) - Max PWM: 760", "(L) - Loop: 6", "(T) - Ti: 1", "(Y) - Encoder filter: 0"} < set(lines)
    assert lines[-1] == "Peak Error: 0"


@pytest.mark.parametrize("typed", [
    "P1.5", "P-1", "P+1", "P65536", "O-32769", "O65536", "M1", "B", "G", "GX", "GV1", "S0", "S1", "S2", "Q1", "R0",
    "?1", "P12x", "+", "-", "+-5", "--5", "-32769", "+65536", "+1.0", "Z16", "Z192", "Z224", "Z256", "Z-1",
    "L-3", "1234",
])  # fmt: skip
def test_what_the_module_does_not_know_is_answered_by_a_question_mark(typed):  # M-4, M-5, M-46, M-A14, M-A18
    bench = on_bench()
    before = say(bench, "?")
    setpoint = words(bench, "GT")
    assert say(bench, typed) == "?"
    assert say(bench, "?") == before
    assert words(bench, "GT") == setpoint


@pytest.mark.parametrize("typed", ["p900", " P 900 ", "P0900", "p9\b900"])
def test_case_blanks_and_rub_outs_do_not_count(typed):
    assert say(on_bench(), typed) == "(P) - Kp: 900"


def test_the_greatest_numbers_are_taken_and_shown_as_entered():  # M-46, M-47, M-A14
    bench = on_bench()
    assert say(bench, "C65535") == "(C) - Max PWM: 65535"
    assert say(bench, "L12") == "(L) - Loop: 12"
    assert say(bench, "Y9") == "(Y) - Encoder filter: 9"
    assert say(bench, "O32767") == "(O) - Output Offset: 32767"


@pytest.mark.parametrize("typed", ["O-25", "O65511"])
def test_an_offset_above_32767_is_a_negative_one(typed):  # M-22
    bench = locked(on_bench())
    assert say(bench, typed) == "(O) - Output Offset: -25"
    bench.run(0.01)
    assert say(bench, "GD") == "PWM Dutycyle: 999"


@pytest.mark.parametrize(("position", "shown"), [(242867, "3, 46259"), (-1, "65535, 65535"), (-65536, "65535, 0")])
def test_position_and_setpoint_are_two_words_each(position, shown):  # M-12, M-13
    bench = on_bench()
    preset(bench, position)
    bench.run(0.01)
    assert say(bench, "GP") == f"Pos: {shown}"
    assert say(bench, "GT") == f"Setpoint: {shown}"


@pytest.mark.parametrize("edge", [2**31 - 1, -(2**31)])
def test_the_position_passes_the_end_of_its_register_without_a_jump(edge):  # M-12, M-35
    bench = on_bench()
    preset(bench, edge)
    say(bench, "+20" if edge > 0 else "-20")
    bench.run(0.3)
    assert abs(get(bench, "GE")) < 10
    assert words(bench, "GP") * edge < 0
    assert words(bench, "GT") == (edge + (20 if edge > 0 else -20) + 2**31) % 2**32 - 2**31


def test_error_output_and_duty_are_shown_as_printed():  # M-14, M-16, M-17
    bench = locked(on_bench(proportional_gain=384), -8)
    assert say(bench, "GE") == "Error: -8"
    say(bench, "+16")
    bench.run(0.01)
    assert say(bench, "GO") == "PID Output: 12"
    say(bench, "O178")
    bench.run(0.01)
    assert say(bench, "GO") == "PID Output: 12"
    assert say(bench, "GD") == "PWM Dutycyle: 1214"


def test_the_printed_status_is_that_of_an_external_fault_after_saturation():  # M-18
    bench = locked(on_bench(proportional_gain=5000), 70)
    bench.wire("x", fault_in=True, fault_out=True)
    bench.pull_fault_net(True)
    bench.run(0.01)
    assert say(bench, "GS") == "Status: 0000010000000101"


@pytest.mark.parametrize(("typed", "answer"), [
    ("Q", "Servo is OFF"), ("R", "Servo RESET!"), ("S", "Parameters saved"), ("+125", "Move +125"),
    ("-75", "Move -75"),
])  # fmt: skip
def test_commands_answer_as_printed(typed, answer):  # M-23, M-24, M-25, M-34
    assert say(on_bench(error_limit=NO_TRIP), typed) == answer


def test_an_overlong_line_is_refused_as_a_whole():
    bench = on_bench()
    assert say(bench, "P" + "0" * 60 + "7") == "?"
    assert say(bench, "P7") == "(P) - Kp: 7"
