"""``edmsim console servo``: scripts in a pipe, a terminal program on a pseudo-terminal, keys, refusals, the scope."""

import os
import select
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import pytest

import edmsim
from edmsim.consoles.scope import Scope
from edmsim.consoles.servo import bench_for, curves_of, run_script, sent_for, serve
from edmsim.errors import InputError
from edmsim.recording.rerun import viewer

from ..conftest import recorded_curve

COMMAND = [sys.executable, "-m", "edmsim", "console", "servo"]


def test_a_script_gets_the_drive_s_bytes_as_they_are(piped):
    done = piped(b"R\nP\n\nP600\n", "console", "servo", "uhu")
    assert done.returncode == 0
    assert done.stdout == (
        b"UHU Servo Controller 3.00 (c) Snr: 134\r\nEEPROM: Error!\r\nHelp by (?)\r\n>R\r\nOK\r\n>P\r\n"
        b"(P)rop.      1000: \r\n>P600\r\nOK\r\n>"
    )


def test_the_module_does_not_echo(piped):
    done = piped(b"P1234\nGV\n", "console", "servo", "servo-module", "--axis", "table", "--tuned")
    assert done.stdout.endswith(b"(P) - Kp: 1234\r\nVelocity: 0\r\n")
    assert b"P1234\r" not in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["uhu", "servo-module"])
def test_garbage_from_a_pipe_and_an_overlong_line_are_answered_and_nothing_moves(drive, piped):
    done = piped(bytes(range(1, 256)) + b"\n" + b"P" * 5000 + b"\n", "console", "servo", drive)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.count(b"?\r\n") >= 2


@pytest.mark.slow
def test_a_closed_input_is_an_empty_script_and_a_reader_that_leaves_ends_it_quietly(piped, monkeypatch):
    monkeypatch.setattr(sys, "stdin", None)
    assert piped(b"", "console", "servo", "uhu").stdout.endswith(b"Help by (?)\r\n>")
    closed = subprocess.run(["sh", "-c", '"$0" "$@" <&- >&-', *COMMAND, "uhu"], stderr=subprocess.PIPE, check=False)
    assert (closed.returncode, closed.stderr) == (0, b"")
    script = '{ yes "#" | head -500; } | "$0" "$@" | head -c 5'
    left = subprocess.run(["sh", "-c", script, *COMMAND, "uhu"], capture_output=True, check=False)
    assert (left.stdout, left.stderr) == (b"UHU S", b"")


@pytest.mark.slow
@pytest.mark.parametrize("script", [b"Z24\n", b"L4\nZ157\nGE\n"])
def test_a_script_waits_for_all_records_of_the_module(script, piped):  # M-30, M-31
    lines = piped(script, "console", "servo", "servo-module").stdout.split(b"\r\n")
    first = lines.index(b"Recorder ON") + 1
    assert all(line.lstrip(b"-").isdigit() for line in lines[first : first + 128])
    assert lines[first + 128 :] == ([b"Error: 0", b""] if b"GE" in script else [b""])


def test_records_that_wait_for_their_trigger_end_no_script_late(piped):  # M-30
    lines = piped(b"Z0\n", "console", "servo", "servo-module").stdout.split(b"\r\n")
    assert lines[-2:] == [b"Recorder ON", b""]


@pytest.mark.parametrize(("wait", "counts"), [("WAIT", 400), (" wait 1.5 ", 400), ("WAIT 0", None)])
def test_a_script_waits_until_the_axis_rests_or_for_a_time(wait, counts, piped):
    done = piped(f"X10\nG400\n{wait}\nCOUNTER\n".encode(), "console", "servo", "uhu", "--axis", "y", "--tuned")
    assert "WAIT" not in done.text[0].upper()
    counted = int(done.text[0].split("(C)ounter")[1].split()[0])
    assert counted == pytest.approx(counts, abs=2) if counts else counted < 100


def test_a_wait_lasts_its_time_and_not_longer_than_a_minute():
    bench = bench_for("uhu", "table", False)
    run_script(bench, b"WAIT 2.5\n", None, print)
    assert bench.time_s == pytest.approx(2.7, abs=0.01)  # with the start-up and the end
    with pytest.raises(InputError, match=r"^the axis does not come to rest in 60 s; WAIT s waits s seconds$"):
        run_script(bench, b"R\nG10\nWAIT\n", None, print)  # as delivered it oscillates there


@pytest.mark.parametrize("text", ["x", "-1", "61", "nan", "inf", "1 2"])
def test_a_wait_of_another_kind_is_refused_before_the_script_begins(text, piped):
    done = piped(f"R\nWAIT {text}\n".encode(), "console", "servo", "uhu")
    assert (done.returncode, done.text[0]) == (2, "")
    assert done.text[1].startswith("edmsim: WAIT s waits s seconds, 0 to 60, and WAIT until the axis rests; ")


@pytest.mark.parametrize(
    ("drive", "script", "why"),
    [
        ("uhu", b"G400\nG900\n", "its following error reached the limit E of 500 counts"),
        ("servo-module", b"+50\n+500\n", "its following error passed the limit E of 100 counts"),
    ],
)
def test_a_drive_that_trips_prints_nothing_and_is_reported_in_a_line(drive, script, why, piped):
    done = piped(script, "console", "servo", drive, "--axis", "table", "--tuned")
    assert done.text[1] == f"edmsim: the drive has shut off its motor: {why}; R switches it on\n"
    assert b"shut" not in done.stdout


@pytest.mark.parametrize(("drive", "script"), [("uhu", b"P\n\n"), ("servo-module", b"Q\n")])
def test_a_motor_that_is_off_without_a_trip_is_not_reported(drive, script, piped):
    assert piped(script, "console", "servo", drive).text[1] == ""


@pytest.mark.slow
def test_with_a_speed_a_pipe_is_live():
    words = [*COMMAND, "uhu", "--axis", "table", "--tuned", "--speed", "10"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as program:
        assert program.stdin is not None
        assert program.stdout is not None
        answer_of(program.stdout.fileno(), b"Help by (?)\r\n>")
        program.stdin.write(b"G200\n")
        program.stdin.flush()
        answer_of(program.stdout.fileno(), b"OK\r\n>")
        time.sleep(0.3)  # 3 s of the axis
        program.stdin.write(b"COUNTER\n")
        program.stdin.close()
        counted = program.stdout.read().split(b"(C)ounter")[1]
    assert program.returncode == 0
    assert int(counted.split()[0]) == pytest.approx(200, abs=2)


@pytest.mark.slow
def test_ctrl_c_ends_a_script_whose_pipe_stays_open():
    bench, before, (reading, writing) = bench_for("uhu", "bench", False), os.dup(0), os.pipe()
    os.dup2(reading, 0)
    interrupt = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    try:
        interrupt.start()
        with pytest.raises(KeyboardInterrupt):
            serve(bench, pty=False, speed=None, scope=None, say=print)
    finally:
        interrupt.join()
        os.dup2(before, 0)
        for end in (before, reading, writing):
            os.close(end)


@pytest.mark.slow
@pytest.mark.parametrize("axis", ["x", "y"])
def test_the_machine_s_own_axis_has_its_screw_its_mass_and_the_ends_of_its_travel(axis):
    table = edmsim.Machine.load().base.table
    bench = bench_for("uhu", axis, True)
    bench.run(0.1)
    assert bench.motor()["table_kg"] == pytest.approx({"x": 45.3, "y": 20.0}[axis])
    middle_um = 500.0 * table.travel_mm.value
    assert bench.axis()["place_um"] == pytest.approx(middle_um, abs=1.0)
    assert bench.talk(b"G100\r").endswith(b"OK\r\n>")
    bench.run(1.0)
    assert bench.axis()["place_um"] == pytest.approx(middle_um + 20.0, abs=1.0)  # 500 lines, 0.4 mm a turn
    bench.steps(axis, 15_000, 2_500.0, 10_000.0)  # 2 um each
    bench.run(7.0)
    assert bench.pins().enabled
    bench.steps(axis, 2_000, 2_500.0, 10_000.0)  # 1.5 mm beyond the travel
    bench.run(2.0)
    assert not bench.pins().enabled  # it met the end, tripped, and springs back
    assert bench.axis()["place_um"] < 1e3 * table.travel_mm.value + 1_000.0


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["console", "servo", "servo"], "choose one of uhu, servo-module"),
        (["console", "servo", "uhu", "--axis", "z"], "there is no axis 'z'"),
        (["console", "servo", "uhu", "--axis", "fast", "--tuned"], "no UHU is tuned"),
        (["console", "servo", "uhu", "--speed", "0"], "--speed is above 0"),
        (["tune", "drive", "uhu", "--axis", "analogue"], "no axis 'analogue' for this drive; choose one of x, y"),
        (["tune", "drive", "uhu", "--out", "/dev/null/before.png"], "/dev/null"),
    ],
)
def test_options_that_cannot_be_are_refused_in_a_line(arguments, reason, piped):
    done = piped(b"", *arguments)
    out, err = done.text
    assert (done.returncode, out, err.count("\n")) == (2, "", 1)
    assert reason in err


def answer_of(port, expected):
    heard, until = b"", time.monotonic() + 60.0
    while expected not in heard and time.monotonic() < until:
        if select.select([port], [], [], 1.0)[0]:
            heard += os.read(port, 4096)
    return heard


@contextmanager
def pseudo_terminal(*arguments):
    """Run the command, yield the port's name, and end it by Ctrl-C."""
    words = [*COMMAND, *arguments, "--pty", "--speed", "10"]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as program:
        assert program.stderr is not None
        line = program.stderr.readline()
        try:
            yield line.split("serial port is ")[1].split(";")[0]
        finally:
            program.send_signal(signal.SIGINT)
    assert program.returncode == 0


@pytest.mark.slow
def test_a_pseudo_terminal_is_raw_and_outlasts_the_program_that_opened_it():
    with pseudo_terminal("uhu") as name:
        port = os.open(name, os.O_RDWR | os.O_NOCTTY)
        os.write(port, b"P700\r")
        assert b"P700\r\nOK\r\n>" in answer_of(port, b"OK\r\n>")
        os.close(port)
        serial = pytest.importorskip("serial")
        with serial.Serial(name, 38400, timeout=30) as line:
            line.write(b"P\r")
            assert line.read_until(b"700: ").endswith(b"P\r\n(P)rop.      700: ")


def test_the_space_bar_switches_the_analyser_and_escape_leaves():  # U-37
    assert sent_for(b" ", True, True) == (b"Z\r", False, False)
    assert sent_for(b"\x1b", True, False) == (b"", False, True)
    assert sent_for(b"p9\n", True, False) == (b"p9\r", False, False)
    held = b"\x1b[C\x1b[C\x1b[1;5D"  # keys come faster than they are read
    assert sent_for(held + b"p9\n", True, False) == (b"G32\rG32\rG-64\rp9\r", False, False)


@pytest.mark.parametrize(("keys", "counts"), [(b"\x1b[C", 32), (b"\x1b[D", -32), (b"\x1b[1;5C", 64)])
def test_cursor_keys_move_the_axis(keys, counts):  # U-60
    bench = bench_for("uhu", "bench", True)
    bench.run(0.1)
    bench.talk(sent_for(keys, True, False)[0])
    bench.run(0.5)
    assert bench.axis()["count"] == pytest.approx(counts, abs=1)
    module = bench_for("servo-module", "table", True)
    module.run(0.1)
    assert module.talk(sent_for(keys, False, False)[0]) == b"Move %+d\r\n" % counts


# The scope of ``edmsim console servo``: what it draws and keeps, and its viewer with a screen and without one.

LISTENS = (
    "import socket, sys, time; s = socket.create_server((sys.argv[2], int(sys.argv[sys.argv.index('--port') + 1])));"
    "time.sleep(60)"
)


def test_the_scope_writes_the_tracking_error_stream(tmp_path, capfdbinary):  # U-34
    file = tmp_path / "scope.rrd"
    bench = bench_for("uhu", "bench", True)
    scope = Scope(False, file, curves_of(bench))
    run_script(bench, b"A\nG60\n", scope, print)
    scope.close()
    streamed = [byte - 128 - 63 for byte in capfdbinary.readouterr().out if byte >= 128]
    assert max(streamed) > 40
    assert recorded_curve(file, "tracking_error") == streamed
    samples = bench.time_s / 533.3e-6
    assert len(recorded_curve(file, "duty")) == pytest.approx(samples, abs=3)


def test_a_recording_takes_little_room(tmp_path):
    bench = bench_for("servo-module", "table", True)
    scope = Scope(False, tmp_path / "scope.rrd", curves_of(bench))
    run_script(bench, b"WAIT 3", scope, print)
    scope.close()
    assert len(recorded_curve(tmp_path / "scope.rrd", "place_um")) > 4_000
    assert (tmp_path / "scope.rrd").stat().st_size < 600_000


def test_a_scope_s_file_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError):
        Scope(False, tmp_path / "file" / "scope.rrd", {})
    with pytest.raises(InputError, match=r"a recording of the scope is written as \.rrd"):
        Scope(False, tmp_path, {})
    (tmp_path / "folder.rrd").mkdir()
    with pytest.raises(InputError, match="is a folder; a recording of the scope is a file"):
        Scope(False, tmp_path / "folder.rrd", {})


@pytest.mark.slow
def test_without_a_screen_the_scope_is_a_page_and_the_drive_runs(piped, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    done = piped(b"G60\n", "console", "servo", "uhu", "--tuned", "--scope")
    assert done.returncode == 0
    assert done.stdout.endswith(b"OK\r\n>")
    (line,) = done.text[1].splitlines()
    assert "no screen here: open http://127.0.0.1:" in line


@pytest.mark.parametrize("screen", [True, False])
def test_a_window_is_left_to_its_user_and_a_page_ends_with_the_drive(screen, monkeypatch):
    monkeypatch.setattr(viewer, "RERUN", (sys.executable, "-c", LISTENS))
    monkeypatch.setattr(viewer, "has_screen", lambda environment, platform: screen)
    live = viewer.LiveViewer("the scope", "wait")
    live.close()
    process = live._process
    if screen:
        assert process.poll() is None
        os.killpg(process.pid, signal.SIGTERM)
    assert process.wait(timeout=10) == -signal.SIGTERM


def test_a_viewer_that_does_not_start_is_reported_in_a_line(monkeypatch):
    monkeypatch.setattr(viewer, "RERUN", (sys.executable, "-c", "raise SystemExit(1)"))
    with pytest.raises(InputError, match="viewer did not start, so there is no scope; --record"):
        Scope(True, None, {})
