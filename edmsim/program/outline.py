"""What a part program draws, before any wire: outlines in mm, from G-code runs or DXF contours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.program.crossing import refuse_self_crossing
from edmsim.program.registers import Offset

JOIN_TOLERANCE_MM = 0.005
"""Ends closer than this many mm are one point (ours: rounding of programs, well below the gap)."""

UNCLEAR_GAP_MM = 0.5
"""A compensated G-code contour whose ends miss each other by less is refused as not closed (ours)."""

_LEAST_AREA_MM2 = 1e-4
_SAME = 1e-9
_LONGEST_LEAD_OUT = 2

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
    """

    start: complex
    on_contour: bool
    moves: tuple[CutMove, ...]
    dwells: tuple[tuple[int, float], ...]


def signed_area(points: NDArray[np.float64]) -> float:
    """Return the enclosed area in mm2 of a closed polyline (n, 2), positive if it runs counter-clockwise."""
    x, y = (points - points[0]).T
    return float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum() / 2)


def outline_of(run: Run) -> tuple[Outline, list[str]]:
    """Tell approach, edge and lead-out of a run apart.

    The edge is the first loop that closes on a point already passed (within `JOIN_TOLERANCE_MM`). What comes
    before it is the program's own approach; at most two moves after it are a lead-out and are left out, for
    the contour is done. Without a loop the edge is open; if compensation was switched on at the thread point
    its first move is the approach.

    Returns
    -------
    outline : Outline
    notices : list of str

    Raises
    ------
    InputError
        Compensation changes twice, a contour is all but closed, or more than a lead-out follows it.
    """
    first, last = _edge_section(run.moves)
    loop = _first_loop(_vertices(run), run.moves, first, last)
    side = run.moves[first].side
    if loop is None:
        ramp = side is not None and not (run.on_contour and first == 0)
        begin, end = first + ramp, last
        _refuse_unclear_gap(run, begin, end)
    else:
        begin, end = loop
    rest = run.moves[end:]
    if len(rest) > _LONGEST_LEAD_OUT or (loop is not None and _goes_on(run, first, loop, last)):
        raise InputError(_rest_reason(run, loop, last), line=rest[0].line)
    notices = [f"line {move.line}: the lead-out after the contour is left out" for move in rest[:1]]
    return _assemble(run, first, begin, end, loop is not None), notices


def _rest_reason(run: Run, loop: tuple[int, int] | None, last: int) -> str:
    """Say why moves after an edge cannot be a lead-out: the contour meets itself and goes on, or is over."""
    begin, end = loop or (0, last)
    count = len(run.moves) - end
    told = "1 move follows after" if count == 1 else f"{count} moves follow after"
    if loop is None or end == last < len(run.moves):
        return f"{told} compensation is off: bring the wire to the next contour with G0"
    place = run.moves[end - 1].points[-1]
    lines = f"lines {run.moves[begin].line} and {run.moves[end - 1].line}"
    return (f"{told} the contour has met itself at X{place.real:.3f} Y{place.imag:.3f} ({lines}), "
            "where it is closed: draw it without touching itself, or bring the wire to the next contour with G0")


def _goes_on(run: Run, first: int, loop: tuple[int, int], last: int) -> bool:
    """Say whether what is before and after a loop makes another one: the contour only touches itself there."""
    vertices, (begin, end) = _vertices(run), loop
    return any(
        abs(vertices[k] - vertices[m]) <= JOIN_TOLERANCE_MM
        and _encloses(vertices[k], (*run.moves[k:begin], *run.moves[end:m]))
        for k in range(first + 1, begin) for m in range(end + 1, last + 1)
    )


def _vertices(run: Run) -> list[complex]:
    return [run.start, *(move.points[-1] for move in run.moves)]


def _edge_section(moves: Sequence[CutMove]) -> tuple[int, int]:
    """Return the range of moves under compensation, or all moves if there is none."""
    compensated = [i for i, move in enumerate(moves) if move.side]
    if not compensated:
        return 0, len(moves)
    first, last = compensated[0], compensated[-1] + 1
    for move in moves[first:last]:
        if move.side != moves[first].side:
            reason = "compensation (G40 G41 G42) changes inside a contour: change it after a G0"
            raise InputError(reason, line=move.line)
        earlier, now = moves[first].offset, move.offset
        if (earlier and earlier.mm) != (now and now.mm):
            reason = f"the offset changes inside a contour, {earlier or 'none'} to {now}: change it after a G0"
            raise InputError(reason, line=move.line)
    return first, last


def _first_loop(
    vertices: list[complex], moves: Sequence[CutMove], first: int, last: int
) -> tuple[int, int] | None:
    """Return the moves ``begin, end`` of the first loop, found through a grid of the join tolerance.

    Areas are differences of sums along the way. A place that is passed again, with nothing enclosed since, is noted
    once, so that a wire that goes back and forth a hundred thousand times is not compared with all of its past.
    """
    swept = _swept(vertices[first], moves[first:last])
    seen: dict[tuple[int, int], list[int]] = {}
    for k in range(first, last + 1):
        column, row = (math.floor(c / JOIN_TOLERANCE_MM) for c in (vertices[k].real, vertices[k].imag))
        cells = ((column + dx, row + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1))
        for j in sorted(j for cell in cells for j in seen.get(cell, ())):
            met = abs(vertices[j] - vertices[k]) <= JOIN_TOLERANCE_MM
            closing = _cross(vertices[k] - vertices[first], vertices[j] - vertices[first])
            area = abs(swept[k - first] - swept[j - first] + closing) / 2
            if met and area > _LEAST_AREA_MM2 / 2 and _encloses(vertices[j], moves[j:k]):
                return j, k
        known = seen.setdefault((column, row), [])
        if not any(vertices[j] == vertices[k] and abs(swept[j - first] - swept[k - first]) < _SAME for j in known):
            known.append(k)
    return None


def _cross(a: complex, b: complex) -> float:
    return a.real * b.imag - a.imag * b.real


def _swept(start: complex, moves: Sequence[CutMove]) -> list[float]:
    """Return twice the area swept, as seen from the start, up to each move's end; 0 in front of the first."""
    swept, at = [0.0], 0j
    for move in moves:
        total = swept[-1]
        for point in move.points:
            total += _cross(at, point - start)
            at = point - start
        swept.append(total)
    return swept


def _encloses(start: complex, moves: Sequence[CutMove]) -> bool:
    points = [start, *(p for move in moves for p in move.points)]
    return abs(signed_area(_array([*points, start]))) > _LEAST_AREA_MM2


def _refuse_unclear_gap(run: Run, begin: int, end: int) -> None:
    if end <= begin:
        reason = "after the approach no move is left to cut: program one more"
        raise InputError(reason, line=run.moves[end - 1].line)
    if run.moves[begin].side is None or end - begin < 3:
        return
    vertices = _vertices(run)
    stop = vertices[end]
    gap = min(abs(vertices[begin] - stop), abs(run.start - stop))
    if gap <= JOIN_TOLERANCE_MM:  # it is closed, and encloses as much to its left as to its right
        points, lines = _polyline(vertices[begin], run.moves[begin:end])
        refuse_self_crossing(_array(points), lines)
    if gap < UNCLEAR_GAP_MM:
        reason = (f"the contour ends at X{stop.real:.3f} Y{stop.imag:.3f}, {gap:.3f} mm from where it began: "
                  f"close it within {JOIN_TOLERANCE_MM} mm")
        raise InputError(reason, line=run.moves[end - 1].line)


def _array(points: Sequence[complex]) -> NDArray[np.float64]:
    values = np.asarray(points, np.complex128)
    return np.column_stack([values.real, values.imag])


def _polyline(start: complex, moves: Sequence[CutMove]) -> tuple[list[complex], list[int]]:
    """Return the points with the start, and for every chord its line."""
    points = [start, *(p for move in moves for p in move.points)]
    return points, [move.line for move in moves for _ in move.points]


def _assemble(run: Run, first: int, begin: int, end: int, closed: bool) -> Outline:
    vertices, moves = _vertices(run), run.moves
    approach, approach_lines = _polyline(run.start, moves[:begin])
    points, lines = _polyline(vertices[begin], moves[begin:end])
    if closed:
        points[-1] = points[0]
    refuse_self_crossing(_array(points), lines)
    side, offset, edge = moves[begin].side, moves[begin].offset, _array(points)
    ramp_end = sum(len(move.points) for move in moves[: first + 1]) if begin > first else len(approach) - 1
    return Outline(
        points_mm=edge,
        line_numbers=tuple(lines),
        closed=closed,
        wire_side=side,
        part_side=_part_side(edge, closed, side, approach[:-1]),
        approach_mm=_array(approach[:-1]),
        approach_lines=tuple(approach_lines),
        compensated_from=len(approach) - 1 if side is None else ramp_end,
        dwells=_dwells(run, end),
        needs_lead_in=len(approach) == 1 and (closed or side is not None),
        elements=tuple(k for k, move in enumerate(moves[begin:end], 1) for _ in move.points),
        offset_mm=offset and offset.mm,
    )


def _part_side(edge: NDArray[np.float64], closed: bool, side: Side | None, approach: list[complex]) -> Side:
    """Opposite the wire; uncompensated: inside, unless the wire comes from inside; left of an open path."""
    if side is not None or not closed:
        return "right" if side == "left" else "left"
    from_inside = bool(approach) and shapely.Polygon(edge).contains(shapely.Point(_array(approach[:1])))
    return "left" if (signed_area(edge) > 0) != from_inside else "right"


def _dwells(run: Run, end: int) -> tuple[tuple[int, float], ...]:
    """Return the dwells by point; one after the end of the edge is kept at its end."""
    counts = np.cumsum([0, *(len(move.points) for move in run.moves[:end])])
    return tuple((int(counts[min(done, end)]), seconds) for done, seconds in run.dwells)
