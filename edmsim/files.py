"""Files and folders that outputs go to."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from edmsim.errors import InputError


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
