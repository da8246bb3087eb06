"""The wall after a pass: its distance from the drawing, straightness and ripple; and pieces that come loose."""

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.geometry import Floats, Polyline, arc_lengths, left_of
from edmsim.metrology import profile
from edmsim.metrology.edges import contour
from edmsim.metrology.kerf import MAX_KERF_OVER_WIRE, wall_distance_um
from edmsim.plant.workpiece.kerf_field import KerfField
from edmsim.program.outline import Side
from edmsim.program.passes import CutPass

STEP_MM = 0.05
CLEARANCE_MM = 0.4  # nearer than this to a corner, or to either end of a pass, the wall is not looked at
FEWEST_WAVES = 3  # waves that must have been cut before a wavelength is reported (ours)


@dataclass(frozen=True)
class WallError:
    """What of a wall a pass left, over the drawing: positive is metal left on the part."""

    places: int  # places along the pass that were measured
    mean_um: float  # over all places and heights; NaN where there are none, as all others then
    rms_um: float  # scatter about that mean
    slices_um: tuple[float, ...]  # mean at every height, from the lowest slice
    bow_um: float  # mid height over the mean of both ends: positive for a wall that is convex, thicker in the middle
    straightness_um: float  # from the lowest to the highest of the heights
    ripple_um: float  # scatter along the path of the mean over the height
    ripple_mm: float  # wavelength with the most of it; NaN where the pass is too short to tell

    @property
    def waves_um(self) -> float:
        """Scatter along the path, at every height about its own mean: root mean square."""
        return math.sqrt(max(self.rms_um**2 - float(np.nanvar(self.slices_um)), 0.0))


def wall_error(field: KerfField, cut_pass: CutPass, part_side: Side, wire_diameter_um: float) -> WallError:
    """Measure the wall on the part's side of a pass, across its path; a wall that leans square to itself."""
    reach_um = MAX_KERF_OVER_WIRE * wire_diameter_um / 2
    left = (part_side == "left") != cut_pass.reversed
    line = _line_of(cut_pass.way.at_mid_height(), cut_pass)
    s_mm = np.arange(STEP_MM / 2, line.length, STEP_MM)
    if cut_pass.lean is None:
        known = _looked_at(field, line, s_mm)
        s_mm = s_mm[known]
        if not len(s_mm):
            return unknown_wall((math.nan,) * field.n_slices)
        away_um, solid = _wall_um(field, line, s_mm, left, reach_um)
        return _summed(s_mm, np.where(solid, cut_pass.offset_um - away_um, np.nan))
    # of a leaning wire slice by slice, at the same shares of the length of its path
    error_um, slants = np.full((field.n_slices, len(s_mm)), np.nan), cut_pass.way.slant[cut_pass.approach_moves :]
    passed_mm = arc_lengths(cut_pass.way.at_mid_height()[cut_pass.approach_moves :] * 1e-3)
    for number, z in enumerate(profile.slice_heights_mm(field, cut_pass.lean.height_mm).tolist()):
        there = _line_of(cut_pass.way.at_height(z), cut_pass)
        own_mm = s_mm / line.length * there.length
        known = _looked_at(field, there, own_mm)
        away_um, solid = _wall_um(field, there, own_mm[known], left, reach_um)
        slant = slants[np.clip(np.searchsorted(passed_mm, s_mm[known], side="right") - 1, 0, len(slants) - 1)]
        error_um[number, known] = np.where(solid, cut_pass.offset_um - away_um / slant, np.nan)[number]
    return _summed(s_mm, error_um)


def _line_of(points_um: NDArray[np.int64], cut_pass: CutPass) -> Polyline:
    return Polyline(np.asarray(points_um[cut_pass.approach_moves :] * 1e-3, np.float64), closed=False)


def _looked_at(field: KerfField, line: Polyline, s_mm: Floats) -> NDArray[np.bool_]:
    """Say at which lengths of a pass its wall is looked at: clear of its ends, of corners and of the blank's edge."""
    marks = np.concatenate(
        [[0.0, line.length], line.s[line.corners(profile.EDGE_CORNER_DEG)], s_mm[line.bend_deg(s_mm, STEP_MM) > 10.0]]
    )
    clear = line.distance_along(s_mm, marks) >= CLEARANCE_MM
    return clear & (profile.depth_in_blank(field.stock, line.at(s_mm)) >= profile.BLANK_EDGE_MM)


def _wall_um(
    field: KerfField, line: Polyline, s_mm: Floats, left: bool, reach_um: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the distance of the wall (slices, n) across a path, and where there is metal to have one."""
    points = line.at(s_mm)
    across = left_of(line.tangent(s_mm, STEP_MM)) * (1.0 if left else -1.0)
    away_um = wall_distance_um(field, points * 1000, across, reach_um)
    return away_um, profile.clear_of_steps(field, points) >= profile.BLANK_EDGE_MM


def unknown_wall(slices_um: tuple[float, ...]) -> WallError:
    """Return the error of a wall of which nothing is known but, perhaps, some slices."""
    return WallError(0, math.nan, math.nan, slices_um, math.nan, math.nan, math.nan, math.nan)


def _summed(s_mm: Floats, error_um: Floats) -> WallError:
    slices = profile.finite_mean(error_um, axis=1)
    known = error_um[np.isfinite(error_um)]
    if not len(known):
        return unknown_wall(tuple(slices.tolist()))
    heights = slices[np.isfinite(slices)]
    along = profile.finite_mean(error_um - slices[:, None], axis=0)
    ends = (heights[0] + heights[-1]) / 2
    quarter = max(len(heights) // 4, 1)
    middle = heights[quarter:-quarter] if len(heights) > 2 * quarter else heights
    return WallError(
        places=int(np.isfinite(error_um).any(axis=0).sum()), mean_um=float(known.mean()), rms_um=float(known.std()),
        slices_um=tuple(slices.tolist()), bow_um=float(middle.mean() - ends), straightness_um=float(np.ptp(heights)),
        ripple_um=float(np.nanstd(along)), ripple_mm=_wavelength_mm(s_mm, along),
    )  # fmt: skip


def _wavelength_mm(s_mm: Floats, along_um: Floats) -> float:
    """Return the wavelength with the greatest amplitude of the longest unbroken stretch; NaN if it is too short."""
    ends = np.flatnonzero(np.diff(s_mm) > 1.5 * STEP_MM) + 1
    longest = max(np.split(np.arange(len(s_mm)), ends), key=len)
    values = along_um[longest]
    if len(values) < 4 * FEWEST_WAVES or not np.isfinite(values).all():
        return math.nan
    spread = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values))))
    spread[:FEWEST_WAVES] = 0.0
    return len(values) * STEP_MM / int(spread.argmax())


RIM_CELLS = 1.5
"""How far beyond its outline a loose piece is taken, in cells: partly filled cells of its rim belong to it (ours)."""


def loose_pieces(field: KerfField, least_mm2: float) -> list[shapely.Polygon]:
    """Return the pieces of `least_mm2` that are cut all round in every slice that has them, in um on the table."""
    holes = shapely.union_all([shapely.Point(x, y).buffer(r) for x, y, r in field.stock.holes_um])
    found: shapely.Geometry | None = None
    for number in range(field.n_slices):
        cut_um = shapely.transform(contour(field, number), lambda mm: mm * 1e3).union(holes)
        islands = [
            shapely.Polygon(ring)
            for part in shapely.get_parts(cut_um) if isinstance(part, shapely.Polygon)
            for ring in part.interiors
        ]  # fmt: skip
        metal = shapely.union_all([island for island in islands if island.area >= least_mm2 * 1e6])
        if field.relief is not None:  # what has no metal at this height holds nothing
            metal = metal.union(field.relief.voids_um[number])
        found = metal if found is None else found.intersection(metal)
    pieces = [] if found is None else [p for p in shapely.get_parts(found) if isinstance(p, shapely.Polygon)]
    gone = shapely.union_all(field.gone)
    rim = RIM_CELLS * field.cell_um
    return [
        shapely.Polygon(shapely.Polygon(piece.exterior).buffer(rim).exterior)
        for piece in pieces
        if piece.area >= least_mm2 * 1e6 and not gone.contains(piece.representative_point())
    ]


def lever_mm(piece: shapely.Polygon, last_um: tuple[float, float]) -> float:
    """Return how far the piece's centre is from where it was held last: what it would tip about."""
    x, y = piece.centroid.x, piece.centroid.y
    return float(np.hypot(x - last_um[0], y - last_um[1])) * 1e-3
