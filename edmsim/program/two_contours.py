"""A wall between two drawn contours, of the lower and the upper face of the workpiece, element by element."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.geometry import arc_lengths
from edmsim.program.outline import Outline, Program, Taper

Floats = NDArray[np.float64]


def ruled_between(below: Program, above: Program) -> Program:
    """Return the program whose walls are ruled between the contours of two, the lower and the upper face."""
    # every contour below goes with the one above whose middle is nearest; lines and arcs go with each other in
    # order, so that their beginnings lie as near to each other as they can
    if len(below.outlines) != len(above.outlines):
        raise InputError(
            f"there are {len(below.outlines)} contours below and {len(above.outlines)} above: draw as many",
            below.source,
        )
    left, outlines = list(above.outlines), []
    for outline in below.outlines:
        middle = shapely.centroid(shapely.LineString(outline.points_mm))
        upper = min(left, key=lambda other: middle.distance(shapely.centroid(shapely.LineString(other.points_mm))))
        left.remove(upper)
        try:
            outlines.append(_ruled(outline, upper))
        except InputError as error:
            raise InputError(f"{outline.name}: {error.reason}", below.source) from None
    return replace(below, outlines=tuple(outlines))


def _ruled(outline: Outline, upper: Outline) -> Outline:
    lower_pieces, upper_pieces = _pieces(outline), _pieces(upper)
    if len(lower_pieces) != len(upper_pieces):
        raise InputError(
            f"it has {len(lower_pieces)} lines and arcs, and the contour above it {len(upper_pieces)}: draw as many, "
            "and split a line or an arc where a corner of the other contour belongs"
        )
    starts = np.array([piece[0] for piece in lower_pieces])
    firsts = np.array([piece[0] for piece in upper_pieces])
    by = min(range(len(firsts)), key=lambda k: float(np.hypot(*(np.roll(firsts, -k, axis=0) - starts).T).sum()))
    lines = ([], [])  # type: tuple[list[Floats], list[Floats]]
    elements: list[int] = []
    for number, piece in enumerate(lower_pieces):
        other = upper_pieces[(number + by) % len(upper_pieces)]
        chords = max(len(piece), len(other)) - 1
        for line, points in zip(lines, (piece, other), strict=True):
            line.append(_spread(points, chords)[:-1])
        elements += [number + 1] * chords
    lower, above = (np.concatenate([*line, line[0][:1]]) for line in lines)
    return replace(
        outline, points_mm=lower, line_numbers=(0,) * len(elements), elements=tuple(elements),
        taper=Taper(upper_mm=above),
    )


def _pieces(outline: Outline) -> list[Floats]:
    """Return the points of every line and arc of a closed contour."""
    firsts = np.flatnonzero(np.diff(outline.elements, prepend=-1)).tolist()
    return [outline.points_mm[a : b + 1] for a, b in pairwise([*firsts, len(outline.points_mm) - 1])]


def _spread(points: Floats, chords: int) -> Floats:
    """Return the points of a line with `chords` chords, evenly along it."""
    if len(points) == chords + 1:
        return points
    passed = arc_lengths(points)
    at = np.linspace(0.0, passed[-1], chords + 1)
    return np.stack([np.interp(at, passed, column) for column in points.T], axis=1)
