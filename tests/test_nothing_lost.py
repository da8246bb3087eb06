"""Nothing of a cut is lost: after any interruption its folder has all results, or a checkpoint for `--resume`."""

import errno
import os
import shutil
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from edmsim.controllers.feed.laws import FixedController
from edmsim.errors import EdmsimError, InputError, run_command
from edmsim.files import locked, replacing, together
from edmsim.job.cut import CHECKPOINT
from edmsim.job.result import remake
from edmsim.recording import scene
from edmsim.recording.report import read_cut
from edmsim.sweep.run import read as read_sweep

from .conftest import FILES, timeless

SHORT = {"max_time_s": 3.0}
PHASES = ["cutting", "measuring", "figures", "recording"]


def names(folder):
    return sorted(file.name for file in folder.iterdir())


@pytest.mark.slow
@pytest.mark.usefixtures("signals")
def test_a_cut_interrupted_in_any_phase_is_finished_by_resuming(cut_small, tmp_path):
    whole = cut_small(**SHORT)
    for phase, number in zip(PHASES, [signal.SIGINT, signal.SIGTERM] * 2, strict=True):
        entered = []

        def enter(name, entered=entered, stop=phase, number=number):
            entered.append(name)
            if name == stop:
                signal.raise_signal(number)

        with pytest.raises(KeyboardInterrupt) as caught:
            cut_small(out=tmp_path, resume=phase != PHASES[0], enter=enter, **SHORT)
        assert caught.value.args == (number,)
        assert entered == PHASES[: PHASES.index(phase) + 1]
        assert names(tmp_path) == [CHECKPOINT]
        assert signal.getsignal(number) in (signal.default_int_handler, signal.SIG_DFL)
    resumed = cut_small(out=tmp_path, resume=True, **SHORT)
    assert timeless(resumed.report) == timeless(whole.report)
    assert names(tmp_path) == FILES


def test_the_progress_tells_the_wall_time_of_the_report(cut_small):
    observed = []
    report = cut_small(watch=lambda progress: observed.append(progress.wall_time_s), **SHORT).report
    assert 0 < observed[0] < observed[-1] == report["wall_time_s"]


@pytest.mark.slow
def test_an_interrupted_cut_is_not_lost_to_the_next_one(cut_small, tmp_path):
    def stop(_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cut_small(out=tmp_path, watch=stop, **SHORT)
    content = (tmp_path / CHECKPOINT).read_bytes()
    with pytest.raises(InputError, match="this folder has an interrupted cut: resume it with") as caught:
        cut_small(out=tmp_path, seed=2, **SHORT)
    assert caught.value.file == str(tmp_path)
    assert (tmp_path / CHECKPOINT).read_bytes() == content
    with pytest.raises(InputError, match="choose --resume or --overwrite"):
        cut_small(out=tmp_path, resume=True, overwrite=True, **SHORT)
    cut_small(out=tmp_path, seed=2, overwrite=True, max_time_s=0.1)
    assert names(tmp_path) == FILES
    with pytest.raises(InputError, match="there is no interrupted cut to resume"):
        cut_small(out=tmp_path / "none", resume=True)
    assert not (tmp_path / "none").exists()


@pytest.mark.slow
def test_an_error_of_a_users_code_loses_a_minute_at_most(cut_small, tmp_path, monkeypatch):
    options = {"out": tmp_path, "controller": "fixed", **SHORT}
    whole = cut_small(**{**options, "out": None})
    windows, left = iter(range(10)), iter(range(40))

    def careless(law, window, update=FixedController.update):
        if next(left) == 20:
            raise ZeroDivisionError
        return update(law, window)

    with pytest.raises(StopIteration):  # ends between windows, where the state is saved
        cut_small(watch=lambda _: next(windows), **options)
    monkeypatch.setattr(FixedController, "update", careless)
    with pytest.raises(ZeroDivisionError), pytest.warns(UserWarning, match=r"at 0\.\d+ s of .*continues at 0\.\d s"):
        cut_small(resume=True, **options)
    monkeypatch.undo()
    assert timeless(cut_small(resume=True, **options).report) == timeless(whole.report)


@pytest.mark.slow
def test_one_cut_at_a_time_works_in_a_folder(cut_small, tmp_path):
    with locked(tmp_path), pytest.raises(InputError, match="another edmsim is at work in this folder"):
        cut_small(out=tmp_path, **SHORT)
    cut_small(out=tmp_path, max_time_s=0.1)
    with locked(tmp_path), pytest.raises(InputError, match="another edmsim is at work"):
        remake(tmp_path, None, "pdf", print)
    assert names(tmp_path) == FILES


@pytest.mark.slow
def test_many_want_a_folder_and_one_after_the_other_has_it(tmp_path):
    """The lock's file is deleted and made again: no process may hold the lock of a deleted file."""
    inside, most, refused = 0, 0, 0

    def work():
        nonlocal inside, most, refused
        for _ in range(300):
            try:
                with locked(tmp_path):
                    inside += 1
                    most = max(most, inside)
                    inside -= 1
            except InputError:
                refused += 1

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == 1
    assert refused < 1200
    assert names(tmp_path) == []


def test_a_folder_without_a_name_is_not_the_present_one(small_cut, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for use in (small_cut.result.write, read_cut, read_sweep):
        with pytest.raises(InputError, match="the folder has no name"):
            use("")
    assert names(tmp_path) == []


def test_files_appear_together_or_not_at_all(tmp_path):
    (tmp_path / "report.json").write_text("old")
    (tmp_path / "notes.txt").write_text("the user's")
    with suppress(RuntimeError), together(tmp_path, "report.json") as folder:
        (folder / "report.json").write_text("new")
        (folder / "a.npz").write_text("new")
        raise RuntimeError
    assert names(tmp_path) == ["notes.txt", "report.json"]
    assert (tmp_path / "report.json").read_text() == "old"
    (tmp_path / ".edmsim-new-left").mkdir()  # left by a process that was killed
    with together(tmp_path, "report.json") as folder:
        (folder / "report.json").write_text("new")
        (folder / "a.npz").write_text("new")
    assert names(tmp_path) == ["a.npz", "notes.txt", "report.json"]
    assert (tmp_path / "report.json").read_text() == "new"


@pytest.mark.slow
def test_a_folder_of_two_cuts_is_refused(cut_small, tmp_path):
    for seed in (1, 2):
        cut_small(out=tmp_path / str(seed), seed=seed, max_time_s=0.1)
    assert read_cut(tmp_path / "1").report["seed"] == 1
    for file in ("report.json", "windows.parquet", "part.npz"):
        mixed = tmp_path / file
        shutil.copytree(tmp_path / "1", mixed)
        shutil.copy(tmp_path / "2" / file, mixed)
        with pytest.raises(InputError, match="are not of one cut: cut again") as caught:
            remake(mixed, None, "pdf", print)
        assert caught.value.file == str(mixed)


def full(*_, **__):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.slow
def test_a_full_disk_warns_and_the_cut_goes_on(cut_small, tmp_path, monkeypatch):
    monkeypatch.setattr("edmsim.job.cut.CHECKPOINT_EVERY_S", 0.0)
    with monkeypatch.context() as patch:
        patch.setattr(np, "savez", full)
        with pytest.warns(UserWarning, match="no checkpoint could be written: No space left on device"):
            cut_small(out=tmp_path, max_time_s=0.1)
    assert names(tmp_path) == FILES


@pytest.mark.slow
@pytest.mark.parametrize(("writer", "name"), [(scene.np, "savez_compressed"), (Path, "write_bytes")])
def test_a_disk_full_at_the_end_leaves_the_checkpoint(cut_small, tmp_path, monkeypatch, writer, name):
    message = "results could not be written: .*No space left on device; the checkpoint holds the cut"
    with monkeypatch.context() as patch, pytest.raises(EdmsimError, match=message) as caught:
        cut_small(out=tmp_path, enter=lambda _: patch.setattr(writer, name, full), **SHORT)
    assert "\n" not in str(caught.value)
    assert names(tmp_path) == [CHECKPOINT]
    cut_small(out=tmp_path, resume=True, **SHORT)
    assert names(tmp_path) == FILES


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_a_command_that_finds_no_room_names_the_file_and_keeps_the_former(tmp_path, capfd, code):
    file = tmp_path / "policy.json"
    file.write_text("former")

    def command():
        with replacing(file) as partial:
            partial.write_text("new")
            raise OSError(code, os.strerror(code))

    with pytest.raises(SystemExit) as ended:
        run_command(command)
    assert (ended.value.code, file.read_text(), names(tmp_path)) == (1, "former", ["policy.json"])
    assert capfd.readouterr().err == f"edmsim: {file}: cannot be written: {os.strerror(code)}\n"


WITHOUT_FIGURES = """
from edmsim.cli.app import main
from edmsim.job import result
from edmsim.recording import html_report
from edmsim.recording.figures import profile
html_report.pictures, result.sample_or_reason = lambda *_: (), lambda *_: "not simulated"
profile.profile_png = lambda *_: b""
main()
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names of files are UTF-8")
def test_odd_names_and_plain_terminals_do_not_crash_a_finished_cut(small_punch, tmp_path):
    folder = os.path.join(os.fsencode(tmp_path), b"o[/b]\xff\xc3 \xb5m")
    program = os.path.join(os.fsencode(tmp_path), b"pun[red]ch\xff.ngc")
    shutil.copy(small_punch, program)
    options = ["--height", "5", "--resolution", "fast", "--max-time", "0.1"]
    command = [sys.executable, "-c", WITHOUT_FIGURES, "cut", program, "--out", folder, *options]
    plain = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    done = subprocess.run(command, env=plain, capture_output=True, check=False)
    assert done.returncode == 3, done.stderr.decode()
    output = done.stdout.decode("ascii")
    assert "mm3 removed" in output
    assert "o[/b]" in output
    assert b"recording" in done.stderr  # the last phase
    assert sorted(os.listdir(folder)) == [name.encode() for name in FILES]
    odd = Path(os.fsdecode(folder))
    report, windows, _ = read_cut(odd)
    assert report["settings"]["program"] == "pun[red]ch?.ngc"
    assert windows.num_rows == report["pulses"] // 255
