"""A program looked at before it is cut: its path, what to know about it, and how long it takes at least."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from edmsim.controllers.mcu.firmware.timers import MAX_FEED_UM_S
from edmsim.job.cut import planned
from edmsim.job.settings import CutSettings
from edmsim.machine.machine import Machine
from edmsim.machine.setting import mean_current_A
from edmsim.plant.gap.generator import timing
from edmsim.program.arcs import extent_mm
from edmsim.program.path import CutPath


@dataclass(frozen=True)
class Check:
    """What is known of a cut without simulating it.

    Attributes
    ----------
    path : CutPath
        The wire's path, with the notices of the reading.
    machine : Machine
    cutting_s : float
        Time of the path at `feed_um_s`: no cut takes less.
    feed_um_s : float
        Greatest feed there can be.
    limited_by : {"machine", "generator"}
        Whether it is the machine's greatest feed, or the one at which every pulse would have to remove all it can.
    waiting_s : float
        Time of threading, ways between contours and dwells.
    """

    path: CutPath
    machine: Machine
    cutting_s: float
    feed_um_s: float
    limited_by: Literal["machine", "generator"]
    waiting_s: float

    @property
    def least_s(self) -> float:
        """The least machining time."""
        return self.cutting_s + self.waiting_s

    @property
    def path_length_mm(self) -> float:
        """Length of the wire's path with its lead-ins."""
        return self.cutting_s * self.feed_um_s * 1e-3


def check(program: str | Path, settings: CutSettings) -> Check:
    """Read a program, offset it and estimate its time, as a cut with these settings would begin.

    Parameters
    ----------
    program : path
        G-code or drawing.
    settings : CutSettings
        As a cut takes them; a workpiece of several heights counts with the lowest for the time.

    Returns
    -------
    Check

    Raises
    ------
    UnknownWordsError
        The program has words that are not known: all of them.
    InputError
        As `edmsim.cut`.
    """
    machine = settings.load_machine()
    path = planned(program, settings, machine)
    feed_um_s, limited_by = greatest_feed_um_s(machine, settings.workpiece.lowest_mm)
    length_um = sum(float(k.along_um[-1]) for k in path.contours)
    return Check(path, machine, length_um / feed_um_s, feed_um_s, limited_by, _waiting_s(path, machine))


def greatest_feed_um_s(machine: Machine, height_mm: float) -> tuple[float, Literal["machine", "generator"]]:
    """Return the greatest feed there can be, and what limits it.

    Every pulse that ignites at once removes what its energy melts; the kerf is as wide as the wire and twice the
    expected gap. No cut is faster than that, most are slower: pulses stay open, or short.
    """
    own = machine.base.table.max_feed_um_s
    limit_um_s = MAX_FEED_UM_S if own is None else own.value
    power_W = mean_current_A(machine) * machine.material.burning_voltage_V.value
    removed_um3_s = power_W * timing(machine).removal_um3_J
    by_power_um_s = removed_um3_s / (2e3 * machine.auto_offset_mm * height_mm * 1e3)
    return (limit_um_s, "machine") if limit_um_s <= by_power_um_s else (by_power_um_s, "generator")


def _waiting_s(path: CutPath, machine: Machine) -> float:
    """Return the time in which the wire does not cut: dwells, ways to the next contour, threading there."""
    dwells = sum(seconds for contour in path.contours for _, seconds in contour.dwells)
    table = machine.base.table
    ways_um = (float(np.hypot(*(b.points_um[0] - a.points_um[-1]))) for a, b in pairwise(path.contours))
    return dwells + sum(way / table.rapid_um_s.value + table.threading_s.value for way in ways_um)


def lines_of(found: Check) -> Sequence[tuple[str, str]]:
    """Return names and texts for a terminal's table."""
    from edmsim.recording.report import duration_text

    origin = np.array(found.path.origin_mm)
    rows = []
    for number, contour in enumerate(found.path.contours, 1):
        x, y = contour.points_um[0] / 1e3 - origin
        across, up = extent_mm(contour.nominal_mm, [number for number, _ in contour.elements])
        kind = "closed" if contour.closed else "open"
        # 0.0 +: a hair below zero would read -0.000
        thread = f"threaded at X {round(x, 6) + 0.0:.3f} Y {round(y, 6) + 0.0:.3f}"
        size = f"{kind}, {across:.3f} x {up:.3f} mm, part on the {contour.part_side}, {thread}"
        rows.append((f"contour {number}", size))
    limit = {"machine": "the machine's greatest feed", "generator": "all that the generator can remove"}
    waiting = f" and {duration_text(found.waiting_s)} of threading and dwells" if found.waiting_s else ""
    feed = f"{found.feed_um_s:.1f} µm/s"
    offsets = ", ".join(f"{um / 1e3:.3f}" for um in sorted({contour.offset_um for contour in found.path.contours}))
    return [
        *rows,
        ("offset", f"{offsets} mm"),
        ("path", f"{found.path_length_mm:.2f} mm"),
        ("time", f"at least {duration_text(found.least_s)}: {limit[found.limited_by]}, {feed}{waiting}"),
    ]
