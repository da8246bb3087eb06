"""The servo module's serial dialogue, to the character, its data recorder, and its faults."""

import re

import numpy as np
import pytest

from edmsim.axis_bench import AxisBench
from edmsim.controllers import axis
from edmsim.controllers.axis import ServoModule
from edmsim.controllers.axis.drive import axis_row

from .module_bench import NO_TRIP, get, locked, on_bench, preset, say, status, words
from .uhu_bench import stepped


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
    say(bench, "+20" if edge > 0 else "-20", run_s=0.3)
    assert abs(get(bench, "GE")) < 10
    assert words(bench, "GP") * edge < 0
    assert words(bench, "GT") == (edge + (20 if edge > 0 else -20) + 2**31) % 2**32 - 2**31


def test_error_output_and_duty_are_shown_as_printed():  # M-14, M-16, M-17
    bench = locked(on_bench(proportional_gain=384), -8)
    assert say(bench, "GE") == "Error: -8"
    say(bench, "+16", run_s=0.01)
    assert say(bench, "GO") == "PID Output: 12"
    say(bench, "O178", run_s=0.01)
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
    sent_s = bench.time_s
    bench.send(f"Z{24 + rate}\r".encode(), axis="x")
    full_s = 128 * 2**rate * (divider + 7) / 19531.25
    bench.run(full_s + 0.3)
    heard = bench.received_at("x")
    text, times = bytes(byte for byte, _ in heard), [at_s for _, at_s in heard]
    answer = b"Recorder ON\r\n"
    assert text.startswith(answer)
    begins = times[len(answer)] - sent_s
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
        stepped(bench, -3000, 1e9 / 665_600, 20_000.0, run_s=0.5)
        shown = get(bench, "GV")
        say(bench, f"Z{24 + source}")
        values = dumped(bench, 0.4)
        assert np.mean(values) == pytest.approx(-10, abs=0.3)
        assert shown == pytest.approx(-10, abs=3)


@pytest.mark.parametrize("move", [30, -30])
def test_trigger_0_waits_for_a_commanded_move_either_way(move):  # M-30, M-61, M-A17
    bench = on_bench()
    say(bench, "Z0", run_s=0.3)
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
    say(bench, "+10", run_s=0.1)
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
    say(bench, "Z26", run_s=0.1)
    say(bench, "Q")
    say(bench, "Z")
    say(bench, "R")
    bench.received("x")
    bench.run(0.6)
    assert bench.received("x") == b""


def test_a_new_recording_ends_the_dump_of_the_one_before():  # M-30
    bench = locked(on_bench(loop_divider=9))
    say(bench, "Z157")
    bench.run(128 * 32 / 1220.7 + 0.05)
    sent = bench.received("x")
    assert 0 < sent.count(b"\r\n") < 128
    assert say(bench, "Z24").endswith("Recorder ON")
    assert dumped(bench, 0.6) == [0] * 128


def test_an_answer_during_the_dump_is_a_transmit_error():  # M-18
    bench = on_bench()
    say(bench, "Z24")
    bench.run(128 * CYCLE_S + 0.02)
    bench.send(b"P\r", axis="x")
    bench.run(0.4)
    assert 15 in status(bench)
    say(bench, "R")
    assert 15 not in status(bench)


# The servo module off and on again: trip, fault input and output, Q, R, its lamp, and what a reset keeps.


def wired(**stored):
    bench = on_bench(**stored)
    bench.wire("x", fault_in=True, fault_out=True)
    return bench


def tripped(bench):
    locked(bench, 70)
    say(bench, "+10", run_s=0.01)
    return bench


def pull(bench):
    bench.pull_fault_net(True)
    bench.run(0.01)
    return bench


def stop(bench):
    say(bench, "Q", run_s=0.01)
    return bench


def test_a_low_reset_pin_stops_the_module_and_its_release_starts_it_anew():  # M-1, M-38, M-45, M-A5, M-A20
    bench = on_bench()
    pins = bench.pins("x")
    assert (pins.enabled, pins.fault_out_low, pins.duty) == (True, False, 0.5)
    say(bench, "P555")
    say(bench, "R")
    assert say(bench, "P") == "(P) - Kp: 555"  # the command R keeps it
    bench.reset_pin("x", low=True)
    bench.run(0.05)
    assert not bench.pins("x").enabled
    assert bench.talk(b"P\r") == b""
    bench.reset_pin("x", low=False)
    bench.run(0.05)
    assert bench.received("x") == b"Servo processor module, rev. A\r\n"
    assert bench.pins("x").enabled
    assert say(bench, "P") == "(P) - Kp: 600"


@pytest.mark.parametrize("wires", [("A", "B"), ("A",)])
def test_without_its_encoder_the_axis_trips_on_its_first_move(wires):  # M-1, M-43
    bench = on_bench()
    for wire in wires:
        bench.unplug("x", wire)
    stepped(bench, 200, 2000.0, run_s=0.3)
    assert {0, 1} <= status(bench)


def test_swapped_phases_run_away_to_the_trip_unless_the_law_turns_them():  # M-1
    for sense, tripped_ in ((1, True), (-1, False)):
        bench = on_bench(law={"encoder_sense": sense})
        bench.swap_phases("x")
        say(bench, "+20", run_s=0.5)
        assert (1 in status(bench)) == tripped_


def test_a_trip_stops_the_loop_and_pulls_the_fault_output():  # M-43, M-18
    bench = tripped(wired())
    pins = bench.pins("x")
    assert (pins.enabled, pins.fault_out_low, bench.fault_net_low) == (False, True, True)
    assert status(bench) & {0, 1, 2} == {0, 1}
    bench.hold("x", False)
    before = words(bench, "GP")
    bench.torque("x", 0.05)
    bench.run(0.1)
    bench.hold("x", True)
    assert abs(words(bench, "GP") - before) > 10  # the encoder is still counted
    assert get(bench, "GE") == words(bench, "GT") - words(bench, "GP")


def test_a_low_fault_input_stops_the_loop_and_leaves_the_output():  # M-44, M-A15
    bench = pull(wired())
    bench.wire("x", fault_in=True, fault_out=True)
    assert not bench.pins("x").enabled
    assert not bench.pins("x").fault_out_low
    assert status(bench) & {0, 1, 2} == {0, 2}
    say(bench, "R")  # lasts a cycle under a low input
    bench.run(0.01)
    assert status(bench) & {0, 1, 2} == {0, 2}
    bench.pull_fault_net(False)
    bench.run(0.05)
    assert not bench.pins("x").enabled  # latched
    say(bench, "R", run_s=0.01)
    assert bench.pins("x").enabled


def test_quit_frees_the_motor_and_says_no_fault():  # M-23, M-41
    bench = stop(wired(output_offset=40))
    pins = bench.pins("x")
    assert (pins.enabled, pins.fault_out_low) == (False, False)
    assert status(bench) & {0, 1, 2} == {0}
    assert get(bench, "GD") == 1064
    bench.torque("x", 0.05)
    bench.run(0.1)
    bench.torque("x", 0.0)
    turned = words(bench, "GP")
    assert turned > 10
    bench.run(0.3)
    before = words(bench, "GP")
    say(bench, "O0")
    say(bench, "R", run_s=0.1)
    assert bench.pins("x").enabled
    assert abs(words(bench, "GP") - before) <= 2  # no jump: the motor's place is the setpoint
    assert abs(words(bench, "GT") - before) <= 1


def test_without_power_the_motor_freewheels():  # M-42
    run_out = {}
    for name in ("freewheel", "shorted"):
        bench = on_bench(proportional_gain=0, derivative_gain=0, velocity_feed_forward=2600, error_limit=NO_TRIP)
        stepped(bench, 20_000, 40_000.0, 200_000.0, run_s=0.3)
        if name == "freewheel":
            stop(bench)
        else:  # duty 50 % and enabled: the bridge shorts the winding
            say(bench, "V0")
        start = words(bench, "GP")
        bench.run(1.0)
        run_out[name] = abs(words(bench, "GP") - start)
    assert run_out["freewheel"] > 2 * run_out["shorted"]


def test_reset_clears_flags_and_peak_and_starts_from_where_the_motor_is():  # M-24, M-33, M-56
    bench = locked(on_bench(), 20, -50, 40)
    bench.run(0.01)
    assert say(bench, "?").split("\r\n")[-1] == "Peak Error: 30"  # the largest so far, either way
    bench = tripped(wired(proportional_gain=5000))
    assert {0, 1, 10} <= status(bench)
    assert say(bench, "?").split("\r\n")[-1] == "Peak Error: 80"
    say(bench, "R", run_s=0.01)
    assert status(bench) & {0, 1, 2, 10, 14, 15} == set()
    assert say(bench, "?").split("\r\n")[-1] == "Peak Error: 0"
    assert get(bench, "GE") == 0
    assert (bench.pins("x").enabled, bench.pins("x").fault_out_low, bench.fault_net_low) == (True, False, False)


@pytest.mark.parametrize("typed", ["+76", "-76"])
def test_a_move_beyond_the_limit_is_a_fault_at_once(typed):  # M-34, M-56
    bench = on_bench(error_limit=75, step_multiplier=9, error_scale=65535)
    assert say(bench, typed) == f"Move {typed}"
    assert {0, 1} <= status(bench)
    assert say(bench, "?").endswith("Peak Error: 76")
    say(bench, "R")
    assert say(bench, "+75") == "Move +75"  # in counts of the encoder: the multiplier has no part in it
    assert words(bench, "GT") == words(bench, "GP") + get(bench, "GE")
    bench.run(0.3)
    assert status(bench) & {0} == set()


def test_a_move_while_off_is_answered_and_discarded_by_reset():  # M-A21
    bench = stop(on_bench())
    before = words(bench, "GP")
    assert say(bench, "+500") == "Move +500"
    bench.run(0.1)
    assert (words(bench, "GP"), words(bench, "GT")) == (before, before + 500)
    assert status(bench) & {0, 1, 2} == {0}
    say(bench, "R", run_s=0.1)
    assert (words(bench, "GP"), words(bench, "GT")) == (before, before)


def lamp(bench, seconds):
    """Times of the lamp's changes over some time, in tenths of a second, and the share that it was lit."""
    bench.changes("x")
    bench.run(seconds)
    rows = bench.changes("x")
    lit = (rows["pins"] & 8) != 0
    turns = np.flatnonzero(np.diff(lit)) + 1
    return np.round(np.diff(rows["time_ns"][turns]) * 1e-8).astype(int), lit[turns]


@pytest.mark.parametrize(("name", "flashes"), [("quit", 1), ("trip", 2), ("external", 3)])
def test_a_stopped_module_flashes_its_reason(name, flashes):  # M-3, M-A10
    bench = {"quit": stop, "trip": tripped, "external": pull}[name](wired())
    lengths, lit = lamp(bench, 8.0)
    lit_times = lengths[lit[:-1]]
    pauses = lengths[~lit[:-1]]
    assert set(lit_times) == {2}
    assert sorted(set(pauses)) == ([18] if flashes == 1 else [2, 20 - 4 * flashes + 2])
    assert len(lit_times) == pytest.approx(4 * flashes, abs=flashes)


def test_a_running_module_blinks_evenly_and_faster_in_recorder_mode():  # M-3, M-A10, M-A5, M-A23: pin 18
    bench = on_bench()
    assert set(lamp(bench, 4.0)[0]) == {5}
    say(bench, "Z0")
    lengths, _ = lamp(bench, 2.0)
    assert lengths.size >= 14
    assert set(lengths) == {1}


def test_no_watchdog_stops_a_module_whose_loop_stands():  # M-A22
    bench = on_bench()
    bench.changes("x")
    bench.stall("x", 0.5)
    bench.run(0.4)
    stepped(bench, 20, 1000.0, run_s=0.4)
    assert bench.pins("x").enabled
    assert status(bench) & {0, 1, 2} == set()
    assert words(bench, "GP") == pytest.approx(20, abs=1)


def test_a_fault_of_one_axis_stops_the_other():  # M-44, M-43
    drives = {name: ServoModule(axis_row("table")) for name in ("x", "y")}
    bench = AxisBench(drives)
    for name in drives:
        bench.wire(name, fault_in=True, fault_out=True)
    bench.run(0.02)
    bench.talk(b"+500\r", axis="x")
    bench.run(0.01)
    assert not bench.pins("y").enabled
    assert bench.talk(b"GS\r", axis="y") == b"Status: 0000000000000101\r\n"
    assert not bench.pins("y").fault_out_low  # else neither would ever come back
    for name in drives:
        bench.talk(b"R\r", axis=name)
    bench.run(0.01)
    assert bench.pins("x").enabled
    assert bench.pins("y").enabled
