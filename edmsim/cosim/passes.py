"""Passes of a cut under way: their settings, what each took and left, and pieces that come loose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import NamedTuple

import numpy as np
import shapely

from edmsim.controllers import FeedController
from edmsim.cosim.legs import Leg
from edmsim.machine.machine import Machine
from edmsim.metrology.passes import WallError, lever_mm, loose_pieces, wall_error
from edmsim.metrology.profile import profile_error
from edmsim.plant.gap.equalising import OppositePulses
from edmsim.plant.plant import Plant
from edmsim.plant.window import PulseWindow
from edmsim.program.passes import CutPass, Piece
from edmsim.program.path import CutPath, WireContour
from edmsim.snapshots import Snapshots

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

    def add(self, window: PulseWindow, opposite: OppositePulses | None) -> None:
        """Add one window and its equalising pulses, if there are any."""
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
    wall: WallError | None = None  # the wall that it left; None while it is not finished
    # profile error behind it, slice by slice from the lowest one, at every `FACE_EVERY`-th place of
    # `profile_error` of the whole contour; none while it is not finished
    face_um: tuple[tuple[float, ...], ...] = ()


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
            last.sums = _less(sums, self._before)

    def end_leg(self, number: int, leg: Leg, plant: Plant) -> None:
        """Measure the wall at the end of a pass, and see what has come loose."""
        one = leg.cut_pass
        if one is None or not self._is_last[number]:
            return
        self._open = False
        contour = self._contours[self.records[-1].contour - 1]
        self.records[-1].wall = wall_error(plant.field, one, contour.part_side, plant.machine.wire_diameter_um)
        error_um = profile_error(plant.field, contour).error_um[:, ::FACE_EVERY]
        self.records[-1].face_um = tuple(tuple(row) for row in np.round(error_um, 1).tolist())
        if one.frees:
            for piece in loose_pieces(plant.field, LEAST_PIECE_MM2):
                self._loosen(piece, one, contour, plant)

    def _loosen(self, piece: shapely.Polygon, one: CutPass, contour: WireContour, plant: Plant) -> None:
        x, y = one.way.at_mid_height()[-1].tolist()
        what = "slug" if not _is_part(piece, contour) else "part"
        far_mm = lever_mm(piece, (x, y))
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
                "centre; hold it with after_tab stop, or place the tab nearer to its centre"
            )
        if what == "part":
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


def _less(now: Sums, before: Sums) -> Sums:
    return Sums(**{one.name: getattr(now, one.name) - getattr(before, one.name) for one in fields(Sums)})


def _is_part(piece: shapely.Polygon, contour: WireContour) -> bool:
    """Say whether a loose piece is the part, and not the slug, of a contour."""
    inside = shapely.LinearRing(contour.nominal_mm).is_ccw == (contour.part_side == "left")
    return inside and bool(piece.contains(shapely.Point(contour.nominal_mm.mean(axis=0) * 1e3)))
