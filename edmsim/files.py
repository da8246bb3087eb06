"""The folder that outputs go to."""

from __future__ import annotations

from pathlib import Path

from edmsim.errors import InputError


def make_writable(folder: Path) -> None:
    """Make a folder and see that it can be written to; raises `InputError` if not."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".edmsim-write-test"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise InputError(f"the output folder cannot be written to: {error.strerror}", folder) from None
