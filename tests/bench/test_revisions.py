"""`edmsim bench --against`: two revisions by turns, each in processes of its own, and nothing left behind."""

import json
import os
import shutil
import subprocess

import numpy as np
import pytest
from rich.console import Console

from edmsim.bench import revisions, workloads
from edmsim.compiled.cache import user_folder
from edmsim.errors import EdmsimError, InputError

COMMITTED = "2001-02-03T04:05:06+00:00"
PROGRAM = """
import json, os, pathlib, sys, edmsim
file = pathlib.Path(edmsim.__file__)
with open(os.environ["RUNS"], "a") as runs:
    runs.write(json.dumps([sys.argv[1:], edmsim.SPEED, int(file.stat().st_mtime)]) + "\\n")
print("a line of a library")
print(json.dumps({"steps_per_s": edmsim.SPEED}))
"""
"""In the place of `workloads`."""


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A checkout of another package of this name, half as fast at its only commit as in the working tree."""
    if shutil.which("git") is None:
        pytest.skip("needs git")
    root = tmp_path / "checkout"
    (root / "edmsim").mkdir(parents=True)
    module, program = root / "edmsim" / "__init__.py", tmp_path / "program.py"
    module.write_text("SPEED = 2.0\n")
    program.write_text(PROGRAM)
    who = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
    for words in (("init", "-q"), ("add", "."), (*who, "commit", "-qm", "first")):
        subprocess.run(["git", "-C", root, *words], check=True, env={**os.environ, "GIT_COMMITTER_DATE": COMMITTED})
    module.write_text("SPEED = 4.0\n")
    monkeypatch.setenv("RUNS", str(tmp_path / "runs"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(revisions, "ROOT", root)
    monkeypatch.setattr(revisions, "PROGRAM", program)
    return root


def left():
    return [file for file in (user_folder() / "revisions").rglob("*") if file.is_file()]


@pytest.mark.slow
def test_both_take_turns_after_each_has_compiled(checkout, tmp_path):
    found = revisions.compare("HEAD", 3)
    runs = [json.loads(line) for line in (tmp_path / "runs").read_text().splitlines()]
    assert [speed for _, speed, _ in runs] == [4.0, 2.0, 4.0, 2.0, 2.0, 4.0, 4.0, 2.0]
    folder, *sizes = runs[1][0]
    assert [sizes, runs[2][0][1:]] == [list(revisions.COMPILING), list(revisions.SIZES)]
    # what is compiled of a revision is found again if its folder and its files' times are the same
    assert folder == str(user_folder() / "revisions" / found.commit / "files")
    assert {time for _, speed, time in runs if speed == 2.0} == {981173106}
    assert left() == []
    ratio = found.ratio("steps_per_s")
    assert (ratio.value, ratio.low, ratio.high) == (2.0, 2.0, 2.0)


@pytest.mark.slow
def test_an_interrupt_leaves_no_files(checkout):
    def interrupt(name):
        if name.startswith("pair 1"):
            assert left()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        revisions.compare("HEAD", 1, interrupt)
    assert left() == []


@pytest.mark.slow
def test_a_revision_that_does_not_run_is_named_with_its_last_line(checkout):
    revisions.PROGRAM.write_text("raise TypeError('no such argument')")
    with pytest.raises(EdmsimError, match=r"this checkout cannot be timed: TypeError: no such argument$"):
        revisions.compare("HEAD", 1)
    assert left() == []


@pytest.mark.slow
def test_only_one_comparison_with_a_revision_is_under_way(checkout):
    commit = revisions.commit_of("HEAD")
    with (
        revisions.checkout(commit),
        pytest.raises(InputError, match="another comparison is at work"), revisions.checkout(commit),
    ):
        pass


def test_an_unknown_revision_is_refused(checkout):
    for name in ("nosuch", "--all", ""):
        with pytest.raises(InputError, match=f"has no revision '{name}': name a commit, a tag or a branch"):
            revisions.commit_of(name)


def test_without_a_checkout_there_is_nothing_to_compare_with(checkout, monkeypatch):
    elsewhere = checkout.parent / "site-packages"
    elsewhere.mkdir()
    for place in (elsewhere, checkout / "edmsim"):  # the latter: installed within the checkout of something else
        monkeypatch.setattr(revisions, "ROOT", place)
        with pytest.raises(InputError, match=f"needs edmsim installed from its git checkout .* runs from {place}"):
            revisions.commit_of("HEAD")


def test_without_git_it_says_so(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match="install git"):
        revisions.commit_of("HEAD")


def test_a_comparison_is_a_table_and_numbers():
    found = revisions.Pairs("0123456789abcdef", {"steps_per_s": np.array([11.0, 12.0, 39.0])},
                        {"steps_per_s": np.array([10.0, 10.0, 10.0])})  # fmt: skip
    numbers = json.loads(json.dumps(revisions.as_numbers(found)))
    assert numbers["against"] == "0123456789abcdef"
    figure = numbers["figures"]["steps_per_s"]
    assert figure["ratio"] == pytest.approx(1.2)
    assert (figure["low"], figure["high"]) == pytest.approx((1.1, 3.9))
    assert figure["here"] == [11.0, 12.0, 39.0]
    with (console := Console(width=100)).capture() as shown:
        console.print(revisions.render(found))
    assert {"0123456789,", "3", "1.200", "3.900", "12", "10"} <= set(shown.get().replace("│", " ").split())


@pytest.mark.slow
@pytest.mark.timeout(400)  # where nothing is compiled yet
def test_the_program_measures_this_checkout(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["workloads.py", str(revisions.ROOT), *revisions.COMPILING])
    workloads.main()
    rates = json.loads(capsys.readouterr().out)
    assert list(rates) == [
        "pulses_per_s_fast", "pulses_per_s_default", "pulses_per_s_fine", "mujoco_pulses_per_s",
        "vector_env_steps_per_s_fast", "vector_env_steps_per_s_fast_threads", "drawn_resets_per_s",
    ]  # fmt: skip
    assert all(rate > 0 for rate in rates.values())
    monkeypatch.setattr("sys.argv", ["workloads.py", "/nowhere", *revisions.COMPILING])
    with pytest.raises(SystemExit, match=r"edmsim came from .*, not from /nowhere"):
        workloads.main()
