"""Edges of a cut, traced tile by tile where half of the metal is removed in the kerf field; loose pieces.

Returned coordinates are in mm on the table unless a function says otherwise. Only metal removed from the blank
counts as cut, so the rim of a start hole or the side of the blank closes a kerf that opens there.
"""

from collections.abc import Iterator, Sequence
from functools import reduce

import numpy as np
import shapely
from contourpy import LineType, contour_generator
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.plant.kernel.state import TILE
from edmsim.plant.workpiece.kerf_field import FULL, KerfField

_HALF = FULL // 2
_RIGHT, _UP = np.array([1, 0]), np.array([0, 1])


def cut_edges(field: KerfField, slice_index: int) -> shapely.MultiLineString:
    """Return the edges of what was cut from one slice, 0 at the bottom, as closed lines in mm."""
    segments = next(edge_segments(field, [slice_index]))
    loose = shapely.multilinestrings(np.asarray(shapely.linestrings(segments), object))
    return shapely.MultiLineString(list(shapely.get_parts(shapely.line_merge(loose))))


def filled(rings: shapely.MultiLineString) -> shapely.Geometry:
    """Return the area inside closed lines, counting even-odd."""
    try:
        return shapely.build_area(rings)
    except shapely.errors.GEOSException:  # rings that touch themselves; this is slower
        loops = [shapely.make_valid(shapely.Polygon(line.coords)) for line in rings.geoms if line.is_closed]
        return reduce(shapely.symmetric_difference, loops, shapely.Polygon())


def contour(field: KerfField, slice_index: int) -> shapely.MultiPolygon:
    """Return the metal removed from one slice as polygons in mm: the kerf."""
    # holes in a polygon are metal that the wire went round: the part or the slug. Start holes and the space outside
    # the blank are not removed metal, so they are not included
    area = filled(cut_edges(field, slice_index))
    return shapely.MultiPolygon(list(shapely.get_parts(area)))


def without_specks(area: shapely.MultiPolygon, least_mm2: float) -> shapely.MultiPolygon:
    """Remove polygons and holes smaller than `least_mm2`: craters next to the kerf, and crumbs of metal in it."""
    return shapely.MultiPolygon([
        shapely.Polygon(part.exterior, [hole for hole in part.interiors if shapely.Polygon(hole).area >= least_mm2])
        for part in area.geoms if shapely.Polygon(part.exterior).area >= least_mm2
    ])  # fmt: skip


RIM_CELLS = 1.5
"""Cells by which a loose piece's outline is expanded, because partly filled cells at its rim belong to it (ours)."""


def loose_pieces(field: KerfField, least_mm2: float) -> list[shapely.Polygon]:
    """Return the pieces of at least `least_mm2` that are free in all slices where they exist, in um on the table."""
    holes = shapely.union_all([shapely.Point(x, y).buffer(r) for x, y, r in field.stock.holes_um])
    slices = []
    for number in range(field.n_slices):
        cut_um = shapely.transform(contour(field, number), lambda mm: mm * 1e3).union(holes)
        islands = [
            shapely.Polygon(ring)
            for part in shapely.get_parts(cut_um) if isinstance(part, shapely.Polygon)
            for ring in part.interiors
        ]  # fmt: skip
        metal = shapely.union_all([island for island in islands if island.area >= least_mm2 * 1e6])
        if field.relief is not None:  # places without metal at this height hold nothing
            metal = metal.union(field.relief.voids_um[number])
        slices.append(metal)
    gone, rim = shapely.union_all(field.gone), RIM_CELLS * field.cell_um
    return [
        shapely.Polygon(shapely.Polygon(piece.exterior).buffer(rim).exterior)
        for piece in shapely.get_parts(reduce(shapely.intersection, slices))
        if piece.difference(gone).area >= least_mm2 * 1e6
    ]


def edge_segments(field: KerfField, slices: Sequence[int]) -> Iterator[NDArray[np.float64]]:
    """Yield, for each of `slices`, the edges as unordered segments: array (m, 2, 2) of ``[end, (x, y)]`` in mm."""
    # removed metal is to the left of every segment; ends that meet are equal to the last bit
    for number in slices:
        if not 0 <= number < field.n_slices:
            raise InputError(f"there is no slice {number}: the field has slices 0 to {field.n_slices - 1}")
    # tiles to trace: allocated tiles, and those below and to the left, whose last squares extend into them
    allocated = np.argwhere(field.index >= 0)
    squares = np.unique(np.concatenate([allocated - by for by in (0, _RIGHT, _UP, _RIGHT + _UP)]), axis=0)
    stock = _stock_parts(field)
    for number in slices:
        removed = _with_neighbours(field, stock[:, number], squares, number)
        crossed = np.flatnonzero((removed.min(axis=(1, 2)) < _HALF) & (removed.max(axis=(1, 2)) >= _HALF))
        segments = np.concatenate([np.empty((0, 2, 2)), *(
            (tile * TILE + found + 0.5) * (field.cell_um / 1000)
            for tile, found in zip(squares[crossed], _segments(removed[crossed]), strict=True)
        )])  # fmt: skip
        yield segments[(segments[:, 0] != segments[:, 1]).any(axis=1)]


def _segments(removed: NDArray[np.int32]) -> Iterator[NDArray[np.float64]]:
    """Yield the edges in each of ``(t, TILE + 1, TILE + 1)``, in cells: arrays (m, 2, 2)."""
    # One call for all tiles, each a chunk, with a row without values after each. The rows are numbered in each tile
    # from 0, so that ends in adjacent tiles meet to the last bit. The higher values are to the left of a line.
    tiles, side = removed.shape[:2]
    if not tiles:
        return
    z = np.full((tiles, side + 1, side), np.nan)
    z[:, :side] = removed.transpose(0, 2, 1)
    y, x = (np.broadcast_to(numbers, z.shape).reshape(-1, side) for numbers in np.ogrid[: side + 1, :side])
    generator = contour_generator(
        x, y, z.reshape(-1, side), line_type=LineType.ChunkCombinedOffset, chunk_size=(side + 1, side)
    )
    for points, offsets in zip(*generator.lines(_HALF), strict=True):
        if points is None or offsets is None:  # half of the metal is gone at most
            yield np.empty((0, 2, 2))
            continue
        pairs = np.stack([points[:-1], points[1:]], axis=1)
        yield np.delete(pairs, offsets[1:-1].astype(np.int64) - 1, axis=0)  # not from one line to the next


def metal_at(field: KerfField, points_um: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the metal fraction (n_slices, n) at points in all slices, bilinear between cell centres."""
    # cells without an allocated tile count as metal, because the wire has not been there
    place = points_um / field.cell_um - 0.5
    cell = np.floor(place).astype(np.int64)
    share = place - cell
    total = np.zeros((len(points_um), field.n_slices))
    for corner in (0, _RIGHT, _RIGHT + _UP, _UP):
        x, y = np.abs(1 - corner - share).T
        total += (x * y)[:, None] * _cell_parts(field, cell + corner)
    return total.T / FULL


def _cell_parts(field: KerfField, cell: NDArray[np.int64]) -> NDArray[np.uint16]:
    """Return the parts of metal in cells ``(n, 2)`` of all slices: array (n, n_slices)."""
    tile = cell // TILE
    place = _place(field, tile)
    parts = np.full((len(cell), field.n_slices), FULL, np.uint16)
    known = place >= 0
    inner = cell[known] % TILE
    parts[known] = field.tiles[place[known], :, inner[:, 0], inner[:, 1]]
    return parts


def _place(field: KerfField, tile: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return the index in `KerfField.tiles` of each tile ``(n, 2)``, or -1 if it is not allocated."""
    inside = ((tile >= 0) & (tile < field.index.shape)).all(axis=1)
    place = np.full(len(tile), -1, np.int32)
    place[inside] = field.index[tile[inside, 0], tile[inside, 1]]
    return place


def _stock_parts(field: KerfField) -> NDArray[np.uint16]:
    """Return the parts of metal in every allocated tile before the cut: array (count, n_slices, TILE, TILE)."""
    distinct = 1 if field.relief is None else field.n_slices  # equal slices share their memory
    parts = np.empty((field.count, distinct, TILE, TILE), np.uint16)
    for tx, ty, place in field.tile_places():
        parts[place] = field.stock_tile(tx, ty)[:distinct]
    return np.broadcast_to(parts, (field.count, field.n_slices, TILE, TILE))


def _with_neighbours(
    field: KerfField, stock: NDArray[np.uint16], squares: NDArray[np.int64], number: int
) -> NDArray[np.int32]:
    """Return the parts removed in each tile and the first row and column of the next: (t, TILE + 1, TILE + 1)."""
    removed = np.zeros((field.count + 1, TILE, TILE), np.int32)  # index -1: tiles not allocated
    removed[:-1] = stock
    removed[:-1] -= field.tiles[: field.count, number]
    block = np.empty((len(squares), TILE + 1, TILE + 1), np.int32)
    block[:, :TILE, :TILE] = removed[_place(field, squares)]
    block[:, TILE, :TILE] = removed[_place(field, squares + _RIGHT), 0]
    block[:, :TILE, TILE] = removed[_place(field, squares + _UP), :, 0]
    block[:, TILE, TILE] = removed[_place(field, squares + _RIGHT + _UP), 0, 0]
    return block
