"""Errors a user meets: bad input is told in one line that says what, where, and what would be right."""

from __future__ import annotations

from pathlib import Path


class EdmsimError(Exception):
    """Base of every error edmsim raises on purpose."""


class InputError(EdmsimError):
    """Something the user gave cannot be used.

    Parameters
    ----------
    reason : str
        One sentence: what is wrong, the offending value, and what would be right.
    file : path, optional
        The file it was read from.
    line : int, optional
        The line in that file, counted from 1.
    """

    def __init__(self, reason: str, file: str | Path | None = None, line: int | None = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.file = None if file is None else str(file)
        self.line = line

    def __str__(self) -> str:
        """Return ``file:line: reason`` with the parts that are known."""
        place = "" if self.file is None else self.file
        if self.line is not None:
            place += f":{self.line}"
        return f"{place}: {self.reason}" if place else self.reason
