"""Kerf width and the wall after a pass, measured slice by slice across the wire's path.

Of the wall: its distance from the drawing, straightness and ripple.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.geometry import Floats, Polyline, arc_lengths, left_of
from edmsim.metrology import edges, profile
from edmsim.plant.workpiece.kerf_field import KerfField
from edmsim.program.passes import CutPass
from edmsim.program.path import WireContour

STEP_MM = 0.05  # distance along a path between measurements
KERF_CLEARANCE_MM = 0.5
MAX_KERF_OVER_WIRE = 3.0  # in wire diameters; a wider kerf was opened by another cut


@dataclass(frozen=True)
class KerfWidth:
    """Distance between both walls, across the wire's path."""

    s_mm: Floats  # (n,): length along the wire's path from the end of the lead-in
    width_um: Floats  # (slices, n): NaN if the slice has no metal within 0.5 mm
    part_um: Floats  # (slices, n): from the wire's path to the wall on the part's side


def width_stats(width_um: Floats) -> dict[str, float]:
    """Return ``mean``, ``min`` and ``max`` of the kerf widths that were measured; NaN if none was."""
    width_um = width_um[np.isfinite(width_um)]
    if not width_um.size:
        return dict.fromkeys(("mean", "min", "max"), float("nan"))
    return {name: float(getattr(width_um, name)()) for name in ("mean", "min", "max")}


def kerf_width(field: KerfField, contour: WireContour, wire_diameter_um: float) -> KerfWidth:
    """Measure the kerf every 0.05 mm across the wire's path, in all slices.

    It omits places within 0.5 mm of the contour's ends, of corners and small arcs, of edges of the blank or of a step
    in the slice, and of missing walls: not yet cut, or opened by another cut.
    """
    if not wire_diameter_um > 0:
        raise InputError(f"a wire diameter of {wire_diameter_um} um cannot be: it must be above 0")
    line = profile.wire_line(contour.at_mid_height())
    s_mm = np.arange(STEP_MM / 2, line.length, STEP_MM)
    if contour.lean is None:
        return _widths(field, contour, line, s_mm, wire_diameter_um)
    heights = profile.slice_heights_mm(field, contour.lean.height_mm).tolist()
    return _of_slices(field, [contour.at_height(z) for z in heights], s_mm / line.length, wire_diameter_um)


def _of_slices(field: KerfField, sections: list[WireContour], shares: Floats, wire_diameter_um: float) -> KerfWidth:
    """Return the kerf of a leaning wire, slice by slice, at `shares` of each slice's path length."""
    rows = np.full((2, field.n_slices, len(shares)), np.nan)
    lengths = [0.0]
    for number, section in enumerate(sections):
        line = profile.wire_line(section)
        found = _widths(field, section, line, shares * line.length, wire_diameter_um, number)
        places = np.rint(np.interp(found.s_mm, shares * line.length, np.arange(len(shares)))).astype(int)
        rows[:, number, places] = found.width_um[0], found.part_um[0]
        lengths.append(line.length)
    return KerfWidth(shares * lengths[1 + len(sections) // 2], rows[0], rows[1])


def _widths(
    field: KerfField, contour: WireContour, line: Polyline, s_mm: Floats, wire_diameter_um: float,
    number: int | None = None,
) -> KerfWidth:
    """Return the kerf of a vertical wire at lengths of its path, in slice `number` or in all."""
    points = line.at(s_mm)
    walls = [_wall_um(field, line, s_mm, side, wire_diameter_um) for side in ("left", "right")]
    solid = profile.clear_of_steps(field, points)
    if number is not None:
        walls, solid = [wall[[number]] for wall in walls], solid[[number]]
    width = walls[0] + walls[1]
    bad = (np.isnan(width) & (solid >= profile.BLANK_EDGE_MM)).any(axis=0)
    bad |= line.bend_deg(s_mm, STEP_MM) > 10.0
    marks = np.concatenate([[0.0, line.length], s_mm[bad]])
    clear = line.distance_along(s_mm, marks) >= KERF_CLEARANCE_MM
    clear &= profile.depth_in_blank(field.stock, points) >= KERF_CLEARANCE_MM
    part = walls[0 if contour.part_side == "left" else 1]
    has_kerf = solid[:, clear] >= KERF_CLEARANCE_MM
    return KerfWidth(s_mm[clear], *(np.where(has_kerf, um[:, clear], np.nan) for um in (width, part)))


def _wall_um(field: KerfField, line: Polyline, s_mm: Floats, side: str, wire_diameter_um: float) -> Floats:
    """Return the distance in um (n_slices, n) across a path to the first metal; NaN from inside metal or if none."""
    start_um, across = line.at(s_mm) * 1000, left_of(line.tangent(s_mm, STEP_MM))
    direction = across if side == "left" else -across
    ray = np.arange(0.0, MAX_KERF_OVER_WIRE * wire_diameter_um / 2, field.cell_um / 2)
    run = int(2 * profile.GRAIN_UM / field.cell_um)

    def metal(rays: NDArray[np.int64], steps: int) -> Floats:
        places = start_um[rays, None, :] + ray[:steps, None] * direction[rays, None, :]
        return edges.metal_at(field, places.reshape(-1, 2)).reshape(field.n_slices, -1, steps)

    out = np.full((field.n_slices, len(s_mm)), np.nan)
    for first in range(0, len(s_mm), 128):  # a bounded number of rays at a time keeps memory small
        rays = np.arange(first, min(first + 128, len(s_mm)))
        rays = rays[(metal(rays, run) < 0.5).any(axis=(0, 2))]  # the wire has not been at the others
        out[:, rays] = _first_wall(metal(rays, len(ray)), run) * (field.cell_um / 2)
    return out


def _first_wall(metal: Floats, run: int) -> Floats:
    """Return where metal of at least `run` steps begins along the last axis; NaN if at the first step or never."""
    solid, begins = metal >= 0.5, metal.shape[-1] - run + 1
    lasting = np.logical_and.reduce([solid[..., k : k + begins] for k in range(run)])
    after = lasting.argmax(axis=-1)
    before = np.maximum(after - 1, 0)
    m0, m1 = (np.take_along_axis(metal, i[..., None], -1)[..., 0] for i in (before, after))
    rise = np.where(after > 0, m1 - m0, np.nan)
    return np.asarray(before + (0.5 - m0) / rise, np.float64)


WALL_CLEARANCE_MM = 0.4  # the wall is not measured nearer than this to a corner or to either end of a pass
FEWEST_WAVES = 3  # least number of waves in a pass for a wavelength to be reported (ours)


@dataclass(frozen=True)
class WallError:
    """Error of the wall after a pass, relative to the drawing; positive if metal is left on the part."""

    places: int  # places along the pass that were measured
    mean_um: float  # over all places and heights; NaN if there are none, as are the fields below
    rms_um: float  # standard deviation about this mean
    slices_um: tuple[float, ...]  # mean at every height, from the lowest slice
    # mid height over the mean of both ends: positive for a wall that is convex, thicker in the middle; NaN below
    # three measured heights
    bow_um: float
    straightness_um: float  # range of the means of all heights; NaN with only one
    ripple_um: float  # standard deviation along the path of the mean over the height; NaN with only one place
    ripple_mm: float  # wavelength of the greatest ripple; NaN if the pass is too short

    @property
    def waves_um(self) -> float:
        """Root mean square along the path of the deviation from the mean at each height."""
        return math.sqrt(max(self.rms_um**2 - float(np.nanvar(self.slices_um)), 0.0))


def wall_error(field: KerfField, cut_pass: CutPass, part_side: str, wire_diameter_um: float) -> WallError:
    """Measure the wall on the part's side of a pass, across its path; a leaning wall perpendicular to the wall."""
    side = part_side if not cut_pass.reversed else "right" if part_side == "left" else "left"
    middle_um = cut_pass.wire_path.at_mid_height()
    line = _line_of(middle_um, cut_pass)
    s_mm = np.arange(STEP_MM / 2, line.length, STEP_MM)

    def error_um(along: Polyline, at_mm: Floats, slant: float | Floats = 1.0) -> Floats:
        away_um = _wall_um(field, along, at_mm, side, wire_diameter_um) / slant
        has_metal = profile.clear_of_steps(field, along.at(at_mm)) >= profile.BLANK_EDGE_MM
        return np.where(has_metal, cut_pass.offset_um - away_um, np.nan)

    if cut_pass.lean is None:
        s_mm = s_mm[_looked_at(field, line, s_mm)]
        return _summed(s_mm, error_um(line, s_mm)) if len(s_mm) else unknown_wall((math.nan,) * field.n_slices)
    # for a leaning wire, slice by slice at the same shares of the path length
    found_um = np.full((field.n_slices, len(s_mm)), np.nan)
    slants = cut_pass.wire_path.slant[cut_pass.approach_moves :]
    passed_mm = arc_lengths(middle_um[cut_pass.approach_moves :] * 1e-3)
    for number, z in enumerate(profile.slice_heights_mm(field, cut_pass.lean.height_mm).tolist()):
        there = _line_of(cut_pass.wire_path.at_height(z), cut_pass)
        own_mm = s_mm / line.length * there.length
        known = _looked_at(field, there, own_mm)
        slant = slants[np.clip(np.searchsorted(passed_mm, s_mm[known], side="right") - 1, 0, len(slants) - 1)]
        found_um[number, known] = error_um(there, own_mm[known], slant)[number]
    return _summed(s_mm, found_um)


def _line_of(points_um: NDArray[np.int64], cut_pass: CutPass) -> Polyline:
    return Polyline(np.asarray(points_um[cut_pass.approach_moves :] * 1e-3, np.float64), closed=False)


def _looked_at(field: KerfField, line: Polyline, s_mm: Floats) -> NDArray[np.bool_]:
    """Return the mask of lengths at which a pass is measured: away from its ends, corners and the blank's edge."""
    marks = np.concatenate(
        [[0.0, line.length], line.s[line.corners(profile.EDGE_CORNER_DEG)], s_mm[line.bend_deg(s_mm, STEP_MM) > 10.0]]
    )
    clear = line.distance_along(s_mm, marks) >= WALL_CLEARANCE_MM
    return clear & (profile.depth_in_blank(field.stock, line.at(s_mm)) >= profile.BLANK_EDGE_MM)


def unknown_wall(slices_um: tuple[float, ...]) -> WallError:
    """Return a `WallError` that is unknown (NaN) except, possibly, for the means of some slices."""
    return WallError(0, math.nan, math.nan, slices_um, math.nan, math.nan, math.nan, math.nan)


def _summed(s_mm: Floats, error_um: Floats) -> WallError:
    slices = profile.finite_mean(error_um, axis=1)
    known = error_um[np.isfinite(error_um)]
    if not len(known):
        return unknown_wall(tuple(slices.tolist()))
    heights = slices[np.isfinite(slices)]
    along = profile.finite_mean(error_um - slices[:, None], axis=0)
    places, quarter = int(np.isfinite(along).sum()), max(len(heights) // 4, 1)
    bow_um = heights[quarter:-quarter].mean() - (heights[0] + heights[-1]) / 2 if len(heights) > 2 else math.nan
    return WallError(
        places=places, mean_um=float(known.mean()), rms_um=float(known.std()),
        slices_um=tuple(slices.tolist()), bow_um=float(bow_um),
        straightness_um=float(np.ptp(heights)) if len(heights) > 1 else math.nan,
        ripple_um=float(np.nanstd(along)) if places > 1 else math.nan, ripple_mm=_wavelength_mm(s_mm, along),
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
