"""From a program's words to corner points, and where along them its settings are due."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from edmsim.controllers.mcu.arcs import arc_points
from edmsim.controllers.mcu.part_program import Entry, Move, Setting
from edmsim.errors import InputError

Point = tuple[int, int]
"""A place in um by the position counters."""


class Due(NamedTuple):
    """A setting of a program and the length of path from which on it holds."""

    path_um: float
    setting: Setting


def lay_out(start_um: Point, program: Sequence[Entry]) -> tuple[list[Point], list[Due]]:
    """Corner points of a program's moves from a start on, and when its settings are due.

    Raises
    ------
    InputError
        If an arc has no circle through its ends, or the program moves nowhere.
    """
    points, dues, length = [start_um], [], 0.0
    for entry in program:
        if isinstance(entry, Setting):
            dues.append(Due(length, entry))
            continue
        corners = way_of(points[-1], entry)
        length += float(np.hypot(*np.diff(np.array(corners), axis=0).T).sum())
        points += corners[1:]
    if len(set(points)) == 1:
        raise InputError("the wire is there already; give another new position")
    return points, dues


def way_of(start_um: Point, move: Move) -> list[Point]:
    """Corner points of one move, its start included."""
    if move.centre_um is None:
        return [start_um, move.end_um]
    return [(int(x), int(y)) for x, y in arc_points(start_um, move.centre_um, move.end_um, move.clockwise)]
