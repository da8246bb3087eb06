"""Files and folders that outputs go to."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from edmsim.errors import InputError

try:
    import fcntl
except ImportError:  # not a POSIX system: nothing is locked there
    fcntl = None  # type: ignore[assignment]

_LOCK = ".edmsim-lock"
_UNFINISHED = ".edmsim-new-"


@contextmanager
def replacing(file: str | Path) -> Iterator[Path]:
    """Give a path beside a file to write to; it takes the file's place when all is written, or else is removed."""
    target = Path(file)
    partial = target.with_name(target.name + ".part")
    try:
        yield partial
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)


def make_writable(folder: Path) -> None:
    """Make a folder and see that it can be written to; raises `InputError` if not."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".edmsim-write-test"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise InputError(f"the output folder cannot be written to: {error.strerror}", folder) from None


@contextmanager
def locked(folder: Path, who: str = "edmsim") -> Iterator[None]:
    """Keep a folder, which is made, to this process; the lock goes with it, however it ends.

    Parameters
    ----------
    folder : path
    who : str
        Who works there, for those who come too late.

    Raises
    ------
    InputError
        The folder cannot be written to, or another process, or another thread of this one, works on it.
    """
    make_writable(folder)
    file = folder / _LOCK
    descriptor = _lock(file, who)
    try:
        yield
    finally:
        with suppress(OSError):
            file.unlink(missing_ok=True)
        os.close(descriptor)


def _lock(file: Path, who: str) -> int:
    while True:
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o666)
        try:
            if fcntl is not None:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(descriptor), os.stat(file)):
                    return descriptor
        except BlockingIOError:
            os.close(descriptor)
            raise InputError(f"another {who} is at work in this folder: wait, or give another", file.parent) from None
        except OSError:  # a file system without locks
            return descriptor
        os.close(descriptor)  # its last owner removed the file meanwhile


@contextmanager
def together(folder: Path, last: str) -> Iterator[Path]:
    """Give a folder to write files into; they come into another one together, when all are written.

    Parameters
    ----------
    folder : path
        Where they come to, in place of those of former ones that have their names. Nobody else works on it.
    last : str
        Name of the file without which the others are nothing: a former one goes first, the new one comes last, so
        that it never stands beside files that are not its own.
    """
    for left in folder.glob(f"{_UNFINISHED}*"):  # by a process that was killed
        shutil.rmtree(left, ignore_errors=True)
    unfinished = Path(tempfile.mkdtemp(prefix=_UNFINISHED, dir=folder))
    try:
        yield unfinished
        files = sorted(unfinished.iterdir(), key=lambda file: file.name == last)
        (folder / last).unlink(missing_ok=True)
        for file in files:
            file.replace(folder / file.name)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
