"""Output files and folders; reading of texts, tables and arrays."""

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

from edmsim.errors import InputError, refuses_wrong_types

_LOCK = ".edmsim-lock"
MOST_ARRAY_BYTES = 800_000_000
"""Greatest size of all arrays in a file (ours: four times the checkpoint of a long cut at `fine`)."""
_UNFINISHED = ".edmsim-new-"
PART = ".edmsim-part"  # suffix of a file that is being written
LEFT_S = 3600.0  # time without a change after which such a file was left by a kill (ours: a film writes every second)


@contextmanager
def naming(file: Path) -> Iterator[None]:
    """Add the file's name to an `OSError`, because that of a full disk has none: see `run_command`."""
    try:
        yield
    except OSError as error:
        if error.errno is not None and error.filename is None:  # other errors have their own text
            error.filename = str(file)
        raise


def remove_unfinished_line(file: Path) -> int:
    """Remove an incomplete last line after a kill or a full disk; return the remaining bytes."""
    with naming(file), file.open("r+b") as opened:  # in place, because other processes may append to it
        whole = opened.read().rfind(b"\n") + 1
        opened.truncate(whole)
    return whole


def unfinished(file: Path) -> Path:
    """Return a new name next to a file for writing it, as two processes may write the same file at a time."""
    return file.with_name(f"{file.name}.{np.random.default_rng().bytes(3).hex()}{PART}")


@contextmanager
def replacing(file: str | Path) -> Iterator[Path]:
    """Yield a temporary path; it replaces the file if all was written, or else is removed."""
    target = Path(file)
    partial = unfinished(target)
    try:
        with naming(target):
            yield partial
            partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)


_OF_DAMAGE = (
    # of the archive
    zipfile.BadZipFile, zlib.error, OSError, EOFError, RuntimeError,
    # of the arrays' headers
    ValueError, TypeError, LookupError, OverflowError, SyntaxError, tokenize.TokenError,
)  # fmt: skip
"""Errors of zipfile and numpy for damaged arrays; others, as for too little memory, are not the file's."""


def read_arrays(packed: bytes) -> dict[str, np.typing.NDArray[Any]]:
    """Return the arrays of an ``.npz`` by name; raises a one-line `ValueError` if they are damaged or too large."""
    # nothing is unpickled, and no memory is allocated before the sizes are checked
    try:
        with zipfile.ZipFile(io.BytesIO(packed)) as archive:
            members = archive.infolist()
            if sum(member.file_size for member in members) > MOST_ARRAY_BYTES:
                raise ValueError(f"its arrays have more than {MOST_ARRAY_BYTES / 1e6:.0f} MB")
            for member in members:
                if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise ValueError(f"{member.filename} is compressed in another way than by numpy")
                with archive.open(member) as opened:
                    _check_array(member, opened)
        with np.load(io.BytesIO(packed), allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except _OF_DAMAGE as error:
        raise ValueError(" ".join(str(error).split()) or type(error).__name__) from None


def _check_array(member: zipfile.ZipInfo, opened: Any) -> None:
    """Refuse a member that is not an array, contains objects, or declares another size than it has."""
    npy = np.lib.format
    header = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[npy.read_magic(opened)]
    try:
        shape, _, dtype = header(opened)
    except MemoryError:  # Python's parser raises it for many operators in a row
        raise ValueError(f"{member.filename} has no header of an array") from None
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
    except ValueError as error:  # a name with a NUL byte
        raise InputError(f"cannot be read: {error}", file) from None


def read_toml(file: str | Path, what: str = "valid TOML") -> dict[str, Any]:
    """Return the entries of a user's TOML file; raises `InputError`, whose message calls the file `what`."""
    try:
        return tomllib.loads(read_text(file))
    except (ValueError, RecursionError) as error:  # also for very long numbers and deeply nested brackets
        raise InputError(f"not {what}: {error}", file) from None


@refuses_wrong_types
def folder_of(name: str | Path) -> Path:
    """Return the folder of this name; raises `InputError` for an empty name, which `Path` allows."""
    if isinstance(name, str) and not name:
        raise InputError("the folder has no name: '.' is the present one")
    return Path(name)


def make_writable(name: str | Path) -> Path:
    """Make a folder if necessary; raises `InputError` if it cannot be written to."""
    folder = folder_of(name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".edmsim-write-test"
        probe.write_bytes(b"")
        probe.unlink()
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL byte
        why = getattr(error, "strerror", None) or error
        raise InputError(f"the output folder cannot be written to: {why}", folder) from None
    return folder


def check_suffix(file: Path, what: str, *suffixes: str) -> str:
    """Return the suffix of an output file in lower case; raises `InputError` for other suffixes and for folders."""
    suffix = file.suffix.lower()
    if suffix not in suffixes:
        raise InputError(f"{what} is written as {' '.join(suffixes)}", file)
    if file.is_dir():
        raise InputError(f"is a folder; {what} is a file", file)
    return suffix


def make_room(file: Path | None, what: str, *suffixes: str) -> None:
    """Refuse an output file, if any, with another suffix or in a folder that cannot be written to."""
    if file is not None:
        check_suffix(file, what, *suffixes)
        make_writable(file.parent)


@contextmanager
def locked(folder: Path | None, who: str = "edmsim") -> Iterator[None]:
    """Lock a folder, if any, for this process. On leaving, the lock is removed, and the folder if new and empty.

    Raises `InputError` if the folder cannot be written to, or is locked. `who` names the holder in the message.
    """
    if folder is None:
        yield
        return
    made = not folder.exists()
    make_writable(folder)
    try:
        with _held(folder / _LOCK, f"another {who} is at work in this folder", folder):
            _remove_left(folder)
            yield
    finally:
        if made:
            with suppress(OSError):
                folder.rmdir()


def _remove_left(folder: Path) -> None:
    """Remove half-written files of processes that were killed; one that is being written without the lock stays."""
    lock_file = folder / _LOCK
    lock_file.touch()
    now_s = lock_file.stat().st_mtime  # by the clock of the file system
    for left in folder.glob(f"*{PART}"):
        with suppress(FileNotFoundError):
            if now_s - left.stat().st_mtime > LEFT_S:
                left.unlink()


@contextmanager
def locked_file(file: Path, who: str) -> Iterator[None]:
    """Lock an output file, in a folder that can be written to, for this process; raises `InputError` if it is."""
    with _held(file.with_name(f"{_LOCK}-{file.name}"), f"another {who} is at work on this file", file):
        yield


@contextmanager
def _held(lock_file: Path, refusal: str, what: Path) -> Iterator[None]:
    """Hold a lock until the end; raises `InputError` if another process holds it."""
    from filelock import FileLock, Timeout

    lock = FileLock(lock_file, timeout=0)
    with suppress(OSError):  # a file system without locks
        try:
            lock.acquire()
        except Timeout:
            raise InputError(f"{refusal}: wait, or give another", what) from None
    try:
        yield
    finally:
        with suppress(OSError):
            lock_file.unlink(missing_ok=True)
        lock.release()


@contextmanager
def together(folder: Path, last: str) -> Iterator[Path]:
    """Yield a temporary folder; when all files are written, they are moved into the target folder together.

    `last` is the file that makes the others valid: the old one is deleted first and the new one moved last, so it is
    never next to files of another run. The caller has locked the folder.
    """
    for left in folder.glob(f"{_UNFINISHED}*"):  # left by a process that was killed
        shutil.rmtree(left, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix=_UNFINISHED, dir=folder, ignore_cleanup_errors=True) as unfinished:
        yield Path(unfinished)
        files = sorted(Path(unfinished).iterdir(), key=lambda file: file.name == last)
        (folder / last).unlink(missing_ok=True)
        for file in files:
            file.replace(folder / file.name)
