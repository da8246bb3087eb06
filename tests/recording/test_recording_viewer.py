"""``edmsim view``: the right command line, bound to this machine, and bad folders named."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import rerun as rr
from rerun.chunk import RrdReader

from edmsim.errors import InputError
from edmsim.recording.rerun import viewer
from edmsim.recording.rerun.write import write_recording


@pytest.fixture(scope="module")
def written(cut: SimpleNamespace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("written") / "cut.rrd"
    write_recording(file, cut.scene, cut.windows, cut.frames, cut.closeups, cut.machine, cut.report, "punch.ngc")
    return file


@pytest.fixture
def folder(written: Path, tmp_path: Path) -> Path:
    """A folder with a recording, which may be damaged."""
    shutil.copy(written, tmp_path)
    return tmp_path


def test_missing_folder_and_missing_recording(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        viewer.find_recording(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"no cut\.rrd in it"):
        viewer.find_recording(tmp_path)


@pytest.mark.slow
def test_whole_recording_is_found(folder: Path) -> None:
    assert viewer.find_recording(folder) == folder / "cut.rrd"


@pytest.mark.parametrize("size", [0, 3, 100, 20_000, -1])
def test_damaged_recording_is_refused(folder: Path, size: int) -> None:
    recording = folder / "cut.rrd"
    recording.write_bytes(recording.read_bytes()[:size])
    with pytest.raises(InputError, match="not a whole rerun recording"):
        viewer.find_recording(folder)


def test_half_written_recording_is_named(tmp_path: Path) -> None:
    (tmp_path / "cut.rrd.part").write_bytes(b"RRF2")
    with pytest.raises(InputError, match=r"no cut\.rrd in it but one half-written"):
        viewer.find_recording(tmp_path)


def write_other(file: Path, application: str, made: str = "") -> None:
    recording = rr.RecordingStream(application, recording_id="other", send_properties=False)
    recording.save(file)
    recording.log("feed", rr.Scalars(1.0))
    if made:
        recording.log("made_by", rr.TextDocument(made), static=True)
    recording.flush()
    recording.disconnect()


def test_recording_of_another_version_is_refused(tmp_path: Path) -> None:
    write_other(tmp_path / "cut.rrd", "edmsim", '{"format": 99, "version": "9.1"}')
    with pytest.raises(InputError, match=r"format 99, written by edmsim 9\.1; this edmsim reads format 2"):
        viewer.find_recording(tmp_path)


def test_recording_of_the_first_version_or_another_program_is_refused(tmp_path: Path) -> None:
    write_other(tmp_path / "cut.rrd", "edmsim")  # it wrote no number
    with pytest.raises(InputError, match="format 1; this edmsim reads format 2, run the cut again"):
        viewer.find_recording(tmp_path)
    write_other(tmp_path / "cut.rrd", "somebody")
    with pytest.raises(InputError, match="a recording of somebody"):
        viewer.find_recording(tmp_path)


@pytest.mark.slow
def test_a_file_of_another_rerun_is_refused(folder: Path) -> None:
    recording = folder / "cut.rrd"
    whole = bytearray(recording.read_bytes())
    whole[4:8] = bytes((0, 99, 0, 0))  # the version stands behind the file's mark
    recording.write_bytes(whole)
    with pytest.raises(InputError, match=r"written by rerun 0\.99, here is 0\."):
        viewer.find_recording(folder)


def test_a_taken_port_is_replaced() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert viewer.free_port(port) not in (0, port)
    assert viewer.free_port(port) == port


def test_foreign_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "cut.rrd").write_text("G01 X10\n")
    with pytest.raises(InputError, match="these 8 bytes are not a whole rerun recording"):
        viewer.find_recording(tmp_path)


@pytest.mark.parametrize(
    ("environment", "platform", "expected"),
    [
        ({}, "linux", False), ({"DISPLAY": ""}, "linux", False), ({"DISPLAY": ":0"}, "linux", True),
        ({"WAYLAND_DISPLAY": "wayland-0"}, "linux", True), ({}, "darwin", True), ({}, "win32", True),
    ],
)  # fmt: skip
def test_screen(environment: dict[str, str], platform: str, expected: bool) -> None:
    assert viewer.has_screen(environment, platform) is expected


@pytest.mark.parametrize("on_screen", [True, False])
def test_nothing_is_served_beyond_this_machine(on_screen: bool, tmp_path: Path) -> None:
    command = viewer.viewer_command(tmp_path / "cut.rrd", on_screen, 9191, 9881)
    assert command[: len(viewer.RERUN) + 1] == [*viewer.RERUN, str(tmp_path / "cut.rrd")]
    assert command[command.index("--bind") + 1] == "127.0.0.1"
    assert ("--serve-web" in command) is not on_screen


def test_rerun_knows_every_option_used(tmp_path: Path) -> None:
    shown = subprocess.run([*viewer.RERUN, "--help"], capture_output=True, text=True, check=True)
    for on_screen in (True, False):
        command = viewer.viewer_command(tmp_path / "cut.rrd", on_screen, 9191, 9881)
        assert all(word in shown.stdout for word in command if word.startswith("--"))


@pytest.mark.slow
def test_view_runs_the_viewer_and_says_the_address(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "RUST_LOG"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    called: list[list[str]] = []

    def call(command: list[str], env: dict[str, str]) -> int:
        assert env["RUST_LOG"] == "warn"  # no lines of INFO on the terminal
        called.append(command)
        raise KeyboardInterrupt

    monkeypatch.setattr(subprocess, "call", call)
    monkeypatch.setattr(viewer, "free_port", lambda port: port)
    assert viewer.view(folder, web_port=9191, grpc_port=9881) == 0
    assert called == [viewer.viewer_command(folder / "cut.rrd", False, 9191, 9881)]
    address = "http://127.0.0.1:9191?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A9881%2Fproxy"
    assert address in capsys.readouterr().out


@pytest.mark.slow
def test_without_a_window_it_serves_the_page(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DISPLAY", ":77")  # a display that is not there
    monkeypatch.delenv("RUST_LOG", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    called: list[list[str]] = []

    def call(command: list[str], env: dict[str, str]) -> int:
        assert env["RUST_LOG"] == "warn"  # no lines of INFO on the terminal
        called.append(command)
        return 1 if len(called) == 1 else 0

    monkeypatch.setattr(subprocess, "call", call)
    assert viewer.view(folder) == 0
    assert ["--serve-web" in command for command in called] == [False, True]
    assert "could not open a window" in capsys.readouterr().out


@pytest.mark.slow
def test_two_cuts_are_laid_side_by_side(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[set[str]] = []

    def look(recording: Path, *_: object) -> int:
        shown.append({chunk.entity_path for chunk in RrdReader(recording).stream().to_chunks()})
        return 0

    monkeypatch.setattr(viewer, "_show", look)
    assert viewer.compare(folder, folder) == 0
    for entity in ("/world/table/workpiece", "/top/rays", "/scope/voltage", "/feed/feed_um_s", "/events"):
        assert {f"/a{entity}", f"/b{entity}"} <= shown[0]
    with pytest.raises(InputError, match="no such folder"):
        viewer.compare(folder, folder / "nowhere")


def test_the_viewers_exit_status_is_stored(tmp_path: Path) -> None:
    assert subprocess.call([*viewer.RERUN, "--no-such-option"], stderr=subprocess.DEVNULL) != 0
