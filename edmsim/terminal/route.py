"""From a program's words to corner points, and where along them its settings are due."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from edmsim.controllers.mcu.dialogue.part_program import Entry, Move, Setting
from edmsim.controllers.mcu.firmware.arcs import arc_points
from edmsim.controllers.mcu.firmware.poscal import STEP_UM
from edmsim.controllers.planner.registry import PLANNERS, kind_of
from edmsim.controllers.protocols import Step
from edmsim.errors import InputError

Point = tuple[int, int]
"""A place by the position counters, in um or steps."""


class Due(NamedTuple):
    """A setting of a program and the length of path from which on it holds."""

    path_um: float
    setting: Setting


class RouteMove(NamedTuple):
    """A move of a program and the length of path up to its end."""

    end_um: float
    move: Move


class Route(NamedTuple):
    """A program laid out from where the wire is.

    Attributes
    ----------
    corners : list of Point
    lengths_um : list of float
        Length of path up to every corner but the first.
    dues : list of Due
        In order.
    moves: list of RouteMove
        In order.
    """

    corners: list[Point]
    lengths_um: list[float]
    dues: list[Due]
    moves: list[RouteMove]

    def move_at(self, path_um: float) -> Move:
        """Return the move that is under way."""
        number = bisect_right([stretch.end_um for stretch in self.moves], path_um)
        return self.moves[min(number, len(self.moves) - 1)].move

    def corner_ahead(self, path_um: float) -> Point:
        """Corner that the wire runs to."""
        return self.corners[min(bisect_right(self.lengths_um, path_um), len(self.lengths_um) - 1) + 1]


def lay_out(start: Point, program: Sequence[Entry], unit_um: int = 1) -> Route:
    """Lay a program out from a start on, by counters of so many um.

    Raises
    ------
    InputError
        If an arc has no circle through its ends, or the program moves nowhere.
    """
    corners, lengths, dues, moves = [start], [0.0], [], []
    for entry in program:
        if isinstance(entry, Setting):
            dues.append(Due(lengths[-1], entry))
            continue
        for corner in _corners_of(corners[-1], entry):
            way = float(np.hypot(corner[0] - corners[-1][0], corner[1] - corners[-1][1]))
            lengths.append(lengths[-1] + unit_um * way)
            corners.append(corner)
        moves.append(RouteMove(lengths[-1], entry))
    if not lengths[-1]:
        raise InputError("the wire is there already; give another new position")
    return Route(corners, lengths[1:], dues, moves)


def _corners_of(start: Point, move: Move) -> list[Point]:
    """Corner points of one move after its start."""
    if move.centre_um is None:
        return [move.end_um]
    return [(int(x), int(y)) for x, y in arc_points(start, move.centre_um, move.end_um, move.clockwise)][1:]


def moved(place_um: tuple[float, float], steps: Iterable[Step]) -> tuple[float, float]:
    """Return a place after some steps."""
    place = [*place_um]
    for step in steps:
        place[step.axis] += STEP_UM * step.direction
    return place[0], place[1]


def check_counts(planner: str) -> str:
    """Refuse a planner that is none, or has no position counters, before anything moves."""
    if not kind_of(planner).counts:
        counting = ", ".join(name for name, kind in PLANNERS.items() if kind.counts)
        raise InputError(f"the terminal's computer cannot count along with the planner {planner}: choose {counting}")
    return planner
