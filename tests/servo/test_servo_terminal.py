"""``edmsim servo``: scripts in a pipe, an ordinary terminal program on a pseudo-terminal, keys, scope, refusals."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from edmsim.errors import InputError
from edmsim.servo.command import bench_for
from edmsim.servo.keys import sent_for
from edmsim.servo.scope import Scope
from edmsim.servo.session import run_script

COMMAND = [sys.executable, "-m", "edmsim", "servo"]


def piped(script: bytes, *arguments: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([*COMMAND, *arguments], input=script, capture_output=True, check=False)


def test_a_script_gets_the_drive_s_bytes_as_they_are():
    told = piped(b"R\nP\n\nP600\n", "uhu")
    assert told.returncode == 0
    assert told.stdout == (
        b"UHU Servo Controller 3.00 (c) Snr: 134\r\nEEPROM: Error!\r\nHelp by (?)\r\n>R\r\nOK\r\n>P\r\n"
        b"(P)rop.      1000: \r\n>P600\r\nOK\r\n>"
    )


def test_the_module_does_not_echo():
    told = piped(b"P1234\nGV\n", "servo-module", "--axis", "table", "--tuned")
    assert told.stdout.endswith(b"(P) - Kp: 1234\r\nVelocity: 0\r\n")
    assert b"P1234\r" not in told.stdout


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["servo"], "choose one of uhu, servo-module"),
        (["uhu", "--axis", "z"], "there is no axis 'z'"),
        (["uhu", "--axis", "fast", "--tuned"], "no UHU is tuned"),
        (["uhu", "--axis", "z", "--autotune"], "there is no axis 'z'"),
        (["steam", "--autotune"], "choose one of uhu, servo-module"),
        (["uhu", "--autotune", "--out", "/dev/null/before.png"], "/dev/null"),
        (["uhu", "--speed", "0"], "--speed is above 0"),
    ],
)
def test_what_cannot_be_is_told_in_a_line(arguments, reason):
    told = piped(b"", *arguments)
    assert told.returncode == 2
    assert reason in told.stderr.decode()
    assert len(told.stderr.decode().strip().splitlines()) == 1


def answer_of(port: int, wanted: bytes) -> bytes:
    heard, until = b"", time.monotonic() + 60.0
    while wanted not in heard and time.monotonic() < until:
        if select.select([port], [], [], 1.0)[0]:
            heard += os.read(port, 4096)
    return heard


@contextmanager
def pseudo_terminal(*arguments: str) -> Iterator[str]:
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


def test_a_pseudo_terminal_is_raw_and_outlasts_the_program_that_opened_it():
    with pseudo_terminal("uhu") as name:
        for _ in range(2):
            port = os.open(name, os.O_RDWR | os.O_NOCTTY)
            os.write(port, b"P700\r")
            assert b"P700\r\nOK\r\n>" in answer_of(port, b"OK\r\n>")
            os.close(port)


def test_pyserial_talks_to_both_drives():
    serial = pytest.importorskip("serial")
    for drive, baud, wanted in (("uhu", 38400, b"P\r\n(P)rop.      1000: "), ("servo-module", 57600, b"(P) - Kp: ")):
        with pseudo_terminal(drive) as name, serial.Serial(name, baud, timeout=30) as port:
            port.write(b"P\r")
            assert wanted in port.read_until(wanted)


def test_the_space_bar_switches_the_analyser_and_escape_leaves():  # U-37
    assert sent_for(b" ", True, False) == (b"A\r", True, False)
    assert sent_for(b" ", True, True) == (b"Z\r", False, False)
    assert sent_for(b"\x1b", True, False) == (b"", False, True)
    assert sent_for(b"p9\n", True, False) == (b"p9\r", False, False)


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


def test_the_scope_writes_the_tracking_error_stream(tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]):
    from rerun.chunk import RrdReader

    file = tmp_path / "scope.rrd"
    scope = Scope(False, file)
    bench = bench_for("uhu", "bench", True)
    bench.trace = True
    run_script(bench, b"A\nG60\n", scope)
    scope.close()
    streamed = [byte - 128 - 63 for byte in capfdbinary.readouterr().out if byte >= 128]
    assert max(streamed) > 40
    drawn: list[float] = []
    for chunk in RrdReader(str(file)).stream().to_chunks():
        if chunk.entity_path == "/tracking_error":
            batch = chunk.to_record_batch()
            drawn += [value for row in batch.column("Scalars:scalars").to_pylist() for value in row]
    assert drawn == streamed


def test_a_scope_s_file_that_cannot_be_written_is_told(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError):
        Scope(False, tmp_path / "file" / "scope.rrd")
