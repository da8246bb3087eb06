"""A rerun viewer that shows curves while they are drawn: a window, or without a screen a page for a browser."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

from edmsim.errors import InputError
from edmsim.recording.rerun.viewer import HERE, RERUN, free_port, has_screen, web_address

_PORT, _WEB_PORT = 9876, 9090
"""Rerun's own, as `edmsim view` has them; a free one where one is taken."""
_PATIENCE_S = 30.0
"""For a viewer to start (ours): ten times what one took here."""
_MEMORY = "500MB"
"""What a viewer keeps before it forgets the oldest (ours): hours of a drive's curves."""


class LiveViewer:
    """A viewer in a process of its own, which takes what is drawn from this machine only.

    Attributes
    ----------
    source : str
        Where it takes it.
    notice : str
        What to tell the user.

    Raises
    ------
    InputError
        It did not start.
    """

    def __init__(self) -> None:
        port, web_port = free_port(_PORT), free_port(_WEB_PORT)
        self.source = f"rerun+http://{HERE}:{port}/proxy"
        self._window = has_screen(os.environ, sys.platform)
        web = [] if self._window else ["--serve-web", "--web-viewer-port", str(web_port)]
        self._process = subprocess.Popen(
            [*RERUN, "--bind", HERE, "--port", str(port), "--memory-limit", _MEMORY, *web],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        address = web_address(web_port, port)
        self.notice = (
            "the scope opens in a window" if self._window
            else f"no screen here: open {address} in a browser on this machine for the scope"
        )  # fmt: skip
        self._wait_for(port)

    def _wait_for(self, port: int) -> None:
        until = time.monotonic() + _PATIENCE_S
        while self._process.poll() is None and time.monotonic() < until:
            if free_port(port) != port:
                return
            time.sleep(0.05)
        self.close()
        raise InputError("rerun's viewer did not start, so there is no scope; --record FILE.rrd keeps the curves")

    def close(self) -> None:
        """Leave a window to its user; a page ends with the drive."""
        if not self._window and self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGTERM)  # the viewer is a child of the interpreter started here
