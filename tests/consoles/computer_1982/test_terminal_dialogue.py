"""MAIN's words at the machine, typed in a pipe: jobs that go well, and every answer to bad input."""

import io
import sys

import pytest
from rich.console import Console

from edmsim.consoles.computer_1982.main_program import MainProgram
from edmsim.consoles.computer_1982.operation import Operation
from edmsim.consoles.computer_1982.session import Session, panel
from edmsim.consoles.computer_1982.words import ALIASES, JOB, WORDS
from edmsim.consoles.devices import Interrupts, Pipe

from .conftest import Script

SET = "TI 30 TP 100"


def test_a_closed_input_has_ended_and_a_closed_output_drops_all(monkeypatch, capfd):
    monkeypatch.setattr(sys, "stdin", None)
    monkeypatch.setattr(sys, "stdout", None)
    pipe = Pipe(Interrupts())
    pipe.write(b"READY\r\n")
    assert (pipe.at_end, pipe.read(None), capfd.readouterr().out) == (True, b"", "")


# T-51, T-52
def test_after_init_all_is_safe_and_the_position_unchanged(operate):
    session = operate("STATUS", SET, "GEN ON", "WAIT 1", "INIT", "STATUS", "WAIT 1", "STATUS")
    state, _, pulses, generator = session.lines[-6:-2]
    assert state.startswith("STAND-BY   POSITION X 32500 Y 32500 um")
    assert "t(i) NOT SET (00H)   t(p) NOT SET (00H)" in pulses
    assert generator.startswith("GENERATOR OFF")
    assert session.rig.place_um == (32_500.0, 32_500.0)


def test_a_jog_moves_one_axis_with_the_generator_off(operate):
    session = operate("x -40", "wait", "Y +20", "WAIT", "POS")  # T-54: small letters do
    assert session.lines[-3] == "POSITION X 32460 Y 32520 um"
    assert session.rig.place_um == (32_460.0, 32_520.0)
    assert session.rig.plant.removed_mm3 == 0.0
    assert session.rig.time_ns == pytest.approx((40 + 20) / 33.3375 * 1e9, rel=0.05)
    assert session.status == 0


def test_a_new_greatest_speed_changes_no_move_under_way(operate):
    session = operate("X -200", "WAIT 1", "SPEED 10", "STATUS", "WAIT")
    assert any(line.startswith("SPEED 127 OF 10 UNITS") for line in session.lines)
    assert session.rig.time_ns == pytest.approx(200 / 33.3375 * 1e9, rel=0.02)


def test_a_straight_cut_reaches_its_end_and_removes_metal(operate):
    session = operate(SET, "NEW 32600 32500", "START", "WAIT", "STATUS")
    assert "READY   X 32600 Y 32500 um" in session.lines
    assert session.rig.plant.removed_mm3 > 0.0
    assert (session.rig.board.generator_on, session.status) == (False, 0)


def test_an_arc_is_cut_about_its_centre(operate, rig):
    places = []
    advance = rig.advance

    def watch():
        advance()
        places.append(rig.place_um)

    rig.advance = watch
    session = operate(SET, "POS 1000 1000", "CCW 980 1020 980 1000", "START", "WAIT")
    assert "READY   X 980 Y 1020 um" in session.lines
    radii = [((x - 32_480) ** 2 + (y - 32_500) ** 2) ** 0.5 for x, y in places]
    assert max(abs(r - 20) for r in radii) <= 2.0 + 1e-9  # one motor step
    assert places[-1] == (32_480.0, 32_520.0)


# T-52: position, new position, t(i), t(p), cutting speed, in this order
def test_main_asks_as_the_document_says_and_starts(operate):
    session = operate("MAIN", "500 600", "500 560", "20", "100", "90", "YES", "WAIT")
    questions = [line.split(" ?")[0] for line in session.lines if " ? " in line]
    assert questions == [
        "POSITION X Y (32500 32500)", "NEW POSITION X Y", "t(i) us", "t(p) us", "CUTTING SPEED (127)",
        "START (YES OR NO)",
    ]  # fmt: skip
    assert "READY   X 500 Y 560 um" in session.lines
    assert session.status == 0


def test_an_empty_answer_keeps_what_is_shown_and_no_does_not_start(operate):
    session = operate(SET, "NEW 1 2", "MAIN", "", "", "", "", "", "NO", "STATUS")
    state, speed, pulses = session.lines[-6:-3]
    assert state == "STAND-BY   POSITION X 32500 Y 32500 um   NEW 1 2"
    assert "OF 127 UNITS" in speed
    assert pulses.startswith("t(i) 30 us (99H)   t(p) 100 us (AAH)")


# T-34: t(i) and t(p) may not be set independently
def test_a_pair_above_2_A_is_refused_and_requested_again(operate):
    session = operate("MAIN", "", "32600 32500", "50", "100", "30", "100", "", "NO", "STATUS")
    assert len(session.refusals) == 1
    assert "above the generator's 2 A" in session.refusals[0]
    assert session.lines[-4].startswith("t(i) 30 us")


# T-34, T-56
def test_a_code_ends_at_every_separator_and_may_begin_with_a_letter(operate):
    session = operate("TI 30;TP;AAH", "MAIN", "", "32600 32500", "99H", "AAH", "", "NO", "STATUS")
    assert session.after("TI 30;TP;AAH").startswith("t(i) 30 us (99H)   t(p) 100 us (AAH)")
    assert session.refusals == []
    assert session.lines[-4].startswith("t(i) 30 us (99H)   t(p) 100 us (AAH)")


def test_keys_take_the_separators_of_all_numbers(operate):  # T-57
    assert operate("KEY 300,Y+", "WAIT").rig.place_um == (32_500.0, 32_800.0)


def test_a_pair_above_2_A_leaves_the_old_pair(operate):
    session = operate(SET, "TI 40", "STATUS", "TI 40 TP 150", "STATUS")
    assert "draws 2.6" in session.after("TI 40")
    pulses = [line for line in session.lines if line.startswith("t(i)")]
    assert [line.split(" us")[0] for line in pulses] == ["t(i) 30", "t(i) 30", "t(i) 40", "t(i) 40"]


@pytest.mark.parametrize(("line", "reason"), [
    ("A" * 65, "a line has at most 64 characters; nothing was done"),
    ("X 65536", "a number has 16 bits, 0..65535, not 65536"),
    ("NEW 70000 1", "a number has 16 bits, 0..65535, not 70000"),
    ("POS 1 99999999999", "a number has 16 bits, 0..65535, not 99999999999"),
    ("TI 200H", "a code is 0H to 1FFH, not 200H"),
    ("FOO", "FOO is not a word of this machine; HELP shows them"),
    ("%", "% is not a word of this machine; HELP shows them"),
    ("STAT US", "STAT is not a word of this machine; HELP shows them"),
    ("START NOW", "NOW is not expected here"),
    ("NEW 1", "NEW x y is expected"),
    ("CW 1 2 3", "CW x y and the centre's x y is expected"),
    ("X", "X and a distance are expected, as in X 50 or X -200"),
    ("X 3O", "a whole number is expected at column 3, not 3O"),
    ("NEW 1 2OO,3", "a whole number is expected at column 7, not 2OO"),
    ("POS 1000.5 2", "a whole number is expected at column 5, not 1000.5"),
    ("X A", "a whole number is expected at column 3, not A"),
    ("X 1", "a motor step is 2 um; jog by at least that"),
    ("X 40000", "soft limit: the counters hold 0 to 65535 um, not 72500"),
    ("SPEED 0", "SPEED is 1 to 127 units, not 0"),
    ("SPEED 128", "SPEED is 1 to 127 units, not 128"),
    ("TI 30 X 20", "X cannot follow settings; TI, TP and SPEED can"),
    ("TI 1001", "t(i) is 1001 us, but the voltage reaches from 0 to 1000 us only"),
    ("TP 10001", "t(p) is 10001 us, but the voltage reaches from 0 to 10000 us only"),
    ("KEY", "a key is expected: 0 to 9, SHIFT, CLEAR, X, Y"),
    ("KEY 5 SHIFT", "a key is expected: 0 to 9, SHIFT, CLEAR, X, Y"),
    ("KEY 5 ENTER", "there is no key ENTER; there are 0 to 9, SHIFT, CLEAR, X, Y"),
    ("KEY 1 SHIFT GO", "key 18 has no meaning with SHIFT or CTRL"),
    ("KEY SPEED", "SPEED is 1 to 127 units, not 0"),
    ("KEY START", "no new position was given; the keys X and Y give one"),
    ("TENSION", "TENSION LOW or TENSION FULL is expected"),
    ("TI 30", "t(p) is not set yet; TI us TP us sets both"),
    ("GEN", "GEN ON or GEN OFF is expected"),
    ("GEN ON", "t(i) and t(p) are not set; TI us TP us sets them"),
    ("START", "no new position was given; NEW x y gives one"),
    ("RUN", "there is no program; LOAD takes one from the host"),
    ("LOAD", "no host is connected; edmsim console 1982 --host FILE connects one"),
    ("GO", "no cut was stopped; START or RUN begins one"),
    ("STOP", "the machine is not moving"), ("WIRE", "the wire is whole"),
    ("HELP FOO", "there is no help on FOO; there is on"),
])  # fmt: skip
def test_bad_input_is_answered_by_one_line_and_does_nothing(operate, line, reason):
    session = operate(line, "STATUS")
    assert len(session.refusals) == 1
    assert session.refusals[0].startswith(f"? {reason}")
    assert "STAND-BY   POSITION X 32500 Y 32500 um   NO NEW POSITION" in session.lines
    assert session.lines[-4] == "t(i) NOT SET (00H)   t(p) NOT SET (00H)"
    assert session.status == 2


def test_the_cut_needs_pulses_and_a_way(operate):
    session = operate("NEW 32600 32500", "START", SET, "NEW 32500 32500", "START")
    assert session.refusals == [
        "? t(i) and t(p) are not set; TI us TP us sets them",
        "? the wire is there already; give another new position",
    ]


def test_a_new_move_while_moving_is_refused_and_the_move_goes_on(operate):
    session = operate("X 20", "X 20", "Y 4", "POS 1 1", "LOAD", "WAIT")
    assert [r.split(";")[0] for r in session.refusals[:3]] == 3 * ["? the machine moves already"]
    assert "READY   X 32520 Y 32500 um" in session.lines


@pytest.mark.parametrize(("speed", "person", "place_um"), [(None, False, 32_520.0), (1e4, False, 32_520.0),
                                                           (1e4, True, 32_500.0)])  # fmt: skip
def test_the_end_of_a_script_ends_its_last_line_and_a_lost_terminal_does_not(rig, speed, person, place_um):
    screen = Script(b"STATUS\nX 20")
    assert Session(rig, screen, Interrupts(), speed=speed, person=person).run() == 0
    assert rig.place_um == (place_um, 32_500.0)
    assert (b"the last line has no end; nothing was done" in screen.printed) is person


def test_return_and_line_feed_together_end_one_line(rig):
    screen = Script(b"POS 1000 1000\r\nMAIN\r\n\r\n1100 1000\r\nSTATUS\r\n")
    assert Session(rig, screen, Interrupts()).run() == 0
    assert b"NEW POSITION X Y ? 1100 1000\r\nt(i) us ? STATUS\r\n" in screen.printed


def test_help_knows_every_word_and_fits_the_screen(operate, rig):
    main = MainProgram(Operation(rig), Session(rig, Script(b""), Interrupts()), print, rig.board.bus)
    assert {ALIASES.get(word, word) for word in main.words} == set(WORDS) - {"MORE"}
    session = operate("HELP", "?", *(f"HELP {word}" for word in main.words))
    assert not session.refusals
    assert all(len(line) <= 80 for text in (JOB, *WORDS.values()) for line in text.splitlines())
    shown = Console(width=80, record=True, file=io.StringIO())
    shown.print(panel([0] * 32, Operation(rig).status(), False))
    below = len(shown.export_text().splitlines()) + 2  # the operator's line, and the one that asked
    assert max(len(text.splitlines()) for text in (JOB, *WORDS.values())) + below <= 24
