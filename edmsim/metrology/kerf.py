"""Width of the kerf, measured across the wire's path in every slice."""

from dataclasses import dataclass

import numpy as np

from edmsim.errors import InputError
from edmsim.geometry import Floats, Polyline, left_of
from edmsim.metrology import profile
from edmsim.metrology.edges import metal_at
from edmsim.plant.workpiece.kerf_field import KerfField
from edmsim.program.path import WireContour

KERF_STEP_MM = 0.05
KERF_CLEARANCE_MM = 0.5
MAX_KERF_OVER_WIRE = 3.0  # wider than this many wire diameters, a kerf was opened by another cut


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
    s_mm = np.arange(KERF_STEP_MM / 2, line.length, KERF_STEP_MM)
    if contour.lean is None:
        return _widths(field, contour, line, s_mm, wire_diameter_um)
    heights = profile.slice_heights_mm(field, contour.lean.height_mm).tolist()
    return _of_slices(field, [contour.at_height(z) for z in heights], s_mm / line.length, wire_diameter_um)


def _of_slices(field: KerfField, sections: list[WireContour], shares: Floats, wire_diameter_um: float) -> KerfWidth:
    """Kerf of a leaning wire, slice by slice, at shares of the lengths of its paths."""
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
    """Kerf of a vertical wire at lengths of its path, in one slice or in all."""
    points = line.at(s_mm)
    across = left_of(line.tangent(s_mm, KERF_STEP_MM))
    walls = [
        wall_distance_um(field, points * 1000, side * across, MAX_KERF_OVER_WIRE * wire_diameter_um / 2)
        for side in (1.0, -1.0)
    ]
    solid = profile.clear_of_steps(field, points)
    if number is not None:
        walls, solid = [wall[[number]] for wall in walls], solid[[number]]
    width = walls[0] + walls[1]
    bad = (np.isnan(width) & (solid >= profile.BLANK_EDGE_MM)).any(axis=0)
    bad |= line.bend_deg(s_mm, KERF_STEP_MM) > 10.0
    marks = np.concatenate([[0.0, line.length], s_mm[bad]])
    clear = line.distance_along(s_mm, marks) >= KERF_CLEARANCE_MM
    clear &= profile.depth_in_blank(field.stock, points) >= KERF_CLEARANCE_MM
    part = walls[0 if contour.part_side == "left" else 1]
    has_kerf = solid[:, clear] >= KERF_CLEARANCE_MM
    return KerfWidth(s_mm[clear], *(np.where(has_kerf, um[:, clear], np.nan) for um in (width, part)))


def wall_distance_um(field: KerfField, start_um: Floats, direction: Floats, reach_um: float) -> Floats:
    """Distance in um along rays to the first metal: (n_slices, n); NaN from inside metal or beyond reach."""
    ray = np.arange(0.0, reach_um, field.cell_um / 2)
    out = np.empty((field.n_slices, len(start_um)))
    for first in range(0, len(start_um), 128):  # a bounded number of rays at a time keeps memory small
        rays = slice(first, first + 128)
        places = start_um[rays, None, :] + ray[:, None] * direction[rays, None, :]
        metal = metal_at(field, places.reshape(-1, 2)).reshape(field.n_slices, -1, len(ray))
        out[:, rays] = _first_wall(metal, int(2 * profile.GRAIN_UM / field.cell_um)) * (field.cell_um / 2)
    return out


def _first_wall(metal: Floats, run: int) -> Floats:
    """Where along the last axis metal first begins that lasts for `run` steps; NaN if at once or never."""
    lasting = np.lib.stride_tricks.sliding_window_view(metal >= 0.5, run, axis=-1).all(axis=-1)
    after = lasting.argmax(axis=-1)
    before = np.maximum(after - 1, 0)
    m0, m1 = (np.take_along_axis(metal, i[..., None], -1)[..., 0] for i in (before, after))
    rise = np.where(after > 0, m1 - m0, np.nan)
    return np.asarray(before + (0.5 - m0) / rise, np.float64)
