"""Passes: a contour cut rough and then trimmed on the same kerf, to and fro, with a tab that is cut last.

A drawing gets its passes from a `PassPlan`: offsets from rough to last, the tab that holds the piece meanwhile, the
overlap. In a G-code program that cuts an edge several times, at offsets that fall, the runs are the passes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.ops import substring

from edmsim.errors import InputError
from edmsim.program.offset import OffsetOutline
from edmsim.program.outline import JOIN_TOLERANCE_MM, Outline

AfterTab = Literal["stop", "cut"]
"""``stop``: the machine stops before the tab is cut, and a piece is glued; ``cut``: it goes on, a slug falls."""
Piece = Literal["profile", "tab"]

TAB_MM = 1.5
"""Usual length of a tab: shops leave 1 to 2 mm."""
OVERLAP_MM = 0.1
"""How far a pass goes on over what another one has cut, at the ends of a tab and of a closed contour (ours)."""
MOST_PASSES = 9
"""More passes than any technology has (ours)."""


@dataclass(frozen=True)
class PassPlan:
    """How every closed or compensated contour is cut in passes.

    Attributes
    ----------
    offsets_mm : tuple of float
        Distance of the wire's centre from the drawing, from the rough pass to the last.
    tab_mm : float
        Length of the edge that is left uncut until the rest is finished, at the end of a closed contour; 0 for none.
    overlap_mm : float
        How far passes go on over what is already cut.
    after_tab : {"stop", "cut"}
        What comes before the tab.

    Raises
    ------
    InputError
        Offsets that grow or are none, a length below 0.
    """

    offsets_mm: tuple[float, ...]
    tab_mm: float = TAB_MM
    overlap_mm: float = OVERLAP_MM
    after_tab: AfterTab = "stop"

    def __post_init__(self) -> None:
        check_offsets(self.offsets_mm)
        for name in ("tab_mm", "overlap_mm"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise InputError(f"{name} is {value}: give a length of 0 mm or more")
        if self.after_tab not in ("stop", "cut"):
            raise InputError(f"after_tab is {self.after_tab!r}: the machine can stop before the tab, or cut on")


def check_offsets(offsets_mm: Sequence[float], line: int | None = None) -> None:
    """Refuse offsets that are none, or of which one is larger than that of the pass before."""
    if not 1 <= len(offsets_mm) <= MOST_PASSES:
        raise InputError(f"a contour is cut in 1 to {MOST_PASSES} passes, not in {len(offsets_mm)}", line=line)
    for number, (before, now) in enumerate(pairwise(offsets_mm), 1):
        if now > before:
            raise InputError(
                f"the offset grows from pass {number} to pass {number + 1}, {before:g} to {now:g} mm: a trim runs "
                "nearer to the part than the pass before it",
                line=line,
            )
    if not all(math.isfinite(mm) and mm > 0 for mm in offsets_mm):
        raise InputError(
            f"an offset of {min(offsets_mm):g} mm leaves no room for a wire: give more than 0", line=line
        )


@dataclass(frozen=True)
class CutPass:
    """One pass of the wire along a contour, in table coordinates.

    Attributes
    ----------
    number : int
        1 is the rough pass; its setting is that of the technology's pass of this number.
    piece : {"profile", "tab"}
        What of the contour it cuts.
    points_um : int64 array (n, 2)
        Wire centre, from where the pass before ended; of the first pass from the start hole.
    approach_moves : int
        The first so many moves bring the wire to where the pass begins.
    offset_um : float
        Distance from the drawing.
    reversed : bool
        Whether it runs against the contour's direction.
    stops_before : bool
        Whether the machine stops before it, for the piece to be glued.
    frees : bool
        Whether a piece of metal may come loose at its end.
    falls : bool
        Whether such a piece falls; else it is held.
    """

    number: int
    piece: Piece
    points_um: NDArray[np.int64]
    approach_moves: int
    offset_um: float
    reversed: bool
    stops_before: bool = False
    frees: bool = False
    falls: bool = False

    @property
    def length_mm(self) -> float:
        """Length of the pass without its approach."""
        return float(np.hypot(*np.diff(self.points_um[self.approach_moves :], axis=0).T).sum()) * 1e-3


@dataclass(frozen=True)
class Way:
    """A stretch of path of one pass in mm, before it is put on the grid."""

    number: int
    piece: Piece
    points: NDArray[np.float64]
    offset_mm: float
    reversed: bool
    stops_before: bool = False
    frees: bool = False
    falls: bool = False


def ways_of(legs: Sequence[OffsetOutline], plan: PassPlan) -> list[Way]:
    """Return the ways of all passes along one outline.

    Parameters
    ----------
    legs : sequence of OffsetOutline
        The outline at the plan's offsets, in their order.
    plan : PassPlan

    Raises
    ------
    InputError
        The contour has no edge to run beside, or the tab does not fit it.
    """
    outline = legs[0].outline
    if outline.wire_side is None:
        raise InputError("the wire follows it as drawn: passes run beside an edge, under G41 or G42")
    lines = [_Line(leg) for leg in legs]
    if not outline.closed or plan.tab_mm == 0:
        return _whole(lines, plan, outline.closed)
    length = lines[0].length
    if plan.tab_mm >= length:
        raise InputError(
            f"the tab of {plan.tab_mm:g} mm is longer than the contour, {length:.3f} mm: make it shorter"
        )
    last = length - plan.tab_mm
    short = [_short_mm(legs[0].offset_mm, leg.offset_mm) for leg in legs]
    if last - 2 * short[-1] <= 0:
        raise InputError(f"a tab of {plan.tab_mm:g} mm leaves {last:.3f} mm of the contour to cut: make it shorter")
    ways = [Way(1, "profile", lines[0].part(0.0, last), legs[0].offset_mm, False)]
    ways += [_way(k + 1, "profile", lines[k], (short[k], last - short[k]), k % 2 == 1) for k in range(1, len(legs))]
    stops = plan.after_tab == "stop"
    for k in range(len(legs)):
        over = plan.overlap_mm + short[k]
        back = (len(legs) + k) % 2 == 0
        way = _way(k + 1, "tab", lines[k], (last - over, length + over), back)
        if k == 0:
            way = Way(
                1,
                "tab",
                way.points,
                way.offset_mm,
                back,
                stops_before=stops,
                frees=True,
                falls=not stops,
            )
        ways.append(way)
    return ways


def _whole(lines: Sequence[_Line], plan: PassPlan, closed: bool) -> list[Way]:
    """Return the ways of passes that have no tab: along an open edge, or round a closed one."""
    ways = []
    for k, line in enumerate(lines):
        short = 0.0 if closed else _short_mm(lines[0].leg.offset_mm, line.leg.offset_mm)
        over = plan.overlap_mm if closed and len(lines) > 1 else 0.0
        back = k % 2 == 1
        ends = (-over, line.length) if back else (short, line.length - short + over)
        way = _way(k + 1, "profile", line, ends if closed else (short, line.length - short), back)
        falls = closed and plan.after_tab == "cut"
        ways.append(Way(way.number, way.piece, way.points, way.offset_mm, back, frees=closed and k == 0, falls=falls))
    return ways


def _way(number: int, piece: Piece, line: _Line, ends: tuple[float, float], back: bool) -> Way:
    points = line.part(*ends)
    return Way(number, piece, points[::-1] if back else points, line.leg.offset_mm, back)


def _short_mm(rough_mm: float, offset_mm: float) -> float:
    """Return how far before the end of the rough pass a trim has to end so that no metal is in front of it.

    The rough pass ends in a round front, of which more stands beside the wire the nearer a pass is to the part.
    """
    nearer = rough_mm - offset_mm
    return math.sqrt(max(2.0 * rough_mm * nearer - nearer**2, 0.0))


class _Line:
    """The wire's path beside an edge, asked by how far along the edge a place lies."""

    def __init__(self, leg: OffsetOutline) -> None:
        self.leg = leg
        self._edge, self._path = leg.edge, shapely.LineString(leg.path)
        self.length = float(self._edge.length)
        self._closed = leg.outline.closed

    def part(self, from_mm: float, to_mm: float) -> NDArray[np.float64]:
        """Return the points (n, 2) of the path between two places of the edge, which may lie beyond its ends."""
        start, stop = self._along(from_mm), self._along(to_mm)
        whole = self._path.length
        if not self._closed:
            return np.asarray(shapely.get_coordinates(substring(self._path, start, stop)), np.float64)
        pieces = [
            shapely.get_coordinates(substring(self._path, max(start - turn, 0.0), min(stop - turn, whole)))
            for turn in np.arange(math.floor(start / whole), math.ceil(stop / whole)) * whole
        ]
        points = np.concatenate(pieces)
        fresh = np.append(True, (np.diff(points, axis=0) != 0).any(axis=1))
        return np.asarray(points[fresh])

    def _along(self, place_mm: float) -> float:
        turns, rest = divmod(place_mm, self.length) if self._closed else (0.0, place_mm)
        if rest == 0.0 or (not self._closed and rest >= self.length):
            return float(turns * self._path.length if rest == 0.0 else self._path.length)
        return float(turns * self._path.length) + float(self._path.project(self._edge.interpolate(rest)))


def grouped(outlines: Sequence[Outline]) -> list[list[Outline]]:
    """Put outlines that follow each other along the same edge into groups: the passes of a program."""
    groups: list[list[Outline]] = []
    for outline in outlines:
        if groups and same_edge(groups[-1][0], outline):
            groups[-1].append(outline)
        else:
            groups.append([outline])
    return groups


def same_edge(one: Outline, other: Outline) -> bool:
    """Say whether two compensated outlines are one edge with the part on the same side of it, either way round."""
    if one.wire_side is None or other.wire_side is None or one.closed != other.closed:
        return False
    line, again = shapely.LineString(one.points_mm), shapely.LineString(other.points_mm)
    if abs(line.length - again.length) > JOIN_TOLERANCE_MM * 10:
        return False
    if shapely.hausdorff_distance(line, again) > JOIN_TOLERANCE_MM:
        return False
    return (one.part_side == other.part_side) != runs_back(one, other)


def runs_back(one: Outline, other: Outline) -> bool:
    """Say whether the second of two outlines along the same edge runs against the first."""
    if one.closed:
        rings = [shapely.LinearRing(outline.points_mm) for outline in (one, other)]
        return bool(rings[0].is_ccw != rings[1].is_ccw)
    start = other.points_mm[0]
    return bool(np.hypot(*(start - one.points_mm[0])) > np.hypot(*(start - one.points_mm[-1])))


def ways_of_group(legs: Sequence[OffsetOutline]) -> list[Way]:
    """Return the ways of a program's passes along one edge, as the program has them."""
    check_offsets([leg.offset_mm for leg in legs], legs[-1].outline.line)
    first = legs[0].outline
    return [
        Way(
            number, "profile", leg.path, leg.offset_mm, runs_back(first, leg.outline),
            stops_before=number > 1 and legs[number - 2].outline.stops_after,
            frees=first.closed and number == 1,
        )
        for number, leg in enumerate(legs, 1)
    ]  # fmt: skip


def on_grid(ways: Sequence[Way], lead: NDArray[np.float64], grid_um: int) -> tuple[CutPass, ...]:
    """Join ways to passes in whole um, each beginning where the one before ended, the first at the lead's begin.

    Parameters
    ----------
    ways : sequence of Way
    lead : float64 array (k, 2)
        In mm, from the start hole; the first way's begin is not in it.
    grid_um : int
        Points are whole multiples of it.
    """
    passes: list[CutPass] = []
    before = lead
    for way in ways:
        points = np.round(np.concatenate([before, way.points]) * 1000 / grid_um).astype(np.int64) * grid_um
        moves = (np.diff(points, axis=0) != 0).any(axis=1)
        passes.append(
            CutPass(
                way.number,
                way.piece,
                points[np.concatenate([[True], moves])],
                int(moves[: len(before)].sum()),
                way.offset_mm * 1000,
                way.reversed,
                way.stops_before,
                way.frees,
                way.falls,
            )
        )
        before = way.points[-1:]
    return tuple(passes)
