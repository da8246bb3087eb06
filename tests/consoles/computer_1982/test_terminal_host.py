"""Programs from the host through the second serial channel, and what a script's exit status says."""

import pytest

from edmsim.consoles.computer_1982.rig import Rig
from edmsim.controllers.mcu.firmware.memory_map import CIADR, TERMINAL_IN

from .conftest import run_script

PROGRAM = """\
* two settings, a line and a quarter of a circle
ti 20 tp 100 speed 100
new 32520 32500

TI 20 TP 150
ccw 32540 32520 32520 32520
END
what stands behind END is not read
"""


@pytest.fixture
def host(tmp_path):
    def write(text, name="program.txt"):
        file = tmp_path / name
        file.write_bytes(text if isinstance(text, bytes) else text.encode())
        return file

    return write


# T-59, T-58: through the second channel, by the redirected input stream
@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
def test_a_program_is_loaded_listed_and_run(operate, host, ends):
    lines = "LOAD", "LIST", "RUN", "WAIT 0", "STATUS", "WAIT", "STATUS"
    session = operate(*lines, host=host(PROGRAM.replace("\n", ends)))
    assert session.after("LOAD") == "LOADED: 2 MOVES, 2 SETTINGS"
    listed = session.lines.index("> LIST")
    assert session.lines[listed + 1 : listed + 5] == [
        "TI 66H TP AAH SPEED 100", "NEW 32520 32500", "TI 66H TP FFH", "CCW 32540 32520 32520 32520",
    ]  # fmt: skip
    assert "READY   X 32540 Y 32520 um" in session.lines
    assert "OF 100 UNITS" in session.lines[-5]
    shown = [line for line in session.lines if line.startswith("t(i)")]
    assert shown == [f"t(i) 20 us (66H)   t(p) {period}" for period in ("100 us (AAH)", "150 us (FFH)")]
    assert session.rig.computer.bus.word(CIADR) == TERMINAL_IN
    assert session.status == 0


def test_status_shows_the_move_of_the_program_that_is_under_way(operate, host):
    session = operate("NEW 5 5", "LOAD", "RUN", "STATUS", "WAIT 1", "STATUS", "WAIT", "STATUS", host=host(PROGRAM))
    shown = [line.split(" um   ")[1] for line in session.lines if " POSITION X " in line]
    assert shown == ["NEW 32520 32500", "CCW 32540 32520 32520 32520", "NEW 5 5"]


def test_a_setting_behind_the_last_move_holds_for_the_next_cut(operate, host):
    program = host("TI 20 TP 100\nNEW 32511 32500\nTI 10 SPEED 50\nEND\n")
    session = operate("LOAD", "RUN", "WAIT", "STATUS", host=program)
    assert "READY   X 32510 Y 32500 um" in session.lines
    assert "t(i) 10 us (33H)   t(p) 100 us (AAH)" in session.lines
    assert any(line.startswith("SPEED 0 OF 50 UNITS") for line in session.lines)


def test_a_setting_refused_on_the_way_is_reported_and_the_cut_goes_on(operate, host):
    session = operate("LOAD", "RUN", "WAIT", host=host(PROGRAM.replace("TI 20 TP 150", "TI 50")))
    (message,) = [line for line in session.lines if "the old setting stays" in line]
    assert message.startswith("? t(i) 50 us in t(p) 100 us draws 3.3")
    assert "READY   X 32540 Y 32520 um" in session.lines


@pytest.mark.parametrize(("text", "reason"), [
    ("NEW 1 2\n", "the host's program ends without END"),
    ("", "the host's program ends without END"),
    ("SPEED 9\nEND\n", "the host's program moves nothing"),
    ("NEW 1 2\nNEW 1\nEND\n", "line 2 of the host's program: NEW x y is expected"),
    ("NEW 1 70000\nEND\n", "line 1 of the host's program: a number has 16 bits, 0..65535, not 70000"),
    ("START\nEND\n", "line 1 of the host's program: START is not one of NEW, CW, CCW, TI, TP, SPEED, END"),
    ("NEW 1 2" + 60 * " " + "\nEND\n", "line 1 of the host's program: a line has at most 64 characters"),
    (b"NEW 1 2\x08\nEND\n", "line 1 of the host's program: 08H is not a character of a line"),
    ("NEW 1 2\n" * 501 + "END\n", "line 501 of the host's program is one more than the 500 that fit"),
])  # fmt: skip
def test_a_faulty_program_is_refused_whole(operate, host, text, reason):
    session = operate("LOAD", "LIST", "RUN", host=host(text))
    assert session.after("LOAD").startswith(f"? {reason}")
    assert session.after("LIST") == "NO PROGRAM"
    assert session.after("RUN") == "? there is no program; LOAD takes one from the host"
    assert session.status == 2


def test_a_faulty_program_leaves_the_old_one(operate, host):
    operate("LOAD", host=host(PROGRAM))
    later = operate("LOAD", "LIST", host=host("NEW 1 2\n"))
    assert later.after("LOAD").startswith("? the host's program ends without END")
    assert later.after("LIST") == "TI 66H TP AAH SPEED 100"


def test_an_arc_of_the_program_that_is_none_stops_it_before_anything_moves(operate, host):
    session = operate("LOAD", "RUN", host=host("NEW 32510 32500\nCW 32530 32500 32540 32500\nEND\n"))
    assert len(session.refusals) == 1
    assert not session.rig.moving
    assert session.rig.place_um == (32_500.0, 32_500.0)


@pytest.mark.slow
def test_a_whole_job_in_a_pipe(host, piped):
    options = "--resolution", "fast", "--height", "5", "--host", str(host(PROGRAM))
    done = piped(b"HELP\nLOAD\nRUN\nWAIT\nSTATUS\nBYE\n", "console", "1982", *options)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"READY   X 32540 Y 32520 um" in done.stdout
    assert b"\r" not in done.stdout


@pytest.mark.parametrize(("options", "reason"), [
    (["--host", "no-such-file"], "no-such-file: cannot be read; --host takes a file with the host's program"),
    (["--tapes", "no-such"], "no-such: is not a folder; --tapes takes the one in which tapes lie"),
    (["--speed", "0"], "--speed is above 0, in machine seconds per second, not 0"),
    (["--fault", "rust"], "there is no fault 'rust'; there are serial-noise, drop-out"),
    (["--planner", "spline"], "planner"),
    (["--planner", "exact"], "cannot count along with the planner exact"),
    (["--resolution", "coarse"], "unknown resolution 'coarse'"),
])  # fmt: skip
def test_bad_options_are_one_line_and_status_2(options, reason, piped):
    done = piped(b"", "console", "1982", *options)
    out, err = done.text
    assert (done.returncode, out, len(err.splitlines())) == (2, "", 1)
    assert reason in err


@pytest.mark.slow
def test_the_help_lists_the_planners_that_count(edmsim):
    shown = " ".join(edmsim("console", "1982", "--help").out.replace("│", "").split())
    assert "One of: poscal, poscal-literal, dda, sine-table. [default: poscal]" in shown


@pytest.mark.slow
def test_the_same_script_gives_the_same_session_bit_for_bit(machine):
    script = "TI 30 TP 100", "NEW 32600 32500", "START", "WAIT 2", "STATUS", "EM", "INIT", "STATUS"
    first, same, other = (run_script(Rig(machine, seed, resolution="fast"), *script).lines for seed in (7, 7, 8))
    assert first == same != other
