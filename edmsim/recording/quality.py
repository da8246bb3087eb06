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
    """What was counted and summed over the whole cut."""

    machining_time_s: float  # machining_time_s, wall_time_s: time of the machine, and of the computer
    wall_time_s: float
    # short, open, spark, arc: pulses by how they ended, all pulses of the generator, also those the analyser
    # did not count
    short: int
    open: int
    spark: int
    arc: int
    path_length_mm: float  # length of wire path cut
    # cut_area_mm2, cutting_time_s: of the cut alone (`edmsim.recording.windows`): path length times the local
    # height of the workpiece, and time
    cut_area_mm2: float
    cutting_time_s: float
    energy: float  # energy of all discharges in J
    removed_mm3: float  # metal removed
    vibration_um_rms: float  # root mean square of the wire's motion about its mean deflection; NaN if unknown
    # feed_limit_um_s, limited_share: greatest feed of machine and planner, and the share of the cut alone at
    # it; NaN if unknown
    feed_limit_um_s: float = math.nan
    limited_share: float = math.nan
    equalising_J: float = 0.0  # energy from the supply of the equalising pulses


@dataclass(frozen=True)
class Wall:
    """A wall of the kerf in one slice: mean, 5 % and 95 % of its distances from the wire's path, in um."""

    mean_um: float
    p5_um: float
    p95_um: float


@dataclass(frozen=True)
class KerfSlice:
    """The kerf at one height over the lower face: places measured, the wall on the part's side and the one across."""

    height_mm: float
    places: int
    part: Wall
    rest: Wall


@dataclass(frozen=True)
class TableShare:
    """What the errors of the table's screws and ways do to the part: ``max``, ``rms`` and ``p95`` in um each."""

    without_um: Mapping[str, float]  # displacement of the wall by the table alone
    left_um: Mapping[str, float]  # what of that the compensation leaves
    # the profile error there would be without compensation: as measured, with what it has taken out added again
    profile_without_um: Mapping[str, float]
    compensated: bool  # whether there was a compensation


@dataclass(frozen=True)
class PassFigures:
    """What a pass did, and the wall and face it left; NaN where that is not known."""

    contour: int  # contour, number: from 1
    number: int
    piece: str
    reversed: bool  # whether it ran against the contour's direction
    begin_s: float  # begin_s, end_s: machine time
    end_s: float
    length_mm: float  # length_mm, rate_mm2_min: length cut, and area per minute
    rate_mm2_min: float
    # offset_um, offset_to_use_um: offset it ran at, and that with which its wall would have met the drawing,
    # had it been the last
    offset_um: float
    offset_to_use_um: float
    # left_um, stock_um: metal that its wall leaves on the drawing in the mean, and what it took of that; of the
    # first pass NaN
    left_um: float
    stock_um: float
    # straightness_um, bow_um: of the wall over the height: from the lowest to the highest, and middle over ends
    straightness_um: float
    bow_um: float
    ripple_um: float  # ripple_um, ripple_mm: scatter of the wall along the path, and its wavelength
    ripple_mm: float
    slices_um: tuple[float, ...]  # the wall over the drawing at every height, from below
    # ra_um, heat_affected_um: of the face as the pass left it: what it took, and what of the passes before is
    # still there
    ra_um: float
    heat_affected_um: float
    short_share: float  # short_share, open_share: of its pulses
    open_share: float


@dataclass(frozen=True)
class HeightError:
    """The profile error at one height, mid-slice over the lower face in mm: ``mean`` and ``rms`` in um."""

    height_mm: float
    mean_um: float
    rms_um: float


@dataclass(frozen=True)
class Reach:
    """The profile error beside what a wire can reach."""

    # ``max``, ``rms`` and ``p95`` of the profile error without what the round wire leaves in inner corners
    reachable_um: Mapping[str, float]
    mean_um: float  # mean error of the walls between corners; NaN if there are none
    worst: WorstPlace | None  # worst, worst_reachable: where either error is largest; None if nothing was measured
    worst_reachable: WorstPlace | None
    elements: tuple[ElementError, ...]  # line by line and arc by arc of the program


NOTHING_REACHED = Reach(dict.fromkeys(("max", "rms", "p95"), math.nan), math.nan, None, None, ())
"""Of a cut of which nothing was measured."""


@dataclass(frozen=True)
class Quality:
    """What was measured on the part; NaN where it could not be."""

    kerf_mean_um: float
    kerf_min_um: float
    kerf_max_um: float
    profile_max_um: float  # profile_max_um, profile_rms_um, profile_p95_um: of the profile error's magnitude
    profile_rms_um: float
    profile_p95_um: float
    corners: tuple[SceneCorner, ...]
    ra_um: float  # roughness of the wall
    # heat_affected_um, electrolysed_um: layers of the wall that heat has changed and that the water has
    # dissolved
    heat_affected_um: float = math.nan
    electrolysed_um: float = math.nan
    section: tuple[KerfSlice, ...] = ()  # the kerf slice by slice, from the bottom
    table: TableShare | None = None  # None for a perfect table
    # what made the profile error (`edmsim.metrology.shares.share_stats`); None if it was not split
    profile_shares: Mapping[str, Mapping[str, float]] | None = None
    reach: Reach = NOTHING_REACHED
    # offset that the path was made with; NaN if unknown, or if its contours have different ones
    offset_um: float = math.nan
    passes: tuple[PassFigures, ...] = ()  # None for a cut in one pass
    heights: tuple[HeightError, ...] = ()  # the profile error slice by slice, from the bottom
