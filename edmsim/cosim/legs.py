"""A contour cut at its dwells: the stretches a planner is made for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

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
    missed_before: int = 0


class Leg(NamedTuple):
    """A stretch of path between two stops of the program: threading, a dwell, the end.

    Attributes
    ----------
    points_um : int64 array (n, 2)
    threads : bool
        A fresh wire is threaded at the first point.
    rest_s, dwell_s : float
        How long the wire waits at the first point before it moves, and at the last one (G4).
    cut_pass : CutPass, optional
        The pass it belongs to; None where the contour is cut in one.
    leads_in : bool
        Whether it is the way from the start hole to where the pass begins.
    """

    points_um: NDArray[np.int64]
    threads: bool
    rest_s: float
    dwell_s: float
    cut_pass: CutPass | None = None
    leads_in: bool = False


def legs_of(contour: WireContour) -> list[Leg]:
    """Cut a contour's path at its dwells; of one in passes return them one after the other, lead-in first."""
    if contour.passes:
        return _legs_of_passes(contour)
    stops = sorted(dict.fromkeys(i for i, _ in contour.dwells))
    wait = {i: sum(s for j, s in contour.dwells if j == i) for i in stops}
    last = len(contour.points_um) - 1
    ends = [i for i in stops if 0 < i < last] + [last]
    starts = [0, *ends[:-1]]
    threads = not contour.continues
    return [
        Leg(contour.points_um[a : b + 1], a == 0 and threads, wait.get(0, 0.0) if a == 0 else 0.0, wait.get(b, 0.0))
        for a, b in zip(starts, ends, strict=True)
    ]


def _legs_of_passes(contour: WireContour) -> list[Leg]:
    legs = []
    for number, one in enumerate(contour.passes):
        first = number == 0 and not contour.continues
        lead = one.approach_moves if number == 0 else 0
        if lead:
            legs.append(Leg(one.points_um[: lead + 1], first, 0.0, 0.0, one, leads_in=True))
        legs.append(Leg(one.points_um[lead:], first and not lead, 0.0, 0.0, one))
    return legs
