"""Passes of a cut: their settings and results, and pieces that come loose."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
import shapely

from edmsim.closed_loop.cycle import CycleResult
from edmsim.controllers import FeedController
from edmsim.geometry import Floats, interpolated
from edmsim.machine.machine import Machine
from edmsim.metrology import edges, kerf, profile
from edmsim.plant.plant import Plant
from edmsim.program.passes import CutPass, Piece
from edmsim.program.path import CutPath, WireContour
from edmsim.snapshots import Snapshots

# A contour divided at its dwells into legs; a planner is made for each leg.


@dataclass
class ProgramPlace:
    """Progress in a program: the leg, its first point and path length, and whether its dwell has begun."""

    leg: int = 0
    from_um: tuple[float, float] = (0.0, 0.0)
    start_um: float = 0.0
    dwelling: bool = False
    lead_um: tuple[float, float] = (0.0, 0.0)
    missed_before: int = 0


class Leg(NamedTuple):
    """The path between two stops of the program: threading, a dwell, the end."""

    points_um: np.typing.NDArray[np.int64]
    threads: bool  # whether a new wire is threaded at the first point
    # rest_s, dwell_s: waiting times at the first point and at the last one (G4)
    rest_s: float
    dwell_s: float
    along_um: Floats  # (n,): path length at every point
    # (n, 2): lead of the upper guide over the lower one; None for a vertical wire
    lead_um: np.typing.NDArray[np.int64] | None = None
    cut_pass: CutPass | None = None  # its pass; None if the contour is cut in one pass
    leads_in: bool = False  # whether it leads from the start hole to the beginning of the pass
    part_side: Literal["left", "right"] | None = None  # None if the wire follows a line as drawn

    def started_at(
        self, point_um: tuple[float, float], lead_um: tuple[float, float]
    ) -> tuple[np.typing.NDArray[Any], Floats, np.typing.NDArray[Any] | None]:
        """Return points, path lengths and leads of the leg from a place on, which need not be its first point."""
        points, leads, along = self.points_um, self.lead_um, self.along_um - self.along_um[0]
        distance_um = math.dist(points[0], point_um)
        if leads is not None:
            distance_um = max(distance_um, math.dist(leads[0], lead_um))
        if distance_um == 0.0:
            return points, along, leads
        leads = None if leads is None else np.concatenate([[lead_um], leads])
        return np.concatenate([[point_um], points]), np.concatenate([[0.0], along + distance_um]), leads


def _part_side(contour: WireContour, one: CutPass | None) -> Literal["left", "right"] | None:
    """Return the side of the part looking along a pass; None if the wire follows a line as drawn."""
    if one is None or not one.reversed:
        return contour.part_side if contour.compensated else None
    return "left" if contour.part_side == "right" else "right"


def legs_of(path: CutPath) -> list[Leg]:
    """Divide the paths of all contours at their dwells into legs, in cutting order."""
    return [leg for contour, number in path.cuts for leg in _legs_of_pass(contour, number)]


def _legs_of_pass(contour: WireContour, number: int) -> Iterator[Leg]:
    """Yield the legs of a contour's pass, counted from 0, or of its only path; the lead-in first."""
    one = contour.passes[number] if contour.passes else None
    part = one or contour
    lead = one.approach_moves if one is not None and number == 0 else 0
    along, waits = part.wire_path.along_um, dict.fromkeys((i for i, _ in part.dwells), 0.0)
    for i, seconds in part.dwells:
        waits[i] += seconds
    ends = sorted({lead, len(part.points_um) - 1, *waits} - {0})
    for a, b in zip([0, *ends[:-1]], ends, strict=True):
        yield Leg(
            part.points_um[a : b + 1], a == 0 and contour.threads[number], waits.get(0, 0.0) if a == 0 else 0.0,
            waits.get(b, 0.0), along[a : b + 1], None if part.lean is None else part.lean.upper_um[a : b + 1], one,
            leads_in=one is not None and b <= lead, part_side=_part_side(contour, one),
        )


def programmed_um(legs: Sequence[Leg], path_um: Floats) -> Floats:
    """Return the places (n, 2) of the program at path lengths over all legs."""
    along, end_um = [], 0.0
    for leg in legs:
        along.append(end_um + leg.along_um - leg.along_um[0])
        end_um = float(along[-1][-1])
    return interpolated(path_um, np.concatenate(along), np.concatenate([leg.points_um for leg in legs]))


def path_behind(legs: Sequence[Leg], number: int) -> tuple[np.typing.NDArray[Any], Floats, np.typing.NDArray[Any]]:
    """Return the path that the wire of a trim has cut before a leg, since threading: points, path lengths, leads.

    A retract may run back onto it beyond the leg's first point, at which lengths are 0.
    """
    # A rough pass ends with a bent wire. At rest for the trim it is straight, which presses it against the metal in
    # front of the rough pass. Open machines also retract along the path that was cut, across the program's lines:
    # LinuxCNC's adaptive feed, Spark's buffer of places.
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


FACE_EVERY = 5  # places of a profile error per place of a pass' face: 0.1 mm (ours: enough for pictures)
LEAST_PIECE_MM2 = 0.02  # smaller pieces of metal are ignored: less than half of a wire's cross-section (ours)


class PassSetup(NamedTuple):
    """Setting of a pass: its controller, and a machine that differs from the first only in operator's settings."""

    machine: Machine
    controller: FeedController


@dataclass
class Sums:
    """Sums over a cut: pulses of each class, energy, voltage over time; also of the pulses before a break."""

    # voltage of the gap with its sign, equalising pulses included; the energy of their supply is separate

    short: int = 0
    open: int = 0
    spark: int = 0
    arc: int = 0
    energy: float = 0.0
    voltage_s: float = 0.0
    crater_um3: float = 0.0
    vibration2_pulses: float = 0.0
    equalising_J: float = 0.0

    def add(self, result: CycleResult) -> None:
        """Add one window and its equalising pulses, if there are any."""
        window, opposite = result.window, result.opposite
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
    """Results of a pass."""

    contour: int  # number of the contour, from 1
    number: int  # number of the pass, from 1
    piece: Piece  # {"profile", "tab"}
    reversed: bool
    offset_um: float
    begin_s: float  # begin_s, end_s: machine time, without the lead-in
    end_s: float
    begin_um: float  # begin_um, end_um: path length, over all passes
    end_um: float
    sums: Sums = field(default_factory=Sums)  # sums over the pass
    wall: kerf.WallError | None = None  # wall after the pass; None until it is finished
    # profile error after the pass, slice by slice from the lowest one, at every `FACE_EVERY`-th place of
    # `profile_error` of the whole contour; None until it is finished
    face_um: tuple[tuple[float, ...], ...] = ()

    @property
    def feed_mm_min(self) -> float:
        """Mean feed; 0 if the pass took no time."""
        seconds = self.end_s - self.begin_s
        return (self.end_um - self.begin_um) / seconds * 0.06 if seconds > 0 else 0.0


class PassLog(Snapshots):
    """Records the results of every pass of a cut, and removes loose pieces, which `notices` report."""

    STATE = ("records", "notices", "_open")
    records: list[PassRecord]

    def __init__(self, path: CutPath, legs: Sequence[Leg]) -> None:
        self.records = []
        self.notices: list[str] = []
        self._open = False
        self.plan(path, legs)

    def plan(self, path: CutPath, legs: Sequence[Leg]) -> None:
        """Use another plan of the same cut: later passes may have other offsets."""
        numbers = {id(one): number for number, contour in enumerate(path.contours, 1) for one in contour.passes}
        cutting = [(id(leg.cut_pass), k) for k, leg in enumerate(legs) if leg.cut_pass and not leg.leads_in]
        last, first = dict(cutting), dict(reversed(cutting))
        self._contours = path.contours
        self._contour_of = [numbers.get(id(leg.cut_pass), 0) for leg in legs]
        self._is_first, self._is_last = (
            [legs_at.get(id(leg.cut_pass)) == k for k, leg in enumerate(legs)] for legs_at in (first, last)
        )

    def begin_leg(self, number: int, leg: Leg, time_s: float, path_um: float) -> None:
        """Begin a record with the first leg of a pass, after its lead-in."""
        one = leg.cut_pass
        self._open = one is not None and not leg.leads_in
        if one is None or not self._is_first[number]:
            return
        contour = self._contour_of[number]
        self.records.append(
            PassRecord(contour, one.number, one.piece, one.reversed, one.offset_um, time_s, time_s, path_um, path_um)
        )

    def add(self, result: CycleResult) -> None:
        """Add one window to the record of its pass."""
        if self._open:
            last = self.records[-1]
            last.end_s, last.end_um = result.time_ns * 1e-9, result.path_um
            last.sums.add(result)

    def end_leg(self, number: int, leg: Leg, plant: Plant) -> None:
        """Measure the wall at the end of a pass, and find loose pieces."""
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
                if piece.within(within):  # the others came loose from earlier contours
                    self._loosen(piece, one, contour, plant)

    def _loosen(self, piece: shapely.Polygon, one: CutPass, contour: WireContour, plant: Plant) -> None:
        x, y = one.wire_path.at_mid_height()[-1].tolist()
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
        taken_mm3 = plant.remove_piece(piece)
        self.notices.append(
            f"the slug falls at X {x / 1e3:.3f} Y {y / 1e3:.3f} mm on the table and is taken out of "
            f"the workpiece, {piece.area * 1e-6:.2f} mm² of it"
            + (f", {taken_mm3:.2f} mm³ of them near the wire's path" if taken_mm3 else "")
        )
