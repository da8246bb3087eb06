"""Files and folders that outputs go to; texts, tables and arrays read from files."""

import io
import math
import shutil
import tempfile
import tokenize
import tomllib
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from edmsim.errors import InputError, refuses_wrong_types

_LOCK = ".edmsim-lock"
MOST_ARRAY_BYTES = 800_000_000
"""Of all arrays in a file that is read (ours: the checkpoint of a long cut at `fine` has a quarter of that)."""
_UNFINISHED = ".edmsim-new-"


@contextmanager
def naming(file: Path) -> Iterator[None]:
    """Say of an `OSError` which file could not be written, as that of a full disk does not: see `run_command`."""
    try:
        yield
    except OSError as error:
        if error.errno is not None and error.filename is None:  # others have a text of their own
            error.filename = str(file)
        raise


def remove_unfinished_line(file: Path) -> int:
    """Remove a last line that a kill or a full disk cut off; return the bytes that are left."""
    with naming(file), file.open("r+b") as opened:  # in place, as others may add to it
        whole = opened.read().rfind(b"\n") + 1
        opened.truncate(whole)
    return whole


@contextmanager
def replacing(file: str | Path) -> Iterator[Path]:
    """Give a path beside a file to write to; it takes the file's place when all is written, or else is removed."""
    target = Path(file)
    partial = target.with_name(target.name + ".part")
    try:
        with naming(target):
            yield partial
            partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)


def read_arrays(packed: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays of an ``.npz`` by name; raises `ValueError` in one line if they are damaged or too large."""
    # nothing is unpickled, and no memory is taken for what is not there
    try:
        with zipfile.ZipFile(io.BytesIO(packed)) as archive:
            members = archive.infolist()
            if sum(member.file_size for member in members) > MOST_ARRAY_BYTES:
                raise ValueError(f"its arrays have more than {MOST_ARRAY_BYTES / 1e6:.0f} MB")
            for member in members:
                with archive.open(member) as opened:
                    _check_array(member, opened)
        with np.load(io.BytesIO(packed), allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except (OSError, EOFError, LookupError, TypeError, SyntaxError, NotImplementedError, RuntimeError, MemoryError,
            tokenize.TokenError, zipfile.BadZipFile, zlib.error) as error:  # fmt: skip
        raise ValueError(" ".join(str(error).split()) or type(error).__name__) from None


def _check_array(member: zipfile.ZipInfo, opened: Any) -> None:
    """Refuse what is not an array, holds objects, or says another size than it has."""
    version = npy.read_magic(opened)
    header = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[version]
    shape, _, dtype = header(opened)
    if dtype.hasobject or any(length < 0 for length in shape):
        raise ValueError(f"{member.filename} is not an array of numbers")
    if math.prod(shape) * dtype.itemsize != member.file_size - opened.tell():
        raise ValueError(f"{member.filename} has another size than it says")


def read_text(file: str | Path, encoding: str = "utf-8-sig") -> str:
    """Return the text of a user's file; raises `InputError` if it cannot be read."""
    try:
        return Path(file).read_text(encoding=encoding)
    except FileNotFoundError:
        raise InputError("no such file", file) from None
    except UnicodeDecodeError as error:
        raise InputError(f"byte {error.start} is not UTF-8: save the file as UTF-8", file) from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file) from None
    except ValueError as error:  # a name with a zero byte
        raise InputError(f"cannot be read: {error}", file) from None


def read_toml(file: str | Path, what: str = "valid TOML") -> dict[str, Any]:
    """Return the entries of a user's TOML file; raises `InputError`, which says `what` it is to be."""
    try:
        return tomllib.loads(read_text(file))
    except (ValueError, RecursionError) as error:  # numbers of thousands of digits, and brackets within brackets, too
        raise InputError(f"not {what}: {error}", file) from None


@refuses_wrong_types
def folder_of(name: str | Path) -> Path:
    """Return the folder that a user names; raises `InputError` for an empty name, which `Path` allows."""
    if isinstance(name, str) and not name:
        raise InputError("the folder has no name: '.' is the present one")
    return Path(name)


def make_writable(name: str | Path) -> Path:
    """Return a folder that is made and can be written to; raises `InputError` if not."""
    folder = folder_of(name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".edmsim-write-test"
        probe.write_bytes(b"")
        probe.unlink()
    except (OSError, ValueError) as error:  # a ValueError for a name with a NUL
        why = getattr(error, "strerror", None) or error
        raise InputError(f"the output folder cannot be written to: {why}", folder) from None
    return folder


def check_suffix(file: Path, what: str, *suffixes: str) -> str:
    """Return the suffix of a file to write, in lower case; raises `InputError` if it is another, or a folder."""
    suffix = file.suffix.lower()
    if suffix not in suffixes:
        raise InputError(f"{what} is written as {' '.join(suffixes)}", file)
    if file.is_dir():
        raise InputError(f"is a folder; {what} is a file", file)
    return suffix


def make_room(file: Path | None, what: str, *suffixes: str) -> None:
    """Refuse a file to write, if there is one, by its suffix or a folder that cannot be written to."""
    if file is not None:
        check_suffix(file, what, *suffixes)
        make_writable(file.parent)


@contextmanager
def locked(folder: Path, who: str = "edmsim") -> Iterator[None]:
    """Keep a folder to this process; the lock goes with it, and a folder made for it into which nothing came.

    Raises `InputError` if the folder cannot be written to, or another process or thread, called `who`, works on it.
    """
    made = not folder.exists()
    make_writable(folder)
    file = folder / _LOCK
    from filelock import FileLock, Timeout

    lock = FileLock(file, timeout=0)
    with suppress(OSError):  # on a file system without locks nothing is locked
        try:
            lock.acquire()
        except Timeout:
            raise InputError(f"another {who} is at work in this folder: wait, or give another", folder) from None
    try:
        yield
    finally:
        with suppress(OSError):
            file.unlink(missing_ok=True)
        lock.release()
        if made:
            with suppress(OSError):
                folder.rmdir()


@contextmanager
def together(folder: Path, last: str) -> Iterator[Path]:
    """Give a folder to write files into; they come into another one together, when all are written.

    `last` is the file without which the others are nothing: a former one goes first, the new one comes last, so that
    it never stands beside files that are not its own. Nobody else works on the folder.
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
