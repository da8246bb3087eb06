"""Approach, edge, overlap and lead-out of what G-code cuts between two rapids."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.program.crossing import refuse_self_crossing
from edmsim.program.loops import array_of, closed_run, first_loop, length_of, vertices_of
from edmsim.program.outline import CutMove, Outline, Run, Side, signed_area

UNCLEAR_GAP_MM = 0.5
"""A compensated G-code contour whose ends miss each other by less is refused as not closed (ours)."""


def outline_of(run: Run) -> tuple[Outline, list[str]]:
    """Tell approach, edge, overlap and lead-out of a run apart.

    The edge is the first loop that closes on a place already passed (within the run's ``join_mm``). What comes before
    it is the program's own approach. What follows and runs along the edge is overlap; what then leaves it is a
    lead-out. Neither is cut, for the contour is done. Without a loop the edge is open; if compensation was switched
    on at the thread point its first move is the approach.

    Returns
    -------
    outline : Outline
    notices : list of str

    Raises
    ------
    InputError
        Compensation changes twice, a contour is all but closed, or what follows it is no lead-out: it closes a loop,
        or is longer than the contour.
    """
    (first, last), count = _edge_section(run.moves), len(run.moves)
    run, loop = closed_run(run, first, last)
    last += len(run.moves) - count  # a move may have been split
    side = run.moves[first].side
    if loop is None:
        ramp = side is not None and not (run.on_contour and first == 0)
        begin, end = first + ramp, last
        _refuse_unclear_gap(run, begin, end)
    else:
        begin, end = loop
    lead_out = end + (0 if loop is None else _overlap(run, begin, end))
    if lead_out < len(run.moves):
        _refuse_more_than_a_lead_out(run, first, (begin, end), lead_out, closed=loop is not None and end < last)
    notices = []
    if lead_out > end:
        notices.append(f"line {run.moves[end].line}: the overlap after the contour is left out")
    if lead_out < len(run.moves):
        notices.append(f"line {run.moves[lead_out].line}: the lead-out after the contour is left out")
    return _assemble(run, first, begin, end, loop is not None), notices


def closes_on_itself(moves: Sequence[CutMove], start: complex, join_mm: float) -> bool:
    """Say whether moves make a loop that is more than a way and the same way back, written with some rounding."""
    vertices = [start, *(move.points[-1] for move in moves)]
    loop = first_loop(vertices, moves, 0, len(moves), join_mm)
    if loop is None:
        return False
    points, _ = _polyline(vertices[loop[0]], moves[loop[0] : loop[1]])
    area_mm2 = abs(signed_area(array_of([*points, points[0]])))
    return area_mm2 > join_mm * length_of(points[0], moves[loop[0] : loop[1]])


def _overlap(run: Run, begin: int, end: int) -> int:
    """Count the moves after a loop that run along its edge."""
    vertices = vertices_of(run)
    edge = shapely.LineString(array_of(_polyline(vertices[begin], run.moves[begin:end])[0]))
    shapely.prepare(edge)
    for count, move in enumerate(run.moves[end:]):
        points = np.array([vertices[end + count], *move.points])
        along = array_of([*points, *((points[:-1] + points[1:]) / 2)])
        if not shapely.dwithin(edge, shapely.points(along), run.join_mm).all():
            return count
    return len(run.moves) - end


def _refuse_more_than_a_lead_out(
    run: Run, first: int, edge: tuple[int, int], lead_out: int, *, closed: bool
) -> None:
    """Refuse moves after an edge that are a contour of their own, or go on with it where it only touched itself."""
    (begin, end), vertices = edge, vertices_of(run)
    before = range(first + 1, begin) if lead_out == end else range(0)
    moves = [*(run.moves[k] for k in before), *run.moves[lead_out:]]
    places = [*(vertices[k] for k in before), *vertices[lead_out:]]
    loop = first_loop(places, moves, 0, len(moves), run.join_mm)
    length_mm = length_of(vertices[lead_out], run.moves[lead_out:])
    if loop is None and length_mm <= length_of(vertices[begin], run.moves[begin:end]):
        return
    count = len(run.moves) - lead_out
    what = "with a closed loop" if loop is not None else f"{length_mm:.3f} mm and so longer than the contour,"
    follow = f"1 move {what} follows" if count == 1 else f"{count} moves {what} follow"
    line = run.moves[lead_out].line
    if not closed:
        raise InputError(f"{follow} after compensation is off: bring the wire to the next contour with G0", line=line)
    place = vertices[end]
    lines = f"lines {run.moves[begin].line} and {run.moves[end - 1].line}"
    met = f"the contour has met itself at X{place.real:.3f} Y{place.imag:.3f} ({lines}), where it is closed"
    remedy = "draw it without touching itself, or bring the wire to the next contour with G0"
    raise InputError(f"{follow} after {met}: {remedy}", line=line)


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


def _refuse_unclear_gap(run: Run, begin: int, end: int) -> None:
    if end <= begin:
        reason = "after the approach no move is left to cut: program one more"
        raise InputError(reason, line=run.moves[end - 1].line)
    if run.moves[begin].side is None or end - begin < 3:
        return
    vertices = vertices_of(run)
    stop = vertices[end]
    gap = min(abs(vertices[begin] - stop), abs(run.start - stop))
    if gap <= run.join_mm:  # it is closed, and encloses as much to its left as to its right
        points, lines = _polyline(vertices[begin], run.moves[begin:end])
        refuse_self_crossing(array_of(points), lines)
    if gap < UNCLEAR_GAP_MM:
        reason = (f"the contour ends at X{stop.real:.3f} Y{stop.imag:.3f}, {gap:.3f} mm from where it began: "
                  f"close it within {run.join_mm:.3g} mm")
        raise InputError(reason, line=run.moves[end - 1].line)


def _polyline(start: complex, moves: Sequence[CutMove]) -> tuple[list[complex], list[int]]:
    """Return the points with the start, and for every chord its line."""
    points = [start, *(p for move in moves for p in move.points)]
    return points, [move.line for move in moves for _ in move.points]


def _assemble(run: Run, first: int, begin: int, end: int, closed: bool) -> Outline:
    vertices, moves = vertices_of(run), run.moves
    approach, approach_lines = _polyline(run.start, moves[:begin])
    points, lines = _polyline(vertices[begin], moves[begin:end])
    if closed:
        points[-1] = points[0]
    refuse_self_crossing(array_of(points), lines)
    side, offset, edge = moves[begin].side, moves[begin].offset, array_of(points)
    ramp_end = sum(len(move.points) for move in moves[: first + 1]) if begin > first else len(approach) - 1
    return Outline(
        points_mm=edge,
        line_numbers=tuple(lines),
        closed=closed,
        wire_side=side,
        part_side=_part_side(edge, closed, side, approach[:-1]),
        approach_mm=array_of(approach[:-1]),
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
    from_inside = bool(approach) and shapely.Polygon(edge).contains(shapely.Point(array_of(approach[:1])))
    return "left" if (signed_area(edge) > 0) != from_inside else "right"


def _dwells(run: Run, end: int) -> tuple[tuple[int, float], ...]:
    """Return the dwells by point; one after the end of the edge is kept at its end."""
    counts = np.cumsum([0, *(len(move.points) for move in run.moves[:end])])
    return tuple((int(counts[min(done, end)]), seconds) for done, seconds in run.dwells)
