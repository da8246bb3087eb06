"""The bench in real time: a pseudo-terminal for the board's serial line, another for the axes.

Lines are answered between two frames, so an answer waits for at most one frame's calculation. If the other side does
not read, output that does not fit into the buffer is lost, and further lines are not answered. If it sends too fast,
it has to wait, as with a USB port. So the other side cannot block the gap.
"""

import select
import time
from collections import abc, deque

from edmsim.consoles.devices import Interrupts, PseudoTerminal
from edmsim.errors import InputError
from edmsim.hil.boards import MOST_LINE, Rig

_WAITING_LINES, _LINES_A_FRAME = 64, 16
"""Greatest number of waiting lines at a port, and of lines answered between two frames (ours)."""
_MOST_UNSENT = 4096  # greatest number of bytes that wait to be sent (ours)
HALF_LINE_S = 1.0  # silence after which a line without an end is executed, as by Powercore V3
TOO_LONG = f"ERROR: line too long (max {MOST_LINE} bytes)\r\n"


class Lines:
    """Splits received bytes into lines."""

    def __init__(self) -> None:
        self.ready: deque[str | None] = deque()  # waiting lines; None for a line that was too long
        self._partial = bytearray()
        self._too_long = False
        self._heard_s = 0.0

    def put(self, data: bytes, now_s: float) -> None:
        """Add received bytes; CR, LF or both end a line, and empty lines are dropped."""
        self._heard_s = now_s
        for part in data.replace(b"\r", b"\n").splitlines(keepends=True):
            self._partial += part.rstrip(b"\n")
            if len(self._partial) > MOST_LINE:
                self._too_long = True
                self._partial.clear()
            if part.endswith(b"\n"):
                self._end()

    def end_half_line(self, now_s: float) -> None:
        """End an incomplete line if nothing was received for `HALF_LINE_S`."""
        if (self._partial or self._too_long) and now_s - self._heard_s > HALF_LINE_S:
            self._end()

    def _end(self) -> None:
        if self._too_long:
            self.ready.append(None)
        elif self._partial:
            self.ready.append(self._partial.decode("latin-1"))
        self._too_long = False
        self._partial.clear()


class Port:
    """A pseudo-terminal and the function that answers its lines."""

    def __init__(self, answer: abc.Callable[[str], str]) -> None:
        self.terminal = PseudoTerminal()
        self.lines = Lines()
        self._answer = answer
        self._unsent = b""

    def answer(self) -> None:
        """Answer some waiting lines, as long as the previous answers could be sent."""
        for _ in range(min(len(self.lines.ready), _LINES_A_FRAME)):
            if self.flush():
                return
            line = self.lines.ready.popleft()
            self.say(TOO_LONG if line is None else self._answer(line))

    def say(self, text: str) -> None:
        """Send a text; it is lost if too many earlier bytes wait to be sent."""
        if len(self._unsent) < _MOST_UNSENT:
            self._unsent += text.encode("ascii", "replace")
        self.flush()

    def flush(self) -> bool:
        """Send waiting bytes; return whether some still wait."""
        if self._unsent:
            self._unsent = self._unsent[self.terminal.send(self._unsent) :]
        return bool(self._unsent)


class Session:
    """A rig with its ports, at `speed` machine seconds per second."""

    def __init__(self, rig: Rig, speed: float = 1.0) -> None:
        if not speed > 0:
            raise InputError(f"--speed is above 0, in machine seconds per second, not {speed:g}")
        self.rig = rig
        self._speed = speed
        self.board = Port(rig.send)
        self.motion = Port(rig.move)
        self._lost = ""

    def run(self, seconds: float | None, stop: abc.Callable[[], bool], say: abc.Callable[[str], None]) -> None:
        """Run until `stop`, called between frames, returns True, or some machine time has passed."""
        began, from_s = time.monotonic(), self.rig.time_s
        while not stop() and (seconds is None or self.rig.time_s - from_s < seconds):
            due = began + (self.rig.time_s - from_s) / self._speed
            self._serve_until(due)
            self.rig.frame()
            self._speak(say)

    def close(self) -> None:
        """Close both pseudo-terminals."""
        for port in (self.board, self.motion):
            port.terminal.close()

    def _serve_until(self, due: float) -> None:
        """Answer lines until a frame is due; at least once, even if the frame is late."""
        while True:
            now = time.monotonic()
            self._receive(now, max(due - now, 0.0))
            if self.rig.board.listens:
                self.board.answer()
            self.motion.answer()
            for port in (self.board, self.motion):
                port.flush()
            if time.monotonic() >= due:
                return

    def _receive(self, now: float, timeout_s: float) -> None:
        ports = [port for port in (self.board, self.motion) if len(port.lines.ready) < _WAITING_LINES]
        answering = [self.board, self.motion] if self.rig.board.listens else [self.motion]
        waits = any(port.lines.ready and not port.flush() for port in answering)
        terminals = [port.terminal.fileno() for port in ports]
        came = select.select(terminals, [], [], 0.0 if waits else timeout_s)[0]
        for port, terminal in zip(ports, terminals, strict=True):
            if terminal in came:
                port.lines.put(port.terminal.read(0.0), time.monotonic())
            else:
                port.lines.end_half_line(now)

    def _speak(self, say: abc.Callable[[str], None]) -> None:
        """Send the board's unsolicited output, and status lines that are due."""
        if said := self.rig.board.unsolicited():
            self.board.say(said)
        if status := self.rig.streamed():
            self.motion.say(status)
        lost = self.rig.gap.lost
        if lost != self._lost:
            self._lost = lost
            if lost:
                self.motion.say(f"ERROR: {lost}; THREAD threads a new wire\r\n")
                say(lost)


def serve(rig: Rig, *, speed: float, seconds: float | None, say: abc.Callable[[str], None]) -> None:
    """Open the ports, pass their names to `say`, and run until Ctrl-C or for some machine time."""
    session = Session(rig, speed)
    interrupts = Interrupts()
    try:
        if rig.board.name != "powercore-v2":
            say(f"the board's serial port is {session.board.terminal.name}")
        say(f"the axes' port is {session.motion.terminal.name}; Ctrl-C ends the simulation")
        with interrupts.caught():
            session.run(seconds, lambda: interrupts.pending, say)
    finally:
        session.close()


def run_alone(rig: Rig, *, feed_um_s: float, seconds: float) -> None:
    """Move x at a feed without ports, until Ctrl-C or for some machine time."""
    interrupts = Interrupts()
    with interrupts.caught():
        until_s = rig.time_s + seconds
        while rig.time_s < until_s and not interrupts.pending:
            rig.gap.setpoints.move_at((feed_um_s, 0.0), rig.gap.plant.time_ns)
            rig.frame()
