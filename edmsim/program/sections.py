"""A run taken apart into its passes: the same profile cut again, to and fro, with other offsets and conditions.

A pass is what is cut under one side and one offset; moves without compensation between two of them lead from the one
to the other. An uncompensated run has passes where its condition changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import shapely

from edmsim.errors import InputError
from edmsim.program.outline import CutMove, Run, array_of, vertices_of

_LEAST_SHARE = 0.5
"""Of the length of what goes on without G40, that lies on what was cut before (ours: a trim retraces the most of it,
with ends of its own; a contour that goes on with another offset retraces none)."""


@dataclass(frozen=True)
class _Section:
    """Moves ``first`` to ``last`` under one compensation."""

    first: int
    last: int


def passes_of(run: Run) -> list[Run]:
    """Split a run where compensation or offset changes: a run for each pass."""
    # moves under an offset of 0 beside some under a greater one are approach and way out, as where they had none
    run = _without_zero_offsets(run)
    sections = _sections(run.moves)
    if len(sections) < 2:
        return [run]
    parts = []
    for number, section in enumerate(sections):
        begin = sections[number - 1].last if number else 0
        if number:
            _check_goes_back(run, sections[:number], section)
        is_last = number == len(sections) - 1
        end = len(run.moves) if is_last else section.last
        until = len(run.moves) if is_last else sections[number + 1].first
        parts.append(_part(run, begin, end, section.first, until))
    return parts


def parts_by_condition(run: Run) -> list[Run]:
    """Split an uncompensated run where its condition changes; what only leads to the contour is not part."""
    moves = run.moves
    if any(move.side for move in moves):
        return [run]
    changes = [k for k in range(1, len(moves)) if moves[k].state.condition != moves[k - 1].state.condition]
    bounds = [0, *changes, len(moves)]
    if len(bounds) > 3 and not _retraces(run, [_Section(0, bounds[1])], _Section(bounds[1], bounds[2])):
        del bounds[1]  # the approach has a condition of its own
    return [_part(run, begin, end, begin, end) for begin, end in pairwise(bounds)]


def _part(run: Run, begin: int, end: int, first: int, until: int) -> Run:
    """Return some moves of a run as a run; stops count that come when its edge has begun and before the next one."""
    vertices, moves = vertices_of(run), run.moves
    before = moves[begin - 1] if begin else None
    is_last = end == len(moves)
    return replace(
        run,
        start=vertices[begin],
        upper_start=run.upper_start if before is None else (before.upper or before.points)[-1],
        on_contour=run.on_contour if begin == 0 else first == begin,
        moves=moves[begin:end],
        dwells=tuple(
            (done - begin, seconds) for done, seconds in run.dwells
            if begin <= done < end or (is_last and done == end)
        ),
        stops=tuple(min(done, end) - begin for done in run.stops if first < done <= until),
        continues=begin > 0,
        one_of_several=True,
    )


def _without_zero_offsets(run: Run) -> Run:
    """Take off compensation whose offset is 0 where another one is greater."""
    values = {move.offset.mm for move in run.moves if move.side and move.offset is not None}
    if len(values) < 2 or 0.0 not in values:
        return run
    moves = tuple(
        replace(move, side=None, offset=None) if move.offset is not None and move.offset.mm == 0 else move
        for move in run.moves
    )
    return replace(run, moves=moves)


def _sections(moves: Sequence[CutMove]) -> list[_Section]:
    """Return the ranges of moves under one compensation each."""
    sections: list[_Section] = []
    for k, move in enumerate(moves):
        if move.side is None:
            continue
        if k and sections and sections[-1].last == k and _compensation(moves[k - 1]) == _compensation(move):
            sections[-1] = _Section(sections[-1].first, k + 1)
        else:
            sections.append(_Section(k, k + 1))
    return sections


def _compensation(move: CutMove) -> tuple[str | None, float | None]:
    return move.side, None if move.offset is None else move.offset.mm


def _check_goes_back(run: Run, earlier: Sequence[_Section], section: _Section) -> None:
    """Refuse a change of compensation in the middle of a contour."""
    moves, first = run.moves, section.first
    stopped = any(done == first for done in run.stops)
    if earlier[-1].last < first or stopped or _retraces(run, earlier, section):
        return
    before, now = moves[first - 1], moves[first]
    reason = (
        "compensation (G40 G41 G42) changes inside a contour" if before.side != now.side
        else f"the offset changes inside a contour, {before.offset or 'none'} to {now.offset or 'none'}"
    )
    raise InputError(f"{reason}: change it after a G0, or after G40 for another pass", line=now.line)


def _retraces(run: Run, earlier: Sequence[_Section], section: _Section) -> bool:
    """Say whether most of a section lies on what was cut before."""
    vertices = vertices_of(run)
    cut = shapely.MultiLineString([
        array_of([vertices[one.first], *(p for move in run.moves[one.first : one.last] for p in move.points)])
        for one in earlier
    ])
    points = array_of(
        [vertices[section.first], *(p for move in run.moves[section.first : section.last] for p in move.points)]
    )
    chords = shapely.linestrings(np.stack([points[:-1], points[1:]], axis=1))
    lengths = shapely.length(chords)
    near = shapely.distance(cut, shapely.points((points[:-1] + points[1:]) / 2)) <= 2 * run.join_mm
    return float(lengths[near].sum()) >= _LEAST_SHARE * float(lengths.sum())
