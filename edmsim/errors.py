"""Errors a user meets: bad input is told in one line that says what, where, and what would be right."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from edmsim.plant.window import PulseWindow


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


class PlantError(EdmsimError):
    """The simulated machine left the range its model holds for.

    Attributes
    ----------
    time_s : float
        Machine time at the end of the window in which that was seen.
    place_um : (float, float)
        Where the motor steps had commanded the wire.
    window : PulseWindow
        What the window had counted and measured.
    """

    def __init__(self, reason: str, time_s: float, place_um: tuple[float, float], window: PulseWindow) -> None:
        super().__init__(reason)
        self.time_s = time_s
        self.place_um = place_um
        self.window = window


class WireLostError(PlantError):
    """The wire was bent further than a wire between guides can be."""


class WireInMetalError(PlantError):
    """The wire was driven into the metal faster than it can be pushed back."""


class NotFiniteError(PlantError):
    """A number of the simulation is infinite or none at all."""
