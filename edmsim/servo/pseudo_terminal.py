"""A pseudo-terminal: a serial port of this computer without a wire, which an ordinary terminal program opens."""

from __future__ import annotations

import os
import select
import tty

_CHUNK = 4096


class PseudoTerminal:
    """Both ends of a pseudo-terminal, in raw mode.

    Attributes
    ----------
    name : str
        What a terminal program opens, for example ``/dev/pts/3``.
    """

    def __init__(self) -> None:
        self._ours, self._theirs = os.openpty()  # theirs stays open here, so that it outlasts who opens and closes it
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.name = os.ttyname(self._theirs)

    def read(self, timeout_s: float | None) -> bytes:
        """Return the bytes that have come; none after the timeout."""
        if not select.select([self._ours], [], [], timeout_s)[0]:
            return b""
        return os.read(self._ours, _CHUNK)

    def write(self, data: bytes) -> None:
        """Send some bytes; what nobody reads is lost when the system's buffer is full, as on an open line."""
        try:
            while data:
                data = data[os.write(self._ours, data) :]
        except BlockingIOError:
            return

    def close(self) -> None:
        """Let the pseudo-terminal go."""
        for end in (self._ours, self._theirs):
            os.close(end)
