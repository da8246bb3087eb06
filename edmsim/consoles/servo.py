"""``edmsim console servo``: a drive on a bench, used by a person, a script or a program."""

import math
import re
import sys
import time
from collections.abc import Callable
from typing import cast

import numpy as np

from edmsim.axis_bench import AxisBench
from edmsim.compiled.axis_rows import FAULT
from edmsim.consoles.devices import Interrupts, Keyboard, Pipe, PseudoTerminal, is_terminal, put
from edmsim.consoles.scope import Scope
from edmsim.controllers.axis import CHIPS
from edmsim.controllers.axis import tuned as tuned_drive
from edmsim.controllers.axis.drive import axis_names, axis_row, data_of
from edmsim.controllers.axis.servo_module import ServoModule
from edmsim.controllers.axis.uhu import Uhu
from edmsim.errors import InputError, one_of

_CURVES = "duty", "current_A", "place_um", "speed_rad_s"  # columns of the bench's samples
_TRACKING = "tracking_error"  # of a UHU, as its analyser sends it


def curves_of(bench: AxisBench) -> dict[str, str]:
    """Return the curves of a bench's drive for a scope, with their titles."""
    streamed = {_TRACKING: "tracking error, counts"} if isinstance(bench.drive(), Uhu) else {}
    return streamed | {name: name.replace("_", " ") for name in _CURVES}


_MACHINE_AXES = ("x", "y")
_MACHINE_MOTOR = "table"  # motor on the screws of the machine's own axes, as with ``edmsim cut --drive``


def bench_for(name: str, axis: str, tuned: bool) -> AxisBench:
    """Return a bench with a drive, as delivered or tuned, on a motor's own axis or on the machine's.

    The axes ``x`` and ``y`` are those of the DEM-15, moved by MuJoCo with its screw, mass and travel, from its
    middle.
    """
    if name not in CHIPS:
        raise InputError(f"there is no drive {name!r} with a serial line; choose one of {one_of(name, CHIPS)}")
    machine_axis = axis in _MACHINE_AXES
    axes = (*_MACHINE_AXES, *axis_names(amplifier=False))
    if axis not in axes:
        raise InputError(f"there is no axis {axis!r} for this drive; choose one of {one_of(axis, axes)}")
    motor = _MACHINE_MOTOR if machine_axis else axis
    drive = tuned_drive(name, motor) if tuned else CHIPS[name](axis_row(motor))
    return AxisBench({axis: drive}, mechanics="mujoco") if machine_axis else AxisBench({"x": drive})


# A drive at a terminal: the bench runs at a multiple of real time, and bytes take as long as on a wire. Keys follow
# the UHU's terminal program (rows U-37 and U-60): the space bar for the analyser, cursors for moves, ESC to leave.
# Other keys are sent to the drive.

LEAVE = b"\x1b"  # ESC ends the program if no more characters follow
_MOVES = {
    b"\x1b[C": 32, b"\x1b[A": 32, b"\x1b[D": -32, b"\x1b[B": -32,
    b"\x1b[1;5C": 64, b"\x1b[1;5A": 64, b"\x1b[1;5D": -64, b"\x1b[1;5B": -64,
}  # fmt: skip
"""Counts of the cursor keys, and of those with Ctrl, as terminals send them: right and up are positive."""
_CURSOR = re.compile(b"(" + b"|".join(map(re.escape, _MOVES)) + b")")


def sent_for(keys: bytes, streams: bool, analysing: bool) -> tuple[bytes, bool, bool]:
    r"""Return the bytes that keys send to a drive, whether its analyser is then on, and whether ESC was pressed.

    A drive that `streams` has an analyser (``A`` and ``Z``) and moves by ``G``, as the UHU; the servo module moves by
    ``+`` and ``-``.

    >>> sent_for(b" ", True, False)
    (b'A\r', True, False)
    >>> sent_for(b"\x1b[1;5D", False, False)
    (b'-64\r', False, False)
    """
    sent, leaves = b"", False
    for pressed in filter(None, _CURSOR.split(keys)):  # a cursor key, or the keys between two of them
        leaves = pressed == LEAVE
        if pressed in _MOVES:
            sent += (b"G%d\r" if streams else b"%+d\r") % _MOVES[pressed]
        elif pressed == b" " and streams:
            sent += b"Z\r" if analysing else b"A\r"
            analysing = not analysing
        elif not leaves:
            sent += pressed.replace(b"\n", b"\r")
    return sent, analysing, leaves


FRAME_S = 0.01  # simulated time between two reads of the terminal (ours): a person does not notice it
_START_S, _LAST_S = 0.1, 0.1  # time for the start-up text, and for the answer to a script's last line (ours)
_REST_S, _LONGEST_WAIT_S = 0.1, 60.0  # time without motion after which an axis rests, and longest WAIT (ours)
_STDIN = 0
STREAM = 0x80  # bytes from here on are the analyser's (row U-35)


def serve(
    bench: AxisBench, *, pty: bool, speed: float | None, scope: Scope | None, say: Callable[[str], None]
) -> None:
    """Connect the drive on x to a person's terminal, a pipe with a speed, a pseudo-terminal, or run a script."""
    if speed is not None and not speed > 0:
        raise InputError(f"--speed is above 0, in simulated seconds per second, not {speed:g}")
    interrupts = Interrupts() if pty or is_terminal() else Interrupts(patience=0)
    passing = _Passing(bench, scope, say)
    with interrupts.caught():
        if pty:
            port = PseudoTerminal()
            say(f"the drive's serial port is {port.name}; Ctrl-C ends it")
            try:
                _run(passing, port, interrupts, speed or 1.0)
            finally:
                port.close()
        elif is_terminal():
            keyboard = _DriveKeyboard(bench, interrupts)
            say("ESC leaves")
            with keyboard.in_character_mode():
                _run(passing, keyboard, interrupts, speed or 1.0)
        elif speed is not None:
            _run(passing, _DrivePipe(interrupts), interrupts, speed)
            passing.end()
        else:
            script = b""
            if sys.stdin is not None:  # None if closed
                with open(_STDIN, "rb", closefd=False) as opened:
                    script = opened.read()
            run_script(bench, script, scope, say)


class _Passing:
    """Run the bench frame by frame: bytes go to the scope, and the reason of a shutdown to `say`."""

    def __init__(self, bench: AxisBench, scope: Scope | None, say: Callable[[str], None]) -> None:
        self.bench, self._scope, self._say = bench, scope, say
        bench.trace = scope is not None
        self._zero = STREAM + int(data_of("uhu")["law"]["stream_zero"])
        self._tripped = True  # a UHU as delivered waits for R, and prints this itself

    def frame(self) -> bytes:
        """Run a frame and return the drive's bytes; report a trip, because the drive prints nothing then."""
        self.bench.run(FRAME_S)
        drive, before = cast(Uhu | ServoModule, self.bench.drive()), self._tripped
        self._tripped = bool(drive.record["lines"][0] & FAULT)
        if self._tripped and not before and (why := drive.why_stopped()):
            self._say(f"the drive has shut off its motor: {why}; R switches it on")
        if self._scope is None:
            return self.bench.received()
        heard, samples = self.bench.received_at(), self.bench.samples()
        streamed = np.array([(at_s, byte - self._zero) for byte, at_s in heard if byte >= STREAM]).reshape(-1, 2)
        self._scope.draw(_TRACKING, *streamed.T)
        for name in _CURVES:
            self._scope.draw(name, samples["time_ns"] * 1e-9, samples[name])
        return bytes(value for value, _ in heard)

    def pause(self, seconds: float) -> None:
        """Run the bench for some time, and print the drive's bytes."""
        until_s = self.bench.time_s + seconds
        while self.bench.time_s < until_s:
            put(self.frame())

    def wait(self, seconds: float) -> None:
        """Run the bench for some time or, for infinity, until the axis rests."""
        if seconds < math.inf:
            self.pause(seconds)
            return
        until_s, count, rested = self.bench.time_s + _LONGEST_WAIT_S, None, 0
        while rested * FRAME_S < _REST_S:
            if self.bench.time_s >= until_s:
                raise InputError(f"the axis does not come to rest in {_LONGEST_WAIT_S:g} s; WAIT s waits s seconds")
            put(self.frame())
            before, count = count, int(self.bench.axis()["count"])
            rested = rested + 1 if count == before else 0

    def end(self) -> None:
        """Run until the drive has read all bytes on the line and answered."""
        while self.bench.sending():
            put(self.frame())
        self.pause(_LAST_S)


def _run(passing: _Passing, device: Pipe | PseudoTerminal, interrupts: Interrupts, speed: float) -> None:
    bench = passing.bench
    device.write(passing.frame())  # loads compiled code, which takes longer than a frame
    began, from_s = time.monotonic(), bench.time_s
    while not interrupts.pending and not device.at_end:
        due = began + (bench.time_s - from_s) / speed
        bench.send(device.read(max(due - time.monotonic(), 0.0)))
        device.write(passing.frame())


def run_script(bench: AxisBench, script: bytes, scope: Scope | None, say: Callable[[str], None]) -> None:
    """Send a script line by line, each after the answer to the line before, and print all bytes of the drive.

    The answer to a servo module's Z is its recording; one with a trigger waits for a line that moves the axis.
    """
    lines = [(line, waiting_s(line)) for line in script.splitlines()]
    drive, passing = bench.drive(), _Passing(bench, scope, say)
    passing.pause(_START_S)
    for line, seconds in lines:
        if seconds is not None:
            passing.wait(seconds)
            continue
        bench.send(line + b"\r")
        quiet = 0
        while quiet < 3:
            heard = passing.frame()
            put(heard)
            busy = bench.sending() or (isinstance(drive, ServoModule) and drive.recording)
            quiet = 0 if busy or any(byte < STREAM for byte in heard) else quiet + 1
    passing.pause(_LAST_S)


def waiting_s(line: bytes) -> float | None:
    """Return for how long a script's line WAIT waits, for ever until the axis rests; None for another line.

    >>> waiting_s(b"WAIT 0.5"), waiting_s(b"wait"), waiting_s(b"P600")
    (0.5, inf, None)
    """
    word, _, text = line.strip().upper().decode("latin-1").partition(" ")
    if word != "WAIT":
        return None
    try:
        seconds = float(text) if text else math.inf
    except ValueError:
        seconds = math.nan
    if not (seconds >= 0.0 and (seconds <= _LONGEST_WAIT_S or not text)):
        raise InputError(
            f"WAIT s waits s seconds, 0 to {_LONGEST_WAIT_S:g}, and WAIT until the axis rests; {text} is neither"
        )
    return seconds


class _DrivePipe(Pipe):
    """A pipe as the drive's line: the drive's bytes are printed unchanged."""

    def read(self, timeout_s: float | None) -> bytes:
        """Return received bytes, with CR for LF."""
        return super().read(timeout_s).replace(b"\r\n", b"\r").replace(b"\n", b"\r")

    def write(self, data: bytes) -> None:
        """Print all bytes."""
        put(data)


class _DriveKeyboard(Keyboard):
    """A person's keys as the UHU's terminal program sends them, and the drive's text without the analyser's bytes.

    Keys that the drive does not echo are echoed here: the servo module's guide sets a terminal to local echo.
    """

    def __init__(self, bench: AxisBench, interrupts: Interrupts) -> None:
        super().__init__(interrupts)
        self._streams = isinstance(bench.drive(), Uhu)
        self._analysing = False

    def read(self, timeout_s: float | None) -> bytes:
        """Return the bytes that the pressed keys send."""
        keys = super().read(timeout_s)
        sent, self._analysing, leaves = sent_for(keys, self._streams, self._analysing)
        self.at_end |= leaves
        if not self._streams:
            super().write(sent.replace(b"\r", b"\r\n"))
        return sent

    def write(self, data: bytes) -> None:
        """Print the drive's text."""
        super().write(bytes(byte for byte in data if byte < STREAM))
