"""Passes: a rough cut of a contour and trims along the same kerf, in alternating directions; a tab is cut last.

The passes of a drawing come from a `PassPlan`: offsets from rough to last, the tab that holds the piece meanwhile,
the overlap. If a G-code program cuts an edge several times with decreasing offsets, its runs are the passes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError, methods_refuse_wrong_types
from edmsim.geometry import Floats, arc_lengths, interpolated
from edmsim.program.offset import OffsetOutline, dwells_along
from edmsim.program.outline import JOIN_TOLERANCE_MM, Outline
from edmsim.program.taper import GuideHeights, Lean, Ruled, WirePath, guides_for

AfterTab = Literal["stop", "cut"]
"""``stop``: the machine stops before the tab, so the piece can be glued; ``cut``: it continues, a slug falls."""
Piece = Literal["profile", "tab"]
TAB_MM = 1.5  # usual length of a tab: shops leave 1 to 2 mm
OVERLAP_MM = 0.1  # distance by which passes overlap, at the ends of a tab and of a closed contour (ours)
MOST_PASSES = 9  # more passes than any technology has (ours)


@methods_refuse_wrong_types
@dataclass(frozen=True)
class PassPlan:
    """Passes of every closed or compensated contour.

    Raises
    ------
    InputError
        If offsets grow or are invalid, or a length is below 0.
    """

    offsets_mm: tuple[float, ...]  # distance of the wire's centre from the drawing, from the rough pass to the last
    tab_mm: float = TAB_MM  # length of the edge at the end of a closed contour that is cut last; 0 for no tab
    overlap_mm: float = OVERLAP_MM  # distance by which passes continue over what is already cut
    after_tab: AfterTab = "stop"  # whether the machine stops before it cuts the tab
    # whether the program has its own passes; the plan then supplies only offsets that no register has
    of_program: bool = False

    def __post_init__(self) -> None:
        check_offsets(self.offsets_mm)
        for name in ("tab_mm", "overlap_mm"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise InputError(f"{name} is {value}: give a length of 0 mm or more")
        if self.after_tab not in ("stop", "cut"):
            raise InputError(f"after_tab is {self.after_tab!r}: the machine can stop before the tab, or cut on")


def check_offsets(offsets_mm: Sequence[float], line: int | None = None) -> None:
    """Refuse invalid offsets, and one that is larger than that of the pass before."""
    if not 1 <= len(offsets_mm) <= MOST_PASSES:
        raise InputError(f"a contour is cut in 1 to {MOST_PASSES} passes, not in {len(offsets_mm)}", line=line)
    for number, (before, now) in enumerate(pairwise(offsets_mm), 1):
        if now > before:
            raise InputError(f"the offset grows from pass {number} to pass {number + 1}, {before:g} to {now:g} mm: a "
                             "trim runs nearer to the part than the pass before it", line=line)
    if not all(math.isfinite(mm) and mm > 0 for mm in offsets_mm):
        raise InputError(f"an offset of {min(offsets_mm):g} mm leaves no room for a wire: give more than 0",
                         line=line)


@dataclass(frozen=True, eq=False)
class CutPass:
    """One pass of the wire along a contour, in table coordinates."""

    number: int  # 1 is the rough pass. The technology's pass of this number has its setting.
    piece: Piece  # part of the contour to cut
    # (n, 2): wire centre, at the lower guide if the wire leans, from the end of the previous pass; for the first pass
    # and one that ``threads``, from the start hole
    points_um: NDArray[np.int64]
    approach_moves: int  # number of moves to the beginning of the pass
    offset_um: float  # distance from the drawing
    reversed: bool  # whether it runs against the contour's direction
    frees: bool = False  # whether a piece of metal may come loose at its end
    falls: bool = False  # whether such a piece falls; otherwise it is held
    threads: bool = False  # whether the wire is threaded for it, at a start hole of its own
    lean: Lean | None = None  # inclination of the wire; None if it is vertical
    dwells: tuple[tuple[int, float], ...] = ()  # ``(i, seconds)``: the wire waits at ``points_um[i]`` (G4)

    @property
    def wire_path(self) -> WirePath:
        """The lower guide's path and the wire's inclination."""
        return WirePath(self.points_um, self.lean)

    def at_height(self, height_mm: float) -> CutPass:
        """Return a leaning wire's pass at a height as that of a vertical wire, in whole um."""
        return replace(self, points_um=self.wire_path.at_height(height_mm), lean=None)

    def moved(self, by_um: NDArray[np.int64]) -> CutPass:
        """Return the pass, moved on the table."""
        lean = self.lean and self.lean.moved(by_um / 1000)
        return replace(self, points_um=self.points_um + by_um, lean=lean)

    @property
    def length_mm(self) -> float:
        """Length of the pass without its approach."""
        along_um = self.wire_path.along_um
        return float(along_um[-1] - along_um[self.approach_moves]) * 1e-3


@dataclass(frozen=True)
class Lead:
    """The lead-in to a path's start, without the start itself, and the program line of every move."""

    points: Floats
    lines: tuple[int, ...]
    parted: bool = False  # to a later pass: whether another contour is cut before it


class Tilt(NamedTuple):
    """Inclination of the wire in a stretch: slope at each of its points, wall, and guides."""

    slope: Floats
    wall: Ruled
    guides: GuideHeights


@dataclass(frozen=True)
class Stretch:
    """A stretch of path of one pass in mm, before it is rounded to the grid; at half the height if the wire leans."""

    # the first `leads` points lead the wire to the start of the stretch

    number: int
    piece: Piece
    points: Floats
    offset_mm: float
    reversed: bool
    frees: bool = False
    falls: bool = False
    threads: bool = False
    parted: bool = False  # whether another contour is cut between the previous stretch and this one
    tilt: Tilt | None = None
    dwells: tuple[tuple[int, float], ...] = ()
    leads: int = 0

    def backwards(self) -> Stretch:
        """Return the same cut in the opposite direction."""
        tilt = self.tilt and self.tilt._replace(slope=self.tilt.slope[::-1])
        last = len(self.points) - 1
        dwells = tuple((last - i, seconds) for i, seconds in reversed(self.dwells))
        return replace(self, points=self.points[::-1], reversed=not self.reversed, tilt=tilt, dwells=dwells)

    def behind(self, link: Stretch) -> Stretch:
        """Return the stretch with the points of `link`, which leads to it, before its own."""
        tilt = self.tilt and self.tilt._replace(
            slope=np.concatenate([link.tilt.slope if link.tilt else np.zeros_like(link.points), self.tilt.slope])
        )
        return replace(
            self, points=np.concatenate([link.points, self.points]), tilt=tilt, leads=len(link.points),
            dwells=tuple((i + len(link.points), seconds) for i, seconds in self.dwells),
        )  # fmt: skip


def stretches_of(legs: Sequence[OffsetOutline], plan: PassPlan) -> list[Stretch]:
    """Return the stretches of all passes along one outline, at the plan's offsets."""
    if legs[0].outline.wire_side is None:
        raise InputError("the wire follows it as drawn: passes run beside an edge, under G41 or G42")
    lines, found = [_Line(leg) for leg in legs], []
    spans = _spans(lines, plan)
    for number, (piece, *ends) in enumerate(spans):
        k = number % len(lines)
        stretch = lines[k].stretch(k + 1, piece, *ends)
        if piece == "tab" and len(stretch.points) < 2:
            raise InputError(f"the tab of {plan.tab_mm:g} mm lies in an inner corner, all of it beside one point of "
                             "the wire's path: give a longer tab, or begin the contour further from the corner")
        frees = legs[0].outline.closed and k == 0 and piece == spans[-1][0]
        stretch = replace(stretch, frees=frees, falls=frees and plan.after_tab == "cut")
        back = (number % 2 == 1) != (piece == "tab")  # a tab is cut on from where the profile's last pass ended
        found.append(_Leg(lines[k], stretch, (ends[0], ends[1]), back))
    return _linked(found)


def _spans(lines: Sequence[_Line], plan: PassPlan) -> list[tuple[Piece, float, float]]:
    """Return piece and lengths of the edge of every pass: the profile's in order, then the tab's if there is one."""
    length, closed, count = lines[0].length, lines[0].leg.outline.closed, len(lines)
    if closed and plan.overlap_mm >= length:
        reason = f"the overlap of {plan.overlap_mm:g} mm is longer than the contour, {length:.3f} mm: make it shorter"
        raise InputError(reason)
    short = [_short_mm(lines[0].leg.offset_mm, line.leg.offset_mm) for line in lines]
    if not closed:
        return [("profile", mm, length - mm) for mm in short]
    if plan.tab_mm == 0:
        over = plan.overlap_mm if count > 1 else 0.0
        return [("profile", -over, length) if k % 2 else ("profile", 0.0, length + over) for k in range(count)]
    if plan.tab_mm >= length:
        raise InputError(
            f"the tab of {plan.tab_mm:g} mm is longer than the contour, {length:.3f} mm: make it shorter"
        )
    last = length - plan.tab_mm
    if last - 2 * short[-1] <= 0:
        raise InputError(f"a tab of {plan.tab_mm:g} mm leaves {last:.3f} mm of the contour to cut: make it shorter")
    begin, end = last - plan.overlap_mm, length + plan.overlap_mm
    return [*(("profile", mm, last - mm) for mm in short), *(("tab", begin - mm, end + mm) for mm in short)]


class _Leg(NamedTuple):
    """A pass between two lengths of the edge, in the edge's direction, and whether it is cut backwards."""

    line: _Line
    stretch: Stretch
    ends: tuple[float, float]
    back: bool


LINK_MM = 1e-3  # a link between two passes may come this much nearer to the part than both (ours: a um)


def _linked(legs: Sequence[_Leg]) -> list[Stretch]:
    """Return the stretches in order, with a link along the edge if a straight one would cut into the part."""
    stretches = [leg.stretch.backwards() if leg.back else leg.stretch for leg in legs]
    for k, (before, leg) in enumerate(pairwise(legs), 1):
        straight = shapely.LineString([stretches[k - 1].points[-1], stretches[k].points[0]])
        nearest = min(before.line.leg.offset_mm, leg.line.leg.offset_mm)
        if leg.line.edge.distance(straight) < nearest - LINK_MM:
            stretches[k] = stretches[k].behind(_link(before, leg))
    return stretches


def _link(before: _Leg, leg: _Leg) -> Stretch:
    """Return the link from the end of one pass to the start of the next along the edge, at the greater offset."""
    outer = before.line if before.line.leg.offset_mm > leg.line.leg.offset_mm else leg.line
    start, stop = before.ends[0 if before.back else 1], leg.ends[1 if leg.back else 0]
    if outer.leg.outline.closed:  # without another full turn
        start += outer.length * round((stop - start) / outer.length)
    own = leg.stretch
    link = replace(outer.stretch(own.number, own.piece, min(start, stop), max(start, stop)), dwells=())
    return link if start <= stop else link.backwards()


def _short_mm(rough_mm: float, offset_mm: float) -> float:
    """Return how far before the end of the rough pass a trim has to end so that no metal is in front of it."""
    # the rough pass ends in a round front: the nearer a trim is to the part, the more of it is beside the wire
    nearer = rough_mm - offset_mm
    return math.sqrt(max(2.0 * rough_mm * nearer - nearer**2, 0.0))


class _Line:
    """The wire's path along an edge, queried by length of the edge; at mid height if the wire leans."""

    def __init__(self, leg: OffsetOutline) -> None:
        self.leg = leg
        middle = leg.at_mid_height()
        self.edge, self._path = middle.edge, shapely.LineString(middle.path)
        self._rows = middle.path if leg.surfaces is None else np.hstack([middle.path, leg.surfaces[1].slope])
        self.length = float(self.edge.length)
        self._closed = leg.outline.closed

    def stretch(self, number: int, piece: Piece, from_mm: float, to_mm: float) -> Stretch:
        """Return the path between two lengths of the edge, which may be beyond its ends."""
        start, stop = self._along(from_mm), self._along(to_mm)
        return self._between(number, piece, start, self._parts(start, stop))

    def whole(self, number: int, back: bool) -> Stretch:
        """Return the whole path as a pass; `back`: its direction is opposite to that of the first pass."""
        stretch = self._between(number, "profile", 0.0, self._rows)
        own = len(self.leg.outline.approach_mm)  # a dwell on the way from the previous pass is put before this pass
        waits = tuple((0, seconds) for i, seconds in self.leg.outline.dwells if i < own and number > 1)
        return replace(stretch, reversed=back, dwells=(*waits, *stretch.dwells))

    def _between(self, number: int, piece: Piece, start_mm: float, rows: Floats) -> Stretch:
        """Return a stretch of points (and slopes if the wire leans), `rows`, which begin at a length of the path."""
        passed = start_mm + arc_lengths(rows[:, :2])
        waits = [(at, seconds) for at, seconds in dwells_along(self.leg) if passed[0] <= at <= passed[-1]]
        dwells: tuple[tuple[int, float], ...] = ()
        if waits:
            every = np.union1d(passed, [at for at, _ in waits])
            rows = interpolated(every, passed, rows)
            dwells = tuple((int(np.searchsorted(every, at)), seconds) for at, seconds in waits)
        tilt = None
        if self.leg.surfaces is not None and self.leg.guides is not None:
            tilt = Tilt(rows[:, 2:], self.leg.surfaces[0], self.leg.guides)
        return Stretch(number, piece, rows[:, :2], self.leg.offset_mm, False, tilt=tilt, dwells=dwells)

    def _parts(self, start: float, stop: float) -> Floats:
        """Return the points (n, 2) between two lengths of the path, with slopes (n, 4) if the wire leans."""
        if not self._closed:
            return self._part(start, stop)
        whole = self._path.length
        first = math.floor(start / whole)
        rows = np.concatenate([
            self._part(max(start - turn, 0.0), min(stop - turn, whole))
            for turn in np.arange(first, max(math.ceil(stop / whole), first + 1)) * whole
        ])
        fresh = np.append(True, (np.diff(rows, axis=0) != 0).any(axis=1))
        return np.asarray(rows[fresh])

    def _part(self, start: float, stop: float) -> Floats:
        passed = arc_lengths(self._rows[:, :2])
        ends = interpolated(np.array([start, stop]), passed, self._rows)
        inner = (passed > start) & (passed < stop)
        return np.concatenate([ends[:1], self._rows[inner], ends[1:]])

    def _along(self, place_mm: float) -> float:
        turns, rest = divmod(place_mm, self.length) if self._closed else (0.0, place_mm)
        if rest == 0.0 or (not self._closed and rest >= self.length):
            return float(turns * self._path.length if rest == 0.0 else self._path.length)
        along = float(self._path.project(self.edge.interpolate(rest)))
        if self._closed:  # in an inner corner, the path's end and start are one point
            turns += round(rest / self.length - along / self._path.length)
        return float(turns * self._path.length) + along


def grouped(outlines: Sequence[Outline]) -> list[list[Outline]]:
    """Group outlines along the same edge, the passes of a program, which may cut other edges between them."""
    lines = [shapely.LineString(outline.points_mm) for outline in outlines]
    near: list[list[int]] = [[] for _ in outlines]
    for later, first in shapely.STRtree(lines).query(lines, "dwithin", JOIN_TOLERANCE_MM).T.tolist():
        near[later].append(first)
    groups: dict[int, list[Outline]] = {}
    for k, outline in enumerate(outlines):
        known = (first for first in sorted(near[k]) if first in groups and same_edge(outlines[first], outline))
        groups.setdefault(next(known, k), []).append(outline)
    return list(groups.values())


def same_edge(one: Outline, other: Outline) -> bool:
    """Return whether two compensated outlines are one edge, in either direction, with the part on the same side."""
    if one.wire_side is None or other.wire_side is None or one.closed != other.closed:
        return False
    line, again = shapely.LineString(one.points_mm), shapely.LineString(other.points_mm)
    if abs(line.length - again.length) > JOIN_TOLERANCE_MM * 10:
        return False
    if shapely.hausdorff_distance(line, again) > JOIN_TOLERANCE_MM:
        return False
    return (one.part_side == other.part_side) != runs_back(one, other)


def runs_back(one: Outline, other: Outline) -> bool:
    """Return whether two outlines along the same edge have opposite directions."""
    if one.closed:
        rings = [shapely.LinearRing(outline.points_mm) for outline in (one, other)]
        return bool(rings[0].is_ccw != rings[1].is_ccw)
    start = other.points_mm[0]
    return bool(np.hypot(*(start - one.points_mm[0])) > np.hypot(*(start - one.points_mm[-1])))


def begins_at(outline: Outline, place_mm: Floats) -> bool:
    """Return whether a pass begins at a place, so that it needs no lead-in from there."""
    return bool(np.hypot(*(outline.points_mm[0] - place_mm)) <= JOIN_TOLERANCE_MM * 10)


def stretches_of_group(legs: Sequence[OffsetOutline], leads: Sequence[Lead | None]) -> list[Stretch]:
    """Return the stretches of a program's own passes along one edge, each after its lead-in, if any."""
    check_offsets([leg.offset_mm for leg in legs], legs[-1].outline.line)
    first, stretches = legs[0].outline, []
    for number, (leg, lead) in enumerate(zip(legs, leads, strict=True), 1):
        stretch = _Line(leg).whole(number, runs_back(first, leg.outline))
        stretch = replace(stretch, frees=first.closed and number == 1)
        if lead is not None:
            stretch = stretch.behind(Stretch(number, "profile", lead.points, leg.offset_mm, False))
            stretch = replace(stretch, threads=not leg.outline.continues, parted=lead.parted)
        stretches.append(stretch)
    return stretches


def on_grid(
    stretches: Sequence[Stretch], lead: Floats, grid_um: int, waits: Sequence[tuple[int, float]] = ()
) -> tuple[CutPass, ...]:
    """Convert stretches to passes in whole um; each begins at the previous end, the first where `lead` begins."""
    # the lead (k, 2) goes from the start hole to the first stretch; `waits` has indices into it
    passes: list[CutPass] = []
    before = lead
    for stretch in stretches:
        apart = stretch.threads or stretch.parted  # from where the previous pass ended
        before = before[:0] if apart else before
        known = np.concatenate([before, stretch.points])
        dwells = (*waits, *((len(before) + i, seconds) for i, seconds in stretch.dwells))
        joined = _guided(known, stretch, len(before), passes[-1] if passes and not apart else None, grid_um)
        joined, moves, dwells = joined.moving(dwells)
        passes.append(
            CutPass(
                stretch.number, stretch.piece, joined.points_um, int(moves[: len(before) + stretch.leads].sum()),
                stretch.offset_mm * 1000, stretch.reversed, stretch.frees, stretch.falls, stretch.threads,
                joined.lean, dwells,
            )
        )
        before, waits = stretch.points[-1:], ()
    return tuple(passes)


def holds(passes: Sequence[CutPass]) -> bool:
    """Return whether the piece is still held at the end of the rough pass, by its tab if there is one."""
    lines = [shapely.LineString(one.wire_path.at_mid_height()) for one in passes if one.number == 1]
    around, parted = (_inside_um2(some, passes[0].offset_um) for some in (lines[:1], lines))
    return len(lines) == 1 or 2 * around <= parted


def _inside_um2(lines: Sequence[shapely.LineString], offset_um: float) -> float:
    """Return the area of the largest piece of metal surrounded by cuts along `lines`."""
    cuts = shapely.get_parts(shapely.MultiLineString(lines).buffer(offset_um))
    return float(max((shapely.Polygon(ring).area for cut in cuts for ring in cut.interiors), default=0.0))


def _guided(known_mm: Floats, stretch: Stretch, leads: int, before: CutPass | None, grid_um: int) -> WirePath:
    """Round a stretch, after `leads` points with a vertical wire, to the grid; begin where pass `before` ended."""
    if stretch.tilt is None:
        return WirePath(np.round(known_mm * 1000 / grid_um).astype(np.int64) * grid_um)
    slope, wall, guides = stretch.tilt
    slope = np.concatenate([np.zeros((leads, 2)), slope])
    points, upper, bends = guides_for(known_mm, 0.5 * guides.height_mm, slope, guides, grid_um)
    if before is not None and before.lean is not None:
        points[0], upper[0] = before.points_um[-1], before.lean.upper_um[-1]
    return WirePath(points, Lean(upper, bends, wall, guides.height_mm))
