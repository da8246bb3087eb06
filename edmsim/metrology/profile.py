"""Profile error: how far the part's wall is from the edge as drawn.

It is measured on the kerf field as a coordinate measuring machine would measure the part, slice by slice.
Positive profile error is metal left on the part, negative is undercut.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edmsim.geometry import Polyline, left_of
from edmsim.metrology.edges import check_slices, edge_segments, metal_at
from edmsim.metrology.surroundings import BLANK_EDGE_MM, GRAIN_UM, clear_of_steps, depth_in_blank, wire_line
from edmsim.plant.workpiece.kerf_field import KerfField
from edmsim.program.path import WireContour

Floats = NDArray[np.float64]

PROFILE_STEP_MM = 0.02
LEAD_IN_REACH_MM = 0.25
"""Arc length on both sides of the lead-in's end that may carry its witness mark: about one wire."""
FRONT_MM = 0.25
"""Nearer than this to where the cut stopped, the rounded front would be taken for the wall."""
FARTHEST_WALL_MM = 1.0
NEAR_SEGMENTS = 8
"""Segments, those with the nearest middles, that are tried for the nearest wall: more cannot crowd there."""


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
        return finite_mean(self.error_um, axis=0)

    def stats(self, with_lead_in: bool = True) -> dict[str, float]:
        """Return ``max`` (largest magnitude), ``rms`` and ``p95`` (of the magnitude), in um.

        They are taken over every point of every slice, by default with the place of the lead-in: a witness
        mark is an error of the part like any other. All are NaN if nothing was measured.
        """
        error = self.error_um if with_lead_in else self.error_um[:, ~self.at_lead_in]
        return error_stats(error)


def error_stats(error_um: Floats) -> dict[str, float]:
    """Return ``max``, ``rms`` and ``p95`` of the magnitude of errors that were measured; NaN if none was."""
    size = np.abs(error_um[np.isfinite(error_um)])
    if not len(size):
        return dict.fromkeys(("max", "rms", "p95"), float("nan"))
    rms = float(np.sqrt(np.mean(size**2)))
    return {"max": float(size.max()), "rms": rms, "p95": float(np.percentile(size, 95))}


def profile_error(field: KerfField, contour: WireContour, slices: Sequence[int] | None = None) -> ProfileError:
    """Measure how far the part's wall is from the edge as drawn.

    For every point of the nominal edge: the distance to the nearest place of the wall on the part's side of
    the wire's path. In an inner corner that is the metal the round wire cannot reach.

    Parameters
    ----------
    field : KerfField
    contour : WireContour
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
    error[:, depth_in_blank(field.stock, points) < BLANK_EDGE_MM] = np.nan
    error[clear_of_steps(field, points)[chosen] < BLANK_EDGE_MM] = np.nan
    lead_in_end = contour.points_um[contour.lead_in_moves] / 1000
    meeting = s_mm[[np.hypot(*(points - lead_in_end).T).argmin()]]
    return ProfileError(points, s_mm, error, line.distance_along(s_mm, meeting) <= LEAD_IN_REACH_MM)


class _WireTrack:
    """The wire's way round the contour as a dense row of points, each with its direction towards the part."""

    def __init__(self, contour: WireContour) -> None:
        from scipy.spatial import cKDTree

        line = wire_line(contour)
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


def finite_mean(values: Floats, axis: int) -> Floats:
    """Mean of the finite values along an axis; NaN where there are none."""
    finite = np.isfinite(values)
    count = finite.sum(axis=axis)
    total = np.where(finite, values, 0.0).sum(axis=axis)
    return np.asarray(np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0), np.float64)
