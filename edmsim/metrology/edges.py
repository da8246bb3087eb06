"""The cut's edges as geometry: the half-removed level of the kerf field, traced tile by tile.

Coordinates that leave this module are in mm on the table. What counts as cut is the metal taken from the
blank: the rim of a drilled start hole or the side of the blank closes a kerf that opens there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import MultiLineString, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from edmsim.errors import InputError
from edmsim.plant.kernel.state import TILE
from edmsim.plant.workpiece.kerf_field import FULL, KerfField

_HALF = FULL // 2
# A square of four neighbouring cell centres: its corners counter-clockwise; its sides (bottom, right, top,
# left) each from the lower to the upper corner, so that squares that share a side compute equal bits.
_CORNER_X, _CORNER_Y = np.array([0, 1, 1, 0]), np.array([0, 0, 1, 1])
_SIDE_FROM, _SIDE_TO = np.array([0, 1, 3, 0]), np.array([1, 2, 2, 3])
# From which side to which the edge leads, by the corners above the level (1, 2, 4, 8 round the square): those
# lie on its left. 16 and 17 are 5 and 10, two opposite corners above, with the middle above as well.
_SIDES = np.array([(0, 0), (0, 3), (1, 0), (1, 3), (2, 1), (0, 3), (2, 0), (2, 3), (3, 2),
                   (0, 2), (1, 0), (1, 2), (3, 1), (0, 1), (3, 0), (0, 0), (0, 1), (3, 0)])
_SECOND = {5: (2, 1), 10: (3, 2), 16: (2, 3), 17: (1, 2)}  # the second edge, where there are two
_RIGHT, _UP = np.array([1, 0]), np.array([0, 1])


def check_slices(field: KerfField, slices: Sequence[int]) -> None:
    """Raise `InputError` unless every number in `slices` is a slice of `field`."""
    for number in slices:
        if not 0 <= number < field.n_slices:
            raise InputError(f"there is no slice {number}: the field has slices 0 to {field.n_slices - 1}")


def cut_edges(field: KerfField, slice_index: int) -> MultiLineString:
    """Return the edges of what was cut from one slice, 0 at the bottom, as closed lines in mm."""
    segments = next(edge_segments(field, [slice_index]))
    loose = shapely.multilinestrings(np.asarray(shapely.linestrings(segments), object))
    return MultiLineString(list(shapely.get_parts(shapely.line_merge(loose))))


def filled(rings: MultiLineString) -> BaseGeometry:
    """Return the area inside closed lines, counting even-odd."""
    try:
        return shapely.build_area(rings)
    except shapely.errors.GEOSException:  # rings that touch themselves: slower, but it takes them
        loops = [shapely.make_valid(Polygon(line.coords)) for line in rings.geoms if line.is_closed]
        return shapely.symmetric_difference_all(loops)


def contour(field: KerfField, slice_index: int) -> MultiPolygon:
    """Return the metal removed from one slice as polygons in mm: the kerf."""
    # holes in a polygon are the metal the wire went round: the part, or the slug. Start holes and the air
    # outside the blank are not removed metal and do not belong to it
    area = filled(cut_edges(field, slice_index))
    return MultiPolygon(list(shapely.get_parts(area)))


def without_specks(area: MultiPolygon, least_mm2: float) -> MultiPolygon:
    """Return polygons and holes of at least an area: without craters beside the kerf and crumbs of metal in it."""
    return MultiPolygon([
        Polygon(part.exterior, [hole for hole in part.interiors if Polygon(hole).area >= least_mm2])
        for part in area.geoms if Polygon(part.exterior).area >= least_mm2
    ])  # fmt: skip


def edge_segments(field: KerfField, slices: Sequence[int]) -> Iterator[NDArray[np.float64]]:
    """Yield, for each of `slices`, the edges as loose segments: array (m, 2, 2) of ``[end, (x, y)]`` in mm."""
    # what was cut lies to the left of every segment; ends that meet are equal to the last bit
    check_slices(field, slices)
    squares = _traced_tiles(field)
    stock = _stock_parts(field)
    for number in slices:
        cells, ends = _trace(_with_neighbours(field, stock[:, number], squares, number))
        origin = squares[cells[:, 0]] * TILE + cells[:, 1:] + 0.5
        segments = (origin[:, None, :] + ends) * (field.cell_um / 1000)
        yield segments[(segments[:, 0] != segments[:, 1]).any(axis=1)]


def metal_at(field: KerfField, points_um: NDArray[np.float64]) -> NDArray[np.float64]:
    """Metal fraction (n_slices, n) at any points of all slices, bilinear between cell centres."""
    # where no tile was ever allocated the wire has not been: that counts as metal
    place = points_um / field.cell_um - 0.5
    cell = np.floor(place).astype(np.int64)
    share = place - cell
    total = np.zeros((len(points_um), field.n_slices))
    for dx, dy in zip(_CORNER_X, _CORNER_Y, strict=True):
        weight = np.abs(1 - dx - share[:, 0]) * np.abs(1 - dy - share[:, 1])
        total += weight[:, None] * _cell_parts(field, cell + dx * _RIGHT + dy * _UP)
    return total.T / FULL


def _cell_parts(field: KerfField, cell: NDArray[np.int64]) -> NDArray[np.uint16]:
    """Parts of metal in cells ``(n, 2)`` of all slices: array (n, n_slices)."""
    tile = cell // TILE
    place = _place(field, tile)
    parts = np.full((len(cell), field.n_slices), FULL, np.uint16)
    known = place >= 0
    inner = cell[known] % TILE
    parts[known] = field.tiles[place[known], :, inner[:, 0], inner[:, 1]]
    return parts


def _place(field: KerfField, tile: NDArray[np.int64]) -> NDArray[np.int32]:
    """Place of each tile ``(n, 2)`` in the field, -1 where there is none."""
    inside = ((tile >= 0) & (tile < field.index.shape)).all(axis=1)
    place = np.full(len(tile), -1, np.int32)
    place[inside] = field.index[tile[inside, 0], tile[inside, 1]]
    return place


def _traced_tiles(field: KerfField) -> NDArray[np.int64]:
    """Tiles to trace: the allocated ones and those below and left, whose last squares reach into them."""
    allocated = np.argwhere(field.index >= 0)
    with_halo = np.concatenate([allocated - shift for shift in (0, _RIGHT, _UP, _RIGHT + _UP)])
    return np.asarray(np.unique(with_halo, axis=0), np.int64)


def _stock_parts(field: KerfField) -> NDArray[np.uint16]:
    """Parts in every allocated tile before the cut: array (count, n_slices, TILE, TILE)."""
    distinct = 1 if field.relief is None else field.n_slices  # slices that are all alike share their room
    parts = np.empty((field.count, distinct, TILE, TILE), np.uint16)
    for tx, ty, place in field.tile_places():
        parts[place] = field.stock_tile(tx, ty)[:distinct]
    return np.broadcast_to(parts, (field.count, field.n_slices, TILE, TILE))


def _with_neighbours(
    field: KerfField, stock: NDArray[np.uint16], squares: NDArray[np.int64], number: int
) -> NDArray[np.int32]:
    """Parts removed in each traced tile and the first row and column of the next: (t, TILE + 1, TILE + 1)."""
    removed = np.zeros((field.count + 1, TILE, TILE), np.int32)  # the last one, place -1, stands for no tile
    removed[:-1] = stock
    removed[:-1] -= field.tiles[: field.count, number]
    block = np.empty((len(squares), TILE + 1, TILE + 1), np.int32)
    block[:, :TILE, :TILE] = removed[_place(field, squares)]
    block[:, TILE, :TILE] = removed[_place(field, squares + _RIGHT), 0]
    block[:, :TILE, TILE] = removed[_place(field, squares + _UP), :, 0]
    block[:, TILE, TILE] = removed[_place(field, squares + _RIGHT + _UP), 0, 0]
    return block


def _trace(block: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Marching squares: cells as ``(block, ix, iy)``, and both ends of their edges from the centre."""
    high = (block >= _HALF).astype(np.uint8)
    code = high[:, :-1, :-1] | high[:, 1:, :-1] << 1 | high[:, 1:, 1:] << 2 | high[:, :-1, 1:] << 3
    cells = np.argwhere((code > 0) & (code < 15))
    kind = code[tuple(cells.T)]
    at, ix, iy = (column[:, None] for column in cells.T)
    corner = block[at, ix + _CORNER_X, iy + _CORNER_Y]
    middle_high = corner.sum(axis=1) >= 4 * _HALF
    kind[(kind == 5) & middle_high] = 16
    kind[(kind == 10) & middle_high] = 17
    crossing = _crossings(corner)
    rows, sides = np.arange(len(cells)), _SIDES[kind]
    for code_of_two, pair in _SECOND.items():
        double = np.flatnonzero(kind == code_of_two)
        rows = np.concatenate([rows, double])
        sides = np.concatenate([sides, np.broadcast_to(pair, (len(double), 2))])
    return cells[rows], crossing[rows[:, None], sides]


def _crossings(corner: NDArray[np.int32]) -> NDArray[np.float64]:
    """Where the level crosses each side of the squares: (n, 4, 2) in cells; where it does not, any number."""
    low, high = corner[:, _SIDE_FROM], corner[:, _SIDE_TO]
    rise = (high - low).astype(np.float64)
    share = np.divide(_HALF - low, rise, out=np.zeros_like(rise), where=rise != 0)
    x = _CORNER_X[_SIDE_FROM] + share * (_CORNER_X[_SIDE_TO] - _CORNER_X[_SIDE_FROM])
    y = _CORNER_Y[_SIDE_FROM] + share * (_CORNER_Y[_SIDE_TO] - _CORNER_Y[_SIDE_FROM])
    return np.stack([x, y], axis=-1)
