"""Outlines of a part program in mm, from G-code runs or DXF contours, before offset; none may cross itself."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.program.tables import Offset

JOIN_TOLERANCE_MM = 0.005  # ends closer than this are one point (ours: rounding of programs, well below the gap)
Side = Literal["left", "right"]
Corners = Literal["sharp", "conical", "cylindrical", "rounded"]
"""Shape at other heights of a corner or an arc of the program plane."""


@dataclass(frozen=True, eq=False)
class Taper:
    """Inclination of the wire along an outline."""

    # angle between wire and vertical for each chord; positive if the wire's upper end leans to the left of the
    # cutting direction. None if `upper_mm` is set.
    angle_deg: tuple[float, ...] | None = None
    # (n, 2): point in the second plane for each point of the outline; the wall between them is ruled
    upper_mm: NDArray[np.float64] | None = None
    # shape of corners and arcs at other heights; None if the program does not say, so the cut's option applies
    corners: Corners | None = "conical"
    program_plane_mm: float = 0.0  # height of the outline's plane over the workpiece's lower face
    second_plane_mm: float | None = None  # height of the plane of `upper_mm`; by default the workpiece's upper face


@dataclass(frozen=True, eq=False)
class Outline:
    """One edge or wire path as drawn, in the program's coordinates."""

    # (n, 2): the edge in the cutting direction; first and last point are equal if ``closed``
    points_mm: NDArray[np.float64]
    line_numbers: tuple[int, ...]  # program line of each of the ``n - 1`` chords; 0 for a drawing
    closed: bool  # whether the edge closes on itself
    # side of the edge to which the wire is offset; if None, the wire's centre follows the points
    wire_side: Side | None
    part_side: Side  # side of the part
    # (k, 2): the program's approach from the thread point to ``points_mm[0]``, which is not included; may be empty.
    # If the wire stays threaded (``continues``), it begins at the end of the previous outline.
    approach_mm: NDArray[np.float64]
    approach_lines: tuple[int, ...] = ()  # program line of each of the ``k`` approach moves
    # index from which ``approach_mm`` is an edge, which is also offset; before it, the points are the wire's centre
    compensated_from: int = 0
    # ``(i, seconds)`` of every G4; ``i`` counts through ``approach_mm``, then ``points_mm``
    dwells: tuple[tuple[int, float], ...] = ()
    needs_lead_in: bool = True  # whether the contour needs a lead-in that the program does not have
    elements: tuple[int, ...] = ()  # line or arc of each of the ``n - 1`` chords, counted along the edge from 1
    offset_mm: float | None = None  # offset of the program's register in mm, if there is one
    # machining condition in force, as the program writes it: ``C001``, ``E1221``, ``S2``
    condition: str | None = None
    approach_condition: str | None = None  # the condition on the approach
    adaptive: bool | None = None  # whether the program requests adaptive feed; None if it sets neither
    # whether the wire stays threaded from the previous outline: only cutting moves lie between them
    continues: bool = False
    stops_after: bool = False  # whether the program stops after the outline (M00, M01), for example to glue the slug
    taper: Taper | None = None  # inclination of the wire; None if it is vertical

    @property
    def line(self) -> int | None:
        """The program line on which the edge begins."""
        return (self.line_numbers[0] or None) if self.line_numbers else None

    @property
    def name(self) -> str:
        """Name of the outline for error messages."""
        x, y = self.points_mm[0]
        return f"the contour from X{x:.3f} Y{y:.3f}"


@dataclass(frozen=True, eq=False)
class Program:
    """All outlines of a part program, in cutting order."""

    outlines: tuple[Outline, ...]
    notices: tuple[str, ...]  # decisions of the reader that you should know
    source: str  # the file
    # name of a G-code program's dialect, such as ``sodick``; None for ``iso`` and for drawings
    dialect: str | None = None
    # the program's table of machining conditions, by condition and column as written
    conditions: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    # settings from your table of conditions, by condition as the program writes it and key of
    # `edmsim.program.tables.SETTINGS`. Empty without such a table.
    settings: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class InForce:
    """Modal state of the program during a cutting move, apart from side and offset."""

    condition: str | None = None  # the machining condition called last
    adaptive: bool | None = None  # whether the feed is to be adaptive; None if the program does not say
    tilt_deg: float = 0.0  # angle between wire and vertical; positive if its upper end leans to the left
    corners: Corners | None = None  # shape of tapered corners; None if the program does not say
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
    # the point of the second plane for each point; empty if the wire does not follow two contours
    upper: tuple[complex, ...] = ()


@dataclass(frozen=True)
class Run:
    """The cutting moves of G-code between two rapids, or one pass of them."""

    start: complex  # where the wire is threaded, ``x + 1j * y`` in mm; of a later pass, where the previous one ended
    # whether compensation was already on when the wire moved to the start, which is then on the contour (Robofil)
    on_contour: bool
    moves: tuple[CutMove, ...]
    dwells: tuple[tuple[int, float], ...]  # ``(moves done, seconds)``
    join_mm: float  # points closer than this are one
    stops: tuple[int, ...] = ()  # moves done at each stop (M0, M1)
    upper_start: complex = 0j  # the start in the second plane
    continues: bool = False  # whether the wire stays threaded from the previous pass
    one_of_several: bool = False  # whether other passes precede or follow without rethreading


def vertices_of(run: Run) -> list[complex]:
    """Return the start and the end of every move."""
    return [run.start, *(move.points[-1] for move in run.moves)]


def points_of(start: complex, moves: Sequence[CutMove]) -> list[complex]:
    """Return a place and all points of the moves from there."""
    return [start, *(point for move in moves for point in move.points)]


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
    """Refuse a polyline (n, 2) in mm that crosses itself, naming the place and the lines of the two moves."""
    moves = (np.diff(points, axis=0) != 0).any(axis=1)
    if not moves.all():  # the wire turns about a point, and moves only in the second plane
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


def chords_of(points: NDArray[np.float64]) -> NDArray[np.object_]:
    """Return the ``n - 1`` chords of a polyline (n, 2), each a `shapely.LineString`."""
    return np.asarray(shapely.linestrings(np.stack([points[:-1], points[1:]], axis=1)), np.object_)


def _crossing_chords(points: NDArray[np.float64]) -> tuple[int, int]:
    """Return two chords of a line that is not simple, which meet other than end to start."""
    chords = chords_of(points)
    tree = shapely.STRtree(chords)
    joined_ends = np.array_equal(points[0], points[-1])
    for first in range(0, len(chords), _AT_ONCE):  # in batches: a line that retraces itself has too many pairs
        left, right = tree.query(chords[first : first + _AT_ONCE], predicate="intersects")
        for a, b in sorted(zip((left + first).tolist(), right.tolist(), strict=True)):
            neighbours = b == a + 1 or (joined_ends and a == 0 and b == len(chords) - 1)
            if b > a and not (neighbours and chords[a].intersection(chords[b]).length == 0):
                return a, b
    raise AssertionError("a line that is not simple has two chords that meet")
