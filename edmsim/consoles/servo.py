"""``edmsim console servo``: a drive on a bench, used by a person, a script or a program; its scope."""

import re
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from edmsim.axis_bench import AxisBench
from edmsim.compiled.axis_rows import FAULT
from edmsim.consoles.devices import Interrupts, Keyboard, Pipe, PseudoTerminal, is_terminal, put
from edmsim.controllers.axis import CHIPS
from edmsim.controllers.axis import tuned as tuned_drive
from edmsim.controllers.axis.drive import axis_names, axis_row, data_of
from edmsim.controllers.axis.servo_module import ServoModule
from edmsim.controllers.axis.uhu import Uhu
from edmsim.errors import InputError, one_of
from edmsim.files import make_room

# The scope of the UHU's terminal program: the tracking error as a curve over a moving time line, drawn by rerun.

_TIME = "simulated_time"
_CURVES = "duty", "current_A", "place_um", "speed_rad_s"  # curves besides the stream: columns of the bench's samples
_BATCH_S = 0.1
"""Simulated time of one batch of points (ours). Every batch has a header: with 100 a second, files were four times
as large."""


class Scope:
    """Curves of a drive in rerun, live or in a recording; `streams` is whether the drive sends its tracking error."""

    def __init__(self, live: bool, file: Path | None, streams: bool = True) -> None:
        import rerun as rr
        import rerun.blueprint as rrb

        from edmsim.recording.rerun.viewer import LiveViewer

        if file is not None:
            make_room(file, "a recording of the scope", ".rrd")
            try:
                file.write_bytes(b"")  # because rerun prints a traceback for a file that it cannot create
            except OSError as error:
                raise InputError(f"the recording cannot be written: {error.strerror}", file) from None
        tracking = [rrb.TimeSeriesView(name="tracking error, counts", contents=["/tracking_error"])]
        views = [
            *(tracking if streams else []),
            *(rrb.TimeSeriesView(name=name.replace("_", " "), contents=[f"/{name}"]) for name in _CURVES),
        ]
        self._zero = int(data_of("uhu")["law"]["stream_zero"])
        self._recording = rr.RecordingStream("edmsim_servo")
        self._heard: list[tuple[int, float]] = []
        self._samples: list[NDArray[np.void]] = []
        self._drawn_s = 0.0
        self._viewer = LiveViewer("the scope", "--record FILE.rrd keeps the curves") if live else None
        # message about the viewer; empty if none runs
        self.notice = self._viewer.notice if self._viewer else ""
        sinks: list[rr.GrpcSink | rr.FileSink] = [rr.GrpcSink(self._viewer.source)] if self._viewer else []
        sinks += [rr.FileSink(str(file))] if file is not None else []
        self._recording.set_sinks(*sinks, default_blueprint=rrb.Blueprint(rrb.Vertical(*views)))

    def draw(self, heard: Sequence[tuple[int, float]], samples: NDArray[np.void]) -> None:
        """Collect bytes (the analyser's have bit 7) with their times, and the bench's samples; draw full batches."""
        self._heard += [(byte, at_s) for byte, at_s in heard if byte >= STREAM]
        self._samples.append(samples)
        if len(samples) and samples["time_ns"][-1] * 1e-9 >= self._drawn_s + _BATCH_S:
            self._draw_batch()

    def _draw_batch(self) -> None:
        heard, self._heard = self._heard, []
        blocks, self._samples = self._samples, []
        if heard:
            errors = np.array([byte - STREAM - self._zero for byte, _ in heard])
            self._send("tracking_error", np.array([at_s for _, at_s in heard]), errors)
        if blocks and len(samples := np.concatenate(blocks)):
            self._drawn_s = samples["time_ns"][-1] * 1e-9
            for name in _CURVES:
                self._send(name, samples["time_ns"] * 1e-9, samples[name])

    def _send(self, name: str, times_s: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        import rerun as rr

        when = [rr.TimeColumn(_TIME, duration=times_s)]
        curve = rr.Scalars.columns(scalars=values.astype(np.float64))
        self._recording.send_columns(name, indexes=when, columns=curve)

    def close(self) -> None:
        """Draw the last batch, write the recording and close the viewer."""
        self._draw_batch()
        self._recording.flush()
        self._recording.disconnect()
        if self._viewer is not None:
            self._viewer.close()


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
        heard = self.bench.received_at()
        self._scope.draw(heard, self.bench.samples())
        return bytes(value for value, _ in heard)

    def pause(self, seconds: float) -> None:
        """Run the bench for some time, and print the drive's bytes."""
        until_s = self.bench.time_s + seconds
        while self.bench.time_s < until_s:
            put(self.frame())

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
    drive, passing = bench.drive(), _Passing(bench, scope, say)
    passing.pause(_START_S)
    for line in script.splitlines():
        bench.send(line + b"\r")
        quiet = 0
        while quiet < 3:
            heard = passing.frame()
            put(heard)
            busy = bench.sending() or (isinstance(drive, ServoModule) and drive.recording)
            quiet = 0 if busy or any(byte < STREAM for byte in heard) else quiet + 1
    passing.pause(_LAST_S)


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
