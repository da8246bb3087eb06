"""Where a run of cutting moves closes on a place it has been before."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.program.outline import CutMove, Run, signed_area

_LEAST_AREA_MM2 = 1e-4
_SAME = 1e-9
_MOVES_AT_ONCE = 10_000
_MOST_PASSES = 1_000_000
"""Places passed within a move that are looked at (ours): a program that has more is not cut with a wire."""


def vertices_of(run: Run) -> list[complex]:
    """Return the start and the end of every move."""
    return [run.start, *(move.points[-1] for move in run.moves)]


def array_of(points: Sequence[complex]) -> NDArray[np.float64]:
    """Return places ``x + 1j * y`` as an array (n, 2)."""
    values = np.asarray(points, np.complex128)
    return np.column_stack([values.real, values.imag])


def length_of(start: complex, moves: Sequence[CutMove]) -> float:
    """Return the length in mm of moves from a place."""
    points = np.array([start, *(p for move in moves for p in move.points)])
    return float(np.abs(np.diff(points)).sum())


def first_loop(
    vertices: Sequence[complex], moves: Sequence[CutMove], first: int, last: int, join_mm: float
) -> tuple[int, int] | None:
    """Return the moves ``begin, end`` of the first loop, found through a grid of the join tolerance.

    Areas are differences of sums along the way. A place that is passed again, with nothing enclosed since, is noted
    once, so that a wire that goes back and forth a hundred thousand times is not compared with all of its past.
    """
    swept = _swept(vertices[first], moves[first:last])
    seen: dict[tuple[int, int], list[int]] = {}
    for k in range(first, last + 1):
        column, row = (math.floor(c / join_mm) for c in (vertices[k].real, vertices[k].imag))
        cells = ((column + dx, row + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1))
        for j in sorted(j for cell in cells for j in seen.get(cell, ())):
            met = abs(vertices[j] - vertices[k]) <= join_mm
            closing = _cross(vertices[k] - vertices[first], vertices[j] - vertices[first])
            area = abs(swept[k - first] - swept[j - first] + closing) / 2
            if met and area > _LEAST_AREA_MM2 / 2 and _encloses(vertices[j], moves[j:k]):
                return j, k
        known = seen.setdefault((column, row), [])
        if not any(vertices[j] == vertices[k] and abs(swept[j - first] - swept[k - first]) < _SAME for j in known):
            known.append(k)
    return None


def closed_run(run: Run, first: int, last: int) -> tuple[Run, tuple[int, int] | None]:
    """Return a run with the moves ``begin, end`` of its first loop among some moves, None if there is no loop.

    A contour that begins in the middle of a side may end by a move along the whole side: a move that closes a loop by
    running on over a place where an earlier move ended is split there.
    """
    vertices, join_mm = vertices_of(run), run.join_mm
    loop = first_loop(vertices, run.moves, first, last, join_mm)
    swept = _swept(vertices[first], run.moves[first:last])
    for k, number in _passes(vertices, run.moves, first, last if loop is None else loop[1], join_mm):
        at, move = vertices[number], run.moves[k]
        chord = _chord_at(vertices[k], move, at, join_mm)
        before, after = (*move.points[:chord], at), move.points[chord:]
        ahead = _swept(vertices[k], [replace(move, points=before)])[-1]
        origin = vertices[k] - vertices[first]
        area = abs(swept[k - first] - swept[number - first] + ahead + _cross(origin, at - vertices[k])) / 2
        if area > _LEAST_AREA_MM2:
            parts = (replace(move, points=before), replace(move, points=after))
            dwells = tuple((done + (done > k), seconds) for done, seconds in run.dwells)
            return replace(run, moves=(*run.moves[:k], *parts, *run.moves[k + 1 :]), dwells=dwells), (number, k + 1)
    return run, loop


def _passes(
    vertices: Sequence[complex], moves: Sequence[CutMove], first: int, last: int, join_mm: float
) -> list[tuple[int, int]]:
    """Return ``(move, vertex)`` where a move passes an earlier vertex between its ends, in the order of the way."""
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


def _chord_at(start: complex, move: CutMove, place: complex, join_mm: float) -> int:
    """Return the index of the chord of a move that passes a place first."""
    points = array_of([start, *move.points])
    chords = shapely.linestrings(np.stack([points[:-1], points[1:]], axis=1))
    distances = shapely.distance(chords, shapely.Point(place.real, place.imag))
    return int(np.flatnonzero(distances <= join_mm)[0])


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
    return abs(signed_area(array_of([*points, start]))) > _LEAST_AREA_MM2
