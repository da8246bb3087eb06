"""The search for a technology: straight cuts, pass after pass on the same metal, until each removes its target stock.

The targets of the passes, roughness, feed and stock, are those of a job shop with 0.25 mm brass wire on 25.4 mm of
steel (`TARGETS`). The model's craters give the pulses for a roughness, the wire limits the power of the rough pass,
and the walls of simulated cuts give the offsets.
"""

import math
import shlex
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

import tomlkit

from edmsim import __version__, geometry, runs
from edmsim.closed_loop.passes import PassRecord, PassSetup
from edmsim.closed_loop.simulation import Simulation
from edmsim.controllers import from_text
from edmsim.errors import InputError
from edmsim.job.plan import feed_limit
from edmsim.machine.machine import Machine
from edmsim.machine.setting import least_period_us, most_current_A, period_range_us
from edmsim.machine.technology import AtHeight, FoundPass, PassSetting, Technology, machine_of
from edmsim.metrology.roughness import roughness_um
from edmsim.plant.gap.generator import crater_um3
from edmsim.plant.workpiece.kerf_field import KerfField
from edmsim.program.passes import CutPass
from edmsim.program.straight import straight_path


class PassTarget(NamedTuple):
    """Target of a pass: Ra, feed at 25.4 mm and stock to remove, and the generator for it."""

    # the numbers are those of a shop's table for 1 to 7 passes (brass 0.254 mm, steel, 25.4 mm, second hand).
    # Shops flush a rough pass with several bar and trims with less; on-times fall from pass to pass, and
    # tension rises; these numbers are ours

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
AT_MM = 25.4  # height of the workpiece for these feeds
FEED_EXPONENT = -0.3
"""The feed of a trim is proportional to the height to this power: a taller wall has more metal, and trims of tall
parts are slower in all tables (ours, within 0 to -1)."""

GENTLE = 1.25  # period of the rough pass over that which broke the wire (ours: it holds for other seeds, too)
SHORTENING = 0.87  # ratio of two periods in that search (ours)
NO_GAIN = 1.02  # the search also ends if a shorter period cuts faster by less than this factor (ours)
START_OF = 1.6  # the search begins at this many times the period that gives the generator's own mean power (ours)
MOST_BREAKS = 6  # most times that a period that broke the wire is lengthened (ours)
POWER = 1.8
"""Metal that a trim's pulses would remove if all of them ignited, over its stock (ours: half stay open)."""
STOCK_SHARE, STOCK_UM = 0.15, 1.5  # tolerance of the stock: a share of it, at least these um (ours)
SHALLOWER_UM = 3.0  # a trim that jammed is repeated farther off the wall by this distance (ours)
MOST_TRIES = 4  # cuts per trim: the last one counts even if it removes too much or too little (ours)
CORNER_BEFORE_UM = 200.0  # path before its outer corners on which trims have a longer period; not searched
"""Trims go some 150 um past the part's corner. Chosen on an outer corner of tool steel, 25.4 mm high (ours)."""
OFFSET_CUTS, NEXT_SEED = 4, 1009
"""Cuts over which an offset is averaged, and the step from seed to seed (ours: one cut scatters by 0.1 um rms, and by
0.3 at `fast`)."""
RA_SHARE = 0.12  # tolerance of Ra, as a share of the target (ours)
FEED_REACHED = 0.85  # a trim that reaches a smaller share of its feed gets more power (ours)
ROUGH_MM, TRIM_MM, OFFSET_MM = 1.6, 1.8, 1.4  # length of the straight cuts (ours: 12 to 16 places are measured)
FIRST_MM = 0.5  # offset with which a search begins (ours)


@dataclass(frozen=True)
class Job:
    """Conditions of a technology; its offsets are those at the resolution."""

    material: str
    machine: str = "production"
    wire: str = "brass-254"
    height_mm: float = 25.4
    passes: int = 4
    resolution: str = "default"
    seed: int = 0

    def check(self) -> None:
        """Raise `InputError` for conditions that cannot be searched for."""
        if not 1 <= self.passes <= len(TARGETS):
            raise InputError(f"a technology has 1 to {len(TARGETS)} passes, not {self.passes}")
        self.setup("production").check()

    def check_like(self, known: Technology, file: Path) -> None:
        """Raise `InputError` for a technology of another material, machine or wire."""
        for name in ("material", "machine", "wire"):
            if getattr(known, name) != getattr(self, name):
                raise InputError(
                    f"the file holds a technology for {name} {getattr(known, name)}, not {getattr(self, name)}: give "
                    "another --out",
                    file,
                )

    def setup(self, generator: str, **choices: Any) -> Machine:
        """Return the machine with a generator and further choices."""
        return Machine.load(
            self.machine, material=self.material, wire=self.wire, generator=generator, height_mm=self.height_mm,
            **choices,
        )

    def machine_of(self, one: PassSetting) -> Machine:
        """Return the machine with the setting of a pass."""
        return machine_of(one, self.machine, self.material, self.wire, self.height_mm)

    def technology(self, heights: Sequence[AtHeight], known: Technology | None = None) -> Technology:
        """Return the technology with passes for these heights; its source names the commands of `known`, too."""
        words = ["edmsim", "tune", "technology", self.material]
        for name in ("machine", "wire", "resolution", "seed"):
            if (chosen := getattr(self, name)) != getattr(Job, name):
                words += [f"--{name}", str(chosen)]
        command = shlex.join([*words, "--height", f"{self.height_mm:g}", "--passes", str(self.passes)])
        source = f"found by simulation: {command}" if known is None else known.source
        if command not in source:
            source += f"; {command}"
        return Technology.model_validate({
            "title": f"{self.material} with the wire {self.wire} on the machine {self.machine}",
            "source": source,
            "machine": self.machine, "material": self.material, "wire": self.wire, "height": tuple(heights),
        })  # fmt: skip


class Cut(NamedTuple):
    """A pass of a straight cut: its record, the metal after it, Ra of its craters, and how it ended."""

    record: PassRecord
    metal: KerfField
    ra_um: float
    outcome: str

    @property
    def last_offset_um(self) -> float:
        """Offset with which the wall would meet the drawing."""
        assert self.record.wall is not None
        return self.record.offset_um - self.record.wall.mean_um


class Tried(NamedTuple):
    """Figures of a cut by which the search decides; its wall's offset and bow are None if it did not finish."""

    outcome: str
    feed_mm_min: float
    ra_um: float
    last_offset_um: float | None
    bow_um: float | None


def _tried(cut: Cut) -> Tried:
    wall = cut.record.wall
    of_wall = (None, None) if wall is None else (cut.last_offset_um, wall.bow_um)
    return Tried(cut.outcome, cut.record.feed_mm_min, cut.ra_um, *of_wall)


class Search:
    """The search for the passes of one height; an interrupted search resumes from its table of runs.

    Passes that are `known` keep their settings: only their offsets are measured again.
    """

    def __init__(
        self, job: Job, tell: Callable[[str], None], journal: Path | None = None, known: AtHeight | None = None
    ) -> None:
        job.check()
        self._job, self._tell = job, tell
        self._known = () if known is None else known.passes
        self._cuts: list[tuple[PassSetting, float]] = []  # setting and offset of the passes found, as they were cut
        self._left: tuple[int, KerfField | None] = (0, None)  # the last pass whose metal is known, and that metal
        self._last: tuple[PassSetting, float, KerfField | None] | None = None  # the last cut; metal if it was made
        self._runs = runs.RunTable(journal, {
            **{name: value for name, value in asdict(job).items() if name != "passes"},
            "files": sorted(runs.digests_of(asdict(job).values()).values()), "edmsim": __version__,
        })  # fmt: skip

    def run(self) -> AtHeight:
        """Search, and return the passes. After Ctrl-C, the same search makes only the cuts that are missing."""
        found = self._passes()
        return self._with_offsets(AtHeight.model_validate({"height_mm": self._job.height_mm, "pass": tuple(found)}))

    def _passes(self) -> list[PassSetting]:
        """Return the known passes, and those of the job that are missing."""
        found, offset_mm = list(self._known), FIRST_MM
        if len(found) >= self._job.passes:
            return found
        for one in found:
            self._cuts.append((one, offset_mm))
            offset_mm -= one.step_um * 1e-3
        for number in range(len(found) + 1, self._job.passes + 1):
            target = TARGETS[number - 1]
            if number == 1:
                found = [self._rough(target)]
            else:  # its stock determines the step from the pass before, and thus its offset
                one, step_um = self._trim(target, number, offset_mm, found[-1])
                offset_mm -= round(step_um, 1) * 1e-3
                found = [*found[:-1], found[-1].model_copy(update={"step_um": round(step_um, 1)}), one]
            self._settle(number)
        return found

    def _settle(self, number: int) -> None:
        """Let the next pass follow the last cut."""
        assert self._last is not None
        one, offset_mm, metal = self._last
        self._cuts.append((one, offset_mm))
        if metal is not None:
            self._left = number, metal

    def _metal(self) -> KerfField | None:
        """Return the metal that the passes found leave; those that an earlier search found are cut again for it."""
        first, metal = self._left
        for number, (one, offset_mm) in enumerate(self._cuts[first:], first + 1):
            metal = self._make(one, number, offset_mm, metal).metal
            self._left = number, metal
        return metal

    def _with_offsets(self, at: AtHeight) -> AtHeight:
        """Return passes with the offsets at which straight cuts through all of them would meet the drawing."""
        # a cut through all passes is enough for every number of them, because the metal that a pass leaves depends
        # on the steps before it, and not on the place of the path. The path is always at the same place, so that
        # repeated measurements find the same offsets
        start = {"last_offset_um": self._radius_um}
        placed = at.model_copy(update={"passes": tuple(one.model_copy(update=start) for one in at.passes)})
        settings = [one.model_dump(exclude={"found"}) for one in placed.passes]
        cuts: list[list[dict[str, float]]] = []
        for number in range(OFFSET_CUTS):
            job = replace(self._job, seed=self._job.seed + NEXT_SEED * number)
            run = runs.identity({"seed": job.seed, "passes": settings})
            if run not in self._runs.rows:
                through = cut_through(job, placed)
                self._tell(f"offsets, cut {number + 1} of {OFFSET_CUTS} at {job.resolution}: {through[-1].outcome}")
                self._runs.add({"id": run, "walls": _walls(through)})
            cuts.append(self._runs.rows[run]["walls"])
        passes = []
        for number, one in enumerate(at.passes, 1):
            walls = [walls[number - 1] for walls in cuts if len(walls) >= number]
            if not walls:
                raise InputError(
                    f"pass {number} did not come to its end in any cut through all passes: ask for {number - 1}"
                )
            mean = {name: fmean(wall[name] for wall in walls) for name in walls[0]}
            self._tell(f"pass {number}: {len(walls)} cuts would meet the drawing at {mean['last_offset_um']:.1f} um")
            passes.append(one.model_copy(update={
                "last_offset_um": round(mean["last_offset_um"], 1),
                "found": _found(mean["feed_mm_min"], mean["stock_um"], mean["ra_um"], mean["bow_um"]),
            }))  # fmt: skip
        return at.model_copy(update={"passes": tuple(passes), "resolution": self._job.resolution})

    def _rough(self, target: PassTarget) -> PassSetting:
        """Shorten the pause until the wire breaks or the cut is not faster, and lengthen it again a little."""
        one = self._setting(target, 1)
        machine = self._job.machine_of(one)
        least_us = self._least_period_us(machine)
        period_us, best, held = one.t_period_us, 0.0, 0.0
        while period_us > least_us:
            cut = self._cut(one.model_copy(update={"t_period_us": round(period_us, 1)}), 1, FIRST_MM)
            rate = cut.feed_mm_min * self._job.height_mm
            if cut.outcome != "finished" or rate < NO_GAIN * best:
                held = period_us / SHORTENING if cut.outcome == "finished" else period_us * GENTLE
                break
            best, period_us = rate, period_us * SHORTENING
        held = max(held, least_us)
        for _ in range(MOST_BREAKS):
            one = one.model_copy(update={"t_period_us": round(held, 1)})
            cut = self._cut(one, 1, FIRST_MM)
            if cut.outcome == "finished":
                return self._with_found(one, cut, 0.0)
            held *= GENTLE
        raise InputError(f"no rough pass was found that holds: {cut.outcome} at a period of {held:.1f} us")

    def _trim(
        self, target: PassTarget, number: int, offset_mm: float, before: PassSetting
    ) -> tuple[PassSetting, float]:
        """Find the step and power with which a trim removes its stock at its feed."""
        one = self._setting(target, number)
        same = one.generator == before.generator
        last_um = before.last_offset_um if same else self._radius_um + 0.3 * (before.last_offset_um - self._radius_um)
        for _ in range(MOST_TRIES):
            step_um, tried = max(target.stock_um + before.last_offset_um - last_um, 0.0), one
            cut = self._cut(tried, number, offset_mm - step_um * 1e-3)
            if cut.last_offset_um is None:  # the wire went into the metal, or the pulses were too few
                last_um, one = last_um + SHALLOWER_UM, self._stronger(one)
                continue
            took_um = step_um - before.last_offset_um + cut.last_offset_um
            feed_share = cut.feed_mm_min / one.feed_mm_min
            off = abs(took_um - target.stock_um) > max(STOCK_SHARE * target.stock_um, STOCK_UM)
            rough = abs(cut.ra_um / target.ra_um - 1.0) > RA_SHARE
            if not (off or rough) and feed_share >= FEED_REACHED:
                break
            last_um = cut.last_offset_um
            if rough:  # arcs are shorter than other discharges, and their number is unknown before the cut
                one = self._with_ra(one, target.ra_um / cut.ra_um)
            if feed_share < FEED_REACHED:
                one = self._stronger(one)
        if cut.last_offset_um is None:
            raise InputError(f"pass {number} did not come to its end: {cut.outcome}")
        return self._with_found(tried, cut, took_um), step_um

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
        """Return the shortest period to try: its pause is as long as a channel takes to deionise."""
        pause_us = machine.base.gap.deionisation_us.value
        return max(machine.t_on_us + pause_us, least_period_us(machine, machine.t_on_us), period_range_us(machine)[0])

    @property
    def _radius_um(self) -> float:
        return self._job.setup("production").wire_diameter_um / 2

    def _setting(self, target: PassTarget, number: int) -> PassSetting:
        """Return the first setting of a search: pulses that make the target's Ra, at an estimated power."""
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
            feed="adaptive" if number == 1 else "constant",
            feed_mm_min=round(min(target.feed_mm_min * scale, 0.06 * feed_limit(plain, "exact")[0]), 3),
            corner_before_um=CORNER_BEFORE_UM if number > 1 else 0.0,
            last_offset_um=self._radius_um, found=_found(0.0, 0.0, 0.0, 0.0),
        )  # fmt: skip

    def _with_found(self, one: PassSetting, cut: Tried, took_um: float) -> PassSetting:
        assert cut.last_offset_um is not None
        assert cut.bow_um is not None
        feed = cut.feed_mm_min if one.feed == "adaptive" else one.feed_mm_min
        return one.model_copy(update={
            "last_offset_um": round(cut.last_offset_um, 1), "feed_mm_min": round(feed, 3),
            "found": _found(cut.feed_mm_min, took_um, cut.ra_um, cut.bow_um),
        })  # fmt: skip

    def _cut(self, one: PassSetting, number: int, offset_mm: float) -> Tried:
        """Return the figures of a cut on the metal that the passes found leave, from the table if it has them."""
        cuts = [[setting.model_dump(), mm] for setting, mm in (*self._cuts, (one, offset_mm))]
        run, metal = runs.identity({"cuts": cuts}), None
        if run not in self._runs.rows:
            cut = self._make(one, number, offset_mm, self._metal())
            metal = cut.metal
            self._runs.add({"id": run, "tried": _tried(cut)._asdict()})
        self._last = one, offset_mm, metal
        return Tried(**self._runs.rows[run]["tried"])

    def _make(self, one: PassSetting, number: int, offset_mm: float, metal: KerfField | None) -> Cut:
        cut = cut_pass(self._job, one, number, offset_mm, metal)
        wall = cut.record.wall
        said = (
            f"pass {number}: {one.t_on_us:g} us and {one.peak_current_A:g} A in {one.t_period_us:g} us: "
            f"{cut.outcome}, {cut.record.feed_mm_min:.2f} mm/min, Ra {cut.ra_um:.2f} um"
        )
        if wall is not None:
            said += f", would meet the drawing at {cut.last_offset_um:.1f} um, bow {wall.bow_um:+.1f} um"
        self._tell(said)
        return cut


def _found(feed_mm_min: float, stock_um: float, ra_um: float, bow_um: float) -> FoundPass:
    """Return the results of a pass, rounded as in its file."""
    return FoundPass(
        feed_mm_min=round(feed_mm_min, 3), stock_um=round(stock_um, 1), ra_um=round(ra_um, 3), bow_um=round(bow_um, 2)
    )


def cut_pass(job: Job, one: PassSetting, number: int, offset_mm: float, metal: KerfField | None) -> Cut:
    """Cut one pass along a straight edge, odd ones forward, on the metal that the pass before it left."""
    machine = job.machine_of(one)
    path = straight_path((offset_mm,) * (2 if number > 1 else 1), ROUGH_MM if number == 1 else TRIM_MM, machine)
    if number > 1:
        contour = path.contours[0]
        points, back = contour.passes[0].points_um[contour.passes[0].approach_moves :], number % 2 == 0
        trim = CutPass(number, "profile", points[::-1] if back else points, 0, contour.offset_um, back)
        path = replace(path, contours=(replace(contour, passes=(trim,)),))
    approach = PassSetup(machine, from_text(one.controller(0.25)))
    simulation = Simulation(
        machine, path, from_text(one.controller()), planner="exact", seed=job.seed + 101 * number,
        resolution=job.resolution, metal=metal, approach=approach if number == 1 else None,
    )
    simulation.run()
    return _cut_of(simulation, simulation.passes.records[-1])


def _cut_of(simulation: Simulation, record: PassRecord) -> Cut:
    ignited = record.sums.spark + record.sums.arc
    flatness = simulation.machine.base.discharge.crater_flatness.value
    ra_um = roughness_um(record.sums.crater_um3 / ignited, flatness) if ignited else math.nan
    assert simulation.outcome is not None
    return Cut(record, simulation.plant.field, ra_um, simulation.outcome)


def cut_in_passes(
    technology: Technology, height_mm: float, passes: int, length_mm: float, *, seed: int, resolution: str,
    edge_mm: geometry.Floats | None = None, watch: Callable[[Simulation], None] = lambda _: None,
) -> Simulation:  # fmt: skip
    """Cut a straight edge, or another open one, in passes with the offsets and settings of a technology.

    `watch` is called after every window.
    """
    table = technology.table(height_mm, passes)
    machines = [
        machine_of(one, technology.machine, technology.material, technology.wire, height_mm) for one in table.settings
    ]
    setups = [PassSetup(m, from_text(one.controller())) for m, one in zip(machines, table.settings, strict=True)]
    approach = PassSetup(machines[0], from_text(table.settings[0].controller(table.approach_share)))
    machine, controller = setups[0]
    simulation = Simulation(
        machine, straight_path(table.offsets_mm, length_mm, machine, edge_mm), controller, planner="exact", seed=seed,
        resolution=resolution, setups=setups, approach=approach,
    )  # fmt: skip
    simulation.run(lambda _: watch(simulation))
    return simulation


def cut_through(job: Job, at: AtHeight) -> list[Cut]:
    """Cut a straight edge through all passes of a height, at the resolution of the job; return a cut for each."""
    simulation = cut_in_passes(
        job.technology([at]), at.height_mm, len(at.passes), OFFSET_MM, seed=job.seed, resolution=job.resolution
    )
    return [_cut_of(simulation, record) for record in simulation.passes.records]


def _walls(cuts: Sequence[Cut]) -> list[dict[str, float]]:
    """Return offset and figures of the passes of a cut, up to the first that did not finish."""
    walls: list[dict[str, float]] = []
    before_um: float | None = None
    for cut in cuts:
        wall = cut.record.wall
        if wall is None:
            break
        walls.append({
            "last_offset_um": cut.last_offset_um, "feed_mm_min": cut.record.feed_mm_min, "ra_um": cut.ra_um,
            "stock_um": 0.0 if before_um is None else before_um - wall.mean_um, "bow_um": wall.bow_um,
        })  # fmt: skip
        before_um = wall.mean_um
    return walls


def _current_for(machine: Machine, ra_um: float) -> float:
    """Return the peak current whose craters make an Ra at the generator's on-time, at most its greatest current."""
    flatness = machine.base.discharge.crater_flatness.value
    low_A, high_A = 1e-3 * most_current_A(machine), most_current_A(machine)
    for _ in range(60):
        middle_A = math.sqrt(low_A * high_A)
        made_um = roughness_um(crater_um3(machine.with_(peak_current_A=middle_A, t_period_us=1000.0)), flatness)
        low_A, high_A = (middle_A, high_A) if made_um < ra_um else (low_A, middle_A)
    return math.sqrt(low_A * high_A)


def _in_tenths(current_A: float, most_A: float) -> float:
    """Return a current in tenths of an A, at most `most_A`."""
    return min(round(current_A, 1), math.floor(10 * most_A) / 10)


def technology_text(technology: Technology) -> str:
    """Return the text of a technology's file."""
    document = tomlkit.document()
    document.update(technology.model_dump(mode="json", by_alias=True, exclude_none=True))
    for one in (one for at in document["height"] for one in at["pass"]):
        found = tomlkit.inline_table()
        found.update(one["found"])
        one["found"] = found
    return tomlkit.dumps(document)


def at_height(known: Technology | None, job: Job) -> AtHeight | None:
    """Return the passes that a technology has for the height of a job."""
    return next((at for at in (known.heights if known else ()) if at.height_mm == job.height_mm), None)


def merged(known: Technology | None, at: AtHeight) -> list[AtHeight]:
    """Return the heights of a technology with this one added or replaced."""
    others = [] if known is None else [one for one in known.heights if one.height_mm != at.height_mm]
    return sorted([*others, at], key=lambda one: one.height_mm)
