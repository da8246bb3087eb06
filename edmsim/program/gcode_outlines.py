"""Reading of G-code (RS-274 and its dialects) into outlines.

The words understood are G0 to G4, G10, G20, G21, G40 to G42, G90 to G92, G90.1, G91.1, M0, M1, M2, M30, M50, M60, F,
D, H, N, X, Y, I, J, R and P. Those that cannot change a contour in two axes (`edmsim.program.blocks`) are read with a
notice. Dwells (G4 with P or X) are in seconds. A ``/`` at the head of a line does not delete it. A G92 before any
move sets the wire's position; later ones shift the coordinates. The moves between two rapids are split into passes,
and each pass into approach, edge, overlap and lead-out.
"""

import math
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError, located, refuses_wrong_types
from edmsim.program import blocks, dialects
from edmsim.program.arcs import rounding_of
from edmsim.program.interpreter import Interpreter, Motions, Reading, prefer_absolute, reading_of, registers_set
from edmsim.program.limits import check_contours, check_count, check_points
from edmsim.program.outline import (
    CutMove,
    InForce,
    Outline,
    Program,
    Run,
    Side,
    Taper,
    array_of,
    chords_of,
    points_of,
    refuse_self_crossing,
    signed_area,
    vertices_of,
)
from edmsim.program.tables import OffsetRegisters, settings_for

# Splitting of a run into passes: cuts of the same profile, in alternating directions, with other offsets and
# conditions. A pass has one side and one offset; moves without compensation between two passes lead from the first to
# the second. An uncompensated run has a new pass where its condition changes.

_LEAST_SHARE = 0.5
"""Least share of a section's length on earlier sections for it to be a pass without G40 before it (ours: a trim
retraces most of its length, except its own ends; a contour that continues with another offset retraces nothing)."""


def passes_of(run: Run) -> list[Run]:
    """Split a run where compensation or offset changes: a run for each pass."""
    # if other moves have a greater offset, moves with an offset of 0 are approach and lead-out, as if uncompensated
    run = _without_zero_offsets(run)
    sections = _sections(run.moves)
    if len(sections) < 2:
        return [run]
    parts = []
    for number, section in enumerate(sections):
        begin = sections[number - 1].stop if number else 0
        if number:
            _check_goes_back(run, sections[:number], section)
        is_last = number == len(sections) - 1
        end = len(run.moves) if is_last else section.stop
        until = len(run.moves) if is_last else sections[number + 1].start
        parts.append(_part(run, begin, end, section.start, until))
    return parts


def parts_by_condition(run: Run) -> list[Run]:
    """Split an uncompensated run where its condition changes; an approach to the contour is not a part."""
    moves = run.moves
    if any(move.side for move in moves):
        return [run]
    changes = [k for k in range(1, len(moves)) if moves[k].state.condition != moves[k - 1].state.condition]
    bounds = [0, *changes, len(moves)]
    if len(bounds) > 3 and not _retraces(run, [range(bounds[1])], range(bounds[1], bounds[2])):
        del bounds[1]  # the approach has a condition of its own
    return [_part(run, begin, end, begin, end) for begin, end in pairwise(bounds)]


def _part(run: Run, begin: int, end: int, first: int, until: int) -> Run:
    """Return some moves of a run as a run; its stops are those after its edge has begun and before the next edge."""
    last = end if end == len(run.moves) else end - 1
    return replace(
        run, start=vertices_of(run)[begin], upper_start=_upper_start(run, begin),
        on_contour=run.on_contour if begin == 0 else first == begin, moves=run.moves[begin:end],
        dwells=tuple((done - begin, seconds) for done, seconds in run.dwells if begin <= done <= last),
        stops=tuple(min(done, end) - begin for done in run.stops if first < done <= until), continues=begin > 0,
        one_of_several=True,
    )  # fmt: skip


def _without_zero_offsets(run: Run) -> Run:
    """Remove compensation with an offset of 0 if another offset is greater."""
    values = {move.offset.mm for move in run.moves if move.side and move.offset is not None}
    if len(values) < 2 or 0.0 not in values:
        return run
    moves = tuple(
        replace(move, side=None, offset=None) if move.offset is not None and move.offset.mm == 0 else move
        for move in run.moves
    )
    return replace(run, moves=moves)


def _sections(moves: Sequence[CutMove]) -> list[range]:
    """Return the ranges of successive moves with the same compensation."""
    sections: list[range] = []
    for k, move in enumerate(moves):
        if move.side is None:
            continue
        if k and sections and sections[-1].stop == k and _compensation(moves[k - 1]) == _compensation(move):
            sections[-1] = range(sections[-1].start, k + 1)
        else:
            sections.append(range(k, k + 1))
    return sections


def _compensation(move: CutMove) -> tuple[str | None, float | None]:
    return move.side, None if move.offset is None else move.offset.mm


def _check_goes_back(run: Run, earlier: Sequence[range], section: range) -> None:
    """Refuse a change of compensation in the middle of a contour."""
    moves, first = run.moves, section.start
    if earlier[-1].stop < first or first in run.stops or _retraces(run, earlier, section):
        return
    before, now = moves[first - 1], moves[first]
    reason = (
        "compensation (G40 G41 G42) changes inside a contour" if before.side != now.side
        else f"the offset changes inside a contour, {before.offset or 'none'} to {now.offset or 'none'}"
    )
    raise InputError(f"{reason}: change it after a G0, or after G40 for another pass", line=now.line)


def _retraces(run: Run, earlier: Sequence[range], section: range) -> bool:
    """Return whether most of a section is on earlier sections."""
    vertices = vertices_of(run)
    *cut, points = (
        array_of(points_of(vertices[one.start], run.moves[one.start : one.stop])) for one in (*earlier, section)
    )
    lengths = shapely.length(chords_of(points))
    middles = shapely.points((points[:-1] + points[1:]) / 2)
    near = shapely.distance(shapely.MultiLineString(cut), middles) <= 2 * run.join_mm
    return float(lengths[near].sum()) >= _LEAST_SHARE * float(lengths.sum())


_LEAST_AREA_MM2 = 1e-4
_SAME = 1e-9
_MOVES_AT_ONCE = 10_000
_MOST_PASSES = 1_000_000
"""Most places passed within moves that are examined (ours: a program that has more is not cut with a wire)."""


def length_of(start: complex, moves: Sequence[CutMove]) -> float:
    """Return the length in mm of moves from a starting point."""
    return float(np.abs(np.diff(points_of(start, moves))).sum())


def first_loop(
    vertices: Sequence[complex], moves: Sequence[CutMove], first: int, last: int, join_mm: float
) -> tuple[int, int] | None:
    """Return the moves ``begin, end`` of the first loop, found through a grid of the join tolerance."""
    # areas are differences of cumulative sums. A point that is passed again, with no area enclosed since, is stored
    # once, so that a wire that goes back and forth a hundred thousand times is not compared with all earlier points
    swept = _swept(vertices[first], moves[first:last])
    by_cell: dict[tuple[int, int], list[int]] = {}
    for k in range(first, last + 1):
        column, row = (math.floor(c / join_mm) for c in (vertices[k].real, vertices[k].imag))
        cells = ((column + dx, row + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1))
        for j in sorted(j for cell in cells for j in by_cell.get(cell, ())):
            met = abs(vertices[j] - vertices[k]) <= join_mm
            closing = _cross(vertices[k] - vertices[first], vertices[j] - vertices[first])
            area = abs(swept[k - first] - swept[j - first] + closing) / 2
            if met and area > _LEAST_AREA_MM2 / 2 and _enclosed_mm2(vertices[j], moves[j:k]) > _LEAST_AREA_MM2:
                return j, k
        known = by_cell.setdefault((column, row), [])
        if not any(vertices[j] == vertices[k] and abs(swept[j - first] - swept[k - first]) < _SAME for j in known):
            known.append(k)
    return None


def closed_run(run: Run, first: int, last: int) -> tuple[Run, tuple[int, int] | None]:
    """Return the run, and the moves ``begin, end`` of its first loop among some moves; None if there is no loop."""
    # a contour that begins in the middle of a side may end with a move along the whole side: if a move closes a loop
    # by passing over the end of an earlier move, it is split there
    vertices, join_mm = vertices_of(run), run.join_mm
    loop = first_loop(vertices, run.moves, first, last, join_mm)
    swept = _swept(vertices[first], run.moves[first:last])
    for k, number in _passes(vertices, run.moves, first, last if loop is None else loop[1], join_mm):
        at, move = vertices[number], run.moves[k]
        chords = chords_of(array_of([vertices[k], *move.points]))
        chord = int(np.flatnonzero(shapely.dwithin(chords, shapely.Point(at.real, at.imag), join_mm))[0])
        before = (*move.points[:chord], at)
        ahead = _swept(vertices[k], [replace(move, points=before)])[-1]
        origin = vertices[k] - vertices[first]
        area = abs(swept[k - first] - swept[number - first] + ahead + _cross(origin, at - vertices[k])) / 2
        if area > _LEAST_AREA_MM2:
            parts = _split(run, k, chord, at)
            dwells = tuple((done + (done > k), seconds) for done, seconds in run.dwells)
            stops = tuple(done + (done > k) for done in run.stops)
            moves = (*run.moves[:k], *parts, *run.moves[k + 1 :])
            return replace(run, moves=moves, dwells=dwells, stops=stops), (number, k + 1)
    return run, loop


def _split(run: Run, k: int, chord: int, at: complex) -> tuple[CutMove, CutMove]:
    move = run.moves[k]
    parts = replace(move, points=(*move.points[:chord], at)), replace(move, points=move.points[chord:])
    if not move.upper:
        return parts
    points, above = (vertices_of(run)[k], *move.points), (_upper_start(run, k), *move.upper)
    share = abs(at - points[chord]) / abs(points[chord + 1] - points[chord])
    there = above[chord] + share * (above[chord + 1] - above[chord])
    return (replace(parts[0], upper=(*move.upper[:chord], there)), replace(parts[1], upper=move.upper[chord:]))


def _upper_start(run: Run, k: int) -> complex:
    """Return the position in the second plane when a move begins; that in the first if the previous move has none."""
    before = run.moves[k - 1] if k else None
    return run.upper_start if before is None else (before.upper or before.points)[-1]


def _passes(
    vertices: Sequence[complex], moves: Sequence[CutMove], first: int, last: int, join_mm: float
) -> list[tuple[int, int]]:
    """Return ``(move, vertex)`` where a move passes an earlier vertex between its ends, in order along the path."""
    places: dict[complex, int] = {}
    for number in range(first, last):
        places.setdefault(vertices[number], number)
    numbers = np.array(list(places.values()), np.intp)
    tree = shapely.STRtree(shapely.points(array_of(list(places))) if places else [])
    found: list[tuple[int, float, int]] = []
    looked_at = 0
    for begin in range(first, last, _MOVES_AT_ONCE):
        these = range(begin, min(begin + _MOVES_AT_ONCE, last))
        lines = [shapely.LineString(array_of([vertices[k], *moves[k].points])) for k in these]
        of_line, of_place = tree.query(lines, predicate="dwithin", distance=join_mm)
        looked_at += len(of_line)
        if looked_at > _MOST_PASSES:
            break
        for line, number in zip(of_line.tolist(), numbers[of_place].tolist(), strict=True):
            k = begin + line
            ends = vertices[k], vertices[k + 1]
            if number < k and all(abs(vertices[number] - end) > join_mm for end in ends):
                place = vertices[number]
                found.append((k, float(lines[line].project(shapely.Point(place.real, place.imag))), number))
    return [(k, number) for k, _, number in sorted(found)]


def _cross(a: complex, b: complex) -> float:
    return a.real * b.imag - a.imag * b.real


def _swept(start: complex, moves: Sequence[CutMove]) -> list[float]:
    """Return twice the area swept about the start, up to each move's end; 0 before the first move."""
    swept, at = [0.0], 0j
    for move in moves:
        total = swept[-1]
        for point in move.points:
            total += _cross(at, point - start)
            at = point - start
        swept.append(total)
    return swept


def _enclosed_mm2(start: complex, moves: Sequence[CutMove]) -> float:
    return abs(signed_area(array_of([*points_of(start, moves), start])))


UNCLEAR_GAP_MM = 0.5  # a compensated contour with a smaller gap is refused as not closed (ours)


def outline_of(run: Run) -> tuple[Outline, list[str]]:
    """Split a run into approach, edge, overlap and lead-out; return its outline and notices."""
    # The edge is the first loop that closes at an earlier point (within the run's `join_mm`). Moves before it are the
    # program's own approach. Moves after it along the edge are overlap, all further moves lead-out; neither is cut,
    # because the contour is complete. Without a loop the edge is open; if compensation was switched on at the thread
    # point, the first move is the approach.
    count, under = len(run.moves), [i for i, move in enumerate(run.moves) if move.side]
    first, last = (under[0], under[-1] + 1) if under else (0, count)
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
    notices = _change_notices(run.moves[begin:end])
    if lead_out > end:
        notices.append(f"line {run.moves[end].line}: the overlap after the contour is left out")
    if lead_out < len(run.moves):
        notices.append(f"line {run.moves[lead_out].line}: the lead-out after the contour is left out")
    return _assemble(run, first, begin, end, loop is not None), notices


def _change_notices(moves: Sequence[CutMove]) -> list[str]:
    """Return notices if an edge has several conditions, or shapes of tapered corners, of which one is chosen."""
    tapered = [move for move in moves if move.state.tilt_deg]
    notices = []
    for what, in_force, chosen in (
        ("the condition", [(move.state.condition or "none", move.line) for move in moves], "longest part"),
        ("the shape of tapered corners", [(move.state.corners or "unstated", move.line) for move in tapered],
         "beginning"),
    ):
        line = next((line for name, line in in_force if name != in_force[0][0]), None)
        if line is not None:
            names = ", ".join(dict.fromkeys(name for name, _ in in_force))
            notices.append(f"line {line}: {what} changes within a contour, {names}: that of its {chosen} is taken")
    return notices


def closes_on_itself(run: Run) -> bool:
    """Return whether a run has a loop that is more than a path there and back, apart from rounding."""
    run, loop = closed_run(run, 0, len(run.moves))
    if loop is None:
        return False
    begin, around = vertices_of(run)[loop[0]], run.moves[loop[0] : loop[1]]
    return _enclosed_mm2(begin, around) > run.join_mm * length_of(begin, around)


def _overlap(run: Run, begin: int, end: int) -> int:
    """Count the moves after a loop that run along its edge."""
    vertices = vertices_of(run)
    edge = shapely.LineString(array_of(points_of(vertices[begin], run.moves[begin:end])))
    shapely.prepare(edge)
    for count, move in enumerate(run.moves[end:]):
        points = np.array([vertices[end + count], *move.points])
        along = array_of([*points, *((points[:-1] + points[1:]) / 2)])
        if not shapely.dwithin(edge, shapely.points(along), run.join_mm).all():
            return count
    return len(run.moves) - end


def _refuse_more_than_a_lead_out(run: Run, first: int, edge: tuple[int, int], lead_out: int, *, closed: bool) -> None:
    """Refuse moves after an edge that are another contour, or that continue an edge which only touched itself."""
    (begin, end), vertices = edge, vertices_of(run)
    before = range(first + 1, begin) if lead_out == end else range(0)
    moves = [*(run.moves[k] for k in before), *run.moves[lead_out:]]
    places = [*(vertices[k] for k in before), *vertices[lead_out:]]
    loop = first_loop(places, moves, 0, len(moves), run.join_mm)
    length_mm = length_of(vertices[lead_out], run.moves[lead_out:])
    # the way back from a tab may be longer than the tab
    short = run.one_of_several or length_mm <= length_of(vertices[begin], run.moves[begin:end])
    if loop is None and short:
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


def _refuse_unclear_gap(run: Run, begin: int, end: int) -> None:
    if end <= begin:
        raise InputError("after the approach no move is left to cut: program one more", line=run.moves[end - 1].line)
    if run.moves[begin].side is None or end - begin < 3 or run.one_of_several:  # the gap is a tab
        return
    vertices = vertices_of(run)
    stop = vertices[end]
    gap = min(abs(vertices[begin] - stop), abs(run.start - stop))
    if gap <= run.join_mm:  # it is closed, with equal areas to its left and its right
        points, lines = _polyline(vertices[begin], run.moves[begin:end])
        refuse_self_crossing(array_of(points), lines)
    if gap < UNCLEAR_GAP_MM:
        reason = (f"the contour ends at X{stop.real:.3f} Y{stop.imag:.3f}, {gap:.3f} mm from where it began: "
                  f"close it within {run.join_mm:.3g} mm")
        raise InputError(reason, line=run.moves[end - 1].line)


def _polyline(start: complex, moves: Sequence[CutMove]) -> tuple[list[complex], list[int]]:
    """Return the points, including the start, and the program line of every chord."""
    return points_of(start, moves), [move.line for move in moves for _ in move.points]


def _assemble(run: Run, first: int, begin: int, end: int, closed: bool) -> Outline:
    vertices, moves = vertices_of(run), run.moves
    approach, approach_lines = _polyline(run.start, moves[:begin])
    points, lines = _polyline(vertices[begin], moves[begin:end])
    if closed:
        points[-1] = points[0]
    refuse_self_crossing(array_of(points), lines)
    side, offset, edge = moves[begin].side, moves[begin].offset, array_of(points)
    leading, cutting = _longest(vertices, moves, 0, begin), _longest(vertices, moves, begin, end)
    assert cutting is not None
    passed = np.cumsum([0, *(len(move.points) for move in moves[:end])])
    ramp_end = sum(len(move.points) for move in moves[: first + 1]) if begin > first else len(approach) - 1
    return Outline(
        points_mm=edge, line_numbers=tuple(lines), closed=closed, wire_side=side,
        part_side=_part_side(edge, closed, side, approach[:-1]), approach_mm=array_of(approach[:-1]),
        approach_lines=tuple(approach_lines), compensated_from=len(approach) - 1 if side is None else ramp_end,
        dwells=tuple((int(passed[min(done, end)]), seconds) for done, seconds in run.dwells),
        needs_lead_in=len(approach) == 1 and (closed or side is not None) and not run.continues,
        elements=tuple(k for k, move in enumerate(moves[begin:end], 1) for _ in move.points),
        offset_mm=offset and offset.mm, condition=cutting.condition, adaptive=cutting.adaptive,
        approach_condition=None if leading is None else leading.condition, continues=run.continues,
        stops_after=any(done >= end for done in run.stops), taper=_taper(run, begin, end, closed),
    )  # fmt: skip


def _longest(vertices: Sequence[complex], moves: Sequence[CutMove], begin: int, end: int) -> InForce | None:
    """Return the modal state with the greatest length among some moves; None if there are no moves."""
    lengths, by_condition = defaultdict[InForce, float](float), defaultdict[str | None, float](float)
    for k in range(begin, end):
        lengths[moves[k].state] += length_of(vertices[k], moves[k : k + 1])
    for state, length_mm in lengths.items():
        by_condition[state.condition] += length_mm
    if not by_condition:
        return None
    condition = max(by_condition, key=lambda name: by_condition[name])
    return max((state for state in lengths if state.condition == condition), key=lambda state: lengths[state])


def _taper(run: Run, begin: int, end: int, closed: bool) -> Taper | None:
    """Return the inclination of the wire along the moves of an edge; None if it is vertical."""
    moves = run.moves[begin:end]
    above = [move for move in moves if move.upper]
    state = moves[0].state
    plane_mm, second_mm = state.planes_mm
    if above and len(above) < len(moves):
        line = next(move.line for move in moves if not move.upper)
        reason = f"the contour has {len(moves)} elements below and {len(above)} above"
        raise InputError(f"{reason}: give this block a move after a colon as well, lower : upper", line=line)
    start = _upper_start(run, begin)
    upper = [start, *(point for move in above for point in move.upper)]
    lower = points_of(vertices_of(run)[begin], moves)
    if above and not all(abs(a - b) <= _SAME for a, b in zip(upper, lower, strict=True)):
        if any(move.state.tilt_deg for move in moves):
            line = next(move.line for move in moves if move.state.tilt_deg)
            raise InputError("the wire leans by an angle and by a second contour: use one of them", line=line)
        if closed:
            gap = abs(upper[-1] - start)
            if gap > run.join_mm:
                reason = f"the contour of the second plane ends {gap:.3f} mm from where it began"
                raise InputError(f"{reason}: close it as the one below is closed", line=moves[-1].line)
            upper[-1] = start
        return Taper(None, array_of(upper), state.corners, plane_mm, second_mm)
    angles = tuple(move.state.tilt_deg for move in moves for _ in move.points)
    tilted = next((move.state for move in moves if move.state.tilt_deg), None)
    return None if tilted is None else Taper(angles, None, tilted.corners, plane_mm)


def _part_side(edge: NDArray[np.float64], closed: bool, side: Side | None, approach: list[complex]) -> Side:
    """Return the side opposite the wire; if uncompensated, inside unless threaded inside, or left of an open path."""
    if side is not None or not closed:
        return "right" if side == "left" else "left"
    from_inside = bool(approach) and shapely.Polygon(edge).contains(shapely.Point(array_of(approach[:1])))
    return "left" if (signed_area(edge) > 0) != from_inside else "right"


@refuses_wrong_types
def read_gcode(
    file: str | Path, ignore: Sequence[str] = (), offsets: Mapping[str, float] | None = None,
    dialect: str = dialects.AUTO, conditions: Mapping[str, Mapping[str, float]] | None = None,
) -> Program:
    """Read a G-code program.

    Parameters
    ----------
    file : path
        The program, in UTF-8 or the encoding of its byte order mark.
    ignore : sequence of str
        Words to leave out, ``M77``, or letters, ``U``.
    offsets : mapping of str to float, optional
        Offsets in mm by register, ``{"D1": 0.155}``. Values in the program take precedence.
    dialect : str
        Name in `edmsim.program.dialects.DIALECTS`; ``auto`` recognises it by words that only one machine has.
    conditions : mapping of str to mapping of str to float, optional
        Settings of conditions, from `edmsim.program.tables.read_conditions`.

    Returns
    -------
    Program
        One outline per run between rapids and per pass, in mm. Its notices list the reader's decisions:
        dialect, coordinates in whole um, absolute arc centres, words without effect, an omitted lead-out.

    Raises
    ------
    UnknownWordsError
        If the file has unknown words; lists all of them.
    InputError
        If an arc or a contour is invalid, or the dialect unknown; names file and line.
    """
    path = Path(file)
    text, ignored = blocks.read_text(path), blocks.Ignored.of(ignore)
    found, dialect_notices = dialects.dialect_of(text, dialect)
    with located(path):
        read = _read(text, ignored, found)
        expanded, unused = blocks.expanded(read.main, read.behind)
        notices = [*read.notices, *unused]
        in_inches = found is dialects.FREECAD and dialects.INCHES.search(text) is not None
        units, unit_notices = blocks.units_of(expanded, found, in_inches)
        registers = OffsetRegisters(offsets or {}, registers_set(expanded))
        two_planes = any(block.upper is not None or block.values.keys() & {"U", "V"} for block in expanded)
        control = Interpreter(units, rounding_of(expanded, units), registers, found, two_planes)
        if found is dialects.LINUXCNC:
            control.state = replace(control.state, planes_mm=_planes_mm(text, units))
        for block in expanded:
            with located(line=block.line):
                control.run_block(block)
        outlines = _outlines(control, notices)
        if conditions and not control.called:
            raise InputError("the program calls no condition: leave the table out, or name its --dialect")
        settings = settings_for(control.called, conditions or {}, read.conditions)
    if control.called and not settings:
        names = ", ".join(control.called)
        dialect_notices.append(
            f"no settings for the conditions {names}: they have no effect; --conditions takes a table of settings"
        )
    dialect_notices += _plane_notices(outlines, control)
    notices = [*dialect_notices, *unit_notices, *control.notices.texts(), *notices]
    notices.sort(key=lambda notice: int((re.findall(r"^line (\d+):", notice) or ["0"])[0]))
    name = None if found is dialects.ISO else found.name
    return Program(tuple(outlines), tuple(notices), str(path), name, read.conditions, settings)


def _planes_mm(text: str, units: blocks.Units) -> tuple[float, float | None]:
    """Return the heights of the planes of X Y and of U V that comments name; the workpiece's faces if they do not."""
    heights = dialects.plane_heights(dialects.comments_of(text))
    if not {"XY", "UV"} <= heights.keys():
        return 0.0, None
    if heights["XY"] == heights["UV"]:
        raise InputError("the comments give the planes of X Y and of U V one height: two planes have two")
    return heights["XY"] * units.at_start_mm, heights["UV"] * units.at_start_mm


def _read(text: str, ignored: blocks.Ignored, dialect: dialects.Dialect) -> blocks.ProgramBlocks:
    """Split a program into blocks; if words are unknown, the error names the dialects that know all of them."""
    try:
        return blocks.read_blocks(text, ignored, dialect)
    except blocks.UnknownWordsError as error:
        others = [other for other in dialects.DIALECTS.values() if other is not dialect]
        knowing = [other.name for other in others if _reads(text, ignored, other)]
        if not knowing:
            raise
        found = [(word, line) for word, lines in error.words.items() for line in lines]
        hint = f"; known to --dialect {' or '.join(knowing)}"
        raise blocks.UnknownWordsError(sorted(found, key=lambda item: item[1]), hint) from None


def _reads(text: str, ignored: blocks.Ignored, dialect: dialects.Dialect) -> bool:
    try:
        blocks.read_blocks(text, ignored, dialect)
    except InputError:
        return False
    return True


def _plane_notices(outlines: Sequence[Outline], control: Interpreter) -> list[str]:
    leaning = [outline.taper for outline in outlines if outline.taper is not None]
    if not leaning or control.state.planes_mm != (0.0, None):
        return []
    if any(taper.upper_mm is not None for taper in leaning):
        return ["the heights of the two planes are not in the program: they are the workpiece's lower and upper face"]
    return ["the height of the program's plane is not in the program: it is the workpiece's lower face"]


def _outlines(control: Interpreter, notices: list[str]) -> list[Outline]:
    absolute = prefer_absolute([motion for run in control.runs for motion in run.motions], control.rounding)
    check_contours(sum(bool(run.motions) for run in control.runs))
    outlines: list[Outline] = []
    count = 0
    for motions in control.runs:
        run = _run_of(motions, absolute, control) if motions.motions else None
        if run is not None:
            count += sum(len(move.points) for move in run.moves)
            check_count(count)
            for outline, new in _outlines_of(run):
                outlines.append(outline)
                notices.extend(new)
            check_contours(len(outlines))
    if not outlines:
        raise InputError("the program cuts nothing: no G1, G2 or G3 with coordinates in it")
    return outlines


def _outlines_of(run: Run) -> list[tuple[Outline, list[str]]]:
    passes = passes_of(run)
    if len(passes) > 1:
        return [outline_of(one) for one in passes]
    try:
        return [outline_of(passes[0])]
    except InputError:
        parts = parts_by_condition(passes[0])
        if len(parts) < 2:
            raise
        return [outline_of(part) for part in parts]


def _run_of(motions: Motions, absolute: bool | None, control: Interpreter) -> Run | None:
    """Convert motions to moves; None if they cut nothing."""
    join_mm = control.rounding.join_mm
    readings = [reading_of(motion, absolute, control.rounding) for motion in motions.motions]
    if any(reading.full is None for reading in readings):  # circles only if the run does not close without
        without = tuple(_cut_move(reading) for reading in readings)
        closes = closes_on_itself(Run(motions.motions[0].start, False, without, (), join_mm))
        readings = [reading.decided(not closes) if reading.full is None else reading for reading in readings]
    for reading in readings:
        for notice in reading.notices:
            control.notices.add(notice, reading.motion.line)
    done = np.cumsum([0, *(reading.moves for reading in readings)])
    dwells = tuple((int(done[count]), seconds) for count, seconds in motions.dwells)
    stops = tuple(int(done[count]) for count in motions.stops)
    moves = tuple(_cut_move(reading) for reading in readings if reading.moves)
    first = motions.motions[0]
    above = first.start if first.upper is None else first.upper.start
    on_contour = motions.side_at_start is not None
    return Run(first.start, on_contour, moves, dwells, join_mm, stops, above) if moves else None


def _cut_move(reading: Reading) -> CutMove:
    """Return a motion as a move, an arc as chords; raises `InputError` if it is larger than any table."""
    motion = reading.motion
    with located(line=motion.line):
        check_points(array_of((motion.start, motion.end)), "the move")
        points, above = reading.planes
        if len(points) > 1:
            check_points(array_of((motion.start, *points)), "the arc")
        check_points(array_of(above), "the move in the second plane")
    return CutMove(points, motion.side, motion.line, motion.offset, motion.state, above)
