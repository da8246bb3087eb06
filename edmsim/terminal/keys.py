"""The operator's presses of the 64 keys: each key is held for a while in machine time, and scanned by the 8279."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator

from edmsim.controllers.mcu.board import Board
from edmsim.controllers.mcu.chips.display import CTRL, SCAN_NS, SHIFT
from edmsim.controllers.mcu.dialogue.front_panel import KEYS

HELD_NS, RELEASED_NS = 60_000_000, 40_000_000
"""How long a key is held, and until the next one (ours: a quick typist)."""
TOGGLE = 0x0B
"""Ctrl-K."""
TYPED = {
    **{bytes([character]): digit for digit, character in enumerate(b"0123456789")},
    b"c": KEYS["CLEAR"], b"\b": KEYS["CLEAR"], b"\x7f": KEYS["CLEAR"],
    b"x": KEYS["X"], b"y": KEYS["Y"], b"X": KEYS["X"] | SHIFT, b"Y": KEYS["Y"] | SHIFT,
    b"i": KEYS["T(I)"], b"p": KEYS["T(P)"], b"v": KEYS["SPEED"], b"\r": KEYS["START"], b"\n": KEYS["START"],
    b" ": KEYS["STOP"], b"g": KEYS["GO"], b"n": KEYS["INIT"],
    b"\x1b[C": KEYS["X+"], b"\x1b[D": KEYS["X-"], b"\x1b[A": KEYS["Y+"], b"\x1b[B": KEYS["Y-"],
}  # fmt: skip
"""Keys of the panel by what a person types at a terminal; the last four are the arrows."""
LEGEND = (
    "Ctrl-K ends  0-9  c CLEAR  x X  y Y (capital: SHIFT)  i T(I)  p T(P)\n"
    "v SPEED  Enter START  space STOP  g GO  n INIT  arrows X+ X- Y+ Y-"
)


def typed_keys(data: bytes) -> list[int]:
    """Return the codes of the keys that were typed; what is none is passed over."""
    codes, at = [], 0
    while at < len(data):
        size = 3 if data[at : at + 2] == b"\x1b[" else 1
        if data[at : at + size] in TYPED:
            codes.append(TYPED[data[at : at + size]])
        at += size
    return codes


class KeyPresses:
    """Keys of a board that are pressed one after the other, in machine time.

    Parameters
    ----------
    board : Board
    """

    def __init__(self, board: Board) -> None:
        self._board = board
        self._waiting: deque[int] = deque()
        self._down_ns = self._scan_ns = 0

    @property
    def busy(self) -> bool:
        """Whether a key is to be pressed or released yet."""
        return bool(self._waiting)

    def press(self, codes: Iterable[int], now_ns: int) -> None:
        """Press keys, after those that wait."""
        if not self.busy:
            self._down_ns = self._scan_ns = now_ns
        self._waiting.extend(codes)

    def scan_until(self, end_ns: int) -> Iterator[None]:
        """Let the 8279 scan up to a time; yields whenever a key waits in it."""
        while self.busy and self._scan_ns < end_ns:
            self._scan_ns += SCAN_NS
            code, held_ns = self._waiting[0], self._scan_ns - self._down_ns
            closed = frozenset([code & 0x3F] if held_ns <= HELD_NS else ())
            self._board.scan_keys(closed, bool(code & SHIFT), bool(code & CTRL))
            if self._board.display.waiting:
                yield
            if held_ns >= HELD_NS + RELEASED_NS:
                self._waiting.popleft()
                self._down_ns = self._scan_ns
