"""The search for a technology: straight cuts, pass after pass on the same metal, until each removes its target stock.

The targets of the passes, roughness, feed and stock, are those of a job shop with 0.25 mm brass wire on 25.4 mm of
steel (`TARGETS`). The model's craters give the pulses for a roughness, the wire limits the power of the rough pass,
and the wall of a simulated cut gives the offsets.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np
import tomlkit
from numpy.typing import NDArray

from edmsim.controllers import from_text
from edmsim.cosim.passes import PassRecord, PassSetup
from edmsim.cosim.simulation import Simulation
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.machine.setting import least_period_us, most_current_A, period_range_us
from edmsim.machine.technology import AtHeight, FoundPass, PassSetting, Technology, machine_of
from edmsim.metrology.roughness import roughness_um
from edmsim.plant.gap.generator import crater_um3
from edmsim.plant.workpiece.kerf_field import KerfField
from edmsim.program.offset import OffsetOutline, offset_open
from edmsim.program.outline import Outline
from edmsim.program.passes import CutPass, PassPlan, on_grid, ways_of
from edmsim.program.path import CutPath, WireContour
from edmsim.runs import RunTable


class PassTarget(NamedTuple):
    """What is asked of a pass: Ra, feed at 25.4 mm, stock to take, and with which generator."""

    # the numbers are those of a shop's table for 1 to 7 passes (brass 0.254 mm, steel, 25.4 mm, second hand).
    # Shops flush a rough pass with several bar and trims with less; on-times fall from pass to pass, and
    # tension rises: by numbers of ours

    ra_um: float
    feed_mm_min: float
    stock_um: float
    generator: str
    t_on_us: float
    tension: float
    pressure: float


TARGETS = (
    PassTarget(1.52, 3.05, math.nan, "production", 1.1, 1.0, 1.0),
    PassTarget(1.17, 4.57, 33.0, "production", 0.8, 1.3, 0.25),
    PassTarget(1.07, 4.06, 45.7, "production", 0.7, 1.3, 0.25),
    PassTarget(0.97, 3.81, 17.8, "production", 0.6, 1.4, 0.25),
    PassTarget(0.30, 4.57, 7.6, "fine", 0.2, 1.5, 0.15),
    PassTarget(0.23, 4.06, 1.3, "fine", 0.15, 1.5, 0.15),
    PassTarget(0.18, 3.56, 1.3, "fine", 0.1, 1.5, 0.15),
)
"""The passes, from rough to last."""
AT_MM = 25.4  # height to which these feeds belong
FEED_EXPONENT = -0.3
"""Feed asked of a trim over the height to this power: a taller wall is more metal, and trims of tall parts are slower
in all tables (ours, within 0 to -1)."""

GENTLE = 1.25  # period of the rough pass over the one at which the wire broke (ours: it holds for other seeds, too)
SHORTENING = 0.87  # from period to period of that search (ours)
NO_GAIN = 1.02  # a shorter period that does not cut faster by more than this ends it as well (ours)
START_OF = 1.6  # the search begins at this many times the period that gives the generator's own mean power (ours)
MOST_BREAKS = 6  # so often a period that broke the wire is lengthened again (ours)
POWER = 1.8
"""What a trim's pulses would take if all of them ignited, over the stock it is to take (ours: half stay open)."""
STOCK_SHARE, STOCK_UM = 0.15, 1.5  # a pass takes what it should within this share, or these um (ours)
SHALLOWER_UM = 3.0  # a trim that jammed is tried again so much further off the wall (ours)
MOST_TRIES = 4  # cuts per trim: the last one counts even if it takes more or less than it should (ours)
OFFSET_CUTS, NEXT_SEED = 4, 1009
"""Cuts over which an offset is averaged, and the step from seed to seed (ours: one cut scatters by 0.6 um rms)."""
RA_SHARE = 0.12  # Ra is that asked for within this share (ours)
FEED_REACHED = 0.85  # a trim that keeps less of its feed than this gets more power (ours)
ROUGH_MM, TRIM_MM = 1.6, 1.8  # length of the straight cuts (ours: 16 places are measured)
MARGIN_MM, HOLE_MM, LEAD_MM = 3.0, 0.3, 0.5


@dataclass(frozen=True)
class Job:
    """What a technology is wanted for."""

    material: str
    machine: str = "production"
    wire: str = "brass-254"
    height_mm: float = 25.4
    passes: int = 4
    resolution: str = "fast"
    seed: int = 0

    def check(self) -> None:
        """Refuse what cannot be searched for."""
        if not 1 <= self.passes <= len(TARGETS):
            raise InputError(f"a technology has 1 to {len(TARGETS)} passes, not {self.passes}")
        self.setup("production").check()

    def check_like(self, known: Technology, file: Path) -> None:
        """Refuse to add a height to a technology of something else, or with fewer passes."""
        for name in ("material", "machine", "wire"):
            if getattr(known, name) != getattr(self, name):
                raise InputError(
                    f"the file holds a technology for {name} {getattr(known, name)}, not {getattr(self, name)}: give "
                    "another --out",
                    file,
                )

    def setup(self, generator: str, **choices: Any) -> Machine:
        """Return a machine with one of the generators at some setting."""
        return Machine.load(
            self.machine, material=self.material, wire=self.wire, generator=generator, height_mm=self.height_mm,
            **choices,
        )

    def machine_of(self, one: PassSetting) -> Machine:
        """Return the machine with the setting of a pass."""
        return machine_of(one, self.machine, self.material, self.wire, self.height_mm)


def straight_path(
    offsets_mm: Sequence[float], length_mm: float, machine: Machine, edge_mm: NDArray[np.float64] | None = None
) -> CutPath:
    """Return a straight edge, or another open one along +x, in passes, cut from a start hole, the part below it."""
    middle = np.array(machine.base.table.centre_um) * 1e-3 - (length_mm / 2, 0.0)
    edge = np.array([[0.0, 0.0], [length_mm, 0.0]]) if edge_mm is None else edge_mm
    edge, count = edge + middle, len(edge) - 1
    elements = tuple(range(1, count + 1))
    outline = Outline(edge, (0,) * count, False, "left", "right", np.empty((0, 2)), elements=elements)
    past_mm = [None, *[offsets_mm[0]] * (len(offsets_mm) - 1)]  # trims go straight past outer corners
    ways_mm = [offset_open(edge, "left", mm, past) for mm, past in zip(offsets_mm, past_mm, strict=True)]
    legs = [OffsetOutline(outline, way, edge, mm) for way, mm in zip(ways_mm, offsets_mm, strict=True)]
    ways = ways_of(legs, PassPlan(tuple(offsets_mm)))
    lead = ways[0].points[:1] - (LEAD_MM, 0.0)
    passes = on_grid(ways, lead, 1)
    points = np.round(np.concatenate([lead, legs[-1].path]) * 1e3).astype(np.int64)
    contour = WireContour(
        points, 1, edge, False, "right", elements=tuple((k, 0) for k in elements), offset_um=offsets_mm[-1] * 1e3,
        passes=passes,
    )
    every = np.concatenate([points * 1e-3, edge])
    (x0, y0), (x1, y1) = every.min(axis=0), every.max(axis=0)
    stock = float(x0 - MARGIN_MM), float(y0 - MARGIN_MM), float(x1 + MARGIN_MM), float(y1 + MARGIN_MM)
    return CutPath((contour,), stock, HOLE_MM, (0.0, 0.0), (), "straight cut")


class Cut(NamedTuple):
    """A pass of a straight cut: its record, the metal behind it, Ra of its craters, and whether the wire held."""

    record: PassRecord
    metal: KerfField
    ra_um: float
    outcome: str

    @property
    def feed_mm_min(self) -> float:
        """Mean feed, its approach included."""
        seconds = self.record.end_s - self.record.begin_s
        return (self.record.end_um - self.record.begin_um) / seconds * 0.06 if seconds > 0 else 0.0

    @property
    def last_offset_um(self) -> float:
        """Offset with which the wall would meet the drawing."""
        assert self.record.wall is not None
        return self.record.offset_um - self.record.wall.mean_um


class Search:
    """The search for the passes of one height; an interrupted search resumes from its table of found passes."""

    def __init__(self, job: Job, tell: Callable[[str], None], journal: Path | None = None) -> None:
        job.check()
        self._job, self._tell = job, tell
        self._first_mm = 0.5
        self._made_with: dict[str, Any] = {}  # setting and offset of the last cut
        self._passes = RunTable(journal, {name: value for name, value in asdict(job).items() if name != "passes"})

    def run(self) -> AtHeight:
        """Search, and return the passes. After Ctrl-C, the same search resumes behind the passes in the journal."""
        known = [row for row in self._passes.rows.values() if len(row["passes"]) <= self._job.passes]
        found = [PassSetting.model_validate(one) for one in known[-1]["passes"]] if known else []
        metal: KerfField | None = None
        offset_mm = self._first_mm
        for number, target in enumerate(TARGETS[: self._job.passes], 1):
            if number <= len(found):  # cut again, for the metal behind it
                one, made = found[number - 1], self._passes.rows[str(number)]["cut"]
                cut = self._cut(PassSetting.model_validate(made["setting"]), number, made["offset_mm"], metal)
            else:
                one, cut, offset_mm, found = self._next(target, number, offset_mm, metal, found)
                passes = [setting.model_dump() for setting in found]
                self._passes.add({"id": str(number), "passes": passes, "cut": self._made_with})
            metal, offset_mm = cut.metal, offset_mm - one.step_um * 1e-3
        return AtHeight.model_validate({"height_mm": self._job.height_mm, "pass": tuple(found)})

    def _next(
        self, target: PassTarget, number: int, offset_mm: float, metal: KerfField | None, found: list[PassSetting]
    ) -> tuple[PassSetting, Cut, float, list[PassSetting]]:
        """Find the next pass; its stock determines the step from the pass before, and thus its offset."""
        if number == 1:
            one, cut = self._rough(target)
            one = self._averaged(one, cut, number, offset_mm, None)
            return one, cut, offset_mm, [one]
        assert metal is not None
        before = found[-1]
        one, cut, step_um = self._trim(target, number, offset_mm, metal, before)
        offset_mm -= round(step_um, 1) * 1e-3
        one = self._averaged(one, cut, number, offset_mm, metal)
        found = [*found[:-1], before.model_copy(update={"step_um": round(step_um, 1)}), one]
        return one, cut, offset_mm, found

    def _averaged(
        self, one: PassSetting, cut: Cut, number: int, offset_mm: float, metal: KerfField | None
    ) -> PassSetting:
        """Return a setting with the mean offset of its cut and of others with other seeds."""
        jobs = [replace(self._job, seed=self._job.seed + NEXT_SEED * k) for k in range(1, OFFSET_CUTS)]
        cuts = [cut, *(cut_pass(job, one, number, offset_mm, metal) for job in jobs)]
        offsets_um = [each.last_offset_um for each in cuts if each.record.wall is not None]
        self._tell(f"pass {number}: {len(offsets_um)} cuts would meet the drawing at {fmean(offsets_um):.1f} um")
        return one.model_copy(update={"last_offset_um": round(fmean(offsets_um), 1)})

    def _rough(self, target: PassTarget) -> tuple[PassSetting, Cut]:
        """Shorten the pause until the wire breaks or nothing is gained, and take some of it back."""
        one = self._setting(target, 1, None)
        machine = self._job.machine_of(one)
        least_us = self._least_period_us(machine)
        period_us, best, held = one.t_period_us, 0.0, 0.0
        while period_us > least_us:
            cut = self._cut(one.model_copy(update={"t_period_us": round(period_us, 1)}), 1, self._first_mm, None)
            rate = cut.feed_mm_min * self._job.height_mm
            if cut.outcome != "finished" or rate < NO_GAIN * best:
                held = period_us / SHORTENING if cut.outcome == "finished" else period_us * GENTLE
                break
            best, period_us = rate, period_us * SHORTENING
        held = max(held, least_us)
        for _ in range(MOST_BREAKS):
            one = one.model_copy(update={"t_period_us": round(held, 1)})
            cut = self._cut(one, 1, self._first_mm, None)
            if cut.outcome == "finished":
                return self._with_found(one, cut, None), cut
            held *= GENTLE
        raise InputError(f"no rough pass was found that holds: {cut.outcome} at a period of {held:.1f} us")

    def _trim(
        self, target: PassTarget, number: int, offset_mm: float, metal: KerfField, before: PassSetting
    ) -> tuple[PassSetting, Cut, float]:
        """Find step and power of a trim: it takes its stock and keeps its feed."""
        one = self._setting(target, number, before)
        same = one.generator == before.generator
        last_um = before.last_offset_um if same else self._radius_um + 0.3 * (before.last_offset_um - self._radius_um)
        for _ in range(MOST_TRIES):
            step_um = max(target.stock_um + before.last_offset_um - last_um, 0.0)
            cut = self._cut(one, number, offset_mm - step_um * 1e-3, metal)
            if cut.record.wall is None:  # the wire went into the metal, or the pulses were too few
                last_um, one = last_um + SHALLOWER_UM, self._stronger(one)
                continue
            took_um = step_um - before.last_offset_um + cut.last_offset_um
            feed_share = cut.feed_mm_min / one.feed_mm_min
            off = abs(took_um - target.stock_um) > max(STOCK_SHARE * target.stock_um, STOCK_UM)
            rough = abs(cut.ra_um / target.ra_um - 1.0) > RA_SHARE
            if not (off or rough) and feed_share >= FEED_REACHED:
                break
            last_um = cut.last_offset_um
            if rough:  # arcs are shorter than other discharges, and nobody knows beforehand how many there are
                one = self._with_ra(one, target.ra_um / cut.ra_um)
            if feed_share < FEED_REACHED:
                one = self._stronger(one)
        if cut.record.wall is None:
            raise InputError(f"pass {number} did not come to its end: {cut.outcome}")
        return self._with_found(one, cut, took_um), cut, step_um

    def _with_ra(self, one: PassSetting, share: float) -> PassSetting:
        """Return a setting with coarser or finer craters, whose volume is proportional to the current."""
        assert one.peak_current_A is not None
        most_A = most_current_A(self._job.setup(one.generator))
        current_A = min(one.peak_current_A * min(max(share, 0.7), 1.4) ** 3, most_A)
        return one.model_copy(update={"peak_current_A": _in_tenths(current_A, most_A)})

    def _stronger(self, one: PassSetting) -> PassSetting:
        least_us = self._least_period_us(self._job.machine_of(one))
        return one.model_copy(update={"t_period_us": round(max(0.75 * one.t_period_us, least_us), 2)})

    def _least_period_us(self, machine: Machine) -> float:
        """Return the shortest period worth trying: it leaves a pause as long as a channel takes to deionise."""
        pause_us = machine.base.gap.deionisation_us.value
        return max(machine.t_on_us + pause_us, least_period_us(machine, machine.t_on_us), period_range_us(machine)[0])

    @property
    def _radius_um(self) -> float:
        return self._job.setup("production").wire_diameter_um / 2

    def _setting(self, target: PassTarget, number: int, before: PassSetting | None) -> PassSetting:
        """Return the setting to begin with: pulses that make the Ra asked for, at some power."""
        plain = self._job.setup(target.generator, t_on_us=target.t_on_us)
        current_A = _current_for(plain, target.ra_um)
        pressure_Pa = plain.base.dielectric.flushing_pressure_Pa.value * target.pressure
        scale = (self._job.height_mm / AT_MM) ** FEED_EXPONENT if number > 1 else AT_MM / self._job.height_mm
        own_us = START_OF * plain.t_period_us * current_A / most_current_A(plain)
        if number > 1:
            target_um3_us = target.stock_um * target.feed_mm_min * scale / 60 * self._job.height_mm
            volume_um3 = crater_um3(plain.with_(peak_current_A=current_A))
            own_us = volume_um3 / (POWER * target_um3_us)
        return PassSetting(
            generator=target.generator, t_on_us=plain.t_on_us,
            peak_current_A=_in_tenths(current_A, most_current_A(plain)),
            t_period_us=round(max(own_us, self._least_period_us(plain)), 2),
            tension_N=round(plain.tension * target.tension, 2),
            flushing_lower_Pa=pressure_Pa, flushing_upper_Pa=pressure_Pa,
            feed="adaptive" if number == 1 else "constant", feed_mm_min=round(target.feed_mm_min * scale, 3),
            last_offset_um=self._radius_um, found=FoundPass(feed_mm_min=0.0, stock_um=0.0, ra_um=0.0, bow_um=0.0),
        )  # fmt: skip

    def _with_found(self, one: PassSetting, cut: Cut, took_um: float | None) -> PassSetting:
        assert cut.record.wall is not None
        feed = cut.feed_mm_min if one.feed == "adaptive" else one.feed_mm_min
        return one.model_copy(update={
            "last_offset_um": round(cut.last_offset_um, 1), "feed_mm_min": round(feed, 3),
            "found": FoundPass(
                feed_mm_min=round(cut.feed_mm_min, 3), stock_um=round(took_um or 0.0, 1), ra_um=round(cut.ra_um, 3),
                bow_um=round(cut.record.wall.bow_um, 2),
            ),
        })  # fmt: skip

    def _cut(self, one: PassSetting, number: int, offset_mm: float, metal: KerfField | None) -> Cut:
        cut = cut_pass(self._job, one, number, offset_mm, metal)
        self._made_with = {"setting": one.model_dump(), "offset_mm": offset_mm}
        wall = cut.record.wall
        left = (
            ""
            if wall is None
            else f", would meet the drawing at {cut.last_offset_um:.1f} um, bow {wall.bow_um:+.1f} um"
        )
        self._tell(
            f"pass {number}: {one.t_on_us:g} us and {one.peak_current_A:g} A in {one.t_period_us:g} us: "
            f"{cut.outcome}, {cut.feed_mm_min:.2f} mm/min, Ra {cut.ra_um:.2f} um{left}"
        )
        return cut


def cut_pass(job: Job, one: PassSetting, number: int, offset_mm: float, metal: KerfField | None) -> Cut:
    """Cut one pass along a straight edge, odd ones forward, on the metal that the pass before it left."""
    machine = job.machine_of(one)
    path = straight_path((offset_mm,) * (2 if number > 1 else 1), ROUGH_MM if number == 1 else TRIM_MM, machine)
    return _run(job, machine, one, path, number, metal)


def _run(job: Job, machine: Machine, one: PassSetting, path: CutPath, number: int, metal: KerfField | None) -> Cut:
    path = _only(path, number)
    approach = PassSetup(machine, from_text(one.controller(0.25)))
    simulation = Simulation(
        machine, path, from_text(one.controller()), planner="exact", seed=job.seed + 101 * number,
        resolution=job.resolution, metal=metal, approach=approach if number == 1 else None,
    )
    outcome = simulation.run()
    record = simulation.passes.records[-1]
    ignited = record.sums.spark + record.sums.arc
    ra_um = (
        roughness_um(record.sums.crater_um3 / ignited, machine.base.discharge.crater_flatness.value)
        if ignited
        else math.nan
    )
    return Cut(record, simulation.plant.field, ra_um, outcome)


def _only(path: CutPath, number: int) -> CutPath:
    """Return a straight path with the pass of a number alone: forward where that is odd, backward where it is not."""
    contour = path.contours[0]
    if number == 1:
        return path
    points = contour.passes[0].points_um[contour.passes[0].approach_moves :]
    back = number % 2 == 0
    shortened = points.copy()
    way = shortened[::-1] if back else shortened
    one = CutPass(number, "profile", way, 0, contour.offset_um, back)
    return replace(path, contours=(replace(contour, passes=(one,)),))


def _current_for(machine: Machine, ra_um: float) -> float:
    """Return the peak current whose craters make an Ra, at the generator's on-time; the greatest there is at most."""
    flatness = machine.base.discharge.crater_flatness.value
    low_A, high_A = 1e-3 * most_current_A(machine), most_current_A(machine)
    for _ in range(60):
        middle_A = math.sqrt(low_A * high_A)
        made_um = roughness_um(crater_um3(machine.with_(peak_current_A=middle_A, t_period_us=1000.0)), flatness)
        low_A, high_A = (middle_A, high_A) if made_um < ra_um else (low_A, middle_A)
    return math.sqrt(low_A * high_A)


def _in_tenths(current_A: float, most_A: float) -> float:
    """Return a current in tenths of an A, not above the greatest there is."""
    return min(round(current_A, 1), math.floor(10 * most_A) / 10)


def technology_text(job: Job, found: Sequence[AtHeight], source: str) -> str:
    """Return a technology as its file holds it."""
    title = f"{job.material} with the wire {job.wire} on the machine {job.machine}"
    document = tomlkit.document()
    document.update({
        "title": title, "source": source, "machine": job.machine, "material": job.material, "wire": job.wire,
        "planner": "exact",
        "height": [{
            "height_mm": at.height_mm, "approach_share": at.approach_share,
            "pass": [one.model_dump(exclude_none=True) for one in at.passes],
        } for at in found],
    })  # fmt: skip
    return tomlkit.dumps(document)


def merged(known: Technology | None, job: Job, at: AtHeight) -> list[AtHeight]:
    """Return the heights of a technology with one more, or one replaced."""
    others = [] if known is None else [one for one in known.heights if one.height_mm != job.height_mm]
    return sorted([*others, at], key=lambda one: one.height_mm)
