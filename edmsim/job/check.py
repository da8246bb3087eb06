"""Check of a program before the cut: its path, the notices, and the least time."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from edmsim.controllers.mcu.firmware.timers import MAX_FEED_UM_S
from edmsim.controllers.planner.registry import kind_of
from edmsim.errors import refuses_wrong_types
from edmsim.job.cut import Passes, planned, read_program, with_passes
from edmsim.job.settings import CutSettings
from edmsim.machine.machine import Machine
from edmsim.machine.setting import mean_current_A
from edmsim.plant.gap.generator import timing
from edmsim.program.arcs import extent_mm
from edmsim.program.outline import Outline, Program
from edmsim.program.path import CutPath
from edmsim.recording.report import duration_text, mm_text

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
    trim_feed_um_s: float  # that of a trim: the largest of machine and planner
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
    found = with_passes(read, settings, planned)
    settings, path = found.settings, found.path
    machine = settings.load_machine()
    feed_um_s, limited_by = greatest_feed_um_s(machine, settings.planner, settings.workpiece.lowest_mm)
    trim_feed_um_s, _ = _feed_limit(machine, settings.planner)
    between_um = sum(way for way, threads in _between_um(path) if not threads)
    length_um = sum(k.length_um for k in path.contours) + between_um
    trims_um = sum(float(p.way.along_um[-1]) for k in path.contours for p in k.passes if p.number > 1)
    cutting_s = (length_um - trims_um) / feed_um_s + trims_um / trim_feed_um_s
    return Check(
        path, machine, length_um * 1e-3, cutting_s, feed_um_s, trim_feed_um_s, limited_by, _waiting_s(path, machine),
        _estimates(found), read,
    )


def _between_um(path: CutPath) -> list[tuple[float, bool]]:
    """Return the distance from each way's end to the next one's beginning, and whether the wire is threaded there."""
    ways = [pair for k in path.contours for pair in zip(k.ways_um, k.threads, strict=True)]
    return [(float(np.hypot(*(way[0] - before[-1]))), threads) for (before, _), (way, threads) in pairwise(ways)]


def _estimates(found: Passes) -> tuple[PassEstimate, ...]:
    """Return what the technology expects of each pass: its feed was that of a straight cut; lead-ins are slower."""
    estimates = []
    for number, one in enumerate(found.table.settings if found.table else (), 1):
        ways = [p for contour in found.path.contours for p in contour.passes if p.number == number]
        slow = sum(
            float(p.way.along_um[p.approach_moves]) * 1e-3 for p in ways if number == 1 and p.piece == "profile"
        )
        length_mm = sum(float(p.way.along_um[-1]) * 1e-3 for p in ways)
        assert found.table is not None
        seconds = 60 * (length_mm - slow + slow / found.table.approach_share) / one.found.feed_mm_min
        offset_mm = max([p.offset_um for p in ways], default=0.0) * 1e-3
        estimates.append(PassEstimate(number, offset_mm, length_mm, seconds, one.found.ra_um))
    return tuple(estimates)


def _feed_limit(machine: Machine, planner: str) -> tuple[float, Limit]:
    """Return the lower one of the greatest feeds of machine and planner, and whose it is."""
    own, of_planner_um_s = machine.base.table.max_feed_um_s, kind_of(planner).max_feed_um_s
    own_um_s = MAX_FEED_UM_S if own is None else own.value
    return (own_um_s, "machine") if own_um_s <= of_planner_um_s else (of_planner_um_s, "planner")


def greatest_feed_um_s(machine: Machine, planner: str, height_mm: float) -> tuple[float, Limit]:
    """Return the highest possible feed of a rough cut and its limit."""
    # every pulse that ignites at once removes what its energy melts, from a kerf as wide as the wire and twice
    # the gap; most cuts are slower: pulses stay open, or short
    limit_um_s, limited_by = _feed_limit(machine, planner)
    power_W = mean_current_A(machine) * machine.material.burning_voltage_V.value
    removed_um3_s = power_W * timing(machine).removal_um3_J
    by_power_um_s = removed_um3_s / (2e3 * machine.auto_offset_mm * height_mm * 1e3)
    return (limit_um_s, limited_by) if limit_um_s <= by_power_um_s else (by_power_um_s, "generator")


def _waiting_s(path: CutPath, machine: Machine) -> float:
    """Return the time in which the wire does not cut: dwells, ways to the next start hole, threading there."""
    dwells = sum(contour.waiting_s for contour in path.contours)
    table = machine.base.table
    return dwells + sum(
        way / table.rapid_um_s.value + table.threading_s.value for way, threads in _between_um(path) if threads
    )


def _pass_lines(found: Check) -> list[tuple[str, str]]:
    rows = [
        (f"pass {one.number}", f"offset {one.offset_mm:.3f} mm, {one.length_mm:.2f} mm of path, some "
                               f"{duration_text(one.seconds)}, Ra {one.ra_um:.2f} µm expected")
        for one in found.passes
    ]  # fmt: skip
    return [*rows, ("expected", f"{duration_text(found.expected_s)} by the technology")] if rows else []


def _program_rows(program: Program) -> Sequence[tuple[str, str]]:
    """Return what a program says of all that it cuts, each by its line; nothing if it has no words for it."""
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
        across, up = extent_mm(contour.nominal_mm, [number for number, _ in contour.elements])
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
