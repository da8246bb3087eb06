"""Playing a cut back: the native rerun viewer where there is a screen, the web viewer otherwise."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import quote

from edmsim.errors import InputError

RERUN = (sys.executable, "-c", "import sys; from rerun_cli.__main__ import main; sys.exit(main())")
"""Starts rerun's command line with this interpreter; ``-m rerun_cli`` would lose the exit status."""

RECORDING = "cut.rrd"
"""Name of the recording in a cut's folder."""


def view(directory: str | Path, web_port: int = 9090, grpc_port: int = 9876) -> int:
    """Show the recording in a cut's folder until the viewer is closed or Ctrl-C is pressed.

    Parameters
    ----------
    directory : path
        The folder a cut was written to.
    web_port, grpc_port : int
        Ports of 127.0.0.1 used where there is no screen: the page, and the data it asks for.

    Returns
    -------
    int
        The viewer's exit status, 0 if it was ended by closing it or by Ctrl-C.

    Raises
    ------
    InputError
        If there is no readable recording in `directory`.
    """
    recording = find_recording(directory)
    on_screen = has_screen(os.environ, sys.platform)
    if not on_screen:
        address = web_address(web_port, grpc_port)
        print(f"No screen here. Open {address} in a browser on this machine; Ctrl-C ends.", flush=True)
    command = viewer_command(recording, on_screen, web_port, grpc_port)
    try:
        return subprocess.call(command)
    except KeyboardInterrupt:
        return 0


def find_recording(directory: str | Path) -> Path:
    """Return the recording in a cut's folder.

    Raises
    ------
    InputError
        If the folder or the recording is missing, or the file is damaged or is not a rerun recording.
    """
    folder = Path(directory)
    if not folder.is_dir():
        raise InputError("no such folder, give the folder that `edmsim cut --out` wrote", directory)
    recording = folder / RECORDING
    if not recording.is_file():
        raise InputError(
            f"there is no {RECORDING} in it, give a folder that `edmsim cut --out` wrote", directory
        )
    _check(recording)
    return recording


def _check(recording: Path) -> None:
    from rerun.chunk import RrdReader

    try:
        with warnings.catch_warnings():
            # A file cut short between two messages is only warned about.
            warnings.simplefilter("error")
            found = RrdReader(recording).recordings()
    except (RuntimeError, Warning):
        found = []
    if not found:
        size = recording.stat().st_size
        raise InputError(f"these {size} bytes are not a whole rerun recording, run the cut again", recording)


def has_screen(environment: Mapping[str, str], platform: str) -> bool:
    """Say whether a window can be opened: always on macOS and Windows, elsewhere if X or Wayland is there."""
    if platform in ("darwin", "win32"):
        return True
    return bool(environment.get("DISPLAY") or environment.get("WAYLAND_DISPLAY"))


def viewer_command(recording: Path, on_screen: bool, web_port: int, grpc_port: int) -> list[str]:
    """Return the command line that shows `recording`; what it serves is bound to 127.0.0.1 only."""
    command = [*RERUN, str(recording.resolve()), "--bind", "127.0.0.1"]
    if on_screen:
        return [*command, "--port", "auto"]
    return [*command, "--serve-web", "--web-viewer-port", str(web_port), "--port", str(grpc_port)]


def web_address(web_port: int, grpc_port: int) -> str:
    """Return the address of the page that shows what `viewer_command` serves."""
    source = quote(f"rerun+http://127.0.0.1:{grpc_port}/proxy", safe="")
    return f"http://127.0.0.1:{web_port}?url={source}"
