"""Preparation of a cut: program and settings to path, passes and drives; notices and least time of a program."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple, cast

import numpy as np

from edmsim.closed_loop.passes import PassSetup
from edmsim.controllers import FeedController, SeesTruth, axis, from_text, user_controllers
from edmsim.controllers.axis.elcam import file, module
from edmsim.controllers.feed.laws import FixedController, TrimController
from edmsim.controllers.mcu.firmware import poscal, timers
from edmsim.controllers.planner.registry import kind_of, position_unit
from edmsim.errors import InputError, located, refuses_wrong_types
from edmsim.job.options import CutSettings
from edmsim.machine.machine import Machine, read_wire
from edmsim.machine.setting import guide_bends, mean_current_A
from edmsim.machine.technology import OF_PASS, PassSetting, PassTable, Technology, read_technology, technology_for
from edmsim.plant.constants import screws, strong_discharge
from edmsim.plant.gap.generator import timing
from edmsim.program import arcs, taper
from edmsim.program.outline import Corners, Outline, Program
from edmsim.program.passes import CutPass, PassPlan
from edmsim.program.path import Conditions, CutPath, WireContour, load_program, plan_path
from edmsim.recording.report import duration_text, mm_text


def make_controller(choice: str | FeedController) -> FeedController:
    """Return a feed controller for a cut: from its text, see `edmsim.controllers.from_text`, or the object itself."""
    own = user_controllers.check_is_controller
    controller = from_text(choice, cutting=True) if isinstance(choice, str) else own(choice)
    if isinstance(controller, SeesTruth):
        raise InputError(
            f"the {controller.name} controller looks at the true gap, which no machine shows: use it only in "
            "comparisons (edmsim evaluate), and cut with another"
        )
    return controller


def read_program(program: str | Path, settings: CutSettings) -> Program:
    """Read the program of a cut with these settings; raises as `load_program`."""
    return load_program(
        program, ignore=settings.ignore, layers=settings.layers, unit=settings.unit, offsets=settings.offsets,
        dialect=settings.dialect, conditions=settings.conditions, upper_layer=settings.upper_layer,
    )


def planned(
    program: str | Path | Program, settings: CutSettings, machines: Sequence[Machine], passes: PassPlan | None = None
) -> CutPath:
    """Plan the wire's path of a cut; `machines` has the machine as set up for every pass. Raises as `plan_path`."""
    machine, errors_mm = machines[0], settings.guide_errors_mm or (0.0, 0.0)
    table = machine.base.table
    step_um, travel_um = table.step_um.value, round(table.travel_mm.value * 1e3)
    unit = position_unit(settings.planner, travel_um, step_um)
    offset = settings.offset if passes is None or passes.of_program else "auto"
    return plan_path(
        program if isinstance(program, Program) else read_program(program, settings), offset,
        auto_offset_mm=machine.auto_offset_mm, table_um=travel_um, grid_um=poscal.unit_um(unit, round(step_um)),
        taper_deg=settings.taper_deg, corners=cast(Corners, settings.taper_corners),
        guides=[guides_of(one, errors_mm) for one in machines], passes=passes,
    )


def guides_of(machine: Machine, errors_mm: tuple[float, float]) -> taper.GuideHeights | None:
    """Return the guides' positions as known to the control; None if the upper guide does not move."""
    travel = machine.base.guides.upper_travel_mm
    if travel is None:
        return None
    bends, (lower_mm, upper_mm) = guide_bends(machine), np.add(machine.guides_z_mm, errors_mm).tolist()
    return taper.GuideHeights(lower_mm, upper_mm, machine.height_mm, travel.value, bends.stiff_mm, bends.radius_mm)


# A cut in passes: the values of a technology replace the options that it decides.

_Plan = Callable[[str | Path | Program, CutSettings, Sequence[Machine], PassPlan | None], CutPath]


class Passes(NamedTuple):
    """A planned cut, with the values of its technology if it is in passes."""

    settings: CutSettings  # with the technology's machine, wire, planner and the setting of the rough pass
    path: CutPath
    setups: tuple[PassSetup, ...] = ()  # one per pass; none for a cut in one pass
    approach: PassSetup | None = None
    table: PassTable | None = None  # offsets and settings of the technology


_OF_PASSES = {"tab_mm": "a tab", "overlap_mm": "an overlap", "after_tab": "what is done before a tab"}
"""Options that affect only passes requested by the settings, not those of the program."""


def with_passes(program: str | Path | Program, settings: CutSettings, plan: _Plan = planned) -> Passes:
    """Plan a cut, in passes if the settings request them or the program has them."""
    if settings.passes is None:
        path = plan(program, settings, [settings.load_machine()], None)
        remedy = "say how many, as --passes 4" if path.passes == 1 else "the program has its own, leave it out"
        _refuse_of_passes(settings, remedy)
        if path.conditions.settings:
            return _by_conditions(program, settings, path, plan)
        if path.passes == 1:
            if settings.technology is not None:
                raise InputError(f"a technology is for passes: {remedy}")
            return Passes(settings, path)
        return _in_passes(program, settings, path.passes, plan, of_program=True)
    if settings.conditions is not None:
        raise InputError("conditions set the program's own passes: leave out their table, or the number of passes")
    if settings.offset == "none":
        raise InputError("passes run beside an edge at their offsets: offset none leaves nothing to trim")
    if settings.passes == 1:
        _refuse_of_passes(settings, "give more than one, as --passes 4")
    return _in_passes(program, settings, settings.passes, plan, of_program=False)


def _chosen(settings: CutSettings, name: str) -> Any:
    """Return the value of an option; None if it is the default."""
    value = getattr(settings, name)
    return None if value == CutSettings.model_fields[name].default else value


def _refuse_of_passes(settings: CutSettings, remedy: str) -> None:
    for name, what in _OF_PASSES.items():
        if _chosen(settings, name) is not None:
            raise InputError(f"{what} is for passes: {remedy}")


def _in_passes(
    program: str | Path | Program, settings: CutSettings, count: int, plan: _Plan, of_program: bool
) -> Passes:
    """Plan a cut in passes of a technology, each with its set-up; their number is the program's or an option."""
    technology = technology_of(settings)
    table = _table(settings, technology, count)
    if of_program:
        note = f"the program cuts an edge {count} times: these are passes, with the settings of the technology "
        table = table._replace(notices=(f"{note}'{technology.title}'", *table.notices))
        passes = PassPlan(table.offsets_mm, of_program=True)
    else:
        shift_mm = 0.0 if settings.offset == "auto" else float(settings.offset) - table.offsets_mm[-1]
        offsets_mm = tuple(round(mm + shift_mm, 6) for mm in table.offsets_mm)
        passes = PassPlan(offsets_mm, settings.tab_mm, settings.overlap_mm, cast(Any, settings.after_tab))
    settings = in_force(settings, technology, table)
    own = technology.material == settings.material
    none = f"there is no technology for {settings.material}, and the settings of '{technology.title}' cannot be used"
    with located(settings.technology, name="" if own else none):
        setups = tuple(setup_of(settings, one) for one in table.settings)
    path = plan(program, settings, [one.machine for one in setups], passes)
    path = replace(path, notices=(*path.notices, *table.notices))
    return Passes(settings, path, setups, approach_of(setups[0].machine, table, table.settings[0]), table)


def _by_conditions(program: str | Path | Program, settings: CutSettings, path: CutPath, plan: _Plan) -> Passes:
    """Plan a cut whose passes have the settings of the program's conditions in the user's table."""
    if settings.technology is not None:
        raise InputError("a technology and a table of conditions both decide the passes: give one of them")
    of_passes = [_with_condition(settings, path.conditions, name) for name in path.conditions.names]
    setups = tuple(_setup(one) for one in of_passes)
    if path.leans:  # because the bends of the wire depend on the tension of each pass
        path = plan(program, of_passes[0], [one.machine for one in setups], None)
    if path.passes == 1:
        return Passes(of_passes[0], path)
    approach = path.conditions.approach
    lead_in = None if approach is None else _setup(_with_condition(settings, path.conditions, approach))
    return Passes(of_passes[0], path, setups, lead_in)


def _with_condition(settings: CutSettings, conditions: Conditions, name: str | None) -> CutSettings:
    """Return the settings of a cut with those of a condition, from the user's table."""
    if name is None:
        return settings
    found = dict(conditions.settings[name])
    decided: dict[str, Any] = {}
    if "feed_um_s" in found:
        decided["controller"] = f"trim:feed_um_s={found.pop('feed_um_s'):g}"
    if "open_target_share" in found:
        decided["controller"] = f"counts:open_target_share={found.pop('open_target_share'):g}"
    if "tension_N" in found:
        decided["tension"] = found.pop("tension_N")
    for option, value in {**decided, **found}.items():
        if _chosen(settings, option) not in (None, value):
            raise InputError(f"the table of conditions decides {option} of {name}: leave the option out")
    return settings.model_copy(update={**decided, **found})


def _setup(settings: CutSettings) -> PassSetup:
    controller = settings.controller
    return PassSetup(settings.load_machine(), from_text(controller) if isinstance(controller, str) else controller)


def in_force(settings: CutSettings, technology: Technology, table: PassTable) -> CutSettings:
    """Return settings with those of the technology and its rough pass; refuse options that contradict them."""
    rough = table.settings[0]
    decided: dict[str, Any] = {
        "machine": technology.machine, "wire": _wire_of(settings, technology), "planner": technology.planner,
        "controller": rough.controller(),
        **{name: getattr(rough, own) for name, own in OF_PASS.items()},
    }  # fmt: skip
    for name, value in decided.items():
        if (chosen := _chosen(settings, name)) not in (None, value):
            raise InputError(
                f"the technology '{technology.title}' sets {name} to {value!r}, not {chosen!r}: omit the option, "
                "or choose a technology with this value"
            )
    return settings.model_copy(update=decided)


def technology_of(settings: CutSettings) -> Technology:
    """Return the technology of a cut in passes: the one named, or that of the material, machine and wire."""
    if settings.technology is not None:
        found = read_technology(settings.technology)
        if found.material != settings.material:
            raise InputError(f"the technology '{found.title}' is for {found.material}, not for {settings.material}")
        with located(settings.technology):
            read_wire(found.wire)
            kind_of(found.planner)
        return found
    return technology_for(settings.material, _chosen(settings, "machine"), _chosen(settings, "wire"))


def _wire_of(settings: CutSettings, technology: Technology) -> str:
    """Return the wire of a cut in passes: that of the technology, or the one chosen if it is nearly the same."""
    chosen = settings.wire
    usual = chosen == CutSettings.model_fields["wire"].default
    return technology.wire if usual or technology.thinner_um(chosen) is None else chosen


def _table(settings: CutSettings, technology: Technology, passes: int) -> PassTable:
    """Return the offsets and settings of a technology, with notices if it is for another material or wire."""
    height_mm, material = settings.workpiece.greatest_mm, settings.material
    table = technology.table(height_mm, passes)
    wire = _wire_of(settings, technology)
    if wire != technology.wire:
        less_um = round((technology.thinner_um(wire) or 0.0) / 2)
        than = "smaller" if less_um > 0 else "larger"
        how = f"{abs(less_um)} um {than}, as its radius is" if less_um else "the same"
        table = table._replace(
            offsets_mm=tuple(round(mm - less_um * 1e-3, 3) for mm in table.offsets_mm),
            notices=(*table.notices, f"the settings of the passes are those for the wire {technology.wire}; with "
                                     f"{wire} their offsets are {how}"),
        )  # fmt: skip
    if table.resolution not in (None, settings.resolution):
        moved = (
            f"the offsets of the passes were measured at the resolution {table.resolution}; at {settings.resolution} "
            "walls lie elsewhere by some um (edmsim tune technology has the option --resolution)"
        )
        table = table._replace(notices=(*table.notices, moved))
    if technology.material == material:
        return table
    own = f"{Path(material).stem}-passes.toml"  # must differ from the material's file
    notice = (
        f"there is no technology for {material}: the passes take the settings of '{technology.title}', the material "
        f"most like it; search its own with edmsim tune technology {material} --height {height_mm:g} --passes "
        f"{passes} --out {own}, and cut with --technology {own}"
    )
    return table._replace(notices=(notice, *table.notices))


def setup_of(settings: CutSettings, one: PassSetting) -> PassSetup:
    """Return the set-up of a pass: the settings of the cut, overridden by those of the pass."""
    own = {name: getattr(one, of_pass) for name, of_pass in OF_PASS.items()}
    return _setup(settings.model_copy(update={**own, "controller": one.controller()}))


def approach_of(machine: Machine, table: PassTable, rough: PassSetting) -> PassSetup:
    """Return the set-up of a lead-in: the rough pass' machine, at a share of its feed."""
    return PassSetup(machine, from_text(rough.controller(table.approach_share)))


class Prepared(NamedTuple):
    """All inputs of a cut before the simulation; for a cut in passes, with the settings of the technology."""

    settings: CutSettings
    machine: Machine
    controller: FeedController
    path: CutPath
    drives: dict[str, axis.Drive]
    compensation: module.Elcam | None
    setups: tuple[PassSetup, ...] = ()
    approach: PassSetup | None = None


def standing_still(planner: str, controllers: Sequence[FeedController]) -> list[str]:
    """Return a notice about each constant feed that the planner rounds to 0."""
    half_um_s = kind_of(planner).speed_unit_nm_s / 2000
    constant = [one for one in controllers if isinstance(one, FixedController | TrimController)]
    feeds = dict.fromkeys(getattr(one, "feed_um_s", 0.0) for one in constant)
    return [
        f"the wire stands still: a feed of {feed_um_s:g} um/s is below half a unit of the planner {planner}, "
        f"{half_um_s:.3g} um/s; choose the planner exact, or a higher feed"
        for feed_um_s in feeds if 0.0 < feed_um_s <= half_um_s
    ]  # fmt: skip


def prepared(program: str | Path, settings: CutSettings, plan: _Plan = planned) -> Prepared:
    """Read and check all inputs of a cut, without simulation."""
    found = with_passes(program, settings, plan)
    settings, path = found.settings, found.path
    machine, tables = settings.load_machine(), settings.compensation
    controller = make_controller(settings.controller)
    if found.setups:
        machine, controller = found.setups[0]
    settings.workpiece.lower_regions(path, machine.wire_diameter_um)  # refuses heights that the path does not reach
    step_um = machine.base.table.step_um.value
    drives = {
        name: axis.from_text(settings.drive, axis.Screw(step_um, screw["um_per_rad"]))
        for name, screw in zip("xy", screws(machine).values(), strict=True)
    }
    compensation = None if tables is None else file.load_tables(file.read_tables(tables), tables)
    return Prepared(
        settings, machine, controller, path, drives, compensation, found.setups, found.approach
    )


# The check of a program: its path, the notices, and the least time.

Limit = Literal["machine", "planner", "generator"]
_LIMITS: dict[Limit, str] = {
    "machine": "the machine's greatest feed", "planner": "the planner's greatest feed",
    "generator": "all that the generator can remove",
}  # fmt: skip


@dataclass(frozen=True)
class PassEstimate:
    """Expected values of a pass by the technology, over all contours: offset, length with approaches, time, Ra."""

    number: int
    offset_mm: float
    length_mm: float
    seconds: float
    ra_um: float


@dataclass(frozen=True)
class Check:
    """Properties of a cut that need no simulation."""

    path: CutPath  # with the reader's notices
    machine: Machine
    path_length_mm: float  # of the wire's path over all passes, with lead-ins
    cutting_s: float  # least time of the path: at `feed_um_s`, and of trims, which remove little, at `trim_feed_um_s`
    feed_um_s: float  # highest possible feed of a rough cut
    trim_feed_um_s: float  # highest possible feed of a trim: that of machine and planner
    # the machine's or the planner's largest feed, or that at which every pulse removes its maximum
    limited_by: Limit
    waiting_s: float  # threading, moves between contours and dwells
    passes: tuple[PassEstimate, ...]  # none for a cut in one pass
    program: Program  # as read

    @property
    def expected_s(self) -> float:
        """Machining time by the technology; 0 for a cut in one pass."""
        return sum(one.seconds for one in self.passes) + (self.waiting_s if self.passes else 0.0)

    @property
    def least_s(self) -> float:
        """The least machining time."""
        return self.cutting_s + self.waiting_s


@refuses_wrong_types
def check(program: str | Path, settings: CutSettings) -> Check:
    """Read a program, offset it and estimate its time for the lowest height, as for a cut with these settings."""
    read = read_program(program, settings)
    found = with_passes(read, settings)
    settings, path = found.settings, found.path
    machine = settings.load_machine()
    settings.workpiece.lower_regions(path, machine.wire_diameter_um)  # refuses heights that the path does not reach
    feed_um_s, limited_by = greatest_feed_um_s(machine, settings.planner, settings.workpiece.lowest_mm)
    trim_feed_um_s, _ = feed_limit(machine, settings.planner)
    between_um = sum(distance for distance, threads in _between_um(path) if not threads)
    length_um = sum(k.length_um for k in path.contours) + between_um
    trims_um = sum(float(p.wire_path.along_um[-1]) for k in path.contours for p in k.passes if p.number > 1)
    cutting_s = (length_um - trims_um) / feed_um_s + trims_um / trim_feed_um_s
    controllers = [setup.controller for setup in found.setups] or [make_controller(settings.controller)]
    path = replace(path, notices=(*path.notices, *standing_still(settings.planner, controllers)))
    if risk := strong_discharge(*([setup.machine for setup in found.setups] or [machine])):
        path = replace(path, notices=(*path.notices, risk))
    return Check(
        path, machine, length_um * 1e-3, cutting_s, feed_um_s, trim_feed_um_s, limited_by, _waiting_s(path, machine),
        _estimates(found), read,
    )


def _between_um(path: CutPath) -> list[tuple[float, bool]]:
    """Return the distance from each path's end to the next one's start, and whether the wire is threaded there."""
    paths = [(contour.guide_paths_um[number], contour.threads[number]) for contour, number in path.cuts]
    return [(float(np.hypot(*(after[0] - before[-1]))), threads) for (before, _), (after, threads) in pairwise(paths)]


def _estimates(found: Passes) -> tuple[PassEstimate, ...]:
    """Return the estimate of each pass: feeds of the technology are those of straight cuts; lead-ins are slower."""
    if found.table is None:
        return ()
    estimates = []
    for number, one in enumerate(found.table.settings, 1):
        passes = [p for contour in found.path.contours for p in contour.passes if p.number == number]
        plain = [contour for contour in found.path.contours if number == 1 and not contour.passes]
        cut: list[CutPass | WireContour] = [*passes, *plain]
        slow = sum(
            float(p.wire_path.along_um[p.approach_moves]) * 1e-3
            for p in passes if number == 1 and p.piece == "profile"
        )  # fmt: skip
        length_mm = sum(float(p.wire_path.along_um[-1]) * 1e-3 for p in cut)
        seconds = 60 * (length_mm - slow + slow / found.table.approach_share) / one.found.feed_mm_min
        offset_mm = max(p.offset_um for p in cut) * 1e-3
        estimates.append(PassEstimate(number, offset_mm, length_mm, seconds, one.found.ra_um))
    return tuple(estimates)


def feed_limit(machine: Machine, planner: str) -> tuple[float, Limit]:
    """Return the lower of the greatest feeds of machine and planner, and which of the two it is."""
    own, of_planner_um_s = machine.base.table.max_feed_um_s, kind_of(planner).max_feed_um_s
    own_um_s = timers.MAX_FEED_UM_S if own is None else own.value
    return (own_um_s, "machine") if own_um_s <= of_planner_um_s else (of_planner_um_s, "planner")


def greatest_feed_um_s(machine: Machine, planner: str, height_mm: float) -> tuple[float, Limit]:
    """Return the highest possible feed of a rough cut and its limit."""
    # the generator's limit: every pulse ignites at once and removes the metal that its energy melts, and the kerf is
    # as wide as the wire and two gaps; most cuts are slower, because pulses are open or short
    limit_um_s, limited_by = feed_limit(machine, planner)
    power_W = mean_current_A(machine) * machine.material.burning_voltage_V.value
    removed_um3_s = power_W * timing(machine).removal_um3_J
    by_power_um_s = removed_um3_s / (2e3 * machine.auto_offset_mm * height_mm * 1e3)
    return (limit_um_s, limited_by) if limit_um_s <= by_power_um_s else (by_power_um_s, "generator")


def _waiting_s(path: CutPath, machine: Machine) -> float:
    """Return the time in which the wire does not cut: dwells, moves to the next start hole, threading there."""
    dwells = sum(contour.waiting_s for contour in path.contours)
    table = machine.base.table
    distances = [distance for distance, threads in _between_um(path) if threads]
    return dwells + sum(distance / table.rapid_um_s.value + table.threading_s.value for distance in distances)


def _pass_lines(found: Check) -> list[tuple[str, str]]:
    rows = [
        (f"pass {one.number}", f"offset {one.offset_mm:.3f} mm, {one.length_mm:.2f} mm of path, some "
                               f"{duration_text(one.seconds)}, Ra {one.ra_um:.2f} µm expected")
        for one in found.passes
    ]  # fmt: skip
    return [*rows, ("expected", f"{duration_text(found.expected_s)} by the technology")] if rows else []


def _program_rows(program: Program) -> Sequence[tuple[str, str]]:
    """Return a row for each outline, by its line; none if the program sets no condition, taper or feed for them."""
    noted = [o for o in program.outlines if o.condition or o.continues or o.taper or o.adaptive is not None]
    if not noted:
        return []
    return [
        (f"line {outline.line}" if outline.line else f"drawn {number}", _outline_text(outline))
        for number, outline in enumerate(program.outlines, 1)
    ]


def _outline_text(outline: Outline) -> str:
    length_mm = float(np.hypot(*np.diff(outline.points_mm, axis=0).T).sum())
    parts = [f"{'closed' if outline.closed else 'open'}, {length_mm:.3f} mm"]
    if outline.wire_side is not None:
        offset = "" if outline.offset_mm is None else f" by {outline.offset_mm:g} mm"
        parts.append(f"wire on the {outline.wire_side}{offset}")
    if outline.condition is not None:
        approach = outline.approach_condition
        parts.append(outline.condition + (f" after {approach}" if approach not in (None, outline.condition) else ""))
    if outline.adaptive is not None:
        parts.append("adaptive feed" if outline.adaptive else "constant feed")
    if outline.taper is not None:
        angles = sorted({abs(angle) for angle in outline.taper.angle_deg or ()})
        parts.append(f"leans by {angles[-1]:g} deg" if angles else "leans between two contours, one in each plane")
    if outline.continues:
        parts.append("on the same wire")
    if outline.stops_after:
        parts.append("then a stop")
    return ", ".join(parts)


def lines_of(found: Check) -> Sequence[tuple[str, str]]:
    """Return names and texts for a terminal's table."""
    origin = np.array(found.path.origin_mm)
    rows = list(_program_rows(found.program))
    for number, contour in enumerate(found.path.contours, 1):
        x, y = contour.points_um[0] / 1e3 - origin
        across, up = arcs.extent_mm(contour.nominal_mm, [number for number, _ in contour.elements])
        kind = "closed" if contour.closed else "open"
        thread = f"{'continues from' if contour.continues else 'threaded at'} X {mm_text(x)} Y {mm_text(y)}"
        size = f"{kind}, {across:.3f} x {up:.3f} mm, part on the {contour.part_side}, {thread}"
        rows.append((f"contour {number}", size))
    waiting = f" and {duration_text(found.waiting_s)} of threading and dwells" if found.waiting_s else ""
    feed = f"{_LIMITS[found.limited_by]}, {found.feed_um_s:.1f} µm/s"
    if found.path.passes > 1 and found.trim_feed_um_s > found.feed_um_s:
        feed += f", {found.trim_feed_um_s:.1f} µm/s in trims"
    used_um = {p.offset_um for k in found.path.contours for p in k.passes} or {
        k.offset_um for k in found.path.contours
    }
    offsets = ", ".join(f"{um / 1e3:.3f}" for um in sorted(used_um))
    return [
        *rows,
        ("offset", f"{offsets} mm"),
        ("path", f"{found.path_length_mm:.2f} mm"),
        *(_pass_lines(found) or [
            ("time", f"at least {duration_text(found.least_s)}: {feed}{waiting}")
        ]),
    ]  # fmt: skip
