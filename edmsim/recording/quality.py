"""What a report is made of: sums over the cut, and what was measured on the part."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from edmsim.metrology.profile import ElementError
from edmsim.metrology.reach import WorstPlace
from edmsim.recording.scene import SceneCorner


@dataclass(frozen=True)
class Totals:
    """What was counted and summed over the whole cut.

    Attributes
    ----------
    machining_time_s, wall_time_s : float
        Time of the machine, and of the computer.
    short, open, spark, arc : int
        Pulses by how they ended, all pulses of the generator, also those the analyser did not count.
    path_length_mm : float
        Length of wire path cut.
    cut_area_mm2, cutting_time_s : float
        Of the cut alone (`edmsim.recording.windows`): path length times the local height of the workpiece, and time.
    energy : float
        Energy of all discharges in J.
    removed_mm3 : float
        Metal removed.
    vibration_um_rms : float
        Root mean square of the wire's motion about its mean deflection; NaN if unknown.
    feed_limit_um_s, limited_share : float
        Greatest feed of machine and planner, and the share of the cut alone at it; NaN if unknown.
    equalising_J : float
        Energy from the supply of the equalising pulses.
    """

    machining_time_s: float
    wall_time_s: float
    short: int
    open: int
    spark: int
    arc: int
    path_length_mm: float
    cut_area_mm2: float
    cutting_time_s: float
    energy: float
    removed_mm3: float
    vibration_um_rms: float
    feed_limit_um_s: float = math.nan
    limited_share: float = math.nan
    equalising_J: float = 0.0


@dataclass(frozen=True)
class Wall:
    """A wall of the kerf in one slice: mean, 5 % and 95 % of its distances from the wire's path, in um."""

    mean_um: float
    p5_um: float
    p95_um: float


@dataclass(frozen=True)
class KerfSlice:
    """The kerf at one height: the middle of a slice over the lower face in mm, places measured, both walls.

    ``part`` is the wall on the part's side of the wire's path, ``rest`` the one across; NaN if there are no places.
    """

    height_mm: float
    places: int
    part: Wall
    rest: Wall


@dataclass(frozen=True)
class TableShare:
    """What the errors of the table's screws and ways do to the part: ``max``, ``rms`` and ``p95`` in um each.

    Attributes
    ----------
    without_um : mapping
        Displacement of the wall by the table alone.
    left_um : mapping
        What of that the compensation leaves.
    profile_without_um : mapping
        The profile error there would be without compensation: as measured, with what it has taken out added again.
    compensated : bool
        Whether there was a compensation.
    """

    without_um: Mapping[str, float]
    left_um: Mapping[str, float]
    profile_without_um: Mapping[str, float]
    compensated: bool


@dataclass(frozen=True)
class PassFigures:
    """What a pass did, and the wall and face it left; NaN where that is not known.

    Attributes
    ----------
    contour, number : int
        From 1.
    reversed : bool
        Whether it ran against the contour's direction.
    begin_s, end_s : float
        Machine time.
    length_mm, rate_mm2_min : float
        Length cut, and area per minute.
    offset_um, offset_to_use_um : float
        Offset it ran at, and that with which its wall would have met the drawing, had it been the last.
    left_um, stock_um : float
        Metal that its wall leaves on the drawing in the mean, and what it took of that; of the first pass NaN.
    straightness_um, bow_um : float
        Of the wall over the height: from the lowest to the highest, and middle over ends.
    ripple_um, ripple_mm : float
        Scatter of the wall along the path, and its wavelength.
    slices_um : tuple of float
        The wall over the drawing at every height, from below.
    ra_um, heat_affected_um : float
        Of the face as the pass left it: what it took, and what of the passes before is still there.
    short_share, open_share : float
        Of its pulses.
    """

    contour: int
    number: int
    piece: str
    reversed: bool
    begin_s: float
    end_s: float
    length_mm: float
    rate_mm2_min: float
    offset_um: float
    offset_to_use_um: float
    left_um: float
    stock_um: float
    straightness_um: float
    bow_um: float
    ripple_um: float
    ripple_mm: float
    slices_um: tuple[float, ...]
    ra_um: float
    heat_affected_um: float
    short_share: float
    open_share: float


@dataclass(frozen=True)
class HeightError:
    """The profile error at one height, mid-slice over the lower face in mm: ``mean`` and ``rms`` in um."""

    height_mm: float
    mean_um: float
    rms_um: float


@dataclass(frozen=True)
class Reach:
    """The profile error beside what a wire can reach.

    Attributes
    ----------
    reachable_um : mapping
        ``max``, ``rms`` and ``p95`` of the profile error without what the round wire leaves in inner corners.
    mean_um : float
        Mean error of the walls between corners; NaN if there are none.
    worst, worst_reachable : WorstPlace or None
        Where either error is largest; None if nothing was measured.
    elements : tuple of ElementError
        Line by line and arc by arc of the program.
    """

    reachable_um: Mapping[str, float]
    mean_um: float
    worst: WorstPlace | None
    worst_reachable: WorstPlace | None
    elements: tuple[ElementError, ...]


NOTHING_REACHED = Reach(dict.fromkeys(("max", "rms", "p95"), math.nan), math.nan, None, None, ())
"""Of a cut of which nothing was measured."""


@dataclass(frozen=True)
class Quality:
    """What was measured on the part; NaN where it could not be.

    Attributes
    ----------
    profile_max_um, profile_rms_um, profile_p95_um : float
        Of the profile error's magnitude.
    ra_um : float
        Roughness of the wall.
    heat_affected_um, electrolysed_um : float
        Layers of the wall that heat has changed and that the water has dissolved.
    section : tuple of KerfSlice
        The kerf slice by slice, from the bottom.
    table : TableShare or None
        None for a perfect table.
    profile_shares : mapping, optional
        What made the profile error (`edmsim.metrology.shares.share_stats`); None if it was not split.
    offset_um : float
        Offset that the path was made with; NaN if unknown, or if its contours have different ones.
    passes : tuple of PassFigures
        None for a cut in one pass.
    heights : tuple of HeightError
        The profile error slice by slice, from the bottom.
    """

    kerf_mean_um: float
    kerf_min_um: float
    kerf_max_um: float
    profile_max_um: float
    profile_rms_um: float
    profile_p95_um: float
    corners: tuple[SceneCorner, ...]
    ra_um: float
    heat_affected_um: float = math.nan
    electrolysed_um: float = math.nan
    section: tuple[KerfSlice, ...] = ()
    table: TableShare | None = None
    profile_shares: Mapping[str, Mapping[str, float]] | None = None
    reach: Reach = NOTHING_REACHED
    offset_um: float = math.nan
    passes: tuple[PassFigures, ...] = ()
    heights: tuple[HeightError, ...] = ()
