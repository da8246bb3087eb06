"""A workpiece whose height changes: the slices that have metal at each place.

The workpiece stands on its lower face, so lower places have no metal in the uppermost slices. A slice has metal where
its middle is below the local height. The topmost slice with metal represents all metal above the slice below it, half
a slice to one and a half, so heights are not rounded.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from edmsim.errors import InputError

_BETWEEN = 1e-6  # distance, in cells, within which an edge counts as on the border of two cells; far above rounding


class LowerRegion(NamedTuple):
    """A region where the workpiece has another height."""

    region_um: BaseGeometry  # in um on the table
    height_mm: float  # height over the workpiece's lower face


class Relief:
    """Heights of a stepped workpiece, and the regions without metal in each slice; the first of two applies."""

    def __init__(self, lower_regions: Sequence[LowerRegion], height_mm: float, n_slices: int) -> None:
        self.height_mm, self.slice_mm = height_mm, height_mm / n_slices
        self.n_slices = n_slices
        of_height: dict[float, list[BaseGeometry]] = {}
        claimed: BaseGeometry = shapely.Polygon()
        for region, height in lower_regions:
            if not 0 < height <= height_mm:
                raise InputError(f"a step {height:g} mm high does not fit a workpiece of up to {height_mm:g} mm")
            if slices_below(height, height_mm, n_slices) == 0:
                raise InputError(f"a step {height:g} mm high is lost between slices of {self.slice_mm:.3g} mm: it "
                                 f"must be above {self.slice_mm / 2:.3g} mm, or the resolution finer")
            of_height.setdefault(height, []).append(region.difference(claimed))
            claimed = claimed.union(region)
        lower = sorted(height for height in of_height if height < height_mm)
        # regions of the lower heights, from the lowest up, without overlap
        self.faces_um = [LowerRegion(shapely.union_all(of_height[height]), height) for height in lower]
        self._bounds_um = shapely.bounds([region for region, _ in self.faces_um]).reshape(-1, 4)
        of_level: dict[int, list[BaseGeometry]] = {}
        for region, height in self.faces_um:
            shapely.prepare(region)
            of_level.setdefault(slices_below(height, height_mm, n_slices), []).append(region)
        self.voids_um: list[BaseGeometry] = []  # region without metal of each slice, from the bottom
        void: BaseGeometry = shapely.Polygon()
        for number in range(n_slices):
            if number in of_level:
                void = shapely.union_all([void, *of_level[number]])
                shapely.prepare(void)
            self.voids_um.append(void)

    def metal(self, x_um: NDArray[np.float64], y_um: NDArray[np.float64], cell_um: float
              ) -> NDArray[np.float64] | None:
        """Return each slice's share of metal (0..1) in square cells, (n_slices, len(x), len(y)); exact."""
        # None if all slices are full of metal there
        half = cell_um / 2
        whole = shapely.box(x_um[0] - half, y_um[0] - half, x_um[-1] + half, y_um[-1] + half)
        if not self.voids_um[-1].intersects(whole):  # the uppermost slice has the least metal
            return None
        share = np.empty((self.n_slices, len(x_um), len(y_um)))
        for number, void in enumerate(self.voids_um):
            if number and void is self.voids_um[number - 1]:
                share[number] = share[number - 1]
            else:
                share[number] = 1.0 - _covered(void, whole, x_um, y_um, half)
        return share

    def heights_mm(self, points_um: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the height at points ``(n, 2)``; on a border the lower one."""
        x_um, y_um = points_um.T
        found = np.full(len(points_um), self.height_mm)
        for region, height in reversed(self._faces_near(*points_um.min(axis=0), *points_um.max(axis=0))):
            found[shapely.intersects_xy(region, x_um, y_um)] = height
        return found

    def levels(self, x_um: NDArray[np.float64], y_um: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the height in slice heights, (len(x), len(y))."""
        whole = shapely.box(x_um[0], y_um[0], x_um[-1], y_um[-1])
        near = next((face for face in self._faces_near(*whole.bounds) if face.region_um.intersects(whole)), None)
        if near is None or near.region_um.contains(whole):  # the usual case
            height_mm = self.height_mm if near is None else near.height_mm
            return np.full((len(x_um), len(y_um)), height_mm / self.slice_mm, np.float32)
        points = np.stack(np.meshgrid(x_um, y_um, indexing="ij"), axis=-1).reshape(-1, 2)
        return (self.heights_mm(points) / self.slice_mm).reshape(len(x_um), len(y_um)).astype(np.float32)

    def _faces_near(self, x0_um: float, y0_um: float, x1_um: float, y1_um: float) -> list[LowerRegion]:
        """Return the faces whose bounding boxes overlap a rectangle, from the lowest up."""
        low_x, low_y, high_x, high_y = self._bounds_um.T
        meets = (low_x <= x1_um) & (high_x >= x0_um) & (low_y <= y1_um) & (high_y >= y0_um)
        return [self.faces_um[k] for k in np.flatnonzero(meets)]

    def clearance_um(self, points_um: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distance of points ``(n, 2)`` to each slice's region without metal, (n_slices, n); 0 inside."""
        points = shapely.points(points_um)
        distance = np.stack([shapely.distance(void, points) for void in self.voids_um])
        return np.where(np.isnan(distance), np.inf, distance)  # no region without metal


def slices_below(height_mm: float, full_mm: float, n_slices: int) -> int:
    """Return the number of slices of a workpiece `full_mm` high whose middle is below a height."""
    middle = (np.arange(n_slices) + 0.5) / n_slices * full_mm
    return int((middle < height_mm).sum())


def middle_slice(lowest_mm: float, full_mm: float, n_slices: int) -> int:
    """Return the slice at mid height of the workpiece's lowest place, which has metal everywhere."""
    return slices_below(lowest_mm, full_mm, n_slices) // 2


def _covered(
    void: BaseGeometry, whole: BaseGeometry, x_um: NDArray[np.float64], y_um: NDArray[np.float64], half_um: float
) -> NDArray[np.float64]:
    """Return the share of each cell that a region covers; only cells on its border are intersected."""
    if not void.intersects(whole):
        return np.zeros((len(x_um), len(y_um)))
    if void.contains(whole):
        return np.ones((len(x_um), len(y_um)))
    x, y = np.meshgrid(x_um, y_um, indexing="ij")
    near = void.intersection(whole)
    shapely.prepare(near)
    share: NDArray[np.float64] = shapely.contains_xy(near, x, y).astype(np.float64)
    rim = _rim(near, whole.bounds, len(x_um), 2 * half_um)
    cells = shapely.box(x[rim] - half_um, y[rim] - half_um, x[rim] + half_um, y[rim] + half_um)
    covered = shapely.area(shapely.intersection(near, cells)) / (2 * half_um) ** 2
    share[rim] = np.where(shapely.contains(near, cells), 1.0, np.minimum(covered, 1.0))
    return share


def _rim(
    near: BaseGeometry, bounds_um: tuple[float, float, float, float], count: int, cell_um: float
) -> NDArray[np.bool_]:
    """Return the cells (count, count) of a tile that a region's edge may touch."""
    low, high = np.array(bounds_um[:2]), np.array(bounds_um[2:])
    rim = np.zeros((count, count), np.bool_)
    areas = [part for part in shapely.get_parts(near) if isinstance(part, shapely.Polygon)]
    for ring in shapely.get_rings(areas):
        corners = shapely.get_coordinates(ring)
        first, last = np.minimum(corners[:-1], corners[1:]), np.maximum(corners[:-1], corners[1:])
        of_tile = ((first == last) & ((first == low) | (first == high))).any(axis=1)  # end of the tile
        # both cells if an edge is between them
        i0, j0 = np.maximum(np.floor((first - low) / cell_um - _BETWEEN).astype(int), 0)[~of_tile].T
        i1, j1 = (np.floor((last - low) / cell_um + _BETWEEN).astype(int) + 1)[~of_tile].T
        for a, b, c, d in zip(i0, i1, j0, j1, strict=True):
            rim[a:b, c:d] = True
    return rim
