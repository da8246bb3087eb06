"""Ending a process by a signal: while it starts, and while it has work to save."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_ENDING = {
    signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL,
    **({signal.SIGHUP: signal.SIG_DFL} if hasattr(signal, "SIGHUP") else {}),
}  # fmt: skip
"""Signals that end a process, and their default handlers."""


class NotedSignals:
    """Deferred signals: recorded by the handler, raised at the next safe point."""

    def __init__(self) -> None:
        self._came: int | None = None
        self._at_once = False

    def take(self, number: int, _: object) -> None:
        """Handle a signal."""
        self._came = number
        if self._at_once:
            self.raise_noted()

    def raise_noted(self) -> None:
        """Raise `KeyboardInterrupt` with the signal's number, if a signal has arrived."""
        if self._came is not None:
            came, self._came = self._came, None
            raise KeyboardInterrupt(came)

    def at_once(self) -> None:
        """Raise at once from here on, because interrupted work can be repeated."""
        self._at_once = True
        self.raise_noted()

    def only_note(self) -> None:
        """Ignore signals from here on, because the work is done."""
        self._at_once, self._came = False, None


_AGAIN_S = 0.05  # after this time Python has left the callback that ignores errors (ours)


def raise_again(ignored: "sys.UnraisableHookArgs") -> None:
    """Raise an interruption again that Python ignored, as in a callback of an import; a `sys.unraisablehook`."""
    if isinstance(ignored.exc_value, KeyboardInterrupt):
        number = next(iter(ignored.exc_value.args), signal.SIGINT)
        threading.Timer(_AGAIN_S, signal.raise_signal, [number]).start()
    else:
        sys.__unraisablehook__(ignored)


@contextmanager
def ending_at_once() -> Iterator[None]:
    """Let Ctrl-C end the command ``edmsim`` or ``python -m edmsim`` at once, without a traceback, while it starts."""
    is_command = any(Path(word).stem == "edmsim" for word in sys.orig_argv[1:3])
    in_main_thread = threading.current_thread() is threading.main_thread()
    starts = is_command and in_main_thread and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if starts:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    yield
    if starts:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@contextmanager
def noted() -> Iterator[NotedSignals]:
    """Defer these signals in the main thread if there is no other handler."""
    interrupts = NotedSignals()
    taken = {}
    if threading.current_thread() is threading.main_thread():
        taken = {number: usual for number, usual in _ENDING.items() if signal.getsignal(number) is usual}
    for number in taken:
        signal.signal(number, interrupts.take)
    try:
        yield interrupts
    finally:
        for number, usual in taken.items():
            signal.signal(number, usual)
