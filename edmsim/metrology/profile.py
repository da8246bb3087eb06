"""Profile error: the distance of the part's wall from the edge as drawn, also at corners and by element.

It is measured on the kerf field as a coordinate measuring machine would measure the part, slice by slice.
Positive profile error is metal left on the part, negative is undercut. No wall can be measured near the wire's own
path, the blank's edges and its steps.
"""

from dataclasses import dataclass

import numpy as np
import scipy  # loads its subpackages when they are first used
from numpy.typing import NDArray

from edmsim.geometry import Floats, Polyline, arc_lengths, interpolated, left_of
from edmsim.metrology.edges import edge_segments, metal_at
from edmsim.plant.workpiece.kerf_field import KerfField, Stock
from edmsim.program.arcs import ROUND_MM
from edmsim.program.path import WireContour
from edmsim.program.taper import is_straight

BLANK_EDGE_MM = 0.15  # nearer than this to the blank's side or start hole, that edge could be mistaken for the cut's
EDGE_CORNER_DEG = 15.0  # a vertex of the drawn edge that turns by less is not a corner (ours)
GRAIN_UM = 12.0  # metal (or a hole in it) thinner than this is a loose grain or sliver in the kerf, not a wall


def wire_line(contour: WireContour) -> Polyline:
    """Return the wire's path in mm without the lead-in."""
    points = contour.points_um[contour.lead_in_moves :]
    return Polyline(points / 1000, closed=bool((points[0] == points[-1]).all()))


def edge_corners(contour: WireContour, line: Polyline) -> NDArray[np.intp]:
    """Return the vertices of a contour's nominal edge, `line`, that are corners: none within a curve."""
    vertices = line.corners(EDGE_CORNER_DEG)
    return np.asarray(vertices[_between_elements(contour, line)[vertices]])


def _between_elements(contour: WireContour, line: Polyline) -> NDArray[np.bool_]:
    """Return for each vertex of a contour's nominal edge, `line`, whether an element begins; all True if unknown."""
    if not contour.elements:
        return np.ones(len(line.s), np.bool_)
    begins, near_mm, elements = arc_lengths(contour.nominal_mm), 1e-5, np.array(contour.elements)[:, 0]
    before, after = (
        elements[np.clip(np.searchsorted(begins, line.s + by, side="right") - 1, 0, len(elements) - 1)]
        for by in (-near_mm, near_mm)
    )
    return np.append(True, (before != after)[1:])


def depth_in_blank(stock: Stock, points_mm: Floats) -> Floats:
    """Return the distance in mm to the blank's nearest side or start hole; negative outside the metal."""
    x, y = points_mm.T
    x0, y0, x1, y1 = (side / 1000 for side in stock.rectangle_um)
    depth = np.minimum(np.minimum(x - x0, x1 - x), np.minimum(y - y0, y1 - y))
    for hole_x, hole_y, radius in stock.holes_um:
        depth = np.minimum(depth, np.hypot(x - hole_x / 1000, y - hole_y / 1000) - radius / 1000)
    return np.asarray(depth)


def clear_of_steps(field: KerfField, points_mm: Floats) -> Floats:
    """Return the distance in mm (n_slices, n) to places where the blank has no metal in a slice; 0 at these."""
    if field.relief is None:
        return np.full((field.n_slices, len(points_mm)), np.inf)
    return field.relief.clearance_um(points_mm * 1000) / 1000


PROFILE_STEP_MM = 0.02
LEAD_IN_REACH_MM = 0.25
"""Arc length on both sides of the lead-in's end that may carry its witness mark: about one wire."""
FRONT_MM = 0.25  # nearer than this to where the cut stopped, the round front would be mistaken for the wall
FARTHEST_WALL_MM = 1.0
PLACE_REACH_MM = 0.5  # a place of the wire belongs to the point of an edge only within this distance
NEAR_SEGMENTS = 8
"""Segments, by nearest middle, among which the nearest wall is searched; more cannot be as near."""


@dataclass(frozen=True)
class ProfileError:
    """Signed distance from the nominal edge to the part's wall."""

    points_mm: Floats  # (n, 2): at most 0.02 mm apart, with all real corners; of a tapered wall at half the height
    s_mm: Floats  # (n,): length along the nominal edge
    # (slices, n): positive if metal is left; NaN where not cut, without metal, or too near to an edge of the blank or
    # of a step in that slice
    error_um: Floats
    at_lead_in: NDArray[np.bool_]  # (n,): within 0.25 mm of the end of the lead-in, which may have a witness mark

    @property
    def mean_um(self) -> Floats:
        """Mean error over the slices, array (n,); NaN if all slices are."""
        return finite_mean(self.error_um, axis=0)

    def stats(self) -> dict[str, float]:
        """Return ``max``, ``rms`` and ``p95`` of the magnitude, in um, over all points and slices; NaN if unknown."""
        return error_stats(self.error_um)


def error_stats(error_um: Floats) -> dict[str, float]:
    """Return ``max``, ``rms`` and ``p95`` of the magnitude of errors that were measured; NaN if none was."""
    size = np.abs(error_um[np.isfinite(error_um)])
    if not len(size):
        return dict.fromkeys(("max", "rms", "p95"), float("nan"))
    rms = float(np.sqrt(np.mean(size**2)))
    return {"max": float(size.max()), "rms": rms, "p95": float(np.percentile(size, 95))}


def profile_error(field: KerfField, contour: WireContour) -> ProfileError:
    """Measure the distance from every point of the nominal edge to the wall on the part's side of the wire's path.

    In an inner corner this includes metal that the round wire cannot reach. Each slice of a tapered wall is measured
    in its plane.
    """
    chosen = list(range(field.n_slices))
    middle = contour.at_mid_height()
    line = Polyline(middle.nominal_mm, contour.closed)
    s_mm = line.stations(PROFILE_STEP_MM, edge_corners(middle, line))
    if contour.lean is None:
        points = line.at(s_mm)
        error = _errors(field, contour, line, s_mm, points, chosen)
    else:
        # at other heights, the points are those on the rulings through the points at mid height
        wall, heights = contour.lean.wall, slice_heights_mm(field, contour.lean.height_mm).tolist()
        passed_mm = arc_lengths(middle.nominal_mm)
        points = interpolated(s_mm, passed_mm, middle.nominal_mm)
        rows = []
        for number, z in enumerate(heights):
            there = interpolated(s_mm, passed_mm, wall.at(z))
            rows.append(_errors(field, contour.at_height(z), line, s_mm, there, [number]))
        error = np.concatenate(rows)
    lead_in_end = middle.points_um[middle.lead_in_moves] / 1000
    meeting = s_mm[[np.hypot(*(points - lead_in_end).T).argmin()]]
    return ProfileError(points, s_mm, error, line.distance_along(s_mm, meeting) <= LEAD_IN_REACH_MM)


def nearest_error_um(places_um: Floats, profiles: list[ProfileError]) -> Floats:
    """Return the mean error at the point of the edges nearest to each place; NaN where none is near."""
    points = np.concatenate([p.points_mm for p in profiles])
    error = np.append(np.concatenate([p.mean_um for p in profiles]), np.nan)
    _, nearest = scipy.spatial.KDTree(points).query(places_um * 1e-3, distance_upper_bound=PLACE_REACH_MM)
    return np.asarray(error[nearest])


def slice_heights_mm(field: KerfField, height_mm: float) -> Floats:
    """Return the heights of the slices' middles above the workpiece's lower face."""
    return (np.arange(field.n_slices) + 0.5) / field.n_slices * height_mm


def _errors(
    field: KerfField, contour: WireContour, line: Polyline, s_mm: Floats, points: Floats, chosen: list[int]
) -> Floats:
    """Return the errors (slices, n) of a vertical wire's wall at points of its edge, at lengths `s_mm` of `line`."""
    track = _WireTrack(contour)
    edges = (_without_grains(segments) for segments in edge_segments(field, chosen))
    size = np.stack([track.distance_to_wall(segments, points) for segments in edges])
    in_metal = metal_at(field, points * 1000)[chosen] >= 0.5
    error = np.where(in_metal, size, -size) * 1000
    uncut = metal_at(field, track.nearest(points) * 1000)[chosen] >= 0.5
    uncut &= np.roll(uncut, 1, axis=1) & np.roll(uncut, -1, axis=1)  # a single point may be a loose grain
    for row, marks in zip(error, uncut, strict=True):
        row[line.distance_along(s_mm, s_mm[marks]) <= FRONT_MM] = np.nan
    error[:, depth_in_blank(field.stock, points) < BLANK_EDGE_MM] = np.nan
    error[clear_of_steps(field, points)[chosen] < BLANK_EDGE_MM] = np.nan
    return error


class _WireTrack:
    """The wire's path round the contour as closely spaced points, each with its direction towards the part."""

    def __init__(self, contour: WireContour) -> None:
        line = wire_line(contour)
        s = line.stations(0.01, np.arange(len(line.points) - 1))
        self.points = line.at(s)
        # At a vertex this direction is the bisector, which separates the sides all round the vertex.
        towards_left = left_of(line.tangent(s, 1e-3))
        self.towards_part = towards_left if contour.part_side == "left" else -towards_left
        self.tree = scipy.spatial.cKDTree(self.points)

    def nearest(self, places: Floats) -> Floats:
        """Return the point of the track nearest to each of `places`."""
        return np.asarray(self.points[self.tree.query(places)[1]])

    def distance_to_wall(self, segments: Floats, points: Floats) -> Floats:
        """Return the distance in mm from each point to the nearest segment on the part's side; NaN if over 1 mm."""
        middle = segments.mean(axis=1)
        i = self.tree.query(middle)[1]
        on_part_side = ((middle - self.points[i]) * self.towards_part[i]).sum(axis=1) > 0
        if on_part_side.sum() < NEAR_SEGMENTS:
            return np.full(len(points), np.nan)
        nearest = scipy.spatial.cKDTree(middle[on_part_side]).query(points, NEAR_SEGMENTS)[1]
        start, stop = segments[on_part_side][nearest].transpose(2, 0, 1, 3)
        along, from_start = stop - start, points[:, None] - start
        share = np.clip((from_start * along).sum(axis=-1) / (along**2).sum(axis=-1), 0.0, 1.0)
        distance = np.linalg.norm(from_start - share[..., None] * along, axis=-1).min(axis=1)
        return np.where(distance <= FARTHEST_WALL_MM, distance, np.nan)


def _without_grains(segments: Floats) -> Floats:
    """Remove the segments (m, 2, 2) of outlines of grains, slivers and pits."""
    ends = segments.reshape(-1, 2) @ (1, 1j)
    _, vertex = np.unique(ends, return_inverse=True)
    start, stop = vertex.reshape(-1, 2).T
    joined = scipy.sparse.coo_array((np.ones(len(start), np.int8), (start, stop)), shape=(len(ends), len(ends)))
    outline = scipy.sparse.csgraph.connected_components(joined, directed=False)[1][start]
    (x0, y0), (x1, y1) = segments[:, 0].T, segments[:, 1].T
    twice_area = np.abs(np.bincount(outline, x0 * y1 - x1 * y0))
    # a strip of width w has an area of w times half its outline
    grain = twice_area < np.bincount(outline, np.hypot(x1 - x0, y1 - y0)) * GRAIN_UM / 1000
    return np.asarray(segments[~grain[outline]], np.float64)


def finite_mean(values: Floats, axis: int) -> Floats:
    """Return the mean of the finite values along an axis; NaN if there are none."""
    finite = np.isfinite(values)
    count = finite.sum(axis=axis)
    total = np.where(finite, values, 0.0).sum(axis=axis)
    return np.asarray(np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0), np.float64)


CORNER_REACH_MM = 0.15  # arc length on both sides of a corner over which its error is taken


@dataclass(frozen=True)
class CornerError:
    """A corner of the nominal edge on the table: its turn, left positive, and its error."""

    x_mm: float
    y_mm: float
    turn_deg: float
    # mean over the height at the worst point within 0.15 mm; positive if metal is left; NaN if unmeasured
    error_um: float


def corners(contour: WireContour, profile: ProfileError) -> list[CornerError]:
    """List the corners of the nominal edge with their errors."""
    line = Polyline(contour.nominal_mm, contour.closed)
    # the angle between an arc's last chord and its tangent there is half the angle between two of its chords
    half_deg = np.where(_between_elements(contour, line), 0.0, line.turn_deg / 2)[:-1]
    turn_deg = line.turn_deg[:-1] - np.roll(half_deg, 1) - np.roll(half_deg, -1)
    found: list[CornerError] = []
    for vertex in edge_corners(contour, line):
        near = profile.mean_um[line.distance_along(profile.s_mm, line.s[[vertex]]) <= CORNER_REACH_MM]
        near = near[np.isfinite(near)]
        error = float(near[np.abs(near).argmax()]) if len(near) else float("nan")
        x, y = (float(value) for value in line.points[vertex])
        found.append(CornerError(x, y, float(turn_deg[vertex]), error))
    return found


@dataclass(frozen=True)
class ElementError:
    """A line or arc of the nominal edge, and its error."""

    contour: int  # number in cutting order, from 1
    element: int  # number along the contour, from 1
    line: int | None  # the program's line; None for a drawing
    kind: str  # line, arc or curve
    radius_mm: float | None
    x_mm: float  # first and last point, on the table
    y_mm: float
    end_x_mm: float
    end_y_mm: float
    length_mm: float
    mean_um: float  # of the profile error over all slices, less metal out of reach; NaN if unknown
    rms_um: float
    low_um: float  # least and greatest error
    high_um: float


def element_errors(
    number: int, contour: WireContour, profile: ProfileError, unreachable_um: Floats
) -> list[ElementError]:
    """Return the error of every element of a contour, whose number counts from 1; empty if elements are unknown."""
    if not contour.elements:
        return []
    begins = arc_lengths(contour.nominal_mm)
    chord_of = np.clip(np.searchsorted(begins, profile.s_mm, side="right") - 1, 0, len(contour.elements) - 1)
    elements = np.array([element for element, _ in contour.elements])
    error = profile.error_um - unreachable_um
    return [
        _element(number, contour, np.flatnonzero(elements == element), error[:, elements[chord_of] == element])
        for element in np.unique(elements)
    ]


def _element(number: int, contour: WireContour, chords: NDArray[np.intp], error_um: Floats) -> ElementError:
    points = contour.nominal_mm[np.append(chords, chords[-1] + 1)]
    element, line = contour.elements[chords[0]]
    kind, radius_mm = _shape(points)
    known = error_um[np.isfinite(error_um)]
    low, high, mean = (float(f(known)) if len(known) else float("nan") for f in (np.min, np.max, np.mean))
    (x, y), (end_x, end_y) = points[0].tolist(), points[-1].tolist()
    return ElementError(
        number, element, line or None, kind, radius_mm, x, y, end_x, end_y,
        float(np.hypot(*np.diff(points, axis=0).T).sum()), mean, error_stats(known)["rms"], low, high,
    )  # fmt: skip


def _shape(points: Floats) -> tuple[str, float | None]:
    """Return the kind of points (n, 2), line, arc or curve, and the radius of an arc."""
    if len(points) == 2:
        return "line", None
    third = (len(points) - 1) // 3
    picked = points[[0, len(points) // 2, -1]] if third == 0 else points[[0, third, 2 * third]]
    a, b, c = picked @ (1, 1j)
    cross = ((b - a).conjugate() * (c - a)).imag
    if abs(cross) < ROUND_MM * abs(c - a):
        return ("line" if is_straight(points, ROUND_MM) else "curve"), None
    centre = a + (abs(b - a) ** 2 * (c - a) - abs(c - a) ** 2 * (b - a)) / (2j * cross)
    radii = np.abs(points @ (1, 1j) - centre)
    return ("arc", float(radii.mean())) if np.ptp(radii) < 2 * ROUND_MM else ("curve", None)
