"""Output files are replaced completely, or not at all on a full disk; cuts are in `tests/test_nothing_lost.py`."""

import os
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest
from matplotlib.figure import Figure

from edmsim.files import LEFT_S, locked, replacing, unfinished
from edmsim.hil import Sensing
from edmsim.hil.samples import SampleFile
from edmsim.plant.kernel.state import OPEN
from edmsim.recording.figures.style import write_figure

from .hil.test_samples import made

NO_LIMIT = pytest.mark.skipif(sys.platform == "win32", reason="no limit of a file's size")


@contextmanager
def room_for(size):
    """Let a file have at most this many bytes, as on a full disk."""
    import resource

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_file_is_replaced_when_all_is_written(tmp_path):
    file = tmp_path / "report.json"
    file.write_text("old")
    with replacing(file) as partial:
        partial.write_text("new")
        assert file.read_text() == "old"
        assert partial.parent == file.parent
    assert [(f.name, f.read_text()) for f in tmp_path.iterdir()] == [("report.json", "new")]


def test_of_two_that_write_a_file_at_a_time_the_last_one_stays(tmp_path):
    file = tmp_path / "part.dxf"
    with replacing(file) as first:
        first.write_text("first")
        with replacing(file) as second:
            second.write_text("second, and longer")
        assert file.read_text() == "second, and longer"
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [("part.dxf", "first")]


def test_what_a_kill_left_half_written_is_removed_by_the_next_who_locks_the_folder(tmp_path):
    with locked(tmp_path):
        left, written, own = unfinished(tmp_path / "a.npz"), unfinished(tmp_path / "a.dxf"), tmp_path / "a.part"
        for file in (left, written, own):
            file.write_text("half")
        os.utime(left, times=(0.0, time.time() - 1.1 * LEFT_S))
    with locked(tmp_path):
        assert not left.exists()
        assert written.exists()
        assert own.exists()


@NO_LIMIT
@pytest.mark.parametrize("name", ["a.png", "a.pdf", "a.svg"])
def test_a_figure_that_finds_no_room_leaves_the_former_one(tmp_path, name):
    figure, file = Figure(), tmp_path / name
    figure.add_subplot().plot(np.random.default_rng(0).random(1000))
    file.write_bytes(b"former")
    with room_for(1000), pytest.raises(OSError, match="File too large") as refused:
        write_figure(figure, file)
    assert refused.value.filename == str(file)
    assert [(one.name, one.read_bytes()) for one in tmp_path.iterdir()] == [(name, b"former")]


@NO_LIMIT
@pytest.mark.parametrize("name", ["gap.wav", "gap.parquet"])
@pytest.mark.parametrize("windows", [1, 600])  # written on closing, and before
@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
def test_samples_that_find_no_room_leave_no_file_and_name_it(tmp_path, name, windows):
    file = tmp_path / name

    def written():
        with SampleFile(file, Sensing(noise_V=1.0)) as samples:
            for _ in range(windows):
                samples.frame(made([OPEN] * 10))

    with room_for(40), pytest.raises(OSError, match="File too large") as refused:
        written()
    assert refused.value.filename == str(file)
    assert list(tmp_path.iterdir()) == []
