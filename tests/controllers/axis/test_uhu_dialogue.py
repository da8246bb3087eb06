"""The UHU's terminal on the bench, to the character: rows U-7 to U-13, its banks, and garbage on the line."""

import itertools

import pytest
from hypothesis import given
from hypothesis import settings as effort
from hypothesis import strategies as st

from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis import tuned as commissioned
from edmsim.controllers.axis.drive import axis_row
from edmsim.controllers.axis.uhu import LATCHED, TARGET, Uhu
from edmsim.machine.machine import Machine
from edmsim.plant.plant import Plant

from .uhu_bench import BAD_BANNER, BANNER, HELP, SAMPLE_SET, ask, count, delivered, register, stepped, tuned


def test_the_start_up_text_comes_at_power_up():  # U-8, GU-1, GU-2
    for stored, text in ((SAMPLE_SET, BANNER), (None, BAD_BANNER)):
        bench = AxisBench({"x": Uhu(axis_row("bench"), stored=stored)})
        bench.run(0.05)
        assert bench.received("x") == text


def test_reset_pin_power_and_plus_say_the_same():  # U-32, U-39, GU-1
    bench = tuned(**SAMPLE_SET)
    bench.received("x")
    assert bench.talk(b"+\r") == b"+\r\n" + BANNER
    bench.reset_pin("x", low=True)
    bench.run(0.01)
    bench.reset_pin("x", low=False)
    bench.run(0.05)
    assert bench.received("x") == BANNER
    bench.power_cycle("x", 0.1)
    bench.run(0.05)
    assert bench.received("x") == BANNER


@pytest.mark.parametrize("key", ["#", "?"])
def test_the_help_is_that_of_the_manual(key):  # U-10, U-11, U-A4, U-A16, GU-3
    bench = tuned(**SAMPLE_SET)
    assert bench.talk(key.encode() + b"\r") == f"{key}\n{HELP}>".replace("\n", "\r\n").encode()


def test_a_letter_with_a_number_sets_it():  # U-9, GU-4
    bench = tuned(**SAMPLE_SET)
    assert bench.talk(b"P600\r") == b"P600\r\nOK\r\n>"
    assert "(P)rop.      600" in ask(bench, "#")


def test_a_letter_alone_asks():  # U-9, U-A18, GU-5, GU-6
    bench = tuned(**SAMPLE_SET)
    assert bench.talk(b"P\r") == b"P\r\n(P)rop.      900: "
    assert bench.talk(b"\r") == b"\r\n>"
    assert bench.talk(b"P\r") == b"P\r\n(P)rop.      900: "
    assert bench.talk(b"600\r") == b"600\r\nOK\r\n>"
    assert bench.talk(b"P\r") == b"P\r\n(P)rop.      600: "
    bench.talk(b"\r")
    for typed, question in ((b"S", b"ave       [0,1,2]"), (b"L", b"oad       [0,1,2]"), (b"G", b"o         [Wert]")):
        assert bench.talk(typed + b"\r") == b"%b\r\n(%b)%b: " % (typed, typed, question)
        assert bench.talk(b"1\r") == b"1\r\nOK\r\n>"
    assert register(bench, TARGET) == 1


@pytest.mark.parametrize("letter", "PIDHXTNEMOC")
def test_every_parameter_shows_its_line_and_takes_any_word(letter):  # U-9, U-47
    bench = delivered()
    for value in (0, 1, 65535):
        assert ask(bench, f"{letter}{value}") == "OK"
        shown = bench.talk(letter.encode() + b"\r").decode()
        assert f" {value}: " in shown
        assert f"({letter})" in shown
        bench.talk(b"\r")


def test_what_is_no_command_changes_nothing():  # U-13, U-A18
    bench = tuned(**SAMPLE_SET)
    before = ask(bench, "#")
    wrong = "P65536 P-1 P6.5 P6,5 PX W1 S3 L9 S-1 G32001 G-32001 R5 A1 +125 -75"
    for line in wrong.split():
        assert ask(bench, line) == "?", line
    bench.talk(b"E\r")
    assert bench.talk(b"12x\r") == b"12x\r\n?\r\n>"
    assert ask(bench, "#") == before
    assert count(bench) == 0


def test_the_counter_of_the_help_shows_the_position_whatever_state_the_drive_is_in():  # U-10, U-A9
    bench = tuned(**SAMPLE_SET)
    assert bench.talk(b"counter\r") == b"counter\r\n(C)ounter    0\r\n>"
    ask(bench, "X5000")
    for way, place in ((300, 300), (-1000, -700)):
        ask(bench, f"G{way}", run_s=1.0)
        shown = int(ask(bench, "COUNTER").removeprefix("(C)ounter"))
        assert shown == pytest.approx(place, abs=2)
        assert shown == count(bench) == bench.drive("x").position
    bench.pull_fault_net(True)
    bench.run(0.1)
    before = count(bench)
    bench.torque("x", 0.3)  # the motor is off, and is turned by hand
    bench.run(0.1)
    bench.torque("x", 0.0)
    bench.run(1.0)
    assert abs(count(bench) - before) > 50
    assert ask(bench, "COUNTER") == f"(C)ounter    {count(bench)}"
    assert ask(bench, "+") == BANNER.decode().removesuffix(">").strip()  # counts from 0 again
    assert ask(bench, "COUNTER") == "(C)ounter    0"


def test_in_a_machine_the_counter_shows_where_the_table_is():  # U-A9
    drive = commissioned("uhu")
    plant = Plant(Machine.load(height_mm=3.0), resolution="fast", drives={"x": drive})
    plant.switch_generator(False)
    start_um = plant.place_um[0]
    plant.advance([(1_000_000 * k, 0, -1) for k in range(20)])
    for _ in range(8):
        plant.advance()
    said = plant.drives["x"].line(b"COUNTER\r").decode()
    counts = int(said.split("(C)ounter")[1].split()[0])
    per_um = float((drive.motor["counts_per_rad"] / drive.motor["um_per_rad"])[0])
    assert plant.place_um[0] - start_um == pytest.approx(-40.0, abs=2.0)
    assert counts == pytest.approx((plant.place_um[0] - start_um) * per_um, abs=2)


def test_keys_are_echoed_one_by_one_and_blanks_case_and_line_feeds_do_not_count():  # U-7, U-A13, U-A14, U-A15
    bench = tuned(**SAMPLE_SET)
    assert [bench.talk(bytes([key])) for key in b"p 6 "] == [b"p", b" ", b"6", b" "]
    assert bench.talk(b"00\r\n") == b"00\r\nOK\r\n>"
    assert "(P)rop.      600" in ask(bench, "#")
    assert bench.talk(b"\r") == b"\r\n>"
    assert bench.talk(b"P70\x081\r") == b"P70\b \b1\r\nOK\r\n>"
    assert "(P)rop.      71" in ask(bench, "#")


def test_the_serial_line_runs_at_a_divisor_of_the_crystal():  # U-7, U-67
    bench = tuned()
    assert bench.drive("x").baud == pytest.approx(38461.5, abs=0.1)
    assert bench.drive("x").baud / 38400 - 1 == pytest.approx(0.0016, abs=1e-4)
    bench.received("x")
    bench.host_baud(38400.0)
    bench.send(b"#\r", axis="x")
    bench.run(0.5)
    times = [time_s for _, time_s in bench.received_at("x")]
    assert min(b - a for a, b in itertools.pairwise(times)) >= 10 / 38461.6


def test_delivery_state_is_cured_by_reset_and_save():  # U-28, GU-2, GU-7, GU-9
    bench = delivered()
    assert not bench.pins("x").enabled
    assert "(P)rop.      1000" in ask(bench, "#")  # preset, U-A22
    assert ask(bench, "+") == BAD_BANNER.decode().removesuffix(">").strip()
    assert bench.talk(b"R\r") == b"R\r\nOK\r\n>"
    assert bench.pins("x").enabled
    assert bench.talk(b"S0\r") == b"S0\r\nOK\r\n>"
    assert bench.talk(b"+\r") == b"+\r\n" + BANNER


def test_the_three_banks_are_independent():  # U-26, U-27, U-54, U-55, U-56
    bench = tuned()
    for bank in (0, 1, 2):
        ask(bench, f"P{1000 + bank}")
        assert ask(bench, f"S{bank}") == "OK"
    for bank in (2, 0, 1, 1, 2, 0, 0, 1):
        assert ask(bench, f"L{bank}") == "OK"
        assert f"(P)rop.      {1000 + bank}" in ask(bench, "#")
    ask(bench, "P77")
    ask(bench, "R")
    assert "(P)rop.      77" in ask(bench, "#")  # R keeps what was not saved
    bench.talk(b"+\r")
    assert "(P)rop.      1000" in ask(bench, "#")


def test_any_flipped_bit_of_a_bank_is_corrected():  # U-29, U-A24
    bench = tuned(**SAMPLE_SET)
    for bit in range(0, 42 * 8, 5):
        bench.flip_bits("x", (bit,))
        assert bench.talk(b"+\r") == b"+\r\n" + BANNER, bit
        assert ask(bench, "#").replace("\r", "") == HELP.strip(), bit
        bench.flip_bits("x", (bit,))


def test_any_two_flipped_bits_are_corrected_or_noticed():  # U-28, U-29, U-A21
    bench = tuned(**SAMPLE_SET)
    for byte in (0, 13, 41):
        for first, second in ((0, 1), (2, 7), (3, 4)):
            bits = (8 * byte + first, 8 * byte + second)
            bench.flip_bits("x", bits)
            assert bench.talk(b"+\r") == b"+\r\n" + BAD_BANNER, bits
            assert not bench.pins("x").enabled
            assert "(P)rop.      1000" in ask(bench, "#")  # presets, never what could not be read
            bench.flip_bits("x", bits)
        bench.flip_bits("x", (8 * byte, (8 * byte + 17) % 336))
        assert bench.talk(b"+\r") == b"+\r\n" + BANNER
        bench.flip_bits("x", (8 * byte, (8 * byte + 17) % 336))


def test_power_lost_in_a_save_leaves_a_bank_that_is_refused():  # U-26, U-28
    bench = tuned(**SAMPLE_SET)
    before = bench.drive("x").record["eeprom"].copy()
    ask(bench, "P2000")
    ask(bench, "I99")
    ask(bench, "S0")
    eeprom = bench.drive("x").record["eeprom"]
    eeprom[0, 3:42] = before[0, 3:42]  # three bytes were written, then the power went
    bench.power_cycle("x", 0.1)
    bench.received("x")
    bench.run(0.05)
    assert ask(bench, "+") == BAD_BANNER.decode().removesuffix(">").strip()


def test_a_failed_load_shuts_off_until_a_reset():  # U-28, U-69, U-A21
    bench = tuned(**SAMPLE_SET)
    assert bench.talk(b"L1\r") == b"L1\r\nEEPROM: Error!\r\n>"
    pins = bench.pins("x")
    assert (pins.enabled, pins.error_led, pins.fault_out_low) == (False, True, True)
    assert ask(bench, "#").replace("\r", "") == HELP.strip()  # the parameters stay
    bench.run(0.2)
    assert not bench.pins("x").enabled
    ask(bench, "R")
    assert bench.pins("x").enabled


@effort(max_examples=20)
@given(st.binary(max_size=60).filter(lambda text: b"g" not in text.lower()))
def test_garbage_moves_no_motor(text):  # U-53
    bench = tuned()
    bench.send(text + b"\r", axis="x")
    bench.run(0.05)
    assert abs(count(bench)) <= 1


def test_a_wrong_baud_rate_and_long_lines_set_nothing():  # U-7, U-13, U-53
    bench = tuned(**SAMPLE_SET)
    for baud in (57600.0, 34800.0):  # M-A6: 34800 is a misprint of 38400
        bench.host_baud(baud)
        assert b"OK" not in bench.talk(b"G500\rP1\r+\r")
        bench.host_baud(38400.0)
        bench.talk(b"\r")
    assert bench.talk(b"P" + b"0" * 40 + b"5\r").endswith(b"?\r\n>")
    assert ask(bench, "#").replace("\r", "") == HELP.strip()
    assert register(bench, LATCHED) == 0


def test_what_is_meant_for_the_servo_module_moves_no_motor():  # M-51
    bench = tuned()
    script = "P1234 D1234 I105 A100 C500 E75 F256 L7 O-25 T3 V750 GV GP GT GE GF GO GD GS Q R S +125 -75 Z157 Z ? J2"
    places = []
    for line in script.split():
        bench.send(line.encode() + b"\r", axis="x")
        bench.run(0.05)
        places.append(count(bench))
    assert max(map(abs, places)) <= 1


def test_a_closed_terminal_stops_nothing():  # U-53
    bench = tuned()
    bench.open_terminal(False)
    bench.send(b"A\r", axis="x")
    stepped(bench, 400, 4000.0, run_s=0.5)
    assert abs(count(bench) - 400) <= 2
