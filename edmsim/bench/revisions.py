"""Two revisions timed in pairs: ``edmsim bench --against``.

A computer's speed varies, and other programs use it, too. So both revisions are timed alternately, by processor time
(several threads by the clock), and the ratio is reported.
"""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import edmsim
from edmsim import errors, files, screen
from edmsim.bench import workloads
from edmsim.compiled.cache import user_folder
from edmsim.evaluation.compare import Figure, median

ROOT = Path(edmsim.__file__).resolve().parents[1]
"""Folder from which edmsim is imported."""


def commit_of(revision: str) -> str:
    """Return the full name of a revision's commit.

    Raises `InputError` if there is no git, edmsim does not run from a checkout, or it has no such revision.
    """
    if shutil.which("git") is None:
        raise errors.InputError("--against needs git, which is not on the path: install git")
    if _git("rev-parse", "--show-prefix") != b"\n":  # no checkout, or a folder of another one
        raise errors.InputError(
            f"--against needs edmsim installed from its git checkout (pip install -e .); it runs from {ROOT}"
        )
    commit = _git("rev-parse", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}").decode().strip()
    if not commit:
        raise errors.InputError(f"{ROOT} has no revision '{revision}': name a commit, a tag or a branch of it")
    return commit


@contextmanager
def checkout(commit: str) -> Iterator[Path]:
    """Yield a temporary folder with the files of a commit, locked for one comparison at a time."""
    # its name and its files' times depend only on the commit, so later comparisons reuse the compiled code
    cached = (user_folder() / "revisions" / commit).resolve()
    with ExitStack() as last, files.locked(cached, "comparison"):
        last.callback(_remove_empty, cached)
        folder, packed = cached / "files", cached / "files.tar"
        try:
            shutil.rmtree(folder, ignore_errors=True)  # left by a comparison that was killed
            _git("archive", f"--output={packed}", commit)
            shutil.unpack_archive(packed, folder, filter="data")
            yield folder
        finally:
            packed.unlink(missing_ok=True)
            shutil.rmtree(folder, ignore_errors=True)


def _remove_empty(folder: Path) -> None:
    with suppress(OSError):  # another comparison uses it
        folder.rmdir()


def _git(*arguments: str) -> bytes:
    """Return git's output for the checkout; empty if git fails."""
    return subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, check=False).stdout


PROGRAM, PAIRS = Path(workloads.__file__), 10
SIZES = "0.1", "5", "1000", "64", "50"
"""Arguments of `workloads`: seconds per spell, spells per figure, windows before timing (see `bench.figures`),
environments, resets."""
COMPILING = "0", "1", "1", "1", "1"
"""Arguments for the first run of each revision, which only compiles."""


@dataclass(frozen=True)
class Pairs:
    """Speed of this checkout compared with a revision."""

    commit: str  # commit of the revision
    here: dict[str, np.ndarray]  # rates of this checkout, one per pair
    there: dict[str, np.ndarray]  # rates of the revision

    def ratio(self, name: str) -> Figure:
        """Return the ratio of a rate, this checkout's over the revision's: median and interval over the pairs."""
        return median(self.here[name] / self.there[name])


def compare(revision: str, pairs: int = PAIRS, watch: Callable[[str], None] = lambda _: None) -> Pairs:
    """Time this checkout, with uncommitted changes, and a revision; `watch` is called with a text before each run."""
    commit = commit_of(revision)
    with checkout(commit) as folder:
        roots = {"this checkout": ROOT, commit[:10]: folder}
        for name, root in roots.items():
            watch(f"compile {name}")
            _rates(name, root, COMPILING)
        found: dict[str, list[dict[str, float]]] = {name: [] for name in roots}
        for pair in range(pairs):
            # A B, B A, A B, so that neither always runs on the warmer machine
            for name in list(roots) if pair % 2 == 0 else reversed(roots):
                watch(f"pair {pair + 1} of {pairs}: {name}")
                found[name].append(_rates(name, roots[name], SIZES))
    here, there = ({key: np.array([run[key] for run in runs]) for key in runs[0]} for runs in found.values())
    return Pairs(commit, here, there)


def _rates(name: str, root: Path, sizes: tuple[str, ...]) -> dict[str, float]:
    """Run `workloads` in a new process, with edmsim from a folder."""
    # safe path, because modules next to the program have the same names as packages
    environment = {**os.environ, "PYTHONPATH": str(root), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, str(PROGRAM), str(root), *sizes]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        said = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        raise errors.EdmsimError(f"{name} cannot be timed: {said[-1]}")
    rates: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return rates


def measured(
    revision: str, count: int | None, watch: Callable[[str], None]
) -> tuple[dict[str, object], screen.ScreenTable]:
    """Return a comparison with a revision as numbers and texts only, and as a table for the terminal."""
    found = compare(revision, PAIRS if count is None else count, watch)
    return as_numbers(found), render(found)


def as_numbers(pairs: Pairs) -> dict[str, object]:
    """Return a comparison as numbers and texts only."""
    figures = {}
    for name, rates in pairs.here.items():
        ratio = pairs.ratio(name)
        figures[name] = {
            "ratio": ratio.value, "low": ratio.low, "high": ratio.high,
            "here": rates.tolist(), "there": pairs.there[name].tolist(),
        }  # fmt: skip
    return {"against": pairs.commit, "figures": figures}


def render(pairs: Pairs) -> screen.ScreenTable:
    """Return a comparison as a table for the terminal."""
    count = len(next(iter(pairs.here.values())))
    table = screen.ScreenTable(
        "figure", numbers=("ratio", "95 % interval", "here", "there"),
        title=f"here over {pairs.commit[:10]}, processor time, {count} pair{'s' * (count > 1)}",
    )
    for name, rates in pairs.here.items():
        ratio = pairs.ratio(name)
        interval = f"{ratio.low:.3f} to {ratio.high:.3f}" if count > 1 else ""
        table.add_row(
            name, f"{ratio.value:.3f}", interval, f"{np.median(rates):,.0f}", f"{np.median(pairs.there[name]):,.0f}"
        )
    return table
