"""Check of a program before the cut: its path, the notices, and the least time."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from edmsim.controllers.mcu.firmware.timers import MAX_FEED_UM_S
from edmsim.job.cut import Passes, planned, read_program, with_passes
from edmsim.job.settings import CutSettings
from edmsim.machine.machine import Machine
from edmsim.machine.setting import mean_current_A
from edmsim.plant.gap.generator import timing
from edmsim.program.arcs import extent_mm
from edmsim.program.outline import Outline, Program
from edmsim.program.path import CutPath
from edmsim.recording.report import duration_text, mm_text


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
    cutting_s: float  # least time of the path, at `feed_um_s`
    feed_um_s: float  # highest possible feed
    # the machine's largest feed, or that at which every pulse removes its maximum
    limited_by: Literal["machine", "generator"]
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

    @property
    def path_length_mm(self) -> float:
        """Length of the wire's path with its lead-ins."""
        return self.cutting_s * self.feed_um_s * 1e-3


def check(program: str | Path, settings: CutSettings) -> Check:
    """Read a program, offset it and estimate its time for the lowest height, as for a cut with these settings."""
    read = read_program(program, settings)
    found = with_passes(read, settings, planned)
    settings, path = found.settings, found.path
    machine = settings.load_machine()
    feed_um_s, limited_by = greatest_feed_um_s(machine, settings.workpiece.lowest_mm)
    length_um = sum(k.length_um for k in path.contours)
    waiting_s, passes = _waiting_s(path, machine), _estimates(found)
    return Check(path, machine, length_um / feed_um_s, feed_um_s, limited_by, waiting_s, passes, read)


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


def greatest_feed_um_s(machine: Machine, height_mm: float) -> tuple[float, Literal["machine", "generator"]]:
    """Return the highest possible feed and its limit."""
    # every pulse that ignites at once removes what its energy melts, from a kerf as wide as the wire and twice
    # the gap; most cuts are slower: pulses stay open, or short
    own = machine.base.table.max_feed_um_s
    limit_um_s = MAX_FEED_UM_S if own is None else own.value
    power_W = mean_current_A(machine) * machine.material.burning_voltage_V.value
    removed_um3_s = power_W * timing(machine).removal_um3_J
    by_power_um_s = removed_um3_s / (2e3 * machine.auto_offset_mm * height_mm * 1e3)
    return (limit_um_s, "machine") if limit_um_s <= by_power_um_s else (by_power_um_s, "generator")


def _waiting_s(path: CutPath, machine: Machine) -> float:
    """Return the time in which the wire does not cut: dwells, ways to the next contour, threading there."""
    dwells = sum(contour.waiting_s for contour in path.contours)
    table = machine.base.table
    ways_um = (float(np.hypot(*(b.points_um[0] - a.points_um[-1]))) for a, b in pairwise(path.contours))
    return dwells + sum(way / table.rapid_um_s.value + table.threading_s.value for way in ways_um)


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
        parts.append(f"leans by {angles[-1]:g} deg" if angles else "leans along a second contour")
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
    limit = {"machine": "the machine's greatest feed", "generator": "all that the generator can remove"}
    waiting = f" and {duration_text(found.waiting_s)} of threading and dwells" if found.waiting_s else ""
    feed = f"{found.feed_um_s:.1f} µm/s"
    used_um = {p.offset_um for k in found.path.contours for p in k.passes} or {
        k.offset_um for k in found.path.contours
    }
    offsets = ", ".join(f"{um / 1e3:.3f}" for um in sorted(used_um))
    return [
        *rows,
        ("offset", f"{offsets} mm"),
        ("path", f"{found.path_length_mm:.2f} mm"),
        *(_pass_lines(found) or [
            ("time", f"at least {duration_text(found.least_s)}: {limit[found.limited_by]}, {feed}{waiting}")
        ]),
    ]  # fmt: skip
