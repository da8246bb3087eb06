"""What an arc means: whether I J count from its start, as usual, or are coordinates; whether it is a full circle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from edmsim.errors import InputError
from edmsim.program.arcs import arc_points, radii, sweep_of
from edmsim.program.outline import Side
from edmsim.program.registers import Offset
from edmsim.program.rounding import RADIUS_TOLERANCE_MM, SAME_PLACE_MM, Rounding


@dataclass(frozen=True)
class Arc:
    """The arc of a G2 or G3 block.

    Attributes
    ----------
    turn : int
        +1 counter-clockwise (G3), -1 clockwise (G2).
    relative : complex
        Centre ``x + 1j * y`` in mm if I J count from the start, or the one found from R.
    absolute : complex or None
        Centre if I J are coordinates; None if the block has no I and J for that.
    absolute_stated : bool or None
        What the program says of I J: G90.1 (True), G91.1 (False), or nothing.
    by_radius : bool
        Whether the block has R, which leaves nothing open.
    """

    turn: int
    relative: complex
    absolute: complex | None
    absolute_stated: bool | None = None
    by_radius: bool = False


@dataclass(frozen=True)
class CuttingMotion:
    """One cutting motion from ``start`` to ``end`` (``x + 1j * y`` in mm); straight if ``arc`` is None."""

    start: complex
    end: complex
    side: Side | None
    line: int
    arc: Arc | None
    offset: Offset | None = None

    def ends_meet(self, rounding: Rounding) -> bool:
        """Whether start and end are one place, so that any far centre is as far from both."""
        return abs(self.end - self.start) <= rounding.join_mm

    def fits(self, rounding: Rounding) -> tuple[bool, bool]:
        """Whether the radii agree about the relative and about the absolute centre, as far as either may be meant."""
        arc = self.arc
        if arc is None or arc.by_radius:
            return arc is not None, False
        relative, absolute = (
            centre is not None and stated is not other and self._agree(centre, rounding)
            for centre, stated, other in (
                (arc.relative, arc.absolute_stated, True), (arc.absolute, arc.absolute_stated, False),
            )
        )  # fmt: skip
        return relative, absolute

    def _agree(self, centre: complex, rounding: Rounding) -> bool:
        first, last = radii(self.start, self.end, centre)
        return abs(first - last) <= rounding.radius_mm and min(first, last) > SAME_PLACE_MM


@dataclass(frozen=True)
class Reading:
    """How a motion is read.

    Attributes
    ----------
    motion : CuttingMotion
    centre : complex or None
        Centre of the arc; None if the motion goes straight to its end.
    full : bool or None
        Whether it is a full circle; None where ends that all but meet may mean that or the short arc between them.
    notices : tuple of str
    """

    motion: CuttingMotion
    centre: complex | None = None
    full: bool | None = False
    notices: tuple[str, ...] = ()

    @property
    def moves(self) -> bool:
        """Whether anything is cut: an arc without a radius whose ends are equal does not move."""
        motion = self.motion
        return self.centre is not None or motion.arc is None or abs(motion.end - motion.start) > SAME_PLACE_MM

    @property
    def points(self) -> tuple[complex, ...]:
        """Points after the start, arcs as chords."""
        motion = self.motion
        if motion.arc is None or self.centre is None:
            return (motion.end,)
        return tuple(arc_points(motion.start, motion.end, self.centre, motion.arc.turn, bool(self.full)))

    def decided(self, full: bool) -> Reading:
        """Take one of two readings, and say so."""
        apart_um = abs(self.motion.end - self.motion.start) * 1e3
        read = "a full circle" if full else "the short arc between them"
        notice = f"the arc's ends are {apart_um:.1f} um apart: it is read as {read}"
        return replace(self, full=full, notices=(*self.notices, notice))


def prefer_absolute(motions: Sequence[CuttingMotion], rounding: Rounding) -> bool | None:
    """Decide what I J mean where both readings fit: what most of the arcs mean that fit one reading only.

    Arcs whose ends meet say nothing of it, as any centre fits them.

    Returns
    -------
    bool or None
        None if no arc fits one reading only.

    Raises
    ------
    InputError
        With the line: an arc fits neither way.
    """
    arcs = [motion for motion in motions if motion.arc is not None and not motion.ends_meet(rounding)]
    all_fits = [motion.fits(rounding) for motion in arcs]
    for motion, fits in zip(arcs, all_fits, strict=True):
        if not any(fits):
            raise InputError(_misfit(motion), line=motion.line)
    votes = [
        fits[1] - fits[0] for motion, fits in zip(arcs, all_fits, strict=True)
        if motion.arc and motion.arc.absolute is not None and motion.arc.absolute_stated is None
    ]  # fmt: skip
    return sum(votes) > 0 if any(votes) else None


def reading_of(motion: CuttingMotion, absolute: bool | None, rounding: Rounding) -> Reading:
    """Return how a motion is read.

    Parameters
    ----------
    motion : CuttingMotion
        One that `prefer_absolute` has not refused.
    absolute : bool or None
        What I J mean in the program where both readings fit.
    rounding : Rounding
    """
    arc = motion.arc
    if arc is None:
        return Reading(motion)
    if arc.by_radius:
        return Reading(motion, arc.relative)
    if motion.ends_meet(rounding):
        return _reading_where_ends_meet(motion, arc, absolute, rounding)
    fits = motion.fits(rounding)
    meant = fits[1] and (bool(absolute) or not fits[0])
    notices = []
    if fits[1] and not fits[0] and arc.absolute_stated is None:
        notices.append("I J are taken as an absolute arc centre: only so do start and end radius agree")
    elif all(fits):
        notices += _both_fit(arc, meant)
    centre = arc.absolute if meant and arc.absolute is not None else arc.relative
    first, last = radii(motion.start, motion.end, centre)
    if abs(first - last) > RADIUS_TOLERANCE_MM:
        apart_um = abs(first - last) * 1e3
        notices.append(f"the arc's radii differ by {apart_um:.1f} um, which the rounding of its numbers explains")
    return Reading(motion, centre, notices=tuple(notices))


def _reading_where_ends_meet(
    motion: CuttingMotion, arc: Arc, absolute: bool | None, rounding: Rounding
) -> Reading:
    """Tell a full circle from an arc so short that it lies, with its radius, within what rounding explains."""
    stated = arc.absolute_stated
    meant = (absolute if stated is None else stated) if arc.absolute is not None else False
    equal = abs(motion.end - motion.start) <= SAME_PLACE_MM
    centre = arc.absolute if meant and arc.absolute is not None else arc.relative
    tiny = abs(centre - motion.start) <= rounding.radius_mm
    if meant is None and arc.absolute is not None and not equal:  # nothing says which is meant: the tiny one, then
        tiny |= SAME_PLACE_MM < abs(arc.absolute - motion.start) <= rounding.radius_mm
    if tiny:
        return Reading(motion, notices=("an arc without a radius is left out",) * equal)
    reading = Reading(motion, centre, True, tuple(_both_fit(arc, bool(meant)) if stated is None else ()))
    if equal:
        return reading
    if sweep_of(motion.start, motion.end, centre, arc.turn) > math.pi:
        return reading.decided(True)
    return replace(reading, full=None)


def _both_fit(arc: Arc, absolute: bool) -> list[str]:
    if arc.absolute is None or abs(arc.relative - arc.absolute) <= SAME_PLACE_MM:
        return []
    meant = "absolute" if absolute else "relative"
    return [f"I J fit both as relative and as absolute centre: taken as {meant}"]


def _misfit(motion: CuttingMotion) -> str:
    def radii_about(centre: complex) -> str:
        return "start radius {:.4f} and end radius {:.4f} mm".format(*radii(motion.start, motion.end, centre))

    arc = motion.arc
    assert arc is not None
    readings = []
    if arc.absolute_stated is not True:
        readings.append(f"with I J relative {radii_about(arc.relative)}")
    if arc.absolute is not None and arc.absolute_stated is not False:
        readings.append(f"{'' if readings else 'with I J '}absolute {radii_about(arc.absolute)}")
    return f"the arc's radii disagree: {', '.join(readings)}; correct I, J or the end point"
