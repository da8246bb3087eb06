"""Arcs: centres within the rounding of a program's numbers; chords; extent as drawn."""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.geometry import Floats
from edmsim.program.blocks import Block, Units
from edmsim.program.limits import FARTHEST_MM
from edmsim.program.outline import JOIN_TOLERANCE_MM

SAME_PLACE_MM = 1e-6  # places closer than this many mm differ by numerical noise only
RADIUS_TOLERANCE_MM = 0.005  # least allowed difference of an arc's two radii (ours: rounding of some um)
COARSEST_MM = 0.0254
"""Numbers with a coarser last place, above 0.001 inch, count as exact (ours: no wire-EDM program rounds so much)."""


@dataclass(frozen=True)
class Rounding:
    """Tolerances that follow from the last decimal place of a program's numbers."""

    resolution_mm: float = 0.0  # value of the last place in mm; 0 if the numbers are exact

    @property
    def radius_mm(self) -> float:
        """Greatest difference of an arc's radii: I and J err by half a place, the end from the centre by 1.5."""
        return max(RADIUS_TOLERANCE_MM, 2 * math.sqrt(2) * self.resolution_mm)

    @property
    def join_mm(self) -> float:
        """Greatest distance between ends that are one point: each may err by half a place along both axes."""
        return max(JOIN_TOLERANCE_MM, math.sqrt(2) * self.resolution_mm)


_NO_PLACE = frozenset({("G", 4), ("G", 10)})  # codes with which X is a time, or R an offset


def rounding_of(blocks: Sequence[Block], units: Units) -> Rounding:
    """Return the resolution of a program: that of the finest number in each unit, and the coarsest of these."""
    unit_mm, decimals = units.at_start_mm, dict[float, int]()
    for block in blocks:
        for letter, number in block.codes:
            unit_mm = (units.of_code_mm(number) if letter == "G" else None) or unit_mm
        if block.decimals is not None and _NO_PLACE.isdisjoint(block.codes):
            decimals[unit_mm] = max(decimals.get(unit_mm, 0), block.decimals)
    written = [unit * 10.0**-places for unit, places in decimals.items()]
    return Rounding(max((mm for mm in written if mm <= COARSEST_MM * (1 + 1e-9)), default=0.0))


ROUND_MM = 0.003  # points of an arc lie on its circle within this: chord tolerance and rounding (ours)
CHORD_TOLERANCE_UM = 1.0  # distance between a curve and its chords (ours: below the 2 um step of the axes, row T-16)


def radii(start: complex, end: complex, centre: complex) -> tuple[float, float]:
    """Return the start and the end radius in mm of an arc about `centre`; all points are ``x + 1j * y``."""
    return abs(start - centre), abs(end - centre)


def sweep_of(start: complex, end: complex, centre: complex, turn: int) -> float:
    """Return the angle in rad, 0 to 2 pi, that an arc about `centre` turns by from its start to its end."""
    return (turn * cmath.phase((end - centre) / (start - centre))) % math.tau


def centre_from_radius(start: complex, end: complex, radius: float, turn: int, tolerance_mm: float) -> complex | None:
    """Return the centre of the arc with a radius, negative for more than half a circle, or None if there is none."""
    # the radius may be up to `tolerance_mm` smaller than half the distance between the ends
    chord = end - start
    half = abs(chord) / 2
    if half < SAME_PLACE_MM or abs(radius) < half - tolerance_mm:
        return None
    height = math.sqrt(max(radius * radius - half * half, 0.0))
    side = turn * (1 if radius > 0 else -1)
    return start + chord / 2 + side * height * 1j * chord / abs(chord)


def arc_points(
    start: complex, end: complex, centre: complex, turn: int, full: bool, chords: int = 1
) -> list[complex]:
    """Return the points of an arc after its start, as chords within the tolerance."""
    # the ends of a full circle need not be equal; if the two radii differ slightly, the radius changes linearly
    first, last = start - centre, end - centre
    sweep = math.tau if full else sweep_of(start, end, centre, turn)
    radius = max(abs(first), abs(last))
    if radius > FARTHEST_MM:
        raise InputError(f"the arc's radius of {radius:.3g} mm is beyond {FARTHEST_MM:g} mm: draw a line")
    sagitta = CHORD_TOLERANCE_UM / 1000
    chord_angle = 2 * math.acos(1 - sagitta / radius) if radius > sagitta else math.pi / 2
    count = max(math.ceil(sweep / chord_angle), 8 if full else 1, chords)
    begin, growth, angle = abs(first), abs(last) - abs(first), cmath.phase(first)
    shares = [i / count for i in range(1, count)]
    points = [centre + cmath.rect(begin + share * growth, angle + turn * share * sweep) for share in shares]
    return [*points, end]


def line_points(start: complex, end: complex, chords: int) -> list[complex]:
    """Return the points of a line, divided into `chords` equal chords, without its start but with its end."""
    return [*(start + (end - start) * i / chords for i in range(1, chords)), end]


def by_element(points: Floats, elements: Sequence[int] | NDArray[np.int64]) -> list[Floats]:
    """Return the points of every line and arc of an edge, with both ends of each."""
    bounds = [0, *(np.flatnonzero(np.diff(elements)) + 1).tolist(), len(elements)]
    return [points[first : last + 1] for first, last in pairwise(bounds)]


def extent_mm(points: Floats, elements: Sequence[int]) -> Floats:
    """Return the extent in X and Y of an edge of chords, including the bulge of its curves beyond their chords."""
    parts = by_element(points, elements)
    high = np.max([points.max(axis=0), *map(_peak, parts)], axis=0)
    low = -np.max([-points.min(axis=0), *(_peak(-part) for part in parts)], axis=0)
    return np.asarray(high - low)


def _peak(points: Floats) -> Floats:
    """Return the greatest X and Y of parabolas through three successive points each; -inf without a maximum."""
    if len(points) < 3:
        return np.full(2, -np.inf)
    a, b, c = points[:-2], points[1:-1], points[2:]
    before, after = np.hypot(*(b - a).T)[:, None], np.hypot(*(c - b).T)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):  # repeated points and straight lines have no maximum
        up, down = (b - a) / before, (c - b) / after
        bend = (down - up) / (before + after)
        slope = up + before * bend
        at, peak = -slope / (2 * bend), b - slope**2 / (4 * bend)
    # a curve exceeds its chords by at most their tolerance; a higher maximum is due to a corner
    smooth = peak <= np.maximum(np.maximum(a, b), c) + CHORD_TOLERANCE_UM / 1000
    return np.asarray(np.where((bend < 0) & (at >= -before) & (at <= after) & smooth, peak, -np.inf).max(axis=0))
