"""What a part program draws, before any wire: outlines in mm, from G-code runs or DXF contours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edmsim.program.registers import Offset

JOIN_TOLERANCE_MM = 0.005
"""Ends closer than this many mm are one point (ours: rounding of programs, well below the gap)."""

Side = Literal["left", "right"]


@dataclass(frozen=True)
class Outline:
    """One edge or wire path as drawn, in the program's coordinates.

    Attributes
    ----------
    points_mm : float64 array (n, 2)
        The edge in the direction of the cut; first and last point equal if ``closed``.
    line_numbers : tuple of int
        For each of the ``n - 1`` chords the line of the program; 0 where there is none (DXF).
    closed : bool
        Whether the edge closes on itself.
    wire_side : {"left", "right", None}
        The side of the edge the wire is offset to; None: the wire's centre follows the points.
    part_side : {"left", "right"}
        The side the part stays on.
    approach_mm : float64 array (k, 2)
        The program's own way from the thread point to ``points_mm[0]`` (not in it); empty if it has none.
    approach_lines : tuple of int
        For each of the ``k`` approach moves the line of the program.
    compensated_from : int
        ``approach_mm`` from this point on is an edge too and is offset like it; before, it is wire centre.
    dwells : tuple of (int, float)
        ``(i, seconds)`` of every G4, ``i`` counted through ``approach_mm`` and then ``points_mm``.
    needs_lead_in : bool
        Whether the wire would be threaded on the contour and wants a lead-in that the program does not have.
    elements : tuple of int
        For each of the ``n - 1`` chords the line or arc it belongs to, counted along the edge from 1.
    offset_mm : float, optional
        Offset of the program's register for it, in mm; None if it has none.
    """

    points_mm: NDArray[np.float64]
    line_numbers: tuple[int, ...]
    closed: bool
    wire_side: Side | None
    part_side: Side
    approach_mm: NDArray[np.float64]
    approach_lines: tuple[int, ...] = ()
    compensated_from: int = 0
    dwells: tuple[tuple[int, float], ...] = ()
    needs_lead_in: bool = True
    elements: tuple[int, ...] = ()
    offset_mm: float | None = None

    @property
    def line(self) -> int | None:
        """The line of the program on which the edge begins."""
        return (self.line_numbers[0] or None) if self.line_numbers else None

    @property
    def name(self) -> str:
        """The outline in the words of an error message."""
        x, y = self.points_mm[0]
        return f"the contour from X{x:.3f} Y{y:.3f}"


@dataclass(frozen=True)
class Program:
    """All outlines of a part program in the order they are to be cut.

    Attributes
    ----------
    outlines : tuple of Outline
    notices : tuple of str
        What a user should know about how it was read.
    source : str
        The file.
    """

    outlines: tuple[Outline, ...]
    notices: tuple[str, ...]
    source: str


@dataclass(frozen=True)
class CutMove:
    """A cutting move of a G-code run: its points after the start, the compensated side, its line, its register."""

    points: tuple[complex, ...]
    side: Side | None
    line: int
    offset: Offset | None = None


@dataclass(frozen=True)
class Run:
    """What G-code cuts between two rapids.

    Attributes
    ----------
    start : complex
        Where the wire is threaded, ``x + 1j * y`` in mm.
    on_contour : bool
        Compensation was on already when the wire was brought there: the point lies on the contour (Robofil).
    moves : tuple of CutMove
    dwells : tuple of (int, float)
        ``(moves done, seconds)``.
    join_mm : float
        Places closer than this are one.
    """

    start: complex
    on_contour: bool
    moves: tuple[CutMove, ...]
    dwells: tuple[tuple[int, float], ...]
    join_mm: float


def signed_area(points: NDArray[np.float64]) -> float:
    """Return the enclosed area in mm2 of a closed polyline (n, 2), positive if it runs counter-clockwise."""
    x, y = (points - points[0]).T
    return float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum() / 2)
