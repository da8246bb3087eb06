"""Playing cuts back: the native rerun viewer where there is a screen, the web viewer otherwise."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import quote

from edmsim.recording.rerun.playback import find_recording

RERUN = (sys.executable, "-c", "import sys; from rerun_cli.__main__ import main; sys.exit(main())")
"""Starts rerun's command line with this interpreter; ``-m rerun_cli`` would lose the exit status."""
HERE = "127.0.0.1"
"""What viewers serve is for this machine only."""


def view(directory: str | Path, web_port: int = 9090, grpc_port: int = 9876) -> int:
    """Show the recording in a cut's folder until the viewer is closed or Ctrl-C is pressed.

    Parameters
    ----------
    directory : path
        The folder a cut was written to.
    web_port, grpc_port : int
        Ports of 127.0.0.1 used where there is no screen: the page, and the data it asks for. Where one is taken,
        a free one is used.

    Returns
    -------
    int
        The viewer's exit status, 0 if it was ended by closing it or by Ctrl-C.

    Raises
    ------
    InputError
        If there is no readable recording in `directory`.
    """
    return _show(find_recording(directory), web_port, grpc_port)


def compare(a: str | Path, b: str | Path, web_port: int = 9090, grpc_port: int = 9876) -> int:
    """Show two cuts side by side; folders, ports, result and errors as for `view`."""
    from edmsim.recording.rerun.comparison import write_comparison

    first, second = find_recording(a), find_recording(b)
    with tempfile.TemporaryDirectory(prefix="edmsim-") as folder:
        both = Path(folder) / "comparison.rrd"
        write_comparison(both, first, second)
        return _show(both, web_port, grpc_port)


def _show(recording: Path, web_port: int, grpc_port: int) -> int:
    try:
        if has_screen(os.environ, sys.platform):
            status = subprocess.call(viewer_command(recording, True, web_port, grpc_port), env=_warnings_only())
            if status == 0:
                return 0
            print("The viewer could not open a window, or ended with an error.", flush=True)
        web_port, grpc_port = free_port(web_port), free_port(grpc_port)
        address = web_address(web_port, grpc_port)
        print(f"No screen here. Open {address} in a browser on this machine; Ctrl-C ends.", flush=True)
        return subprocess.call(viewer_command(recording, False, web_port, grpc_port), env=_warnings_only())
    except KeyboardInterrupt:
        return 0


def _warnings_only() -> dict[str, str]:
    """Return the environment of a viewer that says only what is wrong, unless its user wants more."""
    return {"RUST_LOG": "warn", **os.environ}


def has_screen(environment: Mapping[str, str], platform: str) -> bool:
    """Say whether a window can be opened: always on macOS and Windows, elsewhere if X or Wayland is there."""
    if platform in ("darwin", "win32"):
        return True
    return bool(environment.get("DISPLAY") or environment.get("WAYLAND_DISPLAY"))


def free_port(wanted: int) -> int:
    """Return a port of this machine that nothing listens on: the one wanted, or another."""
    with socket.socket() as probe:
        try:
            probe.bind((HERE, wanted))
        except OSError:
            probe.bind((HERE, 0))
        return int(probe.getsockname()[1])


def viewer_command(recording: Path, on_screen: bool, web_port: int, grpc_port: int) -> list[str]:
    """Return the command line that shows `recording`; what it serves is bound to 127.0.0.1 only."""
    command = [*RERUN, str(recording.resolve()), "--bind", HERE]
    if on_screen:
        return [*command, "--port", "auto"]
    return [*command, "--serve-web", "--web-viewer-port", str(web_port), "--port", str(grpc_port)]


def web_address(web_port: int, grpc_port: int) -> str:
    """Return the address of the page that shows what `viewer_command` serves."""
    source = quote(f"rerun+http://{HERE}:{grpc_port}/proxy", safe="")
    return f"http://{HERE}:{web_port}?url={source}"
