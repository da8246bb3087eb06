"""Workpieces of several heights: conversion of path lengths and drawn areas to regions of one height on the table.

Heights over path length become regions along the path, wide enough for everything that the plant reads. Every point
belongs to the nearest stretch of path, so a change of height is perpendicular to a straight path, and along the
bisector (in steps of `RING_MM`) where the path turns. If stretches are equally near, the metal has the height of the
one that is cut first.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import shapely
from shapely.geometry import shape
from shapely.geometry.base import BaseGeometry
from shapely.ops import substring

from edmsim.errors import InputError
from edmsim.machine.setting import LIMITS, check_height
from edmsim.numeric import plain, real
from edmsim.plant.workpiece.height_steps import LowerRegion

if TYPE_CHECKING:
    from edmsim.program.path import CutPath

Height: TypeAlias = tuple[float, float]  # path length in mm, and the height in mm from there on
Area: TypeAlias = tuple[BaseGeometry | Sequence[Sequence[float]] | Mapping[str, Any], float]
"""Polygon, its corners or its GeoJSON, in mm of the program, and the height in mm inside it."""

WIRE_MARGIN_MM = 0.4
"""Distance from the wire's surface within which a stretch's height applies (ours: rays end at 0.08 mm, tiles are
allocated 0.13 mm beyond them and are 0.13 mm wide, the rest is for the wire's lag)."""
NEAREST_MM = 1e-6  # grid for corners too near to each other (ours: far below a cell, far above rounding)
RING_MM = 0.035  # resolution of distances to the path (ours: a few of them fit between a kerf's middle and its wall)


@dataclass(frozen=True)
class Heights:
    """The heights of a workpiece, along the wire's path and in areas of the drawing."""

    height_mm: float  # height unless `along` or `areas` set another
    # heights from a length of wire path on, in increasing order; the length begins at the first start hole and
    # includes lead-ins but not rapids
    along: Sequence[Height] = ()
    # heights inside Shapely polygons in mm of the program; they override `along`, and the first of overlapping
    # polygons applies
    areas: Sequence[tuple[shapely.Polygon, float]] = ()

    @property
    def all_mm(self) -> list[float]:
        """All heights, some perhaps more than once."""
        return [self.height_mm, *(h for _, h in self.along), *(h for _, h in self.areas)]

    @property
    def greatest_mm(self) -> float:
        """The greatest height, from which the guides are set and which is divided into slices."""
        return max(self.all_mm)

    @property
    def lowest_mm(self) -> float:
        """The lowest height."""
        return min(self.all_mm)

    def lower_regions(self, path: "CutPath", wire_diameter_um: float) -> tuple[LowerRegion, ...]:
        """Return the regions of one height on the table, none if the height never changes."""
        blank = shapely.box(*path.stock_mm)
        regions = [*self._areas(path, blank), *self._stretches(path, wire_diameter_um * 5e-4 + WIRE_MARGIN_MM)]
        if self.greatest_mm == self.lowest_mm:
            return ()
        return tuple(LowerRegion(_in_um(region), height) for region, height in [*regions, (blank, self.height_mm)])

    def _areas(self, path: "CutPath", blank: BaseGeometry) -> list[tuple[BaseGeometry, float]]:
        placed = []
        for number, (area, height) in enumerate(self.areas, 1):
            region = shapely.transform(area, lambda mm: mm + path.origin_mm)
            if not region.intersects(blank):
                x0, y0, x1, y1 = np.subtract(path.stock_mm, (*path.origin_mm, *path.origin_mm))
                raise InputError(f"area {number} of another height is outside the workpiece, which reaches from "
                                 f"X{x0:.3f} Y{y0:.3f} to X{x1:.3f} Y{y1:.3f}")
            placed.append((region, height))
        return placed

    def _stretches(self, path: "CutPath", reach_mm: float) -> list[tuple[BaseGeometry, float]]:
        """Return the regions of one height along the path; they do not overlap."""
        if not self.along:
            return []
        lines = [shapely.LineString(contour.at_mid_height().points_um / 1000) for contour in path.contours]
        total = sum(line.length for line in lines)
        last = self.along[-1][0]
        if last >= total:
            raise InputError(f"the height cannot change at {last:g} mm: the wire's path is {total:.3f} mm long")
        ends = [*(place for place, _ in self.along), math.inf]
        heights = [self.height_mm, *(height for _, height in self.along)]
        claims: list[list[BaseGeometry]] = [[] for _ in ends]
        nearer: BaseGeometry = shapely.Polygon()
        for reach in np.linspace(0, reach_mm, math.ceil(reach_mm / RING_MM) + 1)[1:]:
            # ring by ring outwards; bands begin at the path's start, so a stretch also claims round its first corner
            taken = nearer
            for claim, end in zip(claims, ends, strict=True):
                nearer = _band(lines, end, float(reach))
                claim.append(nearer.difference(taken))
                taken = taken.union(nearer)
        return [(shapely.union_all(claim), height) for claim, height in zip(claims, heights, strict=True)]


def checked_changes(value: Sequence[Height]) -> tuple[Height, ...]:
    """Return changes of height over path length; raises `InputError` if a length does not rise or a height is bad."""
    before = -math.inf
    checked = []
    for place, height in (_pair(plain(item), "a path length") for item in value):
        if real(place) is None:
            raise InputError(f"a height changes at a length of path in mm, not at {place!r}")
        check_height(height, f" from {place:g} mm of path on")
        if not 0 <= place < math.inf:
            raise InputError(f"a height cannot change at {place:g} mm of path: it must be 0 mm or more")
        if place <= before:
            raise InputError(f"heights must come in order of path length: {place:g} mm follows {before:g} mm")
        before = place
        checked.append((float(place), height))
    return tuple(checked)


def checked_areas(value: Sequence[Area]) -> tuple[tuple[shapely.Polygon, float], ...]:
    """Return areas of another height; raises `InputError` for an invalid polygon or height."""
    checked = []
    for number, (corners, height) in enumerate((_pair(item, "a polygon") for item in value), 1):
        check_height(height, f" of area {number}")
        checked.append((_polygon(corners, number), height))
    return tuple(checked)


def corners_of(areas: Sequence[tuple[shapely.Polygon, float]]) -> list[list[object]]:
    """Return areas as lists of corners; those with holes, which a list cannot represent, as GeoJSON."""
    return [
        [shapely.geometry.mapping(area) if area.interiors else shapely.get_coordinates(area).tolist(), height]
        for area, height in areas
    ]


def parse_height(text: str) -> Height:
    """Parse ``12.5:30``: from 12.5 mm of path on, 30 mm high; raises `InputError` for anything else."""
    place, _, height = text.partition(":")
    try:
        return float(place), float(height)
    except ValueError:
        low, high = LIMITS["height_mm"].range
        raise InputError(f"a change of height reads MM:MM, the path length and the height ({low:g}..{high:g}), as "
                         f"12.5:30, not '{text}'") from None


def _in_um(region_mm: BaseGeometry) -> BaseGeometry:
    """Convert a region from mm to um."""
    scaled = partial(shapely.transform, transformation=lambda mm: mm * 1000.0)
    region: BaseGeometry = scaled(region_mm)
    # if corners are too near to each other, rounding may have made the border cross itself
    return region if region.is_valid else scaled(shapely.set_precision(region_mm, NEAREST_MM))


def _pair(item: tuple[Any, float], first: str) -> tuple[Any, float]:
    try:
        where, value = item
    except (TypeError, ValueError):
        where = value = None
    height = real(value)
    if height is None:
        raise InputError(f"a change of height is {first} and a height in mm, not {item!r}")
    return where, float(height)


def _polygon(value: BaseGeometry | Sequence[Sequence[float]] | Mapping[str, Any], number: int) -> shapely.Polygon:
    try:
        with np.errstate(invalid="ignore"):  # NaN in corners is refused below
            polygon = shapely.Polygon(shape(value) if isinstance(value, Mapping) else value)
    except (TypeError, ValueError, LookupError, shapely.errors.ShapelyError) as error:
        raise InputError(f"area {number} of another height is not a polygon: {error}") from None
    if not (polygon.is_valid and polygon.area > 0 and np.isfinite(polygon.bounds).all()):
        why = shapely.is_valid_reason(polygon) if not polygon.is_valid else "it has no area"
        raise InputError(f"area {number} of another height is not a polygon: {why}")
    return polygon


def _band(lines: Sequence[shapely.LineString], end_mm: float, reach_mm: float) -> BaseGeometry:
    """Return the region within `reach_mm` of the path up to a length; its end there is flat, other ends are round."""
    regions, before = [], 0.0
    for line in lines:
        if end_mm > before:
            regions.append(_up_to(line, end_mm - before, reach_mm))
        before += line.length
    return shapely.union_all(regions)


def _up_to(line: shapely.LineString, end_mm: float, reach_mm: float) -> BaseGeometry:
    """Return the region along one contour's path up to a length."""
    if end_mm >= line.length:
        return line.buffer(reach_mm)
    points = shapely.get_coordinates(line)
    back = points[0] - points[1]
    # extended backwards, because the wire has metal behind it where it is threaded
    behind = points[0] + back * (reach_mm / np.hypot(*back))
    return substring(shapely.LineString([behind, *points]), 0.0, reach_mm + end_mm).buffer(reach_mm, cap_style="flat")
