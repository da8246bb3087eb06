"""Revisions of the checkout that edmsim runs from: which one a name means, and a copy of its files for a while."""

from __future__ import annotations

import io
import shutil
import subprocess
import tarfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import edmsim
from edmsim.compiled.cache import user_folder
from edmsim.errors import InputError
from edmsim.files import locked

ROOT = Path(edmsim.__file__).resolve().parents[1]
"""Folder that edmsim is imported from."""


def commit_of(revision: str) -> str:
    """Return the whole name of the commit that a revision is.

    Raises `InputError` if there is no git, edmsim does not run from a checkout, or it has no such revision.
    """
    if shutil.which("git") is None:
        raise InputError("--against looks a revision up with git, which is not on the path: install git")
    if _git("rev-parse", "--show-prefix") != b"\n":  # elsewhere, or in a folder of another project's checkout
        raise InputError(
            f"--against needs edmsim installed from its git checkout (pip install -e .); it runs from {ROOT}"
        )
    commit = _git("rev-parse", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}").decode().strip()
    if not commit:
        raise InputError(f"{ROOT} has no revision '{revision}': name a commit, a tag or a branch of it")
    return commit


@contextmanager
def checkout(commit: str) -> Iterator[Path]:
    """Yield a temporary folder with the files of a commit.

    Its name and its files' times depend only on the commit; later comparisons reuse the compiled code.

    Raises
    ------
    InputError
        If another comparison with the same commit is running, or the user's cache is not writable.
    """
    cached = (user_folder() / "revisions" / commit).resolve()
    with ExitStack() as last, locked(cached, "comparison"):
        last.callback(_remove_empty, cached)
        folder = cached / "files"
        try:
            shutil.rmtree(folder, ignore_errors=True)  # of a comparison that was killed
            with tarfile.open(fileobj=io.BytesIO(_git("archive", commit))) as files:
                files.extractall(folder, filter="data")
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def _remove_empty(folder: Path) -> None:
    with suppress(OSError):  # another comparison has begun
        folder.rmdir()


def _git(*arguments: str) -> bytes:
    """Return what git says of the checkout, nothing where it fails."""
    return subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, check=False).stdout
