"""What a part program draws, before any wire: outlines in mm, from G-code runs or DXF contours; none may cross."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.program.tables import Offset

JOIN_TOLERANCE_MM = 0.005
"""Ends closer than this many mm are one point (ours: rounding of programs, well below the gap)."""

Side = Literal["left", "right"]


Corners = Literal["sharp", "conical", "cylindrical", "rounded"]
"""What a corner or an arc of the program plane becomes at another height."""


@dataclass(frozen=True)
class Taper:
    """Inclination of the wire along an outline.

    Attributes
    ----------
    angle_deg : tuple of float, optional
        Angle between wire and vertical for each chord; positive if the wire's upper end leans to the left of the
        cutting direction. None if `upper_mm` is set.
    upper_mm : float64 array (n, 2), optional
        Point in the second plane for each point of the outline; the wall between them is ruled.
    corners : {"sharp", "conical", "cylindrical", "rounded"}
        Shape of corners and arcs at other heights.
    program_plane_mm : float
        Height of the outline's plane over the workpiece's lower face.
    second_plane_mm : float, optional
        Height of the plane of `upper_mm`; by default the workpiece's upper face.
    """

    angle_deg: tuple[float, ...] | None = None
    upper_mm: NDArray[np.float64] | None = None
    corners: Corners = "conical"
    program_plane_mm: float = 0.0
    second_plane_mm: float | None = None


@dataclass(frozen=True)
class Outline:
    """One edge or wire path as drawn, in the program's coordinates.

    Attributes
    ----------
    points_mm : float64 array (n, 2)
        The edge in the cutting direction; first and last point are equal if ``closed``.
    line_numbers : tuple of int
        Program line of each of the ``n - 1`` chords; 0 for a drawing.
    closed : bool
        Whether the edge closes on itself.
    wire_side : {"left", "right", None}
        Side of the edge to which the wire is offset; if None, the wire's centre follows the points.
    part_side : {"left", "right"}
        Side of the part.
    approach_mm : float64 array (k, 2)
        The program's approach from the thread point to ``points_mm[0]``, which is not included; may be empty.
        If the wire stays threaded (``continues``), it begins at the end of the previous outline.
    approach_lines : tuple of int
        Program line of each of the ``k`` approach moves.
    compensated_from : int
        Index from which ``approach_mm`` is an edge and is offset, too; before, it is the wire's centre.
    dwells : tuple of (int, float)
        ``(i, seconds)`` of every G4; ``i`` counts through ``approach_mm``, then ``points_mm``.
    needs_lead_in : bool
        Whether the contour needs a lead-in that the program does not have.
    elements : tuple of int
        Line or arc of each of the ``n - 1`` chords, counted along the edge from 1.
    offset_mm : float, optional
        Offset of the program's register in mm, if there is one.
    condition : str, optional
        Machining condition in force, as the program writes it: ``C001``, ``E1221``, ``S2``.
    approach_condition : str, optional
        The condition on the approach.
    adaptive : bool, optional
        Whether the program requests adaptive feed; None if it sets neither.
    continues : bool
        Whether the wire stays threaded from the previous outline: only cutting moves lie between them.
    stops_after : bool
        Whether the program stops after the outline (M00, M01), for example to glue the slug.
    taper : Taper, optional
        Inclination of the wire; None if it is vertical.
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
    condition: str | None = None
    approach_condition: str | None = None
    adaptive: bool | None = None
    continues: bool = False
    stops_after: bool = False
    taper: Taper | None = None

    @property
    def line(self) -> int | None:
        """The program line on which the edge begins."""
        return (self.line_numbers[0] or None) if self.line_numbers else None

    @property
    def name(self) -> str:
        """Name of the outline for error messages."""
        x, y = self.points_mm[0]
        return f"the contour from X{x:.3f} Y{y:.3f}"


@dataclass(frozen=True)
class Program:
    """All outlines of a part program, in cutting order.

    Attributes
    ----------
    outlines : tuple of Outline
    notices : tuple of str
        Decisions of the reader that you should know.
    source : str
        The file.
    dialect : str, optional
        Dialect of a G-code program, ``sodick`` or ``fanuc``; None if it has no words of either.
    conditions : mapping of str to mapping of str to float
        The program's table of machining conditions, by condition and column as written.
    settings : mapping of str to mapping of str to float
        Settings from your table of conditions, by condition as the program writes it and key of
        `edmsim.program.tables.SETTINGS`. Empty without such a table.
    """

    outlines: tuple[Outline, ...]
    notices: tuple[str, ...]
    source: str
    dialect: str | None = None
    conditions: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    settings: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class InForce:
    """What is in force while a move is cut, besides side and offset."""

    condition: str | None = None  # the machining condition called last
    adaptive: bool | None = None  # whether the feed is to be adaptive; None if the program does not say
    tilt_deg: float = 0.0  # angle between wire and vertical; positive where its upper end leans to the left
    corners: Corners = "conical"  # what a tapered corner becomes
    # heights of the program's plane and of the second plane, as in `Taper`
    planes_mm: tuple[float, float | None] = (0.0, None)


@dataclass(frozen=True)
class CutMove:
    """A cutting move of a G-code run."""

    points: tuple[complex, ...]  # its points after the start, ``x + 1j * y`` in mm
    side: Side | None  # the compensated side
    line: int
    offset: Offset | None = None  # the register in force
    state: InForce = field(default_factory=InForce)
    # for each point that of the second plane; empty if the wire is not led along two contours
    upper: tuple[complex, ...] = ()


@dataclass(frozen=True)
class Run:
    """What G-code cuts between two rapids, or a pass of it."""

    start: complex  # where the wire is threaded, ``x + 1j * y`` in mm; of a later pass, where the one before it ended
    # compensation was on already when the wire was brought there: the point lies on the contour (Robofil)
    on_contour: bool
    moves: tuple[CutMove, ...]
    dwells: tuple[tuple[int, float], ...]  # ``(moves done, seconds)``
    join_mm: float  # places closer than this are one
    stops: tuple[int, ...] = ()  # moves done at each stop (M0, M1)
    upper_start: complex = 0j  # of the second plane, where the wire is threaded
    continues: bool = False  # whether the wire stays threaded from the pass before
    one_of_several: bool = False  # whether other passes follow, or were before, on the same wire


def vertices_of(run: Run) -> list[complex]:
    """Return the start and the end of every move."""
    return [run.start, *(move.points[-1] for move in run.moves)]


def array_of(points: Sequence[complex]) -> NDArray[np.float64]:
    """Return places ``x + 1j * y`` as an array (n, 2)."""
    values = np.asarray(points, np.complex128)
    return np.column_stack([values.real, values.imag])


def signed_area(points: NDArray[np.float64]) -> float:
    """Return the enclosed area in mm2 of a closed polyline (n, 2), positive if it runs counter-clockwise."""
    x, y = (points - points[0]).T
    return float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum() / 2)


_AT_ONCE = 100


def refuse_self_crossing(points: NDArray[np.float64], line_numbers: Sequence[int]) -> None:
    """Refuse a polyline (n, 2) in mm that crosses itself, with the place and the lines of the two moves that meet."""
    moves = (np.diff(points, axis=0) != 0).any(axis=1)
    if not moves.all():  # the wire turns about a point here, while it moves in the second plane
        points = points[np.append(True, moves)]
        line_numbers = [number for number, moved in zip(line_numbers, moves, strict=True) if moved]
    if len(points) < 2:
        raise InputError("the contour is a single point in the program's plane: exchange the two planes")
    line = shapely.LineString(points)
    if line.is_simple:
        return
    first, second = _crossing_chords(points)
    chords = [shapely.LineString(points[i : i + 2]) for i in (first, second)]
    x, y = shapely.get_coordinates(chords[0].intersection(chords[1]))[0]
    numbers = [line_numbers[i] for i in (first, second)]
    lines = f" (lines {numbers[0]} and {numbers[1]})" if numbers[0] else ""
    reason = f"the contour crosses or retraces itself at X{x:.3f} Y{y:.3f}{lines}: draw it without crossings"
    raise InputError(reason, line=numbers[1] or None)


def chords_of(points: NDArray[np.float64]) -> list[shapely.LineString]:
    """Return the ``n - 1`` chords of a polyline (n, 2)."""
    return list(np.asarray(shapely.linestrings(np.stack([points[:-1], points[1:]], axis=1)), np.object_))


def _crossing_chords(points: NDArray[np.float64]) -> tuple[int, int]:
    """Return two chords of a line that is not simple, which meet elsewhere than end to start."""
    chords = chords_of(points)
    tree = shapely.STRtree(chords)
    joined_ends = np.array_equal(points[0], points[-1])
    for first in range(0, len(chords), _AT_ONCE):  # a line that retraces itself throughout has pairs without number
        left, right = tree.query(chords[first : first + _AT_ONCE], predicate="intersects")
        for a, b in sorted(zip((left + first).tolist(), right.tolist(), strict=True)):
            neighbours = b == a + 1 or (joined_ends and a == 0 and b == len(chords) - 1)
            if b > a and not (neighbours and chords[a].intersection(chords[b]).length == 0):
                return a, b
    raise AssertionError("a line that is not simple has two chords that meet")
