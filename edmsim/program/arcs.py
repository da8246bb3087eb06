"""Arcs: centres found from what a program gives, and arcs turned into chords."""

from __future__ import annotations

import cmath
import math

from edmsim.errors import InputError
from edmsim.program.limits import FARTHEST_MM
from edmsim.program.rounding import SAME_PLACE_MM

CHORD_TOLERANCE_UM = 1.0
"""Largest distance in um between a curve and its chords (ours: below the 2 um step of the axes, row T-16)."""


def radii(start: complex, end: complex, centre: complex) -> tuple[float, float]:
    """Return the start and the end radius in mm of an arc about `centre`; all points are ``x + 1j * y``."""
    return abs(start - centre), abs(end - centre)


def sweep_of(start: complex, end: complex, centre: complex, turn: int) -> float:
    """Return the angle in rad, 0 to 2 pi, that an arc about `centre` turns by from its start to its end."""
    return (turn * cmath.phase((end - centre) / (start - centre))) % math.tau


def centre_from_radius(
    start: complex, end: complex, radius: float, turn: int, tolerance_mm: float
) -> complex | None:
    """Return the centre of the arc with a given radius, or None if there is none.

    Parameters
    ----------
    start, end : complex
        End points ``x + 1j * y`` in mm.
    radius : float
        In mm; negative asks for the arc of more than half a circle, as usual for the word R.
    turn : int
        +1 counter-clockwise, -1 clockwise.
    tolerance_mm : float
        By this much the radius may be smaller than half the distance of the ends.
    """
    chord = end - start
    half = abs(chord) / 2
    if half < SAME_PLACE_MM or abs(radius) < half - tolerance_mm:
        return None
    height = math.sqrt(max(radius * radius - half * half, 0.0))
    side = turn * (1 if radius > 0 else -1)
    return start + chord / 2 + side * height * 1j * chord / abs(chord)


def arc_points(start: complex, end: complex, centre: complex, turn: int, full: bool) -> list[complex]:
    """Return the points of an arc after its start, up to and with its end, as chords within the tolerance.

    Parameters
    ----------
    start, end : complex
        End points ``x + 1j * y`` in mm.
    centre : complex
        Centre in mm. If the two radii differ a little the radius changes evenly along the arc.
    turn : int
        +1 counter-clockwise, -1 clockwise.
    full : bool
        Whether it is a full circle, whose ends need not be equal to the last bit.

    Raises
    ------
    InputError
        The centre is too far away for chords to be told apart.
    """
    first, last = start - centre, end - centre
    sweep = math.tau if full else sweep_of(start, end, centre, turn)
    radius = max(abs(first), abs(last))
    if radius > FARTHEST_MM:
        raise InputError(f"the arc's radius of {radius:.3g} mm is beyond {FARTHEST_MM:g} mm: draw a line")
    count = max(math.ceil(sweep / _chord_angle(radius)), 8 if full else 1)
    begin, growth, angle = abs(first), abs(last) - abs(first), cmath.phase(first)
    shares = [i / count for i in range(1, count)]
    points = [centre + cmath.rect(begin + share * growth, angle + turn * share * sweep) for share in shares]
    return [*points, end]


def _chord_angle(radius: float) -> float:
    sagitta = CHORD_TOLERANCE_UM / 1000
    return 2 * math.acos(1 - sagitta / radius) if radius > sagitta else math.pi / 2
