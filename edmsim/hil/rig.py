"""A board with its gap and the port of the axes, without a clock."""

import math
from collections.abc import Callable
from typing import Any

from edmsim.errors import methods_refuse_wrong_types
from edmsim.hil.boards import Board, make_board
from edmsim.hil.gap import AXES, Frame, Gap
from edmsim.machine.machine import Machine
from edmsim.numeric import finite

MOST_LINE = 127  # longest line in bytes (Powercore V3)
_MOST_STEPS = 100_000
_MOST_HZ = 1000.0
NO_TIME_S = 1e-9  # what sums of floats may differ by


@methods_refuse_wrong_types
class Rig:
    r"""A board, the gap it fires into, and the axes.

    Parameters
    ----------
    board : str or Board
        ``powercore`` (V3), ``powercore-v2`` or ``spark``.
    machine : Machine, optional
        Set-up with the board's generator; by default the usual one.
    seed : int
    gap_um, resolution : optional
        See `Gap`.

    Examples
    --------
    >>> rig = Rig("powercore", seed=1)
    >>> rig.board.unasked()
    'Setup complete\r\n'
    >>> rig.send("SET_ALL_PARAMETERS 0 0.05 5000 80")
    'OK: Parameters set\r\n'
    >>> rig.move("VEL 5 0")
    'ok\r\n'
    >>> rig.run(0.02)
    """

    def __init__(
        self, board: str | Board = "powercore", machine: Machine | None = None, *, seed: int = 0, **gap: Any
    ) -> None:
        self.board = make_board(board) if isinstance(board, str) else board
        if machine is None:
            machine = Machine.load(generator=self.board.generator)
        self.gap = Gap(machine, seed, **gap)
        self._stream_s, self._due_s = 0.0, 0.0  # between status lines, 0 for none; and when the next one is due
        self._watchers: list[Callable[[Frame], None]] = []

    @property
    def time_s(self) -> float:
        """Machine time."""
        return self.gap.time_s

    def watch(self, watcher: Callable[[Frame], None]) -> None:
        """Call an observer with every frame from now on."""
        self._watchers.append(watcher)

    def frame(self) -> Frame:
        """Run a frame, about 1 to 10 ms."""
        frame = self.gap.run(self.board.output())
        self.board.see(frame)
        for watcher in self._watchers:
            watcher(frame)
        return frame

    def run(self, seconds: float) -> None:
        """Run frames for some machine time."""
        until_s = self.time_s + finite("seconds", seconds, 0.0)
        while self.time_s < until_s:
            self.frame()

    def send(self, text: str) -> str:
        """Send a line to the board's serial port and return the answer."""
        return self.board.line(text)

    def status(self) -> str:
        """Return the line of the motion port: machine time, places in um, enable input, wire, the board's pins."""
        x, y = self.gap.place_um
        pins = "".join(f" {name} {value:.4g}" for name, value in self.board.pins().items())
        wire = 0 if self.gap.lost else 1
        return f"T {self.time_s:.6f} X {x:.1f} Y {y:.1f} EN {int(self.board.enabled)} WIRE {wire}{pins}\r\n"

    def streamed(self) -> str:
        """Return a status line if one is due, at most one for each frame; see ``STREAM``."""
        if not self._stream_s or self.time_s < self._due_s - NO_TIME_S:
            return ""
        self._due_s = next_due_s(self._due_s, self._stream_s, self.time_s)
        return self.status()

    def move(self, text: str) -> str:
        """Answer a line of the motion port.

        ``STEP X 3``, ``POS x y`` in um from the start, ``VEL x y`` in um/s, ``STREAM hertz``, ``ENABLE 1``,
        ``THREAD``, and ``?`` for a status line.
        """
        words = str.split(text)  # bytes fail here
        name, numbers = (words[0].upper(), words[1:]) if words else ("", [])
        try:
            return self._motion(name, numbers)
        except ValueError:
            return "ERROR: give STEP X|Y n, POS x y (um), VEL x y (um/s), STREAM hertz, ENABLE 0|1, THREAD or ?\r\n"

    def _motion(self, name: str, words: list[str]) -> str:
        axes, count = self.gap.setpoints, len(words)
        if name == "?" and not count:
            return self.status()
        if name == "STEP" and count == 2 and words[0].upper() in AXES:
            steps = int(words[1])
            if abs(steps) > _MOST_STEPS:
                return f"ERROR: at most {_MOST_STEPS} steps in a line\r\n"
            axes.step(AXES.index(words[0].upper()), steps)
        elif name == "POS" and count == 2:
            x0, y0 = self.gap.origin_um
            axes.go_to((x0 + _finite(words[0]), y0 + _finite(words[1])))
        elif name == "VEL" and count == 2:
            x, y = (_finite(word) for word in words)
            axes.move_at((x, y), self.gap.plant.time_ns)
        elif name == "STREAM" and count == 1:
            hertz = _finite(words[0])
            if not 0 <= hertz <= _MOST_HZ:
                return f"ERROR: STREAM takes 0 (off) to {_MOST_HZ:g} Hz\r\n"
            self._stream_s = 1.0 / hertz if hertz else 0.0
            self._due_s = self.time_s + self._stream_s
        elif name == "ENABLE" and words in (["0"], ["1"]):
            self.board.enabled = words == ["1"]
        elif name == "THREAD" and not count:
            if not self.gap.lost:
                return "ERROR: there is a wire\r\n"
            self.gap.thread()
        else:
            raise ValueError
        return "ok\r\n"


def next_due_s(due_s: float, every_s: float, now_s: float) -> float:
    """Return the first of regular times that comes after now: a frame ends later than what is due in it."""
    while due_s < now_s + NO_TIME_S:
        due_s += every_s
    return due_s


def _finite(word: str) -> float:
    value = float(word)
    if not math.isfinite(value):
        raise ValueError
    return value
