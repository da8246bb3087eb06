"""``edmsim gap --serial``: the boards' dialogues by pyserial, and what the other side may do wrong."""

import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.errors import InputError
from edmsim.hil import Rig
from edmsim.hil.boards import MOST_LINE
from edmsim.hil.session import HALF_LINE_S, TOO_LONG, Lines, Session

serial = pytest.importorskip("serial")
WAIT_S = 20.0
"""A busy machine takes its time; no test waits so long where all is well."""


@contextmanager
def running(board, speed=1.0):
    """A bench under way, with both of its ports open."""
    session = Session(Rig(board, seed=1), speed)
    ended = threading.Event()
    thread = threading.Thread(target=session.run, args=(None, ended.is_set, lambda line: None))
    try:
        with (
            serial.Serial(session.board.terminal.name, 115_200, timeout=WAIT_S) as line,
            serial.Serial(session.motion.terminal.name, 115_200, timeout=WAIT_S) as axes,
        ):
            thread.start()
            yield session, line, axes
    finally:
        ended.set()
        thread.join(WAIT_S)
        session.close()
    assert not thread.is_alive()


def ask(port, line, end=b"\n"):
    port.write(line + end)
    return port.readline()


@pytest.mark.slow
def test_a_host_tunes_a_powercore_and_moves_the_axes():
    with running("powercore") as (_, line, axes):
        assert line.readline() == b"Setup complete\r\n"
        line.write(b"SET_ALL_PARAMETERS 0 0.05 5000 100\n")
        assert line.read_until(b"OK: Parameters set\r\n").endswith(b"OK: Parameters set\r\n")  # it may tell more
        assert ask(axes, b"POS 10 0", b"\r\n") == b"ok\r\n"
        line.write(b"SEND_TELEMETRY\n")
        said = line.read_until(b"-" * 32 + b"\r\n")
        assert b"Machining Frequency:5000 Hz\r\nInitiation Voltage:100 V\r\n" in said
        until = time.monotonic() + WAIT_S
        while b" X 10.0 " not in (status := ask(axes, b"?")):
            assert time.monotonic() < until, status
        assert b" FEEDBACK " in status


@pytest.mark.slow
def test_a_host_polls_a_pulser():
    with running("spark") as (_, line, axes):
        assert ask(line, b"w 1 1") == b"ok\r\n"
        assert ask(axes, b"STREAM 50") == b"ok\r\n"
        times = [float(axes.readline().split()[1]) for _ in range(3)]
        assert times == sorted(times)
        said = ask(line, b"r 0x10 6").split()
        assert said[0] == b"0x10:"
        assert len(said) == 7


@pytest.mark.slow
def test_half_a_line_is_taken_after_a_second_and_one_without_an_end_is_too_long():
    with running("spark") as (_, line, _):
        began = time.monotonic()
        line.write(b"r 4")
        assert line.readline() == b"0x04: 50\r\n"
        assert time.monotonic() - began > 0.9 * HALF_LINE_S
        assert ask(line, b"r" * 5000) == TOO_LONG.encode()
        assert ask(line, b"r 4") == b"0x04: 50\r\n"


@pytest.mark.slow
def test_a_flood_holds_nobody_up_and_every_line_of_it_is_answered():
    with running("spark") as (session, line, axes):
        sender = threading.Thread(target=line.write, args=(b"r 1 5\n" * 3000,))
        sender.start()
        before_s = session.rig.time_s
        answers = [line.readline() for _ in range(3000)]
        sender.join(WAIT_S)
        assert set(answers) == {b"0x01: 0 10 25 50 25\r\n"}
        assert ask(axes, b"?").startswith(b"T ")
        assert session.rig.time_s > before_s


@pytest.mark.slow
def test_who_reads_nothing_and_who_leaves_holds_nobody_up():
    with running("powercore", 100.0) as (session, line, axes):
        axes.write(b"STREAM 1000\nVEL 5 0\n")
        line.write(b"SEND_TELEMETRY\n" * 200)
        until, from_s = time.monotonic() + WAIT_S, session.rig.time_s
        while session.rig.time_s < from_s + 3.0:
            assert time.monotonic() < until
            time.sleep(0.01)
        place = session.rig.gap.place_um
        line.close()
        axes.close()
        from_s = session.rig.time_s
        while session.rig.time_s < from_s + 1.0:
            assert time.monotonic() < until
            time.sleep(0.01)
        assert session.rig.gap.place_um == place  # a velocity does not outlast who sends it
        with serial.Serial(session.motion.terminal.name, timeout=WAIT_S) as again:
            again.reset_input_buffer()
            again.write(b"STREAM 0\n")
            assert b"ok\r\n" in again.read_until(b"ok\r\n")


@pytest.mark.slow
def test_a_board_that_skips_pulses_is_deaf_until_it_has_waited():
    session = Session(Rig("powercore", seed=1))
    try:
        with serial.Serial(session.board.terminal.name, timeout=WAIT_S) as line:
            session.rig.send("RESET_DEVICE")
            line.write(b"SEND_TELEMETRY\n")
            session.run(0.5, lambda: False, lambda text: None)
            assert b"STATE" not in line.read(line.in_waiting)
            session.rig.run(2.0)
            session.run(0.05, lambda: False, lambda text: None)
            assert b"FIRMWARE_VERSION" in line.read_until(b"STATE")
    finally:
        session.close()


def test_a_speed_of_none_is_refused():
    with pytest.raises(InputError, match="--speed is above 0"):
        Session(Rig("spark"), 0.0)


@given(st.lists(st.binary(max_size=300), max_size=8))
def test_bytes_in_any_portions_make_the_same_lines(portions):
    apart, whole = Lines(), Lines()
    for portion in portions:
        apart.put(portion, 0.0)
    whole.put(b"".join(portions), 0.0)
    assert apart.ready == whole.ready
    assert all(line is None or 0 < len(line) <= MOST_LINE for line in whole.ready)
    sent = [part for part in b"".join(portions).replace(b"\r", b"\n").split(b"\n")[:-1] if part]
    assert len(whole.ready) == len(sent)


@pytest.mark.slow
def test_the_command_says_its_ports_and_ctrl_c_ends_it():
    command = [sys.executable, "-m", "edmsim", "gap", "--serial", "powercore"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as bench:
        assert bench.stderr is not None
        board, axes = (bench.stderr.readline() for _ in range(2))
        name = board.split()[-1]
        assert axes.startswith("edmsim: the axes' port is ")
        with serial.Serial(name, timeout=WAIT_S) as line:
            assert line.readline() == b"Setup complete\r\n"
            bench.send_signal(signal.SIGINT)
            assert bench.wait(WAIT_S) == 0
