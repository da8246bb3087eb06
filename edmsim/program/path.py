"""The wire's path: reading of a program by its suffix, offset, lead-in through waste, moves in whole um."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count, pairwise
from pathlib import Path
from typing import Literal, NamedTuple, Self, get_args

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from edmsim.errors import InputError, located, refuse_unknown, refuses_wrong_types
from edmsim.geometry import Floats, arc_lengths, interpolated
from edmsim.machine.machine import Machine
from edmsim.numeric import whole_from
from edmsim.program.arcs import by_element
from edmsim.program.dialects import AUTO
from edmsim.program.limits import MOST_TABLES
from edmsim.program.offset import (
    OffsetOutline,
    away,
    dwells_along,
    keep_apart,
    leaning_outline,
    nearest_chords,
    of_outline,
    offset_edge,
    offset_outline,
)
from edmsim.program.outline import Corners, Outline, Program, Taper, signed_area
from edmsim.program.passes import (
    CutPass,
    Lead,
    PassPlan,
    Stretch,
    begins_at,
    grouped,
    holds,
    on_grid,
    stretches_of,
    stretches_of_group,
)
from edmsim.program.tables import GREATEST_MM, in_um, read_conditions, read_offsets
from edmsim.program.taper import GOUGE_MM, GuideHeights, Lean, WirePath, guides_for, leaning


@refuses_wrong_types
def ruled_between(below: Program, above: Program) -> Program:
    """Return the program whose walls are ruled between the contours of two, the lower and the upper face."""
    # each contour below is paired with the one above at the least Hausdorff distance, because a hole may have the
    # same centre as the contour around it; lines and arcs are paired in order, with starts as near as possible
    if len(below.outlines) != len(above.outlines):
        raise InputError(f"there are {len(below.outlines)} contours below and {len(above.outlines)} above: draw as "
                         "many", below.source)
    left, outlines = list(above.outlines), []
    for outline in below.outlines:
        line = shapely.LineString(outline.points_mm)
        upper = min(left, key=lambda other: line.hausdorff_distance(shapely.LineString(other.points_mm)))
        left.remove(upper)
        with located(below.source, name=outline.name):
            outlines.append(_ruled(outline, upper))
    return replace(below, outlines=tuple(outlines))


def _ruled(outline: Outline, upper: Outline) -> Outline:
    lower_pieces, upper_pieces = (by_element(one.points_mm, one.elements) for one in (outline, upper))
    if len(lower_pieces) != len(upper_pieces):
        raise InputError(f"it has {len(lower_pieces)} lines and arcs, and the contour above it {len(upper_pieces)}: "
                         "draw as many, and split a line or an arc where a corner of the other contour belongs")
    starts = np.array([piece[0] for piece in lower_pieces])
    firsts = np.array([piece[0] for piece in upper_pieces])
    by = min(range(len(firsts)), key=lambda k: float(np.hypot(*(np.roll(firsts, -k, axis=0) - starts).T).sum()))
    lines: tuple[list[Floats], list[Floats]] = ([], [])
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


def _spread(points: Floats, chords: int) -> Floats:
    """Return the points of a line, resampled to `chords` chords of equal length unless it has as many."""
    if len(points) == chords + 1:
        return points
    passed = arc_lengths(points)
    return interpolated(np.linspace(0.0, passed[-1], chords + 1), passed, points)


GCODE_SUFFIXES = (".ngc", ".nc", ".gcode", ".iso", ".txt")  # read as G-code; ``.dxf`` is a drawing


@refuses_wrong_types
def load_program(
    file: str | Path, *, ignore: Sequence[str] = (), layers: Sequence[str] = (), unit: str | None = None,
    offsets: str | Path | None = None, upper_layer: str | None = None, dialect: str = AUTO,
    conditions: str | Path | None = None,
) -> Program:
    """Read a part program or drawing, by its suffix.

    Parameters
    ----------
    file : path
        ``.ngc .nc .gcode .iso .txt`` are G-code, ``.dxf`` is a drawing; upper or lower case.
    ignore : sequence of str
        Words of G-code to leave out: `read_gcode`.
    layers, unit
        For drawings: `read_dxf`.
    upper_layer : str, optional
        A drawing's layer with the contours of the upper face: `ruled_between`.
    offsets : path, optional
        Table of the offset registers of G-code: `edmsim.program.tables.read_offsets`.
    dialect : str
        Dialect of G-code: `read_gcode`.
    conditions : path, optional
        Table of the machining conditions that G-code calls: `read_conditions` of
        `edmsim.program.tables`.

    Returns
    -------
    Program

    Raises
    ------
    InputError
        If the suffix is another, or as `read_gcode` and `read_dxf`.
    """
    path = Path(file)
    suffix = path.suffix.lower()
    if suffix not in (".dxf", *GCODE_SUFFIXES):
        known = " ".join(GCODE_SUFFIXES)
        raise InputError(f"unknown suffix '{path.suffix}': give G-code ({known}) or a drawing (.dxf)", path)
    of_gcode = {"ignore": ignore, "offsets": offsets, "dialect": dialect != AUTO, "conditions": conditions}
    of_drawings = {"layers": layers, "unit": unit, "upper_layer": upper_layer}
    others, kind = (of_gcode, "G-code") if suffix == ".dxf" else (of_drawings, "a drawing")
    if wrong := [name for name, value in others.items() if value]:
        raise InputError(f"{' and '.join(wrong)}: {kind} has this, leave it out here", path)
    if suffix == ".dxf":
        from edmsim.program.dxf import read_dxf

        if upper_layer is None:
            return read_dxf(path, layers, unit)
        return ruled_between(read_dxf(path, layers, unit, upper_layer), read_dxf(path, [upper_layer], unit))
    from edmsim.program.gcode_outlines import read_gcode

    return read_gcode(
        path, ignore, {} if offsets is None else read_offsets(offsets), dialect,
        {} if conditions is None else read_conditions(conditions),
    )


LEAD_IN_MM = 1.0  # usual length in mm of an added lead-in (ours), from the hole's centre to the wire path
START_HOLE_RADIUS_MM = 0.25  # usual start-hole radius in mm (ours: a 0.5 mm hole, drilled by a small-hole EDM drill)
STOCK_MARGIN_MM = 3.0  # blank left around the job in mm, clipped to the table (ours)
HOLE_CLEARANCE_MM = 0.05  # least distance in mm between an added start hole and any edge (ours)
_TOLERANCE_MM = 0.001
_SHARES = (1.0, 0.75, 0.5, 0.35, 0.25, 0.15)
_TURNS_DEG = (0, 15, -15, 30, -30, 45, -45, 60, -60, 75, -75)


@dataclass(frozen=True, eq=False)
class WireContour:
    """One cut from threading the wire to cutting it off, in table coordinates."""

    # (n, 2): wire centre, whole um within the table's travel. The wire is threaded at points_um[0], the start hole.
    points_um: NDArray[np.int64]
    lead_in_moves: int  # number of moves from the start hole to the contour
    # (m, 2): the part's edge as drawn, in mm on the table; first and last point are equal if ``closed``
    nominal_mm: Floats
    closed: bool  # whether the nominal edge closes on itself
    part_side: Literal["left", "right"]  # side of the part, looking along the cut
    dwells: tuple[tuple[int, float], ...] = ()  # ``(i, seconds)``: the wire waits at ``points_um[i]`` (G4)
    line_numbers: tuple[int, ...] = ()  # program line of every move; 0 for drawings and lead-ins
    # for every chord of `nominal_mm`, its line or arc, counted along the contour from 1, and its program line, 0 for
    # drawings
    elements: tuple[tuple[int, int], ...] = ()
    offset_um: float = 0.0  # applied distance between wire centre and nominal edge; may be 0
    # whether edge and offset determine the wire's path; otherwise path and offset determine the edge
    compensated: bool = True
    # inclination of the wire; `points_um` is then the lower guide's, and `nominal_mm` in the program's plane
    lean: Lean | None = None
    # passes in cutting order; `points_um` and `offset_um` are then those of the last pass, all round. Empty for a
    # single pass, which is `points_um`.
    passes: tuple[CutPass, ...] = ()
    continues: bool = False  # whether the wire stays threaded from the previous contour

    @property
    def wire_path(self) -> WirePath:
        """The lower guide's path and the wire's inclination; for several passes, of the last, all round."""
        return WirePath(self.points_um, self.lean)

    @property
    def wire_paths(self) -> tuple[WirePath, ...]:
        """The wire's paths in order: one per pass."""
        return tuple(one.wire_path for one in self.passes) or (self.wire_path,)

    def at_height(self, height_mm: float) -> Self:
        """Return the contour of a leaning wire at a height as that of a vertical wire, in whole um.

        Its offset is that in the plane, at the greatest inclination of the wall.
        """
        if self.lean is None:
            return self
        own = self.wire_path.slant[self.lead_in_moves :]
        return replace(
            self, points_um=self.wire_path.at_height(height_mm), nominal_mm=self.lean.wall.at(height_mm), lean=None,
            offset_um=self.offset_um * float(own.max(initial=1.0)),
            passes=tuple(one.at_height(height_mm) for one in self.passes),
        )

    def at_mid_height(self) -> Self:
        """Return the contour at half the workpiece's height, which pictures and reports use."""
        return self if self.lean is None else self.at_height(0.5 * self.lean.height_mm)

    @property
    def threads(self) -> tuple[bool, ...]:
        """For each of the paths, whether the wire is threaded at its beginning, in a start hole."""
        return (not self.continues, *(one.threads for one in self.passes[1:]))

    @property
    def guide_paths_um(self) -> tuple[NDArray[np.int64], ...]:
        """The lower guide's paths (n, 2) in order."""
        return tuple(path.points_um for path in self.wire_paths)

    @property
    def reach_um(self) -> tuple[NDArray[np.int64], ...]:
        """Paths that must fit on the table: the guide's and, if the wire leans, both faces'."""
        faces = () if self.lean is None else (0.0, self.lean.height_mm)
        return (*self.guide_paths_um, *(path.at_height(z) for z in faces for path in self.wire_paths))

    @property
    def length_um(self) -> float:
        """Total length of the paths."""
        return sum(float(path.along_um[-1]) for path in self.wire_paths)

    @property
    def waiting_s(self) -> float:
        """Total time of the dwells."""
        return sum(seconds for part in (self.passes or (self,)) for _, seconds in part.dwells)

    def __repr__(self) -> str:
        (x, y), moves = self.points_um[0] / 1e3, len(self.points_um) - 1
        length_mm = self.length_um / 1e3
        passes = f" and {self.passes[-1].number} passes" if self.passes else ""
        return (
            f"<WireContour: {length_mm:.3f} mm in {moves} moves{passes}, the first {self.lead_in_moves} lead in; "
            f"{'closed' if self.closed else 'open'}, part on the {self.part_side}; "
            f"threaded at X {x:.3f} Y {y:.3f} mm on the table>"
        )


class Conditions(NamedTuple):
    """Machining conditions of a program's passes, and their settings in the user's table."""

    names: tuple[str | None, ...] = ()  # by pass, from the rough one; None if the program calls none
    approach: str | None = None  # condition on the lead-in
    settings: Mapping[str, Mapping[str, float]] = {}  # by condition and setting; empty without a table


@dataclass(frozen=True, eq=False)
class CutPath:
    """The whole job, contour by contour; the wire is cut and threaded between them."""

    contours: tuple[WireContour, ...]
    stock_mm: tuple[float, float, float, float]  # the workpiece blank on the table
    start_hole_radius_mm: float  # radius of the hole where the wire is threaded
    origin_mm: tuple[float, float]  # the program's zero on the table
    notices: tuple[str, ...]  # decisions of the reader that you should know
    source: str  # the program's file
    conditions: Conditions = field(default_factory=Conditions)  # the program's settings for each pass
    # index of the contour of every wire path in cutting order; empty if all passes of a contour follow one another
    order: tuple[int, ...] = ()

    @property
    def contour_of(self) -> tuple[int, ...]:
        """Index of the contour of every wire path, in cutting order."""
        return self.order or tuple(k for k, contour in enumerate(self.contours) for _ in contour.wire_paths)

    @property
    def cuts(self) -> list[tuple[WireContour, int]]:
        """Contour and number of every wire path, from 0, in cutting order."""
        numbers = [count() for _ in self.contours]
        return [(self.contours[k], next(numbers[k])) for k in self.contour_of]

    @property
    def wire_paths(self) -> list[WirePath]:
        """The wire's paths in cutting order."""
        return [contour.wire_paths[number] for contour, number in self.cuts]

    @property
    def passes(self) -> int:
        """Largest number of passes of a contour, at least 1."""
        return max([1, *(one.number for contour in self.contours for one in contour.passes)])

    @property
    def leans(self) -> bool:
        """Whether the wire leans on some contour."""
        return any(contour.lean is not None for contour in self.contours)

    @property
    def start_holes_um(self) -> NDArray[np.int64]:
        """Places (n, 2) where the wire is threaded."""
        contours = self.contours
        return np.array([w[0] for c in contours for w, new in zip(c.guide_paths_um, c.threads, strict=True) if new])

    @property
    def offset_um(self) -> float | None:
        """Offset of the contours; None if they differ."""
        first, *others = {contour.offset_um for contour in self.contours}
        return None if others else first

    def __repr__(self) -> str:
        x, y = self.origin_mm
        offsets = ", ".join(f"{offset:g}" for offset in sorted({contour.offset_um for contour in self.contours}))
        head = f"<CutPath of {self.source}: offset {offsets} um, program's zero at X {x:.3f} Y {y:.3f} mm"
        return "\n  ".join([f"{head} on the table", *map(repr, self.contours)]) + ">"


@refuses_wrong_types
def plan_path(
    file: str | Path | Program, offset: float | str = "auto", *, auto_offset_mm: float, table_um: int | None = None,
    grid_um: int = 1, lead_in_mm: float = LEAD_IN_MM, start_hole_radius_mm: float = START_HOLE_RADIUS_MM,
    taper_deg: float = 0.0, corners: Corners = "conical", guides: Sequence[GuideHeights | None] = (),
    passes: PassPlan | None = None,
) -> CutPath:
    """Plan the whole cut of a part program.

    A contour under G41 or G42, or from a drawing, is the part's edge; the wire runs at the offset from it.
    A G-code contour without compensation is the wire's path; the part's edge lies at the offset on the
    part's side: inside a closed path (outside, if the wire is threaded inside), left of an open one.

    The path begins at the contour's start point and has its direction. The planner uses the program's
    approach, if there is one; otherwise it adds a straight lead-in through the waste to a closed or
    compensated contour. The cut ends where the contour closes. The job is centred on the table.

    Parameters
    ----------
    file : path or Program
        What `load_program` returns; or a file, which it reads with its defaults.
    offset : "auto", "none" or float
        "auto": each contour's offset register, or `auto_offset_mm` without one; "none": 0, the wire's centre
        follows the drawing; or an offset in mm for all contours, also as text.
    auto_offset_mm : float
        Wire radius plus expected side gap, in mm.
    table_um : int, optional
        Travel of each axis of the table, in um; by default that of the standard machine.
    grid_um : int
        Spacing of the points: 1, or 2 if the controller counts motor steps (row T-61).
    lead_in_mm : float
        Length of added lead-ins in mm; shortened, with a notice, if there is no room.
    start_hole_radius_mm : float
        Radius of the hole at every thread point, in mm.
    taper_deg : float
        Angle between wall and vertical if the program sets none; if positive, the part is smaller above than
        below.
    corners : {"conical", "sharp", "cylindrical", "rounded"}
        Shape of corners and arcs at other heights, see `edmsim.program.outline.Taper`.
    guides : sequence of GuideHeights or None
        Heights at which the wire bends, for each pass; the last applies to all further ones. Required if the wire
        leans; with None, the upper guide does not move.
    passes : PassPlan, optional
        Passes of every contour that the program cuts once. A program that cuts an edge several times has its own
        passes, with offsets from its registers or, without these, from the plan.

    Returns
    -------
    CutPath
        Curves are chords within `CHORD_TOLERANCE_UM`; points are on the grid.

    Raises
    ------
    InputError
        If an input is invalid, the wire does not fit, an approach crosses the part, or the job is too large.
    """
    refuse_unknown("corners", corners, get_args(Corners))
    chosen_mm, grid_um = _offset_mm(offset, auto_offset_mm), whole_from("grid_um", grid_um, 1)
    for name, value in (("lead_in_mm", lead_in_mm), ("start_hole_radius_mm", start_hole_radius_mm)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value}: give a length above 0 mm")
    if table_um is None:
        table_um = round(Machine.load().base.table.travel_mm.value * 1e3)
    program = file if isinstance(file, Program) else load_program(file)
    with located(program.source):
        tapered = [(outline.name, outline.taper) for outline in program.outlines if outline.taper is not None]
        program = replace(program, outlines=leaning(program.outlines, taper_deg, corners))
        drawn = [part for one in program.outlines for part in (one.approach_mm, one.points_mm)]
        _check_fits("what is drawn", np.concatenate(drawn) * 1000, MOST_TABLES * table_um, table_um, program.source)
        notices = list(program.notices)
        for name, own in tapered[:1]:
            shaped = corners != "conical" and (own.upper_mm is not None or own.corners not in (None, corners))
            if ignored := [what for what, is_so in (("angle", taper_deg != 0), ("corners", shaped)) if is_so]:
                notices.append(f"{name} is tapered by the program itself, so the requested {' and '.join(ignored)} "
                               "cannot have an effect on it")
        fixed_mm = None if offset == "auto" else chosen_mm
        others = sorted({one.offset_mm for one in program.outlines if one.offset_mm not in (None, fixed_mm)})
        written = ", ".join(f"{mm:g}" for mm in others)
        if others and fixed_mm is not None:
            notices.append(f"the offset is {fixed_mm:g} mm, as requested, not the {written} mm of the register")
        elif others and passes is not None and not passes.of_program:
            taken = ", ".join(f"{mm:g}" for mm in passes.offsets_mm)
            notices.append(f"the passes have the offsets {taken} mm, not the {written} mm of the register")
        groups = grouped(program.outlines)
        legs = [_legs(group, passes, fixed_mm, auto_offset_mm, guides, notices) for group in groups]
        heights = (0.0, *{of_group[0].guides.height_mm for of_group in legs if of_group[0].guides is not None})
        faces = {z: [of_group[0].at_height(z) for of_group in legs] for z in heights}
        for face in faces.values():
            keep_apart(face)
        edges = {z: shapely.MultiLineString([leg.edge for leg in face]) for z, face in faces.items()}
        around = edges, lead_in_mm, start_hole_radius_mm, notices
        leads = [_lead(of_group[0], *around) for of_group in legs]
        notices += _crossed(faces[0.0], leads)
        preceding = {outline: before for before, outline in pairwise(program.outlines)}
        later = [
            [_later_lead(of_group, k, lead, preceding, around) for k in range(1, len(of_group))]
            for of_group, lead in zip(legs, leads, strict=True)
        ]
        in_passes = any(len(of_group) > 1 for of_group in legs)
        contours = [
            _contour_of(of_group, lead, [None, *later_leads], passes, in_passes, grid_um)
            for of_group, lead, later_leads in zip(legs, leads, later, strict=True)
        ]
        notices += [
            f"the rough pass leaves nothing of the tab of {of_group[0].outline.name}, so the piece is loose before "
            "the tab is cut: give a longer tab, or begin the contour further from a corner"
            for of_group, contour in zip(legs, contours, strict=True) if contour.passes and not holds(contour.passes)
        ]
        shift = _shift_um(contours, table_um, grid_um, program.source)
        placed = tuple(_placed(contour, shift) for contour in contours)
        origin = (float(shift[0]) / 1000, float(shift[1]) / 1000)
        number_of = {outline: number for number, group in enumerate(groups) for outline in group}
        order = tuple(number_of[outline] for outline in program.outlines) if len(groups) < len(number_of) else ()
        return CutPath(
            placed, _stock(placed, table_um), start_hole_radius_mm, origin, tuple(notices), program.source,
            _conditions(program, groups), order,
        )


def _conditions(program: Program, groups: Sequence[Sequence[Outline]]) -> Conditions:
    """Return the conditions of the passes; refuse two conditions in a pass if a table has settings for them."""
    names: list[str | None] = []
    for number in range(max(map(len, groups), default=0)):
        outlines = [group[number] for group in groups if number < len(group)]
        first = outlines[0]
        other = next((outline for outline in outlines if outline.condition != first.condition), None)
        if other is not None and program.settings:
            what = f"pass {number + 1} is cut with {first.condition} and with {other.condition}"
            raise InputError(f"{what}: give all its contours one condition", line=other.line)
        names.append(first.condition)
    approach = groups[0][0].approach_condition if groups else None
    return Conditions(tuple(names), approach, program.settings)


def _legs(
    group: list[Outline], passes: PassPlan | None, chosen_mm: float | None, auto_offset_mm: float,
    guides: Sequence[GuideHeights | None], notices: list[str],
) -> list[OffsetOutline]:
    """Return the edge of a group at the offsets of its passes; adds the last pass's notices of unreachable metal."""
    once = len(group) == 1
    if passes is not None and not (once or passes.of_program):
        reason = f"{group[0].name}: the program cuts it {len(group)} times, in passes of its own"
        raise InputError(f"{reason}: give no number of passes", line=group[1].line)
    for number, one in enumerate(group, 1):
        if (one.taper is None) != (group[0].taper is None):
            first, later = ("vertical", "tilted") if one.taper is not None else ("tilted", "vertical")
            reason = f"pass 1 is {first} and pass {number} {later}: tilt the wire in all passes or in none"
            raise InputError(f"{one.name}: {reason}", line=one.line)
    planned = passes is not None and chosen_mm is None and (
        not passes.of_program if once else len(passes.offsets_mm) == len(group)
    )
    plan_mm: Sequence[float | None] = passes.offsets_mm if passes is not None and planned else [None] * len(group)
    outlines = group * len(plan_mm) if once else group
    if once and len(plan_mm) > 1 and group[0].wire_side is None:
        reason = f"{group[0].name}: the wire follows it as drawn, and passes run beside an edge: use G41 or G42"
        raise InputError(reason, line=group[0].line)
    found: list[OffsetOutline] = []  # planned trims go straight past outer corners, as far out as the rough pass
    for number, (outline, mm) in enumerate(zip(outlines, plan_mm, strict=True), 1):
        register_mm = None if once and mm is not None else outline.offset_mm
        used_mm = next(v for v in (chosen_mm, register_mm, mm, auto_offset_mm) if v is not None)
        own_notices: list[str] = []
        guide = guides[min(number, len(guides)) - 1] if guides else None
        found.append(
            offset_outline(outline, used_mm, own_notices, found[0].offset_mm if found and once else None)
            if outline.taper is None else leaning_outline(outline, used_mm, guide, own_notices)
        )
        notices += own_notices if number == len(outlines) else []
    if planned and not once and any(outline.offset_mm is None for outline in outlines):
        notices.append(
            f"line {group[0].line}: {group[0].name} has passes without offset registers: they take those that belong "
            f"to their settings, {', '.join(f'{leg.offset_mm:g}' for leg in found)} mm"
        )
    return found


def _contour_of(
    legs: list[OffsetOutline], lead: Lead, leads: list[Lead | None], passes: PassPlan | None, in_passes: bool,
    grid_um: int,
) -> WireContour:
    """Return the contour of one edge, with its passes if the path has several; `leads` are those of later passes."""
    last = legs[-1]
    made = _contour if last.surfaces is None else _leaning_contour
    compensated = last.outline.wire_side is not None and (len(legs) > 1 or last.offset_mm > 0)
    if not (in_passes and compensated):
        return replace(made(last, lead, grid_um), continues=last.outline.continues)
    with of_outline(legs[0].outline):
        if passes is not None and not passes.of_program:
            stretches: list[Stretch] = stretches_of(legs, passes)
        else:
            stretches = stretches_of_group(legs, leads)
    contour = made(_as_first(legs), lead, grid_um)
    before = lead.points if len(lead.points) else stretches[0].points[:1]
    first = legs[0].outline
    waits = [(_lead_place(lead, first, i), s) for i, s in first.dwells if i < len(first.approach_mm)]
    return replace(contour, passes=on_grid(stretches, before, grid_um, waits), continues=first.continues)


def _as_first(legs: list[OffsetOutline]) -> OffsetOutline:
    """Return the last pass's path and edge with the direction and start of the first pass."""
    first, last = legs[0], legs[-1]
    if last.outline is first.outline:
        return last
    if last.surfaces is not None:
        return leaning_outline(first.outline, last.offset_mm, last.guides, [])
    assert first.outline.wire_side is not None
    path = offset_edge(first.outline.points_mm, first.outline.wire_side, last.offset_mm, first.outline.closed)
    return replace(last, outline=first.outline, path=path, nominal=first.outline.points_mm)


def _offset_mm(offset: float | str, auto_offset_mm: float) -> float:
    if offset == "none":
        return 0.0
    try:
        value = auto_offset_mm if offset == "auto" else float(offset)
    except ValueError:
        value = math.nan
    if not 0 <= value <= GREATEST_MM:
        shown = auto_offset_mm if offset == "auto" else offset
        raise InputError(f"the offset is {shown!r}: give auto, none, or a length of 0 to {GREATEST_MM:g} "
                         f"mm{in_um(value)}")
    return value


_Around = tuple[Mapping[float, BaseGeometry], float, float, list[str]]


def _lead(
    leg: OffsetOutline, edges: Mapping[float, BaseGeometry], length_mm: float, hole_radius_mm: float,
    notices: list[str],
) -> Lead:
    """Return the lead-in of a pass, which keeps clear of `edges`, by height, on every face of the workpiece."""
    outline, at_faces = leg.outline, [leg.at_height(z) for z in edges]
    with of_outline(outline):
        if len(outline.approach_mm):
            lead = _programmed_lead(leg, hole_radius_mm)
        elif not outline.needs_lead_in:
            return Lead(np.empty((0, 2)), ())
        else:
            starts = [leg.path[0], *(at_face.path[0] for at_face in at_faces[1:])]
            faces = [*edges.values()]
            thread, added = _own_lead_in(starts, away(leg), faces, leg.offset_mm, length_mm, hole_radius_mm)
            if outline.line:
                notices.append(f"line {outline.line}: a lead-in is put before {outline.name}, the program has none")
            notices += added
            lead = Lead(thread[None, :], (0,))
        for at_face in at_faces if len(at_faces) > 1 else []:
            _check_lead(at_face, lead)
    return lead


def _later_lead(
    legs: Sequence[OffsetOutline], k: int, first: Lead, preceding: Mapping[Outline, Outline], around: _Around
) -> Lead | None:
    """Return the lead-in of a later pass; None if it begins where the previous pass of the same edge ended."""
    outline, before = legs[k].outline, legs[k - 1].outline
    parted = outline is not before and preceding[outline] is not before
    if not parted and (outline is before or begins_at(outline, before.points_mm[-1])):
        return None
    rough = legs[0].outline
    if parted and not len(outline.approach_mm) and not rough.continues and begins_at(outline, rough.points_mm[0]):
        return replace(first, parted=True)  # from the same start hole
    return replace(_lead(legs[k], *around), parted=parted)


def _own_lead_in(
    starts: Sequence[Floats], away: Floats, faces: Sequence[BaseGeometry], offset_mm: float, length_mm: float,
    hole_radius_mm: float,
) -> tuple[Floats, list[str]]:
    """Return a thread point away from the contour, on the waste side, and notices."""
    # `starts` has the contour's start on each face of the workpiece, `away` the direction from the part on the first.
    # The lead-in is perpendicular to the edge and of full length if there is room, otherwise turned by up to 75
    # degrees, otherwise shorter, and longer if the wall leans over it. The wire keeps the offset from every edge of
    # each face, the hole its radius and a clearance.
    start, lengths = starts[0], [share * length_mm for share in _SHARES]
    overhang_mm = max(float((begin - start) @ away) for begin in starts)
    if overhang_mm > 0:
        lengths += [overhang_mm + mm for mm in lengths]
    for mm in lengths:
        for turn in _TURNS_DEG:
            cos, sin = math.cos(math.radians(turn)), math.sin(math.radians(turn))
            direction = np.array([cos * away[0] - sin * away[1], sin * away[0] + cos * away[1]])
            thread = start + mm * direction
            approaches = [np.array([thread, begin]) for begin in starts]
            nearest_mm = min(edges.distance(shapely.Point(thread)) for edges in faces)
            if nearest_mm >= hole_radius_mm + HOLE_CLEARANCE_MM and all(
                _clears(approach, edges, offset_mm, _TOLERANCE_MM)
                for approach, edges in zip(approaches, faces, strict=True)
            ):
                why = "there is no more room" if mm < length_mm else "the wall leans over the way to it"
                return thread, [] if mm == length_mm else [f"a lead-in is {mm:.3f} mm long, as {why}"]
    x, y = start
    raise InputError(f"no room for a start hole of {hole_radius_mm:g} mm radius within {max(lengths):.4g} mm of "
                     f"X{x:.3f} Y{y:.3f}: draw the contour with more waste beside its first point, or cut a G-code "
                     "program with its own way from a start hole to the contour")


def _check_approach(approach: Floats, edge: BaseGeometry, offset_mm: float, hole_radius_mm: float) -> None:
    """Refuse a program's own approach (n, 2) in mm if wire or start hole would cut into the part."""
    x, y = approach[0]
    if not _clears(approach, edge, offset_mm):
        raise InputError(f"the approach from X{x:.3f} Y{y:.3f} cuts into the part: thread the wire on the "
                         "waste side, further away, or exchange G41 and G42")
    distance = edge.distance(shapely.Point(approach[0]))
    if distance < hole_radius_mm - _TOLERANCE_MM:
        raise InputError(f"the thread point X{x:.3f} Y{y:.3f} is {distance:.3f} mm from the part, the hole's "
                         f"radius {hole_radius_mm:g} mm: move the point or take a smaller hole")


def _clears(path: Floats, edges: BaseGeometry, offset_mm: float, within_mm: float = GOUGE_MM) -> bool:
    """Return whether a path (n, 2) to a contour keeps the offset from the edges or, at offset 0, meets none."""
    # tolerance: a 1 mm approach in line with the edge comes 2 um nearer to the edge's first point than the offset
    if offset_mm == 0:
        before = path[-1] + (path[-2] - path[-1]) * 0.01
        return bool(shapely.LineString([*path[:-1], before]).distance(edges) > 0)
    return bool(shapely.LineString(path).distance(edges) >= offset_mm - within_mm)


def _programmed_lead(leg: OffsetOutline, hole_radius_mm: float) -> Lead:
    """Offset the compensated part of the program's approach, and refuse it if it cuts into the part."""
    outline, split = leg.outline, leg.outline.compensated_from
    points, lines = outline.approach_mm, outline.approach_lines
    if outline.continues and len(points) > 1:  # the wire is next to the first point, where the previous pass ended
        points, lines, split = points[1:], lines[1:], split - 1
    if split < len(points) and outline.wire_side is not None:
        drawn = np.concatenate([points[split:], outline.points_mm[:1]])
        tail = offset_edge(drawn, outline.wire_side, leg.offset_mm, closed=False)
        tail_lines = np.array(lines[split:])[nearest_chords(drawn, (tail[1:] + tail[:-1]) / 2)]
        points = np.concatenate([points[:split], tail[:-1]])
        lines = (*lines[:split], *tail_lines.tolist())
    if outline.closed and outline.wire_side is not None:
        inside = shapely.Polygon(leg.nominal).contains(shapely.Point(points[0]))
        if inside == ((signed_area(leg.nominal) > 0) == (outline.part_side == "left")):
            x, y = points[0]
            raise InputError(f"the wire is threaded at X{x:.3f} Y{y:.3f} in the part: exchange G41 and G42 "
                             "or thread it in the waste")
    if outline.closed or outline.wire_side is not None:
        hole_mm = 0.0 if outline.continues else hole_radius_mm
        _check_approach(np.concatenate([points, leg.path[:1]]), leg.edge, leg.offset_mm, hole_mm)
    return Lead(points, lines)


def _contour(leg: OffsetOutline, lead: Lead, grid_um: int) -> WireContour:
    """Join lead-in and path on the grid, in the program's coordinates."""
    outline = leg.outline
    path, stops = _with_dwells(leg, lead)
    numbers = np.array(outline.line_numbers)[nearest_chords(outline.points_mm, (path[1:] + path[:-1]) / 2)]
    points = np.round(np.concatenate([lead.points, path]) * 1000 / grid_um).astype(np.int64) * grid_um
    return _on_grid(leg, lead, WirePath(points), stops, numbers.tolist(), _elements(leg))


def _on_grid(
    leg: OffsetOutline, lead: Lead, wire_path: WirePath, stops: Sequence[tuple[int, float]],
    line_numbers: Sequence[int], elements: tuple[tuple[int, int], ...],
) -> WireContour:
    """Return the contour of a path on the grid, lead-in included, without points at which nothing moves."""
    outline, count = leg.outline, len(lead.points)
    wire_path, moves, stops = wire_path.moving(stops)
    if not moves.any():
        with of_outline(outline):
            raise InputError("it moves the wire by less than a um: draw it longer, or leave it out")
    lines = np.array([*lead.lines, *line_numbers], np.int64)[moves]
    return WireContour(
        points_um=wire_path.points_um, lead_in_moves=int(moves[:count].sum()), nominal_mm=leg.nominal,
        closed=outline.closed, part_side=outline.part_side, dwells=stops, line_numbers=tuple(lines.tolist()),
        elements=elements, offset_um=leg.offset_mm * 1000, compensated=outline.wire_side is not None,
        lean=wire_path.lean,
    )


def _crossed(legs: Sequence[OffsetOutline], leads: Sequence[Lead]) -> list[str]:
    """Return notices of lead-ins that cut into another contour; they are allowed, as its piece may be removed."""
    found = []
    shut = [leg for leg in legs if leg.outline.closed and leg.outline.wire_side]
    tree = shapely.STRtree([leg.edge for leg in shut])
    for leg, lead in zip(legs, leads, strict=True):
        if not len(lead.points):
            continue
        approach = np.concatenate([lead.points, leg.path[:1]])
        near = tree.query(shapely.LineString(approach), "dwithin", leg.offset_mm)
        found += [
            f"{leg.outline.name}: the wire cuts into {other.outline.name} on its way from X{approach[0, 0]:.3f} "
            f"Y{approach[0, 1]:.3f}; thread it elsewhere, or take that piece out before"
            for other in (shut[number] for number in sorted(near.tolist()))
            if other is not leg and not _clears(approach, other.edge, leg.offset_mm)
        ]
    return found


def _check_lead(leg: OffsetOutline, lead: Lead) -> None:
    """Refuse a lead-in that cuts into the part on a face of the workpiece."""
    whole = leg.outline.closed or leg.outline.wire_side is not None
    approach = np.concatenate([lead.points, leg.path[:1]])
    if whole and len(lead.points) and not _clears(approach, leg.edge, leg.offset_mm):
        x, y = lead.points[0]
        raise InputError(f"the wire on its way from X{x:.3f} Y{y:.3f} leans into the part: thread it further away")


def _leaning_contour(leg: OffsetOutline, lead: Lead, grid_um: int) -> WireContour:
    """Join lead-in and the paths of both guides on the grid; the wire begins to lean on the lead-in's last move."""
    outline, guides = leg.outline, leg.guides
    assert leg.surfaces is not None
    assert guides is not None
    wall, wire = leg.surfaces
    if not len(lead.points) and wire.slope[0].any():  # threaded vertically, the wire leans before it moves
        lead = Lead(wire.lower_mm[:1], (0,))
    count = len(lead.points)
    slope = np.concatenate([np.zeros((count, 2)), wire.slope])
    known = np.concatenate([lead.points, wire.lower_mm])
    points, leads, bends = guides_for(known, wire.low_mm, slope, guides, grid_um)
    vertices = [*range(count), *(count + vertex for vertex in wire.vertices)]
    own = len(outline.approach_mm)
    stops = [(vertices[i - own + count if i >= own else min(i, count)], seconds) for i, seconds in outline.dwells]
    elements = tuple(zip(wall.elements, wall.line_numbers, strict=True))
    wire_path = WirePath(points, Lean(leads, bends, wall, guides.height_mm))
    return _on_grid(leg, lead, wire_path, stops, wire.line_numbers, elements)


def _elements(leg: OffsetOutline) -> tuple[tuple[int, int], ...]:
    """Return element and program line of every chord of the edge, which may be offset from the drawn outline."""
    outline = leg.outline
    drawn = list(zip(outline.elements, outline.line_numbers, strict=True))
    if leg.nominal is outline.points_mm:
        return tuple(drawn)
    return tuple(drawn[i] for i in nearest_chords(outline.points_mm, (leg.nominal[1:] + leg.nominal[:-1]) / 2))


def _with_dwells(leg: OffsetOutline, lead: Lead) -> tuple[Floats, list[tuple[int, float]]]:
    """Return the path with a point wherever the wire dwells, and the dwells by index into lead and path."""
    path, count = leg.path, len(leg.outline.approach_mm)
    passed, waits = arc_lengths(path), dwells_along(leg)
    every = np.union1d(passed, [at for at, _ in waits])
    places = iter(len(lead.points) + int(np.searchsorted(every, at)) for at, _ in waits)
    return interpolated(every, passed, path), [
        (next(places) if i >= count else _lead_place(lead, leg.outline, i), seconds)
        for i, seconds in leg.outline.dwells
    ]


def _lead_place(lead: Lead, outline: Outline, i: int) -> int:
    """Return the index in the lead-in of point `i` of the program's approach."""
    return int(np.hypot(*(lead.points - outline.approach_mm[i]).T).argmin())


def _shift_um(contours: Sequence[WireContour], table_um: int, grid_um: int, source: str) -> NDArray[np.int64]:
    """Return the shift in um, on the grid, that centres the job on the table."""
    points = np.concatenate([path for contour in contours for path in contour.reach_um])
    _check_fits("the wire's path with its lead-ins", points, table_um, table_um, source)
    low, high = points.min(axis=0), points.max(axis=0)
    return np.asarray((table_um - low - high) // (2 * grid_um) * grid_um, np.int64)


def _check_fits(what: str, points_um: Floats | NDArray[np.int64], most_um: float, table_um: int, source: str) -> None:
    """Refuse points that span more than `most_um`; the message has the size of the table."""
    x, y = np.ptp(points_um, axis=0)
    if max(x, y) > most_um:
        hint = "; if the drawing's unit is another, give --unit" if Path(source).suffix.lower() == ".dxf" else ""
        table = f"{table_um / 1000:g} x {table_um / 1000:g} mm"
        raise InputError(f"{what} spans {x / 1000:.3f} x {y / 1000:.3f} mm: the table has {table}{hint}", source)


def _placed(contour: WireContour, shift: NDArray[np.int64]) -> WireContour:
    return replace(
        contour, points_um=contour.points_um + shift, nominal_mm=contour.nominal_mm + shift / 1000,
        lean=contour.lean and contour.lean.moved(shift / 1000),
        passes=tuple(one.moved(shift) for one in contour.passes),
    )


def _stock(contours: Sequence[WireContour], table_um: int) -> tuple[float, float, float, float]:
    corners = np.concatenate([part for c in contours for part in (*(w / 1000 for w in c.reach_um), c.nominal_mm)])
    low = np.clip(corners.min(axis=0) - STOCK_MARGIN_MM, 0, table_um / 1000)
    high = np.clip(corners.max(axis=0) + STOCK_MARGIN_MM, 0, table_um / 1000)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])
