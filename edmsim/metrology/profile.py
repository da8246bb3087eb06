"""Measuring the cut: profile error, corners, kerf width, taper, roughness.

Everything is measured on the kerf field as a coordinate measuring machine would measure the part, slice by
slice, against the edge as drawn. Positive profile error is metal left on the part, negative is undercut.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.geometry import Polyline, left_of
from edmsim.metrology.edges import check_slices, edge_segments, metal_at
from edmsim.plant.workpiece.kerf_field import KerfField, Stock
from edmsim.program.path import Contour

Floats = NDArray[np.float64]

PROFILE_STEP_MM = 0.02
KERF_STEP_MM = 0.05
CORNER_REACH_MM = 0.15
"""Arc length on both sides of a corner over which its error is taken."""
LEAD_IN_REACH_MM = 0.25
"""Arc length on both sides of the lead-in's end that may carry its witness mark: about one wire."""
BLANK_EDGE_MM = 0.15
"""Nearer than this to the blank's own side or start hole, that edge could be taken for the cut's."""
FRONT_MM = 0.25
"""Nearer than this to where the cut stopped, the rounded front would be taken for the wall."""
FARTHEST_WALL_MM = 1.0
GRAIN_UM = 12.0
"""Metal (or a hole in it) thinner than this is a loose grain or sliver in the kerf, no wall."""
KERF_CLEARANCE_MM = 0.5
NEAR_SEGMENTS = 8
"""Segments, those with the nearest middles, that are tried for the nearest wall: more cannot crowd there."""
MAX_KERF_OVER_WIRE = 3.0
"""Wider than this many wire diameters, a kerf was opened by another cut."""
CRATER_DEPTH_RATIO = 0.067
"""Depth over diameter of a crater: median of the nine rows (0.053 to 0.081) of ETH's single discharges in
WEDM (Esteves et al. 2022, Procedia CIRP 113:232, doi:10.1016/j.procir.2022.09.151)."""


class CornerError(TypedDict):
    """A real corner of the edge as drawn and what became of it."""

    x_mm: float
    y_mm: float
    turn_deg: float
    error_um: float


@dataclass(frozen=True)
class ProfileError:
    """Signed distance from the edge as drawn to the part's wall as cut.

    Attributes
    ----------
    points_mm : array (n, 2)
        Points of the nominal edge, at most 0.02 mm apart; every real corner is one.
    s_mm : array (n,)
        Arc length along the nominal edge.
    error_um : array (slices, n)
        Positive where metal is left on the part, negative where it is undercut; NaN where the cut did not
        come, where a slice has no metal, or so near to the blank's own edge, or the edge of a step in that
        slice, that there is nothing to measure.
    at_lead_in : bool array (n,)
        Points within 0.25 mm of where the lead-in meets the contour: the witness mark, if there is one.
    """

    points_mm: Floats
    s_mm: Floats
    error_um: Floats
    at_lead_in: NDArray[np.bool_]

    @property
    def mean_um(self) -> Floats:
        """Error averaged over the slices, array (n,); NaN where no slice has one."""
        return _mean(self.error_um, axis=0)

    def stats(self, with_lead_in: bool = True) -> dict[str, float]:
        """Return ``max`` (largest magnitude), ``rms`` and ``p95`` (of the magnitude), in um.

        They are taken over every point of every slice, by default with the place of the lead-in: a witness
        mark is an error of the part like any other. All are NaN if nothing was measured.
        """
        error = self.error_um if with_lead_in else self.error_um[:, ~self.at_lead_in]
        return error_stats(error)


@dataclass(frozen=True)
class KerfWidth:
    """Distance between both walls, across the wire's path.

    Attributes
    ----------
    s_mm : array (n,)
        Arc length along the wire's path from the end of the lead-in, where the width was measured.
    width_um : array (slices, n)
        NaN where a slice of a stepped workpiece has no metal within 0.5 mm.
    part_um : array (slices, n)
        Of that width, from the wire's path to the wall on the part's side.
    """

    s_mm: Floats
    width_um: Floats
    part_um: Floats

    def stats(self) -> dict[str, float]:
        """Return ``mean``, ``min`` and ``max`` over all places and slices in um; NaN if there are none."""
        return width_stats(self.width_um)

    @property
    def slice_mean_um(self) -> Floats:
        """Mean width of each slice from the bottom up: the barrel or taper of the cut; NaN if unmeasured."""
        return _mean(self.width_um, axis=1)


def error_stats(error_um: Floats) -> dict[str, float]:
    """Return ``max``, ``rms`` and ``p95`` of the magnitude of errors that were measured; NaN if none was."""
    size = np.abs(error_um[np.isfinite(error_um)])
    if not len(size):
        return dict.fromkeys(("max", "rms", "p95"), float("nan"))
    rms = float(np.sqrt(np.mean(size**2)))
    return {"max": float(size.max()), "rms": rms, "p95": float(np.percentile(size, 95))}


def width_stats(width_um: Floats) -> dict[str, float]:
    """Return ``mean``, ``min`` and ``max`` of the kerf widths that were measured; NaN if none was."""
    width_um = width_um[np.isfinite(width_um)]
    if not width_um.size:
        return dict.fromkeys(("mean", "min", "max"), float("nan"))
    return {name: float(getattr(width_um, name)()) for name in ("mean", "min", "max")}


def profile_error(field: KerfField, contour: Contour, slices: Sequence[int] | None = None) -> ProfileError:
    """Measure how far the part's wall is from the edge as drawn.

    For every point of the nominal edge: the distance to the nearest place of the wall on the part's side of
    the wire's path. In an inner corner that is the metal the round wire cannot reach.

    Parameters
    ----------
    field : KerfField
    contour : Contour
    slices : sequence of int, optional
        Slices to measure; all by default.

    Raises
    ------
    InputError
        If there is no such slice.
    """
    chosen = list(range(field.n_slices) if slices is None else slices)
    check_slices(field, chosen)
    line = Polyline(contour.nominal_mm, contour.closed)
    s_mm = line.stations(PROFILE_STEP_MM, line.corners(15.0))
    points = line.at(s_mm)
    track = _WireTrack(contour)
    edges = (_without_grains(segments) for segments in edge_segments(field, chosen))
    size = np.stack([track.distance_to_wall(segments, points) for segments in edges])
    in_metal = metal_at(field, points * 1000)[chosen] >= 0.5
    error = np.where(in_metal, size, -size) * 1000
    uncut = metal_at(field, track.nearest(points) * 1000)[chosen] >= 0.5
    uncut &= np.roll(uncut, 1, axis=1) & np.roll(uncut, -1, axis=1)  # a single place may be a loose grain
    for row, marks in zip(error, uncut, strict=True):
        row[line.distance_along(s_mm, s_mm[marks]) <= FRONT_MM] = np.nan
    error[:, _depth_in_blank(field.stock, points) < BLANK_EDGE_MM] = np.nan
    error[_clear_of_steps(field, points)[chosen] < BLANK_EDGE_MM] = np.nan
    lead_in_end = contour.points_um[contour.lead_in_moves] / 1000
    meeting = s_mm[[np.hypot(*(points - lead_in_end).T).argmin()]]
    return ProfileError(points, s_mm, error, line.distance_along(s_mm, meeting) <= LEAD_IN_REACH_MM)


def corners(contour: Contour, profile: ProfileError, min_turn_deg: float = 15.0) -> list[CornerError]:
    """List the real corners of the nominal edge with their errors.

    Parameters
    ----------
    contour : Contour
    profile : ProfileError
        Of that contour.
    min_turn_deg : float
        Vertices that turn by less are chords of an arc.

    Returns
    -------
    list of dict
        ``x_mm``, ``y_mm``, ``turn_deg`` (left positive) and ``error_um``: the error, averaged over the
        height, of largest magnitude within 0.15 mm of the corner; NaN where none was measured.
    """
    line = Polyline(contour.nominal_mm, contour.closed)
    found: list[CornerError] = []
    for vertex in line.corners(min_turn_deg):
        near = profile.mean_um[line.distance_along(profile.s_mm, line.s[[vertex]]) <= CORNER_REACH_MM]
        near = near[np.isfinite(near)]
        error = float(near[np.abs(near).argmax()]) if len(near) else float("nan")
        x, y = (float(value) for value in line.points[vertex])
        found.append(CornerError(x_mm=x, y_mm=y, turn_deg=float(line.turn_deg[vertex]), error_um=error))
    return found


def kerf_width(field: KerfField, contour: Contour, wire_diameter_um: float) -> KerfWidth:
    """Measure the kerf every 0.05 mm across the wire's path, in all slices.

    Left out are places within 0.5 mm of the contour's beginning and end, of corners and arcs tighter than
    about 0.3 mm, of the blank's own edges, in each slice of the edges of its steps, and of where a wall is
    missing: not yet cut, or opened by another cut (wider than three wires).

    Parameters
    ----------
    field : KerfField
    contour : Contour
    wire_diameter_um : float
        Above 0.

    Raises
    ------
    InputError
        If the wire's diameter is not above 0.
    """
    if not wire_diameter_um > 0:
        raise InputError(f"a wire diameter of {wire_diameter_um} um cannot be: it must be above 0")
    line = _wire_line(contour)
    s_mm = np.arange(KERF_STEP_MM / 2, line.length, KERF_STEP_MM)
    points = line.at(s_mm)
    across = left_of(line.tangent(s_mm, KERF_STEP_MM))
    walls = [
        _wall_distance(field, points * 1000, side * across, MAX_KERF_OVER_WIRE * wire_diameter_um / 2)
        for side in (1.0, -1.0)
    ]
    width = walls[0] + walls[1]
    solid = _clear_of_steps(field, points)
    bad = (np.isnan(width) & (solid >= BLANK_EDGE_MM)).any(axis=0) | (line.bend_deg(s_mm, KERF_STEP_MM) > 10.0)
    marks = np.concatenate([[0.0, line.length], s_mm[bad]])
    clear = line.distance_along(s_mm, marks) >= KERF_CLEARANCE_MM
    clear &= _depth_in_blank(field.stock, points) >= KERF_CLEARANCE_MM
    part = walls[0 if contour.part_side == "left" else 1]
    kept = solid[:, clear] >= KERF_CLEARANCE_MM
    return KerfWidth(s_mm[clear], *(np.where(kept, um[:, clear], np.nan) for um in (width, part)))


def roughness_um(crater_volume_um3: float, depth_ratio: float = CRATER_DEPTH_RATIO) -> float:
    """Estimate Ra in um of a surface that craters of a mean volume cover side by side.

    A crater is half a flat ellipsoid, as in ETH's data: volume 2/3 area * depth, so with ``k`` = depth over
    diameter ``V = pi k D**3 / 6``. Over its area the depth is ``k D sqrt(u)``, ``u`` uniform in 0..1: on
    average 2/3 of the full depth, with a mean deviation, which is Ra, of 16/81 of it. Derived here, not
    measured: rims, overlap and recast metal are left out, so take it as a lower bound with the right trend
    (Ra rises with the cube root of the volume; published: with the pulse energy to the power 0.3 to 0.4).

    Parameters
    ----------
    crater_volume_um3 : float
        Mean volume of a crater, 0 or more.
    depth_ratio : float
        Depth over diameter, above 0; 0.053 to 0.081 in ETH's data.

    Raises
    ------
    InputError
        If the volume is negative or the ratio not above 0.
    """
    if not crater_volume_um3 >= 0:
        raise InputError(f"a crater volume of {crater_volume_um3} um3 cannot be: it must be 0 or more")
    if not depth_ratio > 0:
        raise InputError(f"a crater depth ratio of {depth_ratio} cannot be: it must be above 0")
    diameter_um = float(np.cbrt(6 * crater_volume_um3 / (np.pi * depth_ratio)))
    return 16 / 81 * depth_ratio * diameter_um


class _WireTrack:
    """The wire's way round the contour as a dense row of points, each with its direction towards the part."""

    def __init__(self, contour: Contour) -> None:
        from scipy.spatial import cKDTree

        line = _wire_line(contour)
        s = line.stations(0.01, np.arange(len(line.points) - 1))
        self.points = line.at(s)
        # At a vertex this direction is the bisector, which tells the sides apart all round the vertex.
        towards_left = left_of(line.tangent(s, 1e-3))
        self.towards_part = towards_left if contour.part_side == "left" else -towards_left
        self.tree = cKDTree(self.points)

    def nearest(self, places: Floats) -> Floats:
        """Point of the track nearest to each of `places`."""
        return np.asarray(self.points[self.tree.query(places)[1]])

    def on_part_side(self, places: Floats) -> NDArray[np.bool_]:
        """Whether each of `places` is on the part's side."""
        i = self.tree.query(places)[1]
        return np.asarray(((places - self.points[i]) * self.towards_part[i]).sum(axis=1) > 0)

    def distance_to_wall(self, segments: Floats, points: Floats) -> Floats:
        """Distance in mm from each point to the nearest segment on the part's side; NaN if over 1 mm."""
        from scipy.spatial import cKDTree

        middle = segments.mean(axis=1)
        wall = self.on_part_side(middle)
        if wall.sum() < NEAR_SEGMENTS:
            return np.full(len(points), np.nan)
        tried = segments[wall][cKDTree(middle[wall]).query(points, NEAR_SEGMENTS)[1]]
        distance = _distance_to_segments(points[:, None], tried[:, :, 0], tried[:, :, 1]).min(axis=1)
        return np.where(distance <= FARTHEST_WALL_MM, distance, np.nan)


def _wire_line(contour: Contour) -> Polyline:
    """The wire's path in mm without the lead-in."""
    points = contour.points_um[contour.lead_in_moves :]
    return Polyline(points / 1000, closed=bool((points[0] == points[-1]).all()))


def _wall_distance(field: KerfField, start_um: Floats, direction: Floats, reach_um: float) -> Floats:
    """Distance in um along rays to the first metal: (n_slices, n); NaN from inside metal or beyond reach."""
    ray = np.arange(0.0, reach_um, field.cell_um / 2)
    out = np.empty((field.n_slices, len(start_um)))
    for first in range(0, len(start_um), 128):  # a bounded number of rays at a time keeps memory small
        rays = slice(first, first + 128)
        places = start_um[rays, None, :] + ray[:, None] * direction[rays, None, :]
        metal = metal_at(field, places.reshape(-1, 2)).reshape(field.n_slices, -1, len(ray))
        out[:, rays] = _first_wall(metal, int(2 * GRAIN_UM / field.cell_um)) * (field.cell_um / 2)
    return out


def _first_wall(metal: Floats, run: int) -> Floats:
    """Where along the last axis metal first begins that lasts for `run` steps; NaN if at once or never."""
    lasting = np.lib.stride_tricks.sliding_window_view(metal >= 0.5, run, axis=-1).all(axis=-1)
    after = lasting.argmax(axis=-1)
    before = np.maximum(after - 1, 0)
    m0, m1 = (np.take_along_axis(metal, i[..., None], -1)[..., 0] for i in (before, after))
    rise = np.where(after > 0, m1 - m0, np.nan)
    return np.asarray(before + (0.5 - m0) / rise, np.float64)


def _without_grains(segments: Floats) -> Floats:
    """Leave out the segments (m, 2, 2) of outlines of grains, slivers and pits."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ends = segments.reshape(-1, 2) @ (1, 1j)
    _, vertex = np.unique(ends, return_inverse=True)
    start, stop = vertex.reshape(-1, 2).T
    joined = coo_array((np.ones(len(start), np.int8), (start, stop)), shape=(len(ends), len(ends)))
    outline = connected_components(joined, directed=False)[1][start]
    (x0, y0), (x1, y1) = segments[:, 0].T, segments[:, 1].T
    twice_area = np.abs(np.bincount(outline, x0 * y1 - x1 * y0))
    # a strip of width w has an area of w times half its outline
    grain = twice_area < np.bincount(outline, np.hypot(x1 - x0, y1 - y0)) * GRAIN_UM / 1000
    return np.asarray(segments[~grain[outline]], np.float64)


def _distance_to_segments(points: Floats, start: Floats, stop: Floats) -> Floats:
    """Distances (...) of points to segments, all of shape (..., 2)."""
    along, way = stop - start, points - start
    share = np.clip((way * along).sum(axis=-1) / (along**2).sum(axis=-1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(way - share[..., None] * along, axis=-1), np.float64)


def _depth_in_blank(stock: Stock, points_mm: Floats) -> Floats:
    """Distance in mm to the blank's nearest own edge, side or start hole; negative outside the metal."""
    x, y = points_mm.T
    x0, y0, x1, y1 = (side / 1000 for side in stock.rectangle_um)
    depth = np.minimum(np.minimum(x - x0, x1 - x), np.minimum(y - y0, y1 - y))
    for hole_x, hole_y, radius in stock.holes_um:
        depth = np.minimum(depth, np.hypot(x - hole_x / 1000, y - hole_y / 1000) - radius / 1000)
    return np.asarray(depth)


def _clear_of_steps(field: KerfField, points_mm: Floats) -> Floats:
    """Distance in mm to where each slice has no metal from the beginning, (n_slices, n); 0 inside it."""
    if field.relief is None:
        return np.full((field.n_slices, len(points_mm)), np.inf)
    return field.relief.clearance_um(points_mm * 1000) / 1000


def _mean(values: Floats, axis: int) -> Floats:
    """Mean of the finite values along an axis; NaN where there are none."""
    finite = np.isfinite(values)
    count = finite.sum(axis=axis)
    total = np.where(finite, values, 0.0).sum(axis=axis)
    return np.asarray(np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0), np.float64)
