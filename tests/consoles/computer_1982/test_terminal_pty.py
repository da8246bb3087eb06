"""A person at a pseudo-terminal: characters echoed and corrected as they are typed, and the tty always restored."""

import os
import pty
import re
import select
import signal
import subprocess
import sys
import termios
import time

import pytest

TIMEOUT_S = 300.0  # the pulse loop may have to be compiled first


class Operator:
    """Types at a pseudo-terminal and reads what it shows."""

    def __init__(self, *options, term="dumb"):
        self.master, self.slave = pty.openpty()
        self.before = termios.tcgetattr(self.slave)
        command = "from edmsim.cli.app import main; main()"
        self.process = subprocess.Popen(
            [sys.executable, "-c", command, "console", "1982", "--resolution", "fast", "--height", "5", *options],
            stdin=self.slave, stdout=self.slave, stderr=self.slave, start_new_session=True,
            env={**os.environ, "TERM": term, "COLUMNS": "100", "LINES": "40"},
            preexec_fn=lambda: os.close(os.open(os.ttyname(0), os.O_RDWR)),
        )  # fmt: skip
        self.shown = ""

    def type(self, keys):
        os.write(self.master, keys)

    def see(self, text):
        """Wait until a text is shown; return what was shown up to it, and forget that."""
        until = time.monotonic() + TIMEOUT_S
        while text not in self.shown:
            left = until - time.monotonic()
            if left <= 0 or not select.select([self.master], [], [], left)[0]:
                raise AssertionError(f"{text!r} was not shown; shown was {self.shown!r}")
            self.shown += os.read(self.master, 4096).decode("utf-8", "replace")
        before, self.shown = self.shown.split(text, 1)
        return before + text

    def leave(self):
        """Wait for the end, reading on, as an unread screen blocks who writes to it; return the exit status."""
        until = time.monotonic() + TIMEOUT_S
        while self.process.poll() is None:
            assert time.monotonic() < until, f"it did not end; shown was {self.shown!r}"
            if select.select([self.master], [], [], 0.05)[0]:
                self.shown += os.read(self.master, 4096).decode("utf-8", "replace")
        assert termios.tcgetattr(self.slave) == self.before
        return self.process.wait()


@pytest.fixture
def sit_down():
    seats = []

    class Seat(Operator):
        def __init__(self, *options, term="dumb"):
            super().__init__(*options, term=term)
            seats.append(self)

    yield Seat
    for seat in seats:
        seat.process.kill()
        seat.process.wait()
        if seat.master is not None:
            os.close(seat.master)
        os.close(seat.slave)


# T-53, T-A10: echo and the four correction characters, at the keyboard
@pytest.mark.slow
def test_a_person_types_corrects_jogs_ends_a_wait_and_leaves(sit_down):
    operator = sit_down("--speed", "50")
    operator.see("> ")
    assert termios.tcgetattr(operator.slave) != operator.before
    operator.type(b"PO\x08OSS\x7f\r")
    shown = operator.see(" um\r\n")
    assert "\b \b" in shown
    assert shown.endswith("POSITION X 32500 Y 32500 um\r\n")
    operator.type(b"garbage\x18x 20\x12\r")
    assert "X 20" not in operator.see("READY   X 32520 Y 32500 um")
    operator.type(b"foo\r")
    operator.see("? FOO is not a word of this machine; HELP shows them")
    operator.type(b"X 30000\rWAIT\r")
    operator.see("WAITING")
    operator.type(b"\x18STOP\r")  # Ctrl-X ends the wait
    operator.see("STOPPED")
    operator.type(b"\x04")  # Ctrl-D on an empty line leaves
    assert operator.leave() == 0  # a person's typing errors are part of the work


@pytest.mark.slow
def test_ctrl_c_is_the_emergency_stop_and_nothing_moves_until_init(sit_down):
    operator = sit_down("--speed", "1")
    operator.see("> ")
    operator.type(b"X 1000\r")
    operator.see("\n> ")
    operator.type(b"\x03")
    operator.see("EMERGENCY: STOP BY THE OPERATOR; NOTHING MOVES UNTIL INIT")
    operator.type(b"X 20\r")
    operator.see("only INIT helps")
    operator.type(b"POS\r")
    stopped_at = operator.see(" um\r\n> ")
    operator.type(b"INIT\rPOS\r")
    assert re.findall(r"POSITION X \d+ Y \d+", operator.see(" um\r\n> ")) == re.findall(
        r"POSITION X \d+ Y \d+", stopped_at
    )
    operator.type(b"X 20\rWAIT\r")
    operator.see("READY")
    operator.process.send_signal(signal.SIGTERM)  # ended from outside, the tty is restored as well
    assert operator.leave() == 128 + signal.SIGTERM


@pytest.mark.slow
def test_a_real_terminal_shows_digits_and_pulses(sit_down):
    operator = sit_down("--speed", "20", term="xterm")
    operator.see("STAND-BY")
    operator.type(b"TI 30 TP 100\rNEW 32700 32500\rSTART\r")
    shown = operator.see("CUTTING")
    shown += operator.see("READY")
    assert "short" in shown
    assert "erosion" in shown
    operator.type(b"\x0b")  # T-28: Ctrl-K gives the keyboard to the front panel, whose arrows jog
    operator.see("Ctrl-K ends")
    operator.type(b"20\x1b[D")
    operator.see("READY   X 32680 Y 32500 um")
    operator.type(b"\x0b")
    os.close(operator.master)  # the window is closed: there is nothing to draw on, and nothing to restore
    operator.master = None
    assert operator.process.wait(TIMEOUT_S) == 128 + signal.SIGHUP


@pytest.mark.slow
def test_ctrl_c_in_a_pipe_stops_the_machine_and_the_script():
    command = [sys.executable, "-m", "edmsim", "console", "1982", "--resolution", "fast"]
    pipe = subprocess.PIPE
    with subprocess.Popen([*command, "--speed", "1"], stdin=pipe, stdout=pipe, text=True) as run:
        assert run.stdin is not None
        assert run.stdout is not None
        run.stdin.write("X 1000\nSTATUS\n")
        run.stdin.flush()
        while not run.stdout.readline().startswith("JOGGING"):
            assert run.poll() is None
        run.send_signal(signal.SIGINT)
        while not (line := run.stdout.readline()).startswith("EMERGENCY"):
            assert run.poll() is None
        assert line.startswith("EMERGENCY: STOP BY THE OPERATOR; NOTHING MOVES UNTIL INIT")
        run.stdin.close()
        assert run.wait(TIMEOUT_S) == 3
