"""A resumed cut has the same bits as an uninterrupted one, and is refused with other settings."""

import json
import shutil
import signal
import threading
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

import edmsim
from edmsim import models
from edmsim.controllers import FeedCommand
from edmsim.errors import InputError
from edmsim.job.cut import CHECKPOINT

from .conftest import timeless

SHORT = {"max_time_s": 8.0}
STEEL = "technologies/tool-steel-brass-254.toml"


def stop_after(windows):
    """Return a watcher that presses Ctrl-C at the end of a window."""
    left = windows

    def watch(_):
        nonlocal left
        left -= 1
        if left == 0:
            raise KeyboardInterrupt

    return watch


def interrupted(cut, folder, windows=100, **options):
    with pytest.raises(KeyboardInterrupt):
        cut(out=folder, watch=stop_after(windows), **{**SHORT, **options})


@contextmanager
def edited(file):
    """Yield the arrays and the JSON of a checkpoint, and store their changes."""
    with np.load(file) as stored:
        arrays = dict(stored)
    document = json.loads(arrays["__json__"].tobytes())
    yield arrays, document
    arrays["__json__"] = np.frombuffer(json.dumps(document).encode(), np.uint8)
    np.savez(file, **arrays)


def columns(result):
    return {name: result.windows.column(name).to_numpy() for name in result.windows.column_names}


def assert_same(a, b):
    assert timeless(a.report) == timeless(b.report)
    np.testing.assert_equal(columns(a), columns(b))
    assert a.contour(0).equals(b.contour(0))
    assert a.closeups.table().tobytes() == b.closeups.table().tobytes()


@pytest.fixture(scope="module")
def whole(cut_small):
    """Return the uninterrupted cut."""
    return cut_small(**SHORT)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [{}, {"planner": "dda"}, {"planner": "poscal-literal"}, {"drive": "uhu"}, {"generator": "iso-energetic"},
     {"generator": "ignition-pulse", "controller": "fixed:feed_um_s=12"},
     {"generator": "iso-energetic", "pulse_shape": "triangle", "peak_current_A": 5.0, "flushing_lower_Pa": 0.0,
      "standoff_upper_mm": 1.0}],
)  # fmt: skip
def test_resumed_cut_equals_the_uninterrupted_one(cut_small, whole, tmp_path, options):
    uninterrupted = cut_small(**SHORT, **options) if options else whole
    interrupted(cut_small, tmp_path, **options)
    assert [file.name for file in tmp_path.iterdir()] == [CHECKPOINT]
    resumed = cut_small(out=tmp_path, resume=True, **SHORT, **options)
    assert_same(resumed, uninterrupted)
    assert not (tmp_path / CHECKPOINT).exists()
    assert (tmp_path / "report.json").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("signals")
def test_ctrl_c_within_a_window_waits_for_its_end(cut_small, whole, tmp_path):
    interrupted = 0
    while True:
        hand = threading.Timer(0.002, signal.raise_signal, (signal.SIGINT,))
        # up to four interrupts, of which one must succeed, because a busy machine may finish the cut first
        begin = iter([hand.start] if interrupted < 4 else [])
        try:
            result = cut_small(out=tmp_path, resume=interrupted > 0, watch=lambda _, b=begin: next(b, int)(), **SHORT)
            hand.cancel()
            break
        except KeyboardInterrupt:
            interrupted += 1
            hand.join()
    assert interrupted
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert_same(result, whole)


@pytest.mark.slow
def test_twice_interrupted_and_in_a_dwell(tmp_path):
    program = tmp_path / "dwell.ngc"
    program.write_text("G0 X0 Y0\nG1 X0.101\nG4 P3\nG1 Y0.203\nG4 P1\nG1 X0\nM2\n")
    options = {"height_mm": 5.0, "resolution": "fast", "offset": "none"}
    whole = edmsim.cut(program, **options)
    assert whole.report["outcome"] == "finished"
    t_s, path_um = (whole.windows.column(name).to_numpy() for name in ("t_s", "path_um"))
    in_dwell = int(np.flatnonzero(np.diff(path_um) == 0)[20])
    assert t_s[in_dwell] < whole.report["machining_time_s"] - 3
    out = tmp_path / "out"
    for windows in (in_dwell, len(t_s) - in_dwell - 30):
        with pytest.raises(KeyboardInterrupt):
            edmsim.cut(program, out=out, watch=stop_after(windows), resume=out.exists(), **options)
    assert_same(edmsim.cut(program, out=out, resume=True, **options), whole)


@pytest.mark.slow
def test_wall_time_goes_on_from_the_checkpoint(cut_small, tmp_path):
    interrupted(cut_small, tmp_path)
    with edited(tmp_path / CHECKPOINT) as (_, document):
        document["wall_time_s"] = 1000.0
    assert 1000 < cut_small(out=tmp_path, resume=True, **SHORT).report["wall_time_s"] < 1600


@pytest.fixture(scope="module")
def stopped(cut_small, tmp_path_factory):
    """Return the folder of an interrupted cut, which tests must not change."""
    folder = tmp_path_factory.mktemp("stopped")
    interrupted(cut_small, folder, 20)
    return folder


@pytest.fixture
def own_stopped(stopped, tmp_path):
    """Return a copy of the checkpoint of an interrupted cut, which the test may change."""
    return Path(shutil.copy(stopped / CHECKPOINT, tmp_path))


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"seed": 7}, "seed 1, not 7"),
        ({"height_mm": 6.0}, "height_mm 5.0, not 6.0"),
        ({"controller": "fixed"}, "controller 'counts', not 'fixed'"),
        ({"planner": "dda"}, "planner 'poscal', not 'dda'"),
        ({"resolution": "default"}, "resolution 'fast', not 'default'"),
        ({"tension": 7.0}, "tension_N"),
        ({"wire_speed_m_s": 0.2}, "wire_speed_m_s None, not 0.2"),
        ({"flushing_upper_Pa": 0.0}, "flushing_upper_Pa None, not 0.0"),
        ({"standoff_upper_mm": 2.0}, "standoff_upper_mm None, not 2.0"),
        ({"offset": "0.2"}, "offset_um"),
        ({"max_time_s": 13.0}, "max_time_s 8.0, not 13.0"),
    ],
)
def test_resume_with_other_settings_is_refused(cut_small, stopped, changed, named):
    content = (stopped / CHECKPOINT).read_bytes()
    with pytest.raises(InputError, match="interrupted cut was made with") as caught:
        cut_small(out=stopped, resume=True, **{**SHORT, **changed})
    assert named in str(caught.value)
    assert str(stopped / CHECKPOINT) in str(caught.value)
    assert [(f.name, f.read_bytes()) for f in stopped.iterdir()] == [(CHECKPOINT, content)]


TWO = "G92 X0. Y1.\nG41 D1\nG1 Y0.\nX2.\nG40\nG0 X5. Y1.\nG41 D2\nG1 Y0.\nX7.\n"


IN_PASSES = {"technology": "t.toml", "passes": 2, "height_mm": 25.4}
CUT_WITH = "the interrupted cut was made with"


@pytest.mark.parametrize(("file", "old", "new", "options", "message"), [
    ("two.ngc", "X7.", "X7.1", {"offset": "0.2"}, "program two.ngc: not as in the interrupted cut; undo"),
    ("a.toml", "D1 = 0.155\nD2 = 0.160\n", "D1 = 0.155\nD2 = 0.200\n", {"offsets": "a.toml"},
     "wire path: not as in the interrupted cut; a.toml changed since then: undo"),
    ("a.json", '"clip": 10.0', '"clip": 1.0', {"controller": "policy:a.json"},
     "controller policy:a.json: not as in the interrupted cut; undo"),
    ("t.toml", "approach_share = 0.25", "approach_share = 0.5", IN_PASSES,
     "passes: not as in the interrupted cut; t.toml changed since then: undo"),
    ("t.toml", "t_period_us = 33.2", "t_period_us = 34.0", IN_PASSES,
     f"{CUT_WITH} t_period_us 33.2, not 34.0; t.toml changed since then: undo"),
    ("t.toml", "step_um = 38.1", "step_um = 48.1", IN_PASSES,
     "wire path: not as in the interrupted cut; t.toml changed since then: undo"),
    ("m.toml", "value = 9.3e-3", "value = 9.2e-3", {"material": "m.toml"},
     "constants: not as in the interrupted cut; m.toml changed since then: undo"),
])  # fmt: skip
def test_resume_with_a_file_that_was_edited_is_refused(monkeypatch, tmp_path, file, old, new, options, message):
    monkeypatch.chdir(tmp_path)
    policy = models.path("policies/GapFeed-ppo.json")
    shutil.copy(policy.with_suffix(".npz"), "a.npz")
    sources = {"a.toml": old, "a.json": policy.read_text(), "t.toml": models.path(STEEL).read_text(), "two.ngc": TWO,
               "m.toml": models.path("materials/tool-steel.toml").read_text()}  # fmt: skip
    Path("two.ngc").write_text(TWO)
    Path(file).write_text(sources[file])
    options = {"out": "out", "height_mm": 5.0, "resolution": "fast", **options}
    with pytest.raises(KeyboardInterrupt):
        edmsim.cut("two.ngc", watch=stop_after(2), **options)
    assert old in sources[file]
    Path(file).write_text(sources[file].replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        edmsim.cut("two.ngc", resume=True, **options)


@pytest.mark.slow
def test_a_cut_is_resumed_from_another_folder(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    Path("tables").mkdir()
    Path("tables/d.toml").write_text("D1 = 0.155\nD2 = 0.160\n")
    Path("two.ngc").write_text(TWO)
    options = {"out": tmp_path / "out", "height_mm": 5.0, "resolution": "fast", "max_time_s": 1.0}
    with pytest.raises(KeyboardInterrupt):
        edmsim.cut("two.ngc", watch=stop_after(2), offsets="tables/d.toml", **options)
    monkeypatch.chdir("tables")
    assert edmsim.cut("../two.ngc", resume=True, offsets="d.toml", **options).report["outcome"] == "time-limit"


def truncated(data):
    return data[: len(data) // 2]


def flipped(data):
    place = data.index(b"windows.rows") + 400
    return data[:place] + bytes(255 - b for b in data[place : place + 64]) + data[place + 64 :]


@pytest.mark.parametrize("damage", [truncated, flipped, lambda _: b"", lambda _: b"no checkpoint\n"])
def test_damaged_checkpoint_is_refused(cut_small, own_stopped, damage):
    own_stopped.write_bytes(damage(own_stopped.read_bytes()))
    with pytest.raises(InputError, match="damaged") as caught:
        cut_small(out=own_stopped.parent, resume=True, **SHORT)
    assert str(caught.value).startswith(str(own_stopped))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("part", "missing", "message"),
    [
        (0, "windows.rows", "damaged"),
        # as in the oldest checkpoints
        (1, "format", "another version of edmsim wrote the checkpoint; cut again"),
    ],
)
def test_checkpoint_with_a_part_missing_is_refused(cut_small, own_stopped, part, missing, message):
    with edited(own_stopped) as parts:
        del parts[part][missing]
    with pytest.raises(InputError, match=message) as caught:
        cut_small(out=own_stopped.parent, resume=True, **SHORT)
    assert str(caught.value).startswith(str(own_stopped))


def test_interrupt_without_a_folder_just_stops_and_nothing_can_be_resumed(cut_small):
    with pytest.raises(KeyboardInterrupt):
        cut_small(watch=stop_after(2), **SHORT)
    with pytest.raises(InputError, match="name its folder"):
        cut_small(resume=True)


@dataclass
class Numpy:
    """A law whose snapshot has NumPy numbers, from the beginning or after some windows."""

    after: int
    name: ClassVar[str] = "numpy"
    windows: int = 0

    def reset(self, max_feed_um_s):
        return FeedCommand(5.0)

    def update(self, observation):
        self.windows += 1
        return FeedCommand(5.0)

    def snapshot(self):
        return {"windows": self.windows if self.windows < self.after else np.int64(self.windows)}

    def restore(self, state):
        self.windows = state["windows"]


@pytest.mark.slow
def test_a_law_whose_snapshot_cannot_be_stored_loses_no_cut(cut_small, tmp_path):
    with pytest.raises(InputError, match=r"numpy controller has a snapshot that JSON cannot hold .*int64"):
        cut_small(controller=Numpy(0), out=tmp_path, watch=stop_after(1), max_time_s=0.2)
    with pytest.warns(UserWarning, match=r"no checkpoint could be written: .*int64.*; the cut goes on"):
        cut_small(controller=Numpy(3), out=tmp_path, max_time_s=0.2)
    assert (tmp_path / "report.json").exists()
