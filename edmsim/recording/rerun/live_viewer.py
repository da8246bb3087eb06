"""A rerun viewer that shows what comes while it comes: a window, or without a screen a page for a browser."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from edmsim.errors import InputError
from edmsim.recording.rerun.playback import APPLICATION
from edmsim.recording.rerun.viewer import HERE, RERUN, free_port, has_screen, web_address

_PORT, _WEB_PORT = 9876, 9090
"""Rerun's own, as `edmsim view` has them; a free one where one is taken."""
_PATIENCE_S = 30.0
"""For a viewer to start (ours): ten times what one took here."""
_MEMORY = "500MB"
"""What a viewer keeps before it forgets the oldest (ours): hours of a drive's curves, a hundred episodes."""


class LiveViewer:
    """A viewer in a process of its own, which takes what is drawn from this machine only.

    Parameters
    ----------
    what : str
        What it shows, for the notice.
    instead : str
        What a user can do where it does not start.

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

    def __init__(self, what: str, instead: str) -> None:
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
            f"{what} opens in a window" if self._window
            else f"no screen here: open {address} in a browser on this machine for {what}"
        )  # fmt: skip
        self._wait_for(port, what, instead)

    def _wait_for(self, port: int, what: str, instead: str) -> None:
        until = time.monotonic() + _PATIENCE_S
        while self._process.poll() is None and time.monotonic() < until:
            if free_port(port) != port:
                return
            time.sleep(0.05)
        self.close()
        raise InputError(f"rerun's viewer did not start, so there is no {what.removeprefix('the ')}; {instead}")

    def close(self) -> None:
        """Leave a window to its user; a page ends with what it shows."""
        if not self._window and self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGTERM)  # the viewer is a child of the interpreter started here


def show(recording: Path, viewer: LiveViewer) -> None:
    """Have a viewer open a recording that is whole, beside those it has."""
    import rerun as rr

    stream = rr.RecordingStream(APPLICATION, recording_id=f"show-{recording.parent.name}", send_properties=False)
    stream.set_sinks(rr.GrpcSink(viewer.source))
    stream.log_file_from_path(recording)
    stream.flush()
    stream.disconnect()
