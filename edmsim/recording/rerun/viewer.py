"""Playback of cuts: in the native rerun viewer if there is a screen, in the web viewer otherwise.

Also two cuts side by side, a viewer of live data, and screenshots without screen and GPU.
"""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

import rerun as rr
import rerun.blueprint as rrb
from rerun.experimental import ViewerClient

from edmsim.errors import InputError
from edmsim.files import make_writable
from edmsim.recording.figures import palette
from edmsim.recording.rerun import write
from edmsim.recording.rerun.playback import APPLICATION, PATH, TIME, Playback, Sizes, find_recording, read_chunks
from edmsim.signals import noted

SIDES = (("a", "A", palette.SKY), ("b", "B", palette.ORANGE))
"""Of each cut: its origin in the recording, its letter, and the colour of its curves."""
CURVES = (
    ("pulses/short", "short, %"), ("pulses/open", "open, %"), ("feed/feed_um_s", "feed, µm/s"),
    ("gap/gap_um", "gap, µm"), ("gap/lag_um", "wire lag, µm"), ("gap/error_um", "profile error, µm"),
    ("gas/coverage", "gas on the wire's front, share"),
)
"""Curves to compare the cuts with, and the titles of their views."""
OF_EPISODES = tuple(
    (f"{place}/{write.TOTAL}", f"{what} so far")
    for place, what in ((write.RETURN, "return"), (write.COST, "cost"))
)
"""Further curves, which only episodes of environments have."""


@write.releasing
def write_comparison(file: Path, a: Path, b: Path) -> None:
    """Write two recordings into one that shows them side by side."""
    plays = [Playback(a), Playback(b)]
    folders = [play.recording.resolve().parent.name for play in plays]
    names = [f"{letter}: {folder}" for (_, letter, _), folder in zip(SIDES, folders, strict=True)]
    recording = rr.RecordingStream(APPLICATION, recording_id="comparison", send_properties=False)
    chunks = [read_chunks(play.recording) for play in plays]
    entities = [{str(chunk.entity_path) for chunk in of_one} for of_one in chunks]
    curves = CURVES + tuple(curve for curve in OF_EPISODES if any(f"/{curve[0]}" in known for known in entities))
    with write.saved(recording, file, _blueprint([play.sizes for play in plays], names, curves)):
        recording.send_recording_name(" and ".join(names))
        for (place, letter, colour), of_one, known in zip(SIDES, chunks, entities, strict=True):
            shown = [chunk for chunk in of_one if not chunk.entity_path.startswith("/__")]
            recording.send_chunks([chunk.with_entity_path(f"/{place}{chunk.entity_path}") for chunk in shown])
            line = rr.SeriesLines(names=[letter], colors=[palette.rgb(colour)], widths=[1.3])
            for entity, _ in curves:
                if f"/{entity}" in known:  # because a curve without values would hide the others
                    recording.log(f"{place}/{entity}", line, static=True)


def _blueprint(sizes: list[Sizes], names: list[str], curves: tuple[tuple[str, str], ...]) -> rrb.Blueprint:
    columns = [
        rrb.Vertical(
            write.workpiece_view(size, f"/{place}", f"{name} (wire deflection × {size.deflection_factor:g})"),
            write.gap_view(size, f"/{place}", f"{letter}, at the wire from above, µm, to scale"),
            write.scope_view(f"/{place}", f"{letter}, gap voltage and current"),
            row_shares=[4, 4, 3],
        )
        for (place, letter, _), size, name in zip(SIDES, sizes, names, strict=True)
    ]  # fmt: skip
    plots = [write.plot_view([f"{place}/{entity}" for place, *_ in SIDES], title) for entity, title in curves]
    events = (write.events_view(f"/{place}", f"{letter}, events") for place, letter, _ in SIDES)
    views = rrb.Horizontal(*columns, rrb.Vertical(*plots, rrb.Horizontal(*events)), column_shares=[3, 3, 4])
    return write.played(views, PATH, max(s.end_s for s in sizes))


RERUN = (sys.executable, "-c", "import sys; from rerun_cli.__main__ import main; sys.exit(main())")
"""Command that starts rerun with this interpreter; ``-m rerun_cli`` would lose the exit status."""
HERE = "127.0.0.1"  # viewers serve only this machine
PORT, WEB_PORT = 9876, 9090  # rerun's defaults; if one is in use, a free port is used


def view(directory: str | Path, web_port: int = WEB_PORT, grpc_port: int = PORT) -> int:
    """Show the recording in a cut's folder until you close the viewer or press Ctrl-C.

    Parameters
    ----------
    directory : path
        The folder of a cut.
    web_port, grpc_port : int
        Ports of 127.0.0.1 for the page and its data if there is no screen. If a port is in use, the viewer takes
        a free one.

    Returns
    -------
    int
        The viewer's exit status, 0 if you close it or press Ctrl-C.

    Raises
    ------
    InputError
        If there is no readable recording in `directory`.
    """
    return _show(find_recording(directory), web_port, grpc_port)


def compare(a: str | Path, b: str | Path, web_port: int = WEB_PORT, grpc_port: int = PORT) -> int:
    """Show two cuts side by side; folders, ports, result and errors as for `view`."""
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
    """Return environment variables with which a viewer prints only warnings, unless the user has set RUST_LOG."""
    return {"RUST_LOG": "warn", **os.environ}


def has_screen(environment: Mapping[str, str], platform: str) -> bool:
    """Return whether a window can be opened: always on macOS and Windows, elsewhere if X or Wayland is running."""
    if platform in ("darwin", "win32"):
        return True
    return bool(environment.get("DISPLAY") or environment.get("WAYLAND_DISPLAY"))


def free_port(port: int) -> int:
    """Return `port` if it is free on this machine, or else another that is."""
    with socket.socket() as probe:
        try:
            probe.bind((HERE, port))
        except OSError:
            probe.bind((HERE, 0))
        return int(probe.getsockname()[1])


def viewer_command(recording: Path, on_screen: bool, web_port: int, grpc_port: int) -> list[str]:
    """Return the command line that shows `recording`; its servers are bound to 127.0.0.1."""
    command = [*RERUN, str(recording.resolve()), "--bind", HERE]
    if on_screen:
        return [*command, "--port", "auto"]
    return [*command, "--serve-web", "--web-viewer-port", str(web_port), "--port", str(grpc_port)]


def web_address(web_port: int, grpc_port: int) -> str:
    """Return the address of the page that `viewer_command` serves."""
    return f"http://{HERE}:{web_port}?url={quote(_source(grpc_port), safe='')}"


def _source(port: int) -> str:
    """Return the address at which a viewer receives data."""
    return f"rerun+http://{HERE}:{port}/proxy"


_TO_BEGIN_S = 30.0  # longest start of a viewer (ours: ten times the measured time)
_MEMORY = "500MB"
"""Memory of a viewer, which then drops the oldest data (ours: hours of a drive's curves, a hundred episodes)."""


def _started(*options: str) -> subprocess.Popen[bytes]:
    """Start a viewer in its own process, without output, and bound to this machine."""
    return subprocess.Popen(
        [*RERUN, "--bind", HERE, *options], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGTERM)  # the group, because the viewer is a child of the interpreter
        process.wait()


class LiveViewer:
    """A viewer in its own process, which receives data only from this machine."""

    def __init__(self, what: str, instead: str) -> None:
        port, web_port = free_port(PORT), free_port(WEB_PORT)
        self.source = _source(port)
        self._window = has_screen(os.environ, sys.platform)
        web = [] if self._window else ["--serve-web", "--web-viewer-port", str(web_port)]
        self._process = _started("--port", str(port), "--memory-limit", _MEMORY, *web)
        address = web_address(web_port, port)
        self.notice = (
            f"{what} opens in a window" if self._window
            else f"no screen here: open {address} in a browser on this machine for {what}"
        )  # fmt: skip
        self._wait_for(port, what, instead)

    def _wait_for(self, port: int, what: str, instead: str) -> None:
        until = time.monotonic() + _TO_BEGIN_S
        while self._process.poll() is None and time.monotonic() < until:
            if free_port(port) != port:
                return
            time.sleep(0.05)
        self.close()
        raise InputError(f"rerun's viewer did not start, so there is no {what.removeprefix('the ')}; {instead}")

    def close(self) -> None:
        """Stop serving a web page; a window stays open until its user closes it."""
        if not self._window:
            _end(self._process)

    @write.releasing
    def show(self, recording: Path) -> None:
        """Open a complete recording in addition to those already shown."""
        stream = rr.RecordingStream(APPLICATION, recording_id=f"show-{recording.parent.name}", send_properties=False)
        stream.set_sinks(rr.GrpcSink(self.source))
        stream.log_file_from_path(recording)
        stream.flush()
        stream.disconnect()


SHARES = (0.05, 0.25, 0.5, 0.75, 1.0)  # shares of the machine time at which pictures are taken
_TO_DRAW_S = 60.0  # longest time for the viewer to start and to read the recording
_OPENED_S, _SETTLED_S = 4.0, 0.8
"""Waiting times: after opening, the viewer moves its cameras; after a new time, it draws for several frames."""


def take_screenshots(recording: Path, folder: str | Path, shares: tuple[float, ...] = SHARES) -> list[Path]:
    """Take screenshots of a recording in the viewer, at shares of its machine time.

    Parameters
    ----------
    recording : path
        Of a cut.
    folder : path
        For the files, ``cut-005.png`` and so on, named by the share in percent.
    shares : tuple of float
        0 to 1.

    Returns
    -------
    list of Path
        The pictures, 1920 x 1080.

    Raises
    ------
    InputError
        As `edmsim.recording.rerun.playback.find_recording`; or if the folder cannot be written to, or there is no
        Vulkan driver.
    """
    end_s = Playback(recording).end_s
    written = []
    with _headless(recording) as client:
        target = make_writable(folder)  # only here, because without a driver an empty folder would remain
        time.sleep(_OPENED_S)
        for share in shares:
            client.set_time(TIME, duration=share * end_s, play_state="paused")
            time.sleep(_SETTLED_S)
            file = target / f"cut-{round(100 * share):03d}.png"
            file.write_bytes(_picture(client))
            written.append(file)
    return written


def _picture(client: ViewerClient) -> bytes:
    """Return a screenshot; repeat it if a busy machine misses the viewer's own deadline."""
    until = time.monotonic() + _TO_DRAW_S
    while True:
        try:
            return client.take_screenshot()
        except TimeoutError:
            if time.monotonic() > until:
                raise InputError(f"the viewer made no picture in {_TO_DRAW_S:g} s; is the machine busy?") from None


@contextmanager
def _headless(recording: Path) -> Iterator[ViewerClient]:
    """Run the viewer without a window, bound to this machine, and yield a client of it."""
    port = free_port(0)
    with noted() as interrupts:  # because the viewer, in its own session, would outlive a command ended by SIGTERM
        process = _started(str(recording.resolve()), "--headless", "--port", str(port))
        try:
            interrupts.at_once()
            yield _connected(process, _source(port))
        finally:
            _end(process)


def _connected(process: subprocess.Popen[bytes], address: str) -> ViewerClient:
    until = time.monotonic() + _TO_DRAW_S
    while time.monotonic() < until and process.poll() is None:
        try:
            client = ViewerClient.connect(address)
            client.set_time(TIME, duration=0.0, play_state="paused")
        except (ConnectionError, RuntimeError):
            time.sleep(0.2)
        else:
            return client
    raise InputError(
        "rerun's viewer did not start without a window: it needs a Vulkan driver, on Debian and Ubuntu "
        "mesa-vulkan-drivers"
    )
