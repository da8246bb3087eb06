"""Cuts whose motion another program makes; the HAL component with a stand-in of LinuxCNC's module, and LinuxCNC."""

import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest

import edmsim
from edmsim.errors import InputError
from edmsim.hil.external import ExternalMotion

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "linuxcnc"
LINE = "G21 G90\nG0 X0 Y0\nM64 P0\nM66 P0 L3 Q60\nM52 P1\nF60\nG1 X0.8\nM52 P0\nM65 P0\nM2\n"


class Other:
    """A program that runs along x at a feed, and back a little on the way, as the clock of the cut goes."""

    def __init__(self, feed_um_s, distance_um):
        self.feed_um_s, self.distance_um = feed_um_s, distance_um
        self.windows = []

    def place_um(self):
        time_s = self.windows[-1].time_s if self.windows else 0.0
        place = self.feed_um_s * time_s - 20.0 * (time_s > 2.0)
        return 1000.0 + min(place, self.distance_um), -500.0

    def finished(self):
        return self.place_um()[0] >= 1000.0 + self.distance_um

    def show(self, windows):
        self.windows.append(windows)


def program(folder, text=LINE):
    file = folder / "line.ngc"
    file.write_text(text)
    return file


@pytest.fixture(scope="module")
def gap(load_script):
    return load_script(EXAMPLE / "gap.py")


def cut(file, controller, **options):
    return edmsim.cut(file, controller=controller, resolution="fast", height_mm=10.0, **options)


@pytest.mark.slow
@pytest.mark.parametrize("generator", ["iso-pulse", "iso-energetic"])
def test_the_axes_go_where_the_other_program_is_and_the_cut_is_one_as_any(tmp_path, gap, generator):
    other = Other(60.0, 300.0)
    file = gap.without_words(str(program(tmp_path)), str(tmp_path))
    result = cut(file, ExternalMotion(other, 1e9), generator=generator)
    assert result.report["outcome"] == "emergency-stop"
    assert re.match(r"the program that moves .* ended at 0\.\d+ of 0\.800 mm of the path", result.report["reason"])
    windows = result.windows
    x, path = (windows.column(name).to_numpy() for name in ("x_um", "path_um"))
    assert x[-1] - x[0] == pytest.approx(300.0, abs=4.0)
    assert path[-1] == pytest.approx(300.0, abs=4.0)
    assert np.diff(path).min() < -5.0  # it went back where the other program did
    assert windows.column("feed_um_s").to_numpy()[-20:].mean() == pytest.approx(30.0, abs=5.0)
    assert len(other.windows) == windows.num_rows


def test_a_cut_in_real_time_takes_its_time(tmp_path, gap):
    file = gap.without_words(str(program(tmp_path)), str(tmp_path))
    other = Other(1000.0, 100.0)
    began = time.monotonic()
    cut(file, ExternalMotion(other, 0.5))
    assert time.monotonic() - began >= 0.9 * other.windows[-2].time_s / 0.5


def test_axes_that_are_behind_when_the_other_program_ends_go_to_its_end(tmp_path, gap):
    class Ahead(Other):
        def place_um(self):
            return 1000.0 + 60.0 * (len(self.windows) > 3), -500.0

    file = gap.without_words(str(program(tmp_path, LINE.replace("X0.8", "X0.07"))), str(tmp_path))
    other = Ahead(0.0, 60.0)
    result = cut(file, ExternalMotion(other, 1e9))
    assert result.report["outcome"] == "finished"
    path_um = result.windows.column("path_um").to_numpy()
    assert path_um[3] == 0.0
    assert path_um[4] < 55.0  # a window at the rapid feed is not enough
    assert path_um[-1] == pytest.approx(60.0, abs=3.0)


def test_a_second_contour_a_bad_scale_and_a_resumed_cut_are_refused(tmp_path):
    with pytest.raises(InputError, match="time_scale is above 0"):
        ExternalMotion(Other(1.0, 1.0), math.nan)
    motion = ExternalMotion(Other(1.0, 1.0))
    with pytest.raises(InputError, match="cannot be resumed"):
        motion.restore(motion.snapshot())
    machine, points = edmsim.Machine.load(), np.array([[0.0, 0.0], [100.0, 0.0]])
    other = Other(1000.0, 100.0)
    for text in ("G1 X0.1\nG4 P0.1\nG1 X0.2\nM2\n", "G1 X0.1\nG0 X1\nG1 X1.1\nM2\n"):
        with pytest.raises(InputError, match="one contour without dwells"):
            cut(program(tmp_path, "G21 G90\nG0 X0 Y0\n" + text), ExternalMotion(other, 1e9), out=tmp_path / "out")
    assert not other.windows
    assert not (tmp_path / "out").exists()
    lost = Other(1.0, 1.0)
    motion = ExternalMotion(lost, 1e9)
    motion.set_up(machine, points, 0.0)
    motion.reset(30.0)
    lost.feed_um_s = math.nan
    with pytest.raises(InputError, match="a place of the program that moves the axes, in um, is nan"):
        motion.path_run("exact").advance(0, 10**6, 0)
    for place_um in ((0.0, 0.0, 0.0), None):
        lost.place_um = lambda place_um=place_um: place_um
        with pytest.raises(InputError, match=r"moves the axes, in um, is .*: give x and y"):
            motion.path_run("exact").advance(0, 10**6, 0)


class Component(dict):
    """A HAL component of the stand-in."""

    def __init__(self, name):
        super().__init__()
        self.name, self.made = name, {}

    def newpin(self, name, kind, direction):
        self.made[name] = (kind, direction)
        self[name] = False if kind == "bit" else 0.0

    newparam = newpin


HAL = SimpleNamespace(component=Component, HAL_FLOAT="float", HAL_BIT="bit", HAL_IN="in", HAL_OUT="out", HAL_RW="rw")


def test_the_component_has_the_pins_of_its_page(gap):
    made = gap.make_component(HAL, "edm-gap").made
    assert [name for name, pin in made.items() if pin == ("float", "in")] == ["x", "y", "u", "v"]
    assert made["enable"] == ("bit", "in")
    assert made["time-scale"] == ("float", "rw")
    for name in ("gap-voltage", "short-ratio", "open-ratio", "spark-ratio"):
        assert made[name] == ("float", "out")
    assert made["wire-broken"] == ("bit", "out")


def test_words_of_linuxcnc_are_left_out_with_their_numbers(tmp_path, gap):
    file = program(tmp_path, "G1 X1 m52 p1\nY1 M62 P1\nN3M64P0\nM66 P0 L3 Q60\nM62P3\nM68 E0 Q1.5\nM2\nM30\n")
    (tmp_path / "out").mkdir()
    text = gap.without_words(str(file), str(tmp_path / "out")).read_text()
    assert [line.strip() for line in text.splitlines()] == ["G1 X1", "Y1", "N3", "", "", "", "M2", "M30"]


def test_a_program_that_cannot_be_read_ends_the_component_in_one_line_before_it_is_ready(tmp_path, gap, monkeypatch):
    file = tmp_path / "line.ngc"
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(sys, "argv", ["gap.py", str(file)])
    for said in ("no such file", "byte 1 is not UTF-8"):
        with pytest.raises(SystemExit, match=f"^edmsim: {file}: {said}"):
            gap.main()
        file.write_bytes(b"(\xfcber)\nG1 X1\n")


def test_without_linuxcnc_the_component_ends_in_one_line(gap, monkeypatch):
    monkeypatch.setattr(gap, "DEBIAN", "nowhere")
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setitem(sys.modules, "hal", None)
    monkeypatch.setattr(sys, "argv", ["gap.py", str(EXAMPLE / "part.ngc")])
    with pytest.raises(SystemExit, match=r"^edmsim: Python 3\.\d+ cannot load LinuxCNC's module hal, of "):
        gap.main()


@pytest.mark.slow
def test_the_component_cuts_while_enable_is_high(tmp_path, gap):
    component = gap.make_component(HAL, "edm-gap")
    component["time-scale"] = 200.0
    chosen = gap.arguments([str(program(tmp_path)), "--out", str(tmp_path / "out"), "--height", "10"])
    (tmp_path / "words").mkdir()
    read = gap.without_words(chosen.program, str(tmp_path / "words"))
    thread = threading.Thread(target=gap.serve, args=(component, chosen, read, 1))
    thread.start()
    component["x"], component["enable"] = 5.0, True
    until = time.monotonic() + 60.0
    while not component["cutting"]:
        assert time.monotonic() < until
        time.sleep(0.01)
    while component["x"] < 5.1:  # 10 um/s in the gap, and 200 times as fast here
        component["x"] += 0.002
        time.sleep(0.001)
    assert component["gap-voltage"] > 0.0
    assert sum(component[f"{kind}-ratio"] for kind in ("short", "open", "spark")) == pytest.approx(1.0, abs=0.1)
    component["enable"] = False
    thread.join(60.0)
    assert not component["cutting"]
    windows = pq.read_table(tmp_path / "out" / "windows.parquet")
    x = windows.column("x_um").to_numpy()
    assert x[-1] - x[0] == pytest.approx(100.0, abs=6.0)
    assert (tmp_path / "out" / "cut.rrd").is_file()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("linuxcnc") is None, reason="LinuxCNC (Debian: linuxcnc-uspace) is not here")
def test_linuxcnc_cuts_through_the_gap_and_it_is_recorded_as_any_cut(tmp_path):
    config = tmp_path / "config"
    shutil.copytree(EXAMPLE, config)
    python = f"env PYTHONPATH={ROOT} {sys.executable}"
    changes = {
        "DISPLAY = axis": "DISPLAY = ./run_once.py", "PYVCP = panel.xml": "", "POSTGUI_HALFILE = panel.hal": "",
        "PYTHON = python3": f"PYTHON = {python}",
    }  # fmt: skip
    text = (config / "edm.ini").read_text()
    for was, is_now in changes.items():
        assert was in text
        text = text.replace(was, is_now)
    (config / "edm.ini").write_text(text)
    (config / "part.ngc").write_text(LINE)
    with tempfile.TemporaryDirectory() as fifo:
        Path(fifo).chmod(0o777)
        own = {"HOME": str(tmp_path), "RTAPI_FIFO_PATH": f"{fifo}/fifo"}
        if os.getuid() == 0:
            own["RTAPI_UID"] = "65534"  # its real-time part does not run as root
        subprocess.run(["linuxcnc", "edm.ini"], cwd=config, env={**os.environ, **own}, timeout=100, check=False)
    out = config / "out" / "linuxcnc"
    windows = pq.read_table(out / "windows.parquet")
    x, spark = windows.column("x_um").to_numpy(), windows.column("spark").to_numpy()
    assert windows.column("path_um").to_numpy()[-1] == pytest.approx(800.0, abs=6.0)
    assert x[-1] - x[0] == pytest.approx(800.0, abs=60.0)  # it may have moved before the first window was cut
    assert spark.sum() > 1000
    assert {file.name for file in out.iterdir()} >= {"report.html", "cut.rrd", "profile.png"}
