"""Passes of a cut: their settings, what each removed and left, and pieces that come loose."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.controllers import FeedController
from edmsim.cosim.observers import Turn
from edmsim.geometry import Floats, interpolated
from edmsim.machine.machine import Machine
from edmsim.metrology import edges, kerf, profile
from edmsim.plant.plant import Plant
from edmsim.program.passes import CutPass, Piece
from edmsim.program.path import CutPath, WireContour
from edmsim.snapshots import Snapshots

# A contour cut at its dwells: the stretches a planner is made for.


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
    part_side: Literal["left", "right"] | None = None  # looking along the leg; None: the wire follows a line as drawn

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


def _part_side(contour: WireContour, one: CutPass | None) -> Literal["left", "right"] | None:
    """Return the side of the part looking along a pass; None where the wire follows a line as drawn."""
    if one is None or not one.reversed:
        return contour.part_side if contour.compensated else None
    return "left" if contour.part_side == "right" else "right"


def legs_of(contour: WireContour) -> list[Leg]:
    """Cut a contour's path at its dwells; of one in passes return them one after the other, lead-in first."""
    legs: list[Leg] = []
    parts: Sequence[CutPass | WireContour] = contour.passes or (contour,)
    for number, (part, threads) in enumerate(zip(parts, contour.threads, strict=True)):
        one = part if isinstance(part, CutPass) else None
        lead = one.approach_moves if one is not None and number == 0 else 0
        along, waits = part.way.along_um, dict.fromkeys((i for i, _ in part.dwells), 0.0)
        for i, seconds in part.dwells:
            waits[i] += seconds
        ends = sorted({lead, len(part.points_um) - 1, *waits} - {0})
        for a, b in zip([0, *ends[:-1]], ends, strict=True):
            legs.append(
                Leg(
                    part.points_um[a : b + 1], a == 0 and threads, waits.get(0, 0.0) if a == 0 else 0.0,
                    waits.get(b, 0.0), along[a : b + 1],
                    None if part.lean is None else part.lean.upper_um[a : b + 1], one,
                    leads_in=one is not None and b <= lead, part_side=_part_side(contour, one),
                )
            )
    return legs


def programmed_um(legs: Sequence[Leg], path_um: Floats) -> Floats:
    """Return the places (n, 2) of the program at lengths of path over all legs."""
    along, end_um = [], 0.0
    for leg in legs:
        along.append(end_um + leg.along_um - leg.along_um[0])
        end_um = float(along[-1][-1])
    return interpolated(path_um, np.concatenate(along), np.concatenate([leg.points_um for leg in legs]))


def way_behind(legs: Sequence[Leg], number: int) -> tuple[NDArray[Any], NDArray[np.float64], NDArray[Any]]:
    """Return what the wire of a trim has cut before a leg, since it was threaded: points, lengths of path, leads.

    A retract runs back onto it over the leg's first point, from which lengths count, below 0.
    """
    # A rough pass ends with a bent wire. At rest for the trim it is straight, and so pressed to the metal ahead of
    # the rough pass. Open machines run back along what they have cut, whatever the program's lines are: LinuxCNC's
    # adaptive feed, Spark's buffer of places.
    leg, first = legs[number], number
    if leg.cut_pass is not None and leg.cut_pass.number > 1:
        leans = leg.lead_um is not None
        while first > 0 and not legs[first].threads and (legs[first - 1].lead_um is not None) == leans:
            first -= 1
    before = legs[first:number]
    to_go, along = 0.0, [np.empty(0)]
    for one in reversed(before):
        along.insert(1, one.along_um - one.along_um[-1] - to_go)
        to_go += float(one.along_um[-1] - one.along_um[0])
    points = [np.empty((0, 2)), *(one.points_um for one in before)]
    leads = [np.empty((0, 2)), *(one.lead_um for one in before if one.lead_um is not None)]
    return np.concatenate(points), np.concatenate(along), np.concatenate(leads)


FACE_EVERY = 5  # places of a profile error per place of a pass' face: 0.1 mm (ours: pictures show no more)
LEAST_PIECE_MM2 = 0.02  # smaller pieces of metal are crumbs: less than half of a wire's cross-section (ours)


class PassSetup(NamedTuple):
    """Setting of a pass: a machine that differs from the first one only in what an operator sets, and who feeds."""

    machine: Machine
    controller: FeedController


@dataclass
class Sums:
    """Pulses of each class, energy and voltage over time of a cut; all pulses count, those before a break as well."""

    # the voltage is that of the gap with its sign, equalising pulses included; their supply's energy is by itself

    short: int = 0
    open: int = 0
    spark: int = 0
    arc: int = 0
    energy: float = 0.0
    voltage_s: float = 0.0
    crater_um3: float = 0.0
    vibration2_pulses: float = 0.0
    equalising_J: float = 0.0

    def add(self, turn: Turn) -> None:
        """Add one window and its equalising pulses, if there are any."""
        window, opposite = turn.window, turn.opposite
        duration_s = window.duration_ns * 1e-9
        net_V = window.mean_voltage_V if opposite is None else opposite.net_voltage_V
        self.short += window.short
        self.open += window.open
        self.spark += window.spark
        self.arc += window.arc
        self.energy += window.energy_J
        self.voltage_s += net_V * duration_s
        self.equalising_J += 0.0 if opposite is None else opposite.power_W * duration_s
        self.crater_um3 += window.crater_um3
        self.vibration2_pulses += window.vibration2_um2 * window.pulses

    @property
    def pulses(self) -> int:
        """Pulses of all classes."""
        return self.short + self.open + self.spark + self.arc


@dataclass
class PassRecord:
    """What became of a pass."""

    contour: int  # number of the contour, from 1
    number: int  # of the pass, from 1
    piece: Piece  # {"profile", "tab"}
    reversed: bool
    offset_um: float
    begin_s: float  # begin_s, end_s: machine time, from when it begins to cut: a lead-in comes before
    end_s: float
    begin_um: float  # begin_um, end_um: length of wire path, over all passes
    end_um: float
    sums: Sums = field(default_factory=Sums)  # pulses, energy and craters of the pass
    wall: kerf.WallError | None = None  # the wall that it left; None while it is not finished
    # profile error behind it, slice by slice from the lowest one, at every `FACE_EVERY`-th place of
    # `profile_error` of the whole contour; none while it is not finished
    face_um: tuple[tuple[float, ...], ...] = ()

    @property
    def feed_mm_min(self) -> float:
        """Mean feed; 0 where the pass took no time."""
        seconds = self.end_s - self.begin_s
        return (self.end_um - self.begin_um) / seconds * 0.06 if seconds > 0 else 0.0


class PassLog(Snapshots):
    """Keeps what every pass of a cut did, a record each, and looks after loose pieces, of which `notices` tell."""

    STATE = ("records", "notices", "_before", "_open")
    records: list[PassRecord]

    def __init__(self, path: CutPath, legs: Sequence[Leg]) -> None:
        self.records = []
        self.notices: list[str] = []
        self._before, self._open = Sums(), False
        self.plan(path, legs)

    def plan(self, path: CutPath, legs: Sequence[Leg]) -> None:
        """Take another plan of the same cut: the passes to come may have other offsets."""
        numbers = {id(one): number for number, contour in enumerate(path.contours, 1) for one in contour.passes}
        cutting = [(id(leg.cut_pass), k) for k, leg in enumerate(legs) if leg.cut_pass and not leg.leads_in]
        last, first = dict(cutting), dict(reversed(cutting))
        self._contours = path.contours
        self._contour_of = [numbers.get(id(leg.cut_pass), 0) for leg in legs]
        self._is_first, self._is_last = (
            [legs_at.get(id(leg.cut_pass)) == k for k, leg in enumerate(legs)] for legs_at in (first, last)
        )

    def begin_leg(self, number: int, leg: Leg, time_s: float, path_um: float, sums: Sums) -> None:
        """Begin a record with the first leg of a pass, behind its lead-in."""
        one = leg.cut_pass
        self._open = one is not None and not leg.leads_in
        if one is None or not self._is_first[number]:
            return
        contour = self._contour_of[number]
        self._before = Sums(**asdict(sums))
        self.records.append(
            PassRecord(contour, one.number, one.piece, one.reversed, one.offset_um, time_s, time_s, path_um, path_um)
        )

    def follow(self, time_s: float, path_um: float, sums: Sums) -> None:
        """Take in how far the cut is."""
        if self._open:
            last = self.records[-1]
            last.end_s, last.end_um = time_s, path_um
            last.sums = Sums(**{name: value - getattr(self._before, name) for name, value in asdict(sums).items()})

    def end_leg(self, number: int, leg: Leg, plant: Plant) -> None:
        """Measure the wall at the end of a pass, and see what has come loose."""
        one = leg.cut_pass
        if one is None or not self._is_last[number]:
            return
        self._open = False
        contour = self._contours[self.records[-1].contour - 1]
        self.records[-1].wall = kerf.wall_error(plant.field, one, contour.part_side, plant.machine.wire_diameter_um)
        error_um = profile.profile_error(plant.field, contour).error_um[:, ::FACE_EVERY]
        self.records[-1].face_um = tuple(tuple(row) for row in np.round(error_um, 1).tolist())
        if one.frees:
            within = shapely.Polygon(contour.at_mid_height().nominal_mm * 1e3).buffer(one.offset_um)
            for piece in edges.loose_pieces(plant.field, LEAST_PIECE_MM2):
                if piece.within(within):  # others came loose from contours before
                    self._loosen(piece, one, contour, plant)

    def _loosen(self, piece: shapely.Polygon, one: CutPass, contour: WireContour, plant: Plant) -> None:
        x, y = one.way.at_mid_height()[-1].tolist()
        is_part = shapely.LinearRing(contour.nominal_mm).is_ccw == (contour.part_side == "left")
        what = "part" if is_part else "slug"
        far_mm = math.dist((piece.centroid.x, piece.centroid.y), (x, y)) * 1e-3
        if not one.falls or contour.lean is not None:
            why = ", as the fall of a piece with tapered walls is not in the model" if one.falls else ""
            self.notices.append(
                f"the {what} is loose after the cut at X {x / 1e3:.3f} Y {y / 1e3:.3f} mm on the table "
                f"and is taken to be held: glued, or by a magnet{why}"
            )
            return
        if far_mm > plant.machine.wire_diameter_um * 1e-3:
            self.notices.append(
                f"the {what} would tip onto the wire: nothing holds it when the cut ends {far_mm:.2f} mm from its "
                "centre; hold it with after_tab stop, or begin the contour nearer to it"
            )
        if is_part:
            self.notices.append(
                "the part comes loose before its last pass and is taken to lie still: after_tab stop "
                "lets the machine stop for it to be held"
            )
            return
        taken_mm3 = plant.take_out(piece)
        self.notices.append(
            f"the slug falls at X {x / 1e3:.3f} Y {y / 1e3:.3f} mm on the table and is taken out of "
            f"the workpiece, {piece.area * 1e-6:.2f} mm² of it"
            + (f", {taken_mm3:.2f} mm³ of them near the wire's path" if taken_mm3 else "")
        )
