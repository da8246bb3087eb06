"""``edmsim view``: the right command line, bound to this machine, bad folders named; and the film of a cut."""

import dataclasses
import os
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
import shapely
from PIL import Image
from rerun.chunk import RrdReader

from edmsim.errors import InputError
from edmsim.files import locked_file, unfinished
from edmsim.recording.report import PassFigures
from edmsim.recording.rerun import viewer
from edmsim.recording.rerun.playback import Playback
from edmsim.recording.rerun.viewer import take_screenshots
from edmsim.recording.scene import Terrace, polylines
from edmsim.recording.video import Film, render
from edmsim.recording.windows import column

from .conftest import LEAD, changed


@pytest.fixture
def folder(recording, tmp_path):
    """A folder with a recording, which may be damaged."""
    shutil.copy(recording, tmp_path)
    return tmp_path


def cut_off(size):
    return lambda file: file.write_bytes(file.read_bytes()[:size])


def written_by(application, made=""):
    """Return what writes a recording of another program, or of another version."""

    def write(file):
        recording = rr.RecordingStream(application, recording_id="other", send_properties=False)
        recording.save(file)
        recording.log("feed", rr.Scalars(1.0))
        if made:
            recording.log("made_by", rr.TextDocument(made), static=True)
        recording.flush()
        recording.disconnect()

    return write


def of_rerun_0_99(file):
    whole = file.read_bytes()
    file.write_bytes(whole[:4] + bytes((0, 99, 0, 0)) + whole[8:])  # the version stands behind the file's mark


@pytest.mark.parametrize(("spoil", "reason"), [
    (lambda file: shutil.rmtree(file.parent), "no such folder"), (Path.unlink, r"no cut\.rrd in it"),
    (lambda file: file.rename(unfinished(file)), r"no cut\.rrd in it but one half-written"),
    *((cut_off(size), "not a whole rerun recording") for size in (0, 3, 100, 20_000, -1)),
    (lambda file: file.write_text("G01 X10\n"), "these 8 bytes are not a whole rerun recording"),
    (written_by("edmsim", '{"format": 99, "version": "9.1"}'),
     r"format 99, written by edmsim 9\.1; this edmsim reads format 2"),
    (written_by("edmsim"), "format 1; this edmsim reads format 2, run the cut again"),  # it wrote no number
    (written_by("somebody"), "a recording of somebody"),
    (of_rerun_0_99, r"written by rerun 0\.99, and 0\.\d+ is installed"),
])  # fmt: skip
def test_what_cannot_be_played_is_refused_by_what_it_is(spoil, reason, folder):
    spoil(folder / "cut.rrd")
    with pytest.raises(InputError, match=reason):
        viewer.find_recording(folder)


def test_a_file_is_no_folder(folder):
    with pytest.raises(InputError, match=r"cut\.rrd: a file, give the folder that .* wrote; the command rerun shows"):
        viewer.find_recording(folder / "cut.rrd")


def test_a_folder_is_no_recording(tmp_path):
    with pytest.raises(InputError, match=r"cannot be read: Is a directory; give a cut's cut\.rrd"):
        Playback(tmp_path)


def test_a_taken_port_is_replaced():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert viewer.free_port(port) not in (0, port)
    assert viewer.free_port(port) == port


@pytest.mark.parametrize(("environment", "platform", "expected"), [
    ({}, "linux", False), ({"DISPLAY": ""}, "linux", False), ({"DISPLAY": ":0"}, "linux", True),
    ({"WAYLAND_DISPLAY": "wayland-0"}, "linux", True), ({}, "darwin", True), ({}, "win32", True),
])  # fmt: skip
def test_screen(environment, platform, expected):
    assert viewer.has_screen(environment, platform) is expected


@pytest.mark.parametrize("on_screen", [True, False])
def test_nothing_is_served_beyond_this_machine(on_screen, tmp_path):
    command = viewer.viewer_command(tmp_path / "cut.rrd", on_screen, 9191, 9881)
    assert command[: len(viewer.RERUN) + 1] == [*viewer.RERUN, str(tmp_path / "cut.rrd")]
    assert command[command.index("--bind") + 1] == "127.0.0.1"
    assert ("--serve-web" in command) is not on_screen


@pytest.mark.slow
def test_rerun_knows_every_option_used_and_fails_at_another(tmp_path):
    shown = subprocess.run([*viewer.RERUN, "--help"], capture_output=True, text=True, check=True)
    for on_screen in (True, False):
        command = viewer.viewer_command(tmp_path / "cut.rrd", on_screen, 9191, 9881)
        assert all(word in shown.stdout for word in command if word.startswith("--"))
    assert subprocess.call([*viewer.RERUN, "--no-such-option"], stderr=subprocess.DEVNULL) != 0


@pytest.mark.slow
def test_view_serves_a_page_where_no_window_opens_and_says_its_address(folder, monkeypatch, capsys):
    for name in ("WAYLAND_DISPLAY", "RUST_LOG"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("DISPLAY", ":77")  # a display that is not there
    monkeypatch.setattr(sys, "platform", "linux")
    called = []
    ends = iter((1, 0))

    def call(command, env):
        assert env["RUST_LOG"] == "warn"  # no lines of INFO on the terminal
        called.append(command)
        for status in ends:
            return status
        raise KeyboardInterrupt

    monkeypatch.setattr(subprocess, "call", call)
    monkeypatch.setattr(viewer, "free_port", lambda port: port)
    window, page = (viewer.viewer_command(folder / "cut.rrd", on_screen, 9191, 9881) for on_screen in (True, False))
    assert viewer.view(folder, web_port=9191, grpc_port=9881) == 0
    assert called == [window, page]
    assert "could not open a window" in capsys.readouterr().out
    monkeypatch.delenv("DISPLAY")
    assert viewer.view(folder, web_port=9191, grpc_port=9881) == 0
    assert called[2:] == [page]
    address = "http://127.0.0.1:9191?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A9881%2Fproxy"
    assert address in capsys.readouterr().out


@pytest.mark.slow
def test_two_cuts_are_laid_side_by_side(folder, monkeypatch):
    shown = []

    def look(recording, *_):
        shown.append({chunk.entity_path for chunk in RrdReader(recording).stream().to_chunks()})
        return 0

    monkeypatch.setattr(viewer, "_show", look)
    assert viewer.compare(folder, folder) == 0
    for entity in ("/world/table/workpiece", "/top/rays", "/scope/voltage", "/feed/feed_um_s", "/events"):
        assert {f"/a{entity}", f"/b{entity}"} <= shown[0]
    with pytest.raises(InputError, match="no such folder"):
        viewer.compare(folder, folder / "nowhere")


# ``edmsim report --film``: films that play, pictures without a screen, and what cannot be done in one line.


@pytest.mark.slow
def test_legends_of_a_film_cover_no_curve(play):
    film = Film(play, 60)
    legends = [(axes, axes.get_legend()) for axes in film._figure.axes if axes.get_legend() is not None]
    assert len(legends) == 2
    for axes, legend in legends:
        assert legend.get_window_extent().y0 > axes.get_window_extent().y1 - 1.0
        assert not legend.get_window_extent().overlaps(axes.title.get_window_extent())


@pytest.mark.slow
def test_a_gif_plays_the_cut(recording, tmp_path):
    render(recording, tmp_path / "new" / "cut.gif", seconds=0.8)
    with Image.open(tmp_path / "new" / "cut.gif") as film:
        assert (film.n_frames, film.size) == (8, (768, 432))
        first = np.asarray(film.convert("RGB"), int)
        film.seek(7)
        last = np.asarray(film.convert("RGB"), int)
    assert 0.001 < (np.abs(last - first).max(axis=2) > 60).mean() < 0.5
    assert [file.name for file in (tmp_path / "new").iterdir()] == ["cut.gif"]


@pytest.mark.slow
def test_an_mp4_plays_the_cut(recording, tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    render(recording, tmp_path / "cut.mp4", seconds=0.5)
    done = subprocess.run(
        [ffmpeg.get_ffmpeg_exe(), "-i", str(tmp_path / "cut.mp4"), "-f", "null", "-"],
        capture_output=True, text=True, check=True,
    ).stderr  # fmt: skip
    assert "h264" in done
    assert "1280x720" in done
    assert "25 fps" in done
    assert "frame=   12" in done


@pytest.mark.slow
def test_pictures_show_the_kerf_grow_and_are_the_same_again(play):
    film = Film(play, 60)
    begin, end = (film.picture(share * play.end_s) for share in (0.02, 1.0))
    ground = np.all(begin[60:250, 20:230] < 60, axis=2).sum(), np.all(end[60:250, 20:230] < 60, axis=2).sum()
    assert ground[1] > ground[0] + 200  # dark pixels of the kerf
    np.testing.assert_array_equal(film.picture(0.02 * play.end_s), begin)


@pytest.mark.parametrize(("name", "seconds", "message"), [
    ("cut.gif", "1", "seconds cannot be '1': give float"), ("cut.avi", 1.0, r"a film is written as \.mp4 \.gif"),
    ("cut", 1.0, "a film is written"), ("cut.gif", 0.0, "0 s cannot be made"),
    ("cut.gif", float("nan"), "nan s cannot"), ("cut.mp4", 1e4, "give 0.5 to 600"),
])  # fmt: skip
def test_what_is_no_film_is_refused(recording, tmp_path, name, seconds, message):
    with pytest.raises(InputError, match=message):
        render(recording, tmp_path / name, seconds)
    assert list(tmp_path.iterdir()) == []


def test_two_films_are_not_drawn_into_one_file(recording, tmp_path):
    film = tmp_path / "cut.gif"
    with locked_file(film, "edmsim report"), pytest.raises(InputError, match="another edmsim report is at work on"):
        render(recording, film, 0.5)
    assert list(tmp_path.iterdir()) == []


def test_the_kerf_in_the_upper_face_is_not_covered_by_layers_below(cut, record, tmp_path):
    box = shapely.box(15.0, 15.0, 17.0, 31.0)  # as high as a layer of the solid: a slice of nine
    faces = (box, 4 * 20.0 / 9), (shapely.box(*cut.scene.stock_mm).difference(box), 20.0)
    led_mm = [(0.1 * ((k + 0.5) * 20.0 / 9 - 10.0), 0.0) for k in range(9)]
    edges = zip(led_mm, cut.scene.cut_edges_mm, strict=True)
    scene = dataclasses.replace(
        cut.scene, lead=LEAD, terraces=tuple(Terrace(polylines(face), height) for face, height in faces),
        cut_edges_mm=tuple(tuple(line + by for line in lines) for by, lines in edges),
    )
    rows = cut.windows.take(np.arange(0, len(cut.windows), 30))
    play = Playback(record(
        tmp_path / "cut.rrd", scene=scene, windows=changed(rows, x_um=column(rows, "x_um") - 2000.0)
    ))  # fmt: skip
    film = Film(play, 60)
    film.picture(play.end_s)
    metal = shapely.union_all([shapely.Polygon(path.vertices) for path in film._metal.get_paths()])
    assert not metal.contains(shapely.Point(30.155 + led_mm[-1][0], 23.0))  # on the path, at the upper face
    assert metal.contains(shapely.Point(16.0, 23.0))  # the lower face is drawn


def test_a_film_ended_by_a_signal_leaves_nothing_behind(recording, tmp_path, monkeypatch):
    monkeypatch.setattr(Film, "picture", lambda *of: os.kill(os.getpid(), signal.SIGTERM))
    with pytest.raises(KeyboardInterrupt):
        render(recording, tmp_path / "cut.gif", 0.5)
    assert list(tmp_path.iterdir()) == []


def test_mp4_without_its_package_says_what_to_install(recording, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"pip install 'edmsim\[video\]'"):
        render(recording, tmp_path / "cut.mp4")
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_and_a_cut_of_no_windows(empty_recording, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        render(empty_recording, tmp_path / "file" / "cut.gif")
    with pytest.raises(InputError, match="no window"):
        render(empty_recording, tmp_path / "cut.gif")
    assert not (tmp_path / "cut.gif").exists()


def test_a_viewer_without_a_window_does_not_outlast_its_command(tmp_path, monkeypatch):
    shown = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"], start_new_session=True)
    monkeypatch.setattr(viewer, "_started", lambda *options: shown)
    monkeypatch.setattr(viewer, "_connected", lambda *of: os.kill(os.getpid(), signal.SIGTERM))
    with pytest.raises(KeyboardInterrupt), viewer._headless(tmp_path / "cut.rrd"):
        pass
    assert shown.poll() is not None


@pytest.mark.slow
def test_without_a_graphics_driver_screenshots_say_so(recording, tmp_path, monkeypatch):
    monkeypatch.setenv("WGPU_BACKEND", "dx12" if sys.platform != "win32" else "metal")  # no such thing here
    with pytest.raises(InputError, match="Vulkan driver"):
        take_screenshots(recording, tmp_path / "shots")
    assert not (tmp_path / "shots").exists()


@pytest.mark.slow
@pytest.mark.skipif(
    not any(Path("/usr/share/vulkan/icd.d").glob("*.json")) and shutil.which("vulkaninfo") is None,
    reason="no Vulkan driver",
)
def test_screenshots_need_no_screen(recording, tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    files = take_screenshots(recording, tmp_path / "shots", (0.0, 1.0))
    assert [file.name for file in files] == ["cut-000.png", "cut-100.png"]
    begin, end = (np.asarray(Image.open(file).convert("RGB"), int) for file in files)
    assert begin.shape == (1080, 1920, 3)
    assert (np.abs(end - begin).max(axis=2) > 60).mean() > 0.001
    left = subprocess.run(["pgrep", "-P", str(os.getpid())], capture_output=True, text=True, check=False)
    assert "rerun" not in left.stdout


@pytest.mark.slow
def test_curves_of_passes_are_read_on_the_time_of_the_machine(record, cut, play, tmp_path):
    """Each is in the recording once more, on the timeline of its pass."""
    trim = PassFigures(1, 2, "profile", True, 1.0, 5.0, *[0.0] * 10, [0.0], *[0.0] * 4)
    again = Playback(record(tmp_path / "cut.rrd", report=dataclasses.replace(cut.report, passes=[trim])))
    for found, expected in zip(again.series("/feed/feed_um_s"), play.series("/feed/feed_um_s"), strict=True):
        assert found.tolist() == expected.tolist()
