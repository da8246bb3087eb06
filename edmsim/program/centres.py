"""Which centre an arc means: I J relative to its start, as usual, or absolute, as on Robofil controls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from edmsim.errors import InputError
from edmsim.program.arcs import arc_points, is_centre, radii
from edmsim.program.outline import Side
from edmsim.program.registers import Offset


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
    """

    turn: int
    relative: complex
    absolute: complex | None


@dataclass(frozen=True)
class CuttingMotion:
    """One cutting motion from ``start`` to ``end`` (``x + 1j * y`` in mm); straight if ``arc`` is None."""

    start: complex
    end: complex
    side: Side | None
    line: int
    arc: Arc | None
    offset: Offset | None = None

    @property
    def fits(self) -> tuple[bool, bool]:
        """Whether start and end radius agree about the relative and about the absolute centre."""
        if self.arc is None:
            return False, False
        absolute = self.arc.absolute is not None and is_centre(self.start, self.end, self.arc.absolute)
        return is_centre(self.start, self.end, self.arc.relative), absolute

    def points(self, prefer_absolute: bool) -> tuple[complex, ...]:
        """Return the points after the start, arcs as chords.

        Parameters
        ----------
        prefer_absolute : bool
            Which centre to take where both fit.
        """
        if self.arc is None:
            return (self.end,)
        relative, absolute = self.fits
        chosen = self.arc.absolute if absolute and (prefer_absolute or not relative) else None
        centre = self.arc.relative if chosen is None else chosen
        return tuple(arc_points(self.start, self.end, centre, self.arc.turn))


def prefer_absolute(motions: Sequence[CuttingMotion]) -> tuple[bool, list[tuple[str, int]]]:
    """Decide what I J mean where both readings fit: what most of the arcs mean that fit one reading only.

    Returns
    -------
    absolute : bool
    notices : list of (str, int)
        What was decided, with the line.

    Raises
    ------
    InputError
        With the line: an arc fits neither way.
    """
    arcs = [(motion, motion.fits) for motion in motions if motion.arc is not None]
    for motion, fits in arcs:
        if not any(fits):
            raise InputError(_misfit(motion), line=motion.line)
    centred = [fits for motion, fits in arcs if motion.arc and motion.arc.absolute is not None]
    absolute = sum(fits == (False, True) for fits in centred) > sum(fits == (True, False) for fits in centred)
    notices = [(_told(motion, fits, absolute), motion.line) for motion, fits in arcs if fits[1]]
    return absolute, [(text, line) for text, line in notices if text]


def _told(motion: CuttingMotion, fits: tuple[bool, bool], absolute: bool) -> str:
    if not fits[0]:
        return "I J are taken as an absolute arc centre: only so do start and end radius agree"
    if motion.arc is None or motion.arc.relative == motion.arc.absolute:
        return ""
    meant = "absolute" if absolute else "relative"
    return f"I J fit both as relative and as absolute centre: taken as {meant}"


def _misfit(motion: CuttingMotion) -> str:
    def told(centre: complex) -> str:
        return "start radius {:.4f} and end radius {:.4f} mm".format(*radii(motion.start, motion.end, centre))

    assert motion.arc is not None
    text = f"the arc's radii disagree: with I J relative {told(motion.arc.relative)}"
    if motion.arc.absolute is not None:
        text += f", absolute {told(motion.arc.absolute)}"
    return text + "; correct I, J or the end point"
