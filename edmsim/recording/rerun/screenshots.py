"""Screenshots of a recording in rerun's own viewer, without a screen and without a GPU."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from edmsim.errors import InputError
from edmsim.files import make_writable
from edmsim.recording.rerun.playback import Playback
from edmsim.recording.rerun.stream import TIME
from edmsim.recording.rerun.viewer import HERE, RERUN, free_port

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

SHARES = (0.05, 0.25, 0.5, 0.75, 1.0)
"""Shares of the machine time at which pictures are taken."""
_PATIENCE_S = 60.0
"""How long the viewer may take to start, and to read the recording."""
_OPENED_S, _SETTLED_S = 4.0, 0.8
"""The viewer moves its cameras into place after opening, and draws what a new time needs over some frames."""


def take_screenshots(recording: Path, folder: str | Path, shares: tuple[float, ...] = SHARES) -> list[Path]:
    """Take pictures of a recording as it opens in the viewer, at shares of its machine time.

    Parameters
    ----------
    recording : path
        Of a cut.
    folder : path
        Where ``cut-005.png`` and so on are written, named after the share in percent.
    shares : tuple of float
        0 to 1.

    Returns
    -------
    list of Path
        The pictures, 1920 x 1080.

    Raises
    ------
    InputError
        As `edmsim.recording.rerun.playback.find_recording`; or the folder cannot be written to; or there is no Vulkan
        driver to draw with.
    """
    end_s = Playback(recording).end_s
    target = Path(folder)
    make_writable(target)
    written = []
    with _headless(recording) as client:
        time.sleep(_OPENED_S)
        for share in shares:
            client.set_time(TIME, duration=share * end_s, play_state="paused")
            time.sleep(_SETTLED_S)
            file = target / f"cut-{round(100 * share):03d}.png"
            file.write_bytes(_picture(client))
            written.append(file)
    return written


def _picture(client: ViewerClient) -> bytes:
    """Take a screenshot; a busy machine may miss the viewer's own deadline."""
    until = time.monotonic() + _PATIENCE_S
    while True:
        try:
            return client.take_screenshot()
        except TimeoutError:
            if time.monotonic() > until:
                raise InputError(f"the viewer made no picture in {_PATIENCE_S:g} s; is the machine busy?") from None


@contextmanager
def _headless(recording: Path) -> Iterator[ViewerClient]:
    """Run the viewer without a window, bound to this machine, and give a client of it."""
    from rerun.experimental import ViewerClient

    port = free_port(0)
    command = [*RERUN, str(recording.resolve()), "--headless", "--bind", HERE, "--port", str(port)]
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        yield _connected(process, ViewerClient, f"rerun+http://{HERE}:{port}/proxy")
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGTERM)  # the viewer is a child of the interpreter started here
        process.wait()


def _connected(process: subprocess.Popen[bytes], kind: type[ViewerClient], address: str) -> ViewerClient:
    until = time.monotonic() + _PATIENCE_S
    while time.monotonic() < until and process.poll() is None:
        try:
            client = kind.connect(address)
            client.set_time(TIME, duration=0.0, play_state="paused")
        except (ConnectionError, RuntimeError):
            time.sleep(0.2)
        else:
            return client
    raise InputError(
        "rerun's viewer did not start without a window: it needs a Vulkan driver, on Debian and Ubuntu "
        "mesa-vulkan-drivers"
    )

