"""A contour cut at its dwells: the stretches a planner is made for."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.program.passes import CutPass
from edmsim.program.path import WireContour


@dataclass
class ProgramPlace:
    """How far a program is: the leg, where and after what length of path it began, whether its dwell has begun."""

    leg: int = 0
    from_um: tuple[float, float] = (0.0, 0.0)
    start_um: float = 0.0
    dwelling: bool = False
    lead_um: tuple[float, float] = (0.0, 0.0)
    missed_before: int = 0


class Leg(NamedTuple):
    """A stretch of path between two stops of the program: threading, a dwell, the end."""

    points_um: NDArray[np.int64]
    threads: bool  # a fresh wire is threaded at the first point
    # rest_s, dwell_s: how long the wire waits at the first point before it moves, and at the last one (G4)
    rest_s: float
    dwell_s: float
    along_um: NDArray[np.float64]  # (n,): length of path up to every point
    # (n, 2): where the upper guide is, relative to the lower one; None: above it, all along
    lead_um: NDArray[np.int64] | None = None
    cut_pass: CutPass | None = None  # the pass it belongs to; None where the contour is cut in one
    leads_in: bool = False  # whether it is the way from the start hole to where the pass begins

    def started_at(
        self, point_um: tuple[float, float], lead_um: tuple[float, float]
    ) -> tuple[NDArray[Any], NDArray[np.float64], NDArray[Any] | None]:
        """Return points, lengths of path and leads of the leg from a place on that need not be its first point."""
        points, leads, along = self.points_um, self.lead_um, self.along_um - self.along_um[0]
        way = math.dist(points[0], point_um)
        if leads is not None:
            way = max(way, math.dist(leads[0], lead_um))
        if way == 0.0:
            return points, along, leads
        leads = None if leads is None else np.concatenate([[lead_um], leads])
        return np.concatenate([[point_um], points]), np.concatenate([[0.0], along + way]), leads


def legs_of(contour: WireContour) -> list[Leg]:
    """Cut a contour's path at its dwells; of one in passes return them one after the other, lead-in first."""
    if contour.passes:
        return _legs_of_passes(contour)
    wait, last = _waits_s(contour.dwells), len(contour.points_um) - 1
    ends = [i for i in wait if 0 < i < last] + [last]
    starts = [0, *ends[:-1]]
    along, threads = contour.along_um, not contour.continues
    return [
        Leg(
            contour.points_um[a : b + 1], a == 0 and threads, wait.get(0, 0.0) if a == 0 else 0.0, wait.get(b, 0.0),
            along[a : b + 1], None if contour.lean is None else contour.lean.upper_um[a : b + 1],
        )
        for a, b in zip(starts, ends, strict=True)
    ]


def _legs_of_passes(contour: WireContour) -> list[Leg]:
    legs = []
    for number, one in enumerate(contour.passes):
        threads = number == 0 and not contour.continues
        lead, last = one.approach_moves if number == 0 else 0, len(one.points_um) - 1
        along, waits = one.way.along_um, _waits_s(one.dwells)
        ends = sorted({lead, last, *(i for i in waits if i > 0)} - {0})
        for a, b in zip([0, *ends[:-1]], ends, strict=True):
            legs.append(
                Leg(
                    one.points_um[a : b + 1], a == 0 and threads, waits.get(0, 0.0) if a == 0 else 0.0,
                    waits.get(b, 0.0), along[a : b + 1], None if one.lean is None else one.lean.upper_um[a : b + 1],
                    cut_pass=one, leads_in=b <= lead,
                )
            )
    return legs


def _waits_s(dwells: Sequence[tuple[int, float]]) -> dict[int, float]:
    """Return how long the wire waits at every point where it does, in order."""
    return {i: sum(seconds for j, seconds in dwells if j == i) for i in sorted({i for i, _ in dwells})}
