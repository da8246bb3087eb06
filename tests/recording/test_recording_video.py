"""``edmsim report --film``: films that play, pictures without a screen, and what cannot be done in one line."""

from __future__ import annotations

import dataclasses
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from edmsim.errors import InputError
from edmsim.recording import Closeups, Frames, Playback, WindowTable, render, take_screenshots
from edmsim.recording.film import Film
from edmsim.recording.rerun.viewer import SHARES
from edmsim.recording.rerun.write import write_recording


def write(folder: Path, cut: SimpleNamespace, **changed: object) -> Path:
    arguments = {name: getattr(cut, name) for name in ("scene", "windows", "frames", "closeups", "machine", "report")}
    write_recording(folder / "cut.rrd", **(arguments | changed), title="punch.ngc")
    return folder / "cut.rrd"


@pytest.fixture(scope="module")
def recording(cut: SimpleNamespace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("recording"), cut)


@pytest.mark.slow
def test_legends_of_a_film_cover_no_curve(recording: Path) -> None:
    film = Film(Playback(recording), 60)
    legends = [(axes, axes.get_legend()) for axes in film._figure.axes if axes.get_legend() is not None]
    assert len(legends) == 2
    for axes, legend in legends:
        assert legend.get_window_extent().y0 > axes.get_window_extent().y1 - 1.0
        assert not legend.get_window_extent().overlaps(axes.title.get_window_extent())


@pytest.mark.slow
def test_a_gif_plays_the_cut(recording: Path, tmp_path: Path) -> None:
    render(recording, tmp_path / "new" / "cut.gif", seconds=0.8)
    with Image.open(tmp_path / "new" / "cut.gif") as film:
        assert (film.n_frames, film.size) == (8, (768, 432))
        first = np.asarray(film.convert("RGB"), int)
        film.seek(7)
        last = np.asarray(film.convert("RGB"), int)
    assert 0.001 < (np.abs(last - first).max(axis=2) > 60).mean() < 0.5
    assert [file.name for file in (tmp_path / "new").iterdir()] == ["cut.gif"]


@pytest.mark.slow
def test_an_mp4_plays_the_cut(recording: Path, tmp_path: Path) -> None:
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
def test_pictures_show_the_kerf_grow_and_are_the_same_again(recording: Path) -> None:
    play = Playback(recording)
    film = Film(play, 60)
    begin, end = (film.picture(share * play.end_s) for share in (0.02, 1.0))
    ground = np.all(begin[60:250, 20:230] < 60, axis=2).sum(), np.all(end[60:250, 20:230] < 60, axis=2).sum()
    assert ground[1] > ground[0] + 200  # dark pixels of the kerf
    np.testing.assert_array_equal(film.picture(0.02 * play.end_s), begin)


@pytest.mark.parametrize(
    ("name", "seconds", "message"),
    [("cut.avi", 1.0, r"'\.avi' is not a film"), ("cut", 1.0, "is not a film"),
     ("cut.gif", 0.0, "0 s cannot be made"),
     ("cut.gif", float("nan"), "nan s cannot"), ("cut.mp4", 1e4, "give 0.5 to 600")],
)  # fmt: skip
def test_what_is_no_film_is_refused(
    recording: Path, tmp_path: Path, name: str, seconds: float, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        render(recording, tmp_path / name, seconds)
    assert list(tmp_path.iterdir()) == []


def test_mp4_without_its_package_says_what_to_install(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"pip install 'edmsim\[video\]'"):
        render(recording, tmp_path / "cut.mp4")
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_and_a_cut_of_no_windows(cut: SimpleNamespace, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    empty = write(
        tmp_path, cut, windows=WindowTable().to_arrow(), frames=Frames(9), closeups=Closeups(9, 32, 4),
        scene=dataclasses.replace(cut.scene, cut_edges_mm=()),
    )  # fmt: skip
    with pytest.raises(InputError, match="cannot be written"):
        render(empty, tmp_path / "file" / "cut.gif")
    with pytest.raises(InputError, match="no window"):
        render(empty, tmp_path / "cut.gif")
    assert not (tmp_path / "cut.gif").exists()


@pytest.mark.slow
def test_without_a_graphics_driver_screenshots_say_so(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WGPU_BACKEND", "dx12" if sys.platform != "win32" else "metal")  # no such thing here
    with pytest.raises(InputError, match="Vulkan driver"):
        take_screenshots(recording, tmp_path / "shots")


@pytest.mark.slow
@pytest.mark.skipif(
    not any(Path("/usr/share/vulkan/icd.d").glob("*.json")) and shutil.which("vulkaninfo") is None,
    reason="no Vulkan driver",
)
def test_screenshots_need_no_screen(recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    files = take_screenshots(recording, tmp_path / "shots", (0.0, 1.0))
    assert [file.name for file in files] == ["cut-000.png", "cut-100.png"]
    begin, end = (np.asarray(Image.open(file).convert("RGB"), int) for file in files)
    assert begin.shape == (1080, 1920, 3)
    assert (np.abs(end - begin).max(axis=2) > 60).mean() > 0.001
    left = subprocess.run(["pgrep", "-P", str(os.getpid())], capture_output=True, text=True, check=False)
    assert "rerun" not in left.stdout


def test_shares_are_within_the_cut() -> None:
    assert all(0 <= share <= 1 for share in SHARES)
