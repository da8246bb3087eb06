"""The kerf field: the remaining metal in every slice of the workpiece, on a sparse tiled grid.

A cell stores its fraction of metal as an integer number of 1/32768 parts, so removal is exact: no metal is lost or
gained by rounding. Tiles exist only along the path.
"""

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.compiled.elementary import exponential
from edmsim.compiled.jit import compiled
from edmsim.errors import InputError
from edmsim.plant.kernel.state import NO_METAL_UM, TILE
from edmsim.plant.workpiece.height_steps import LowerRegion, Relief

FULL = 32768  # parts in a full cell
PARALLEL = 1e-9  # a direction with a smaller cosine is parallel to an axis of the grid


@dataclass(frozen=True)
class Stock:
    """The blank before the first spark: a rectangle with round start holes, optionally with several heights.

    Raises
    ------
    InputError
        If there are lower regions without a height to compare them with.
    """

    rectangle_um: tuple[float, float, float, float]
    holes_um: tuple[tuple[float, float, float], ...] = ()
    # regions that are lower than the rest; where they overlap, the first one applies
    lower_regions: tuple[LowerRegion, ...] = ()
    # height outside the lower regions, the greatest: the machine's `height_mm`. Required with lower regions.
    height_mm: float | None = None

    def __post_init__(self) -> None:
        if self.lower_regions and self.height_mm is None:
            raise InputError("lower regions need height_mm, the greatest height: that of the machine")

    def is_whole(self, x0_um: float, y0_um: float, x1_um: float, y1_um: float) -> bool:
        """Return whether the lowest slice is full of metal between two corners, away from edges and holes."""
        left, low, right, high = self.rectangle_um
        if not (left <= x0_um and low <= y0_um and x1_um <= right and y1_um <= high):
            return False
        return len(self._holes_near(x0_um, y0_um, x1_um, y1_um)) == 0

    @functools.cached_property
    def _holes(self) -> NDArray[np.float64]:
        return np.array(self.holes_um, np.float64).reshape(-1, 3)

    def _holes_near(self, x0_um: float, y0_um: float, x1_um: float, y1_um: float) -> NDArray[np.float64]:
        """Return the holes (n, 3) whose bounding squares overlap a rectangle."""
        x, y, radius = self._holes.T
        in_x = (x + radius >= x0_um) & (x - radius <= x1_um)
        return np.asarray(self._holes[in_x & (y + radius >= y0_um) & (y - radius <= y1_um)])

    def fraction(self, x_um: NDArray[np.float64], y_um: NDArray[np.float64], cell_um: float) -> NDArray[np.float64]:
        """Return the share of metal (0..1) in square cells of side `cell_um` centred at ``x_um[:, None], y_um``."""
        # This is for the lowest slice, where no step removes metal. Exact for the rectangle; at a hole's edge the
        # share falls linearly over one cell. Where holes overlap, the one that takes most of a cell counts.
        x0, y0, x1, y1 = self.rectangle_um
        half = cell_um / 2
        in_x = np.clip(np.minimum(x_um + half, x1) - np.maximum(x_um - half, x0), 0, cell_um) / cell_um
        in_y = np.clip(np.minimum(y_um + half, y1) - np.maximum(y_um - half, y0), 0, cell_um) / cell_um
        left = np.ones((len(x_um), len(y_um)))
        near = self._holes_near(x_um[0] - cell_um, y_um[0] - cell_um, x_um[-1] + cell_um, y_um[-1] + cell_um)
        for hole_x, hole_y, radius in near:
            outside = np.hypot(x_um[:, None] - hole_x, y_um[None, :] - hole_y) - radius
            left = np.minimum(left, np.clip(0.5 + outside / cell_um, 0.0, 1.0))
        return np.asarray(in_x[:, None] * in_y[None, :] * left)


class KerfField:
    """Metal left, per slice.

    Parameters
    ----------
    n_slices : int
        Slices of the workpiece height, counted from the bottom.
    stock : Stock
        The blank from which tiles are filled when they are first needed.
    cell_um : float
        Side of a cell in um.
    extent_um : float
        Side of the square the field covers, from the table's origin (row T-61).

    Attributes
    ----------
    tiles : uint16 array (capacity, n_slices, TILE, TILE)
        Parts of metal left, indexed ``[tile, slice, ix, iy]``; cell ``(ix, iy)`` of tile ``(tx, ty)`` covers
        ``x`` from ``(tx * TILE + ix) * cell_um`` on, likewise ``y``. The metal's edge is the half-full level
        between cell centres.
    index : int32 array (nx, ny)
        The tile's index in `tiles`; -1 if it is not allocated, because the stock is untouched there.
    relief : Relief or None
        The places at which each slice of a stepped stock has metal; None if all slices have it everywhere.
    gone : tuple of Polygon
        Pieces that fell out of the stock, in um: `remove_piece`.
    levels : float32 array (capacity, TILE, TILE)
        Of a stepped stock, its height over a slice's before the cut, ``[tile, ix, iy]``; otherwise it has no tiles.

    Raises
    ------
    InputError
        If a step of the stock falls within a slice.
    """

    def __init__(self, n_slices: int, stock: Stock, cell_um: float = 4.0, extent_um: float | None = None) -> None:
        extent_um = max(stock.rectangle_um[2:]) if extent_um is None else extent_um
        self.n_slices = n_slices
        self.stock = stock
        self._even = Stock(stock.rectangle_um, stock.holes_um)  # without its lower regions
        self.cell_um = cell_um
        n = int(np.ceil(extent_um / (cell_um * TILE))) + 2
        self.index: NDArray[np.int32] = np.full((n, n), -1, np.int32)
        self.tiles: NDArray[np.uint16] = np.empty((64, n_slices, TILE, TILE), np.uint16)
        self.count = 0
        self._stock_parts = 0
        self._stock_beyond = 0.0
        self.gone: tuple[shapely.Polygon, ...] = ()
        self.relief: Relief | None = None
        if stock.lower_regions and stock.height_mm is not None:
            self.relief = Relief(stock.lower_regions, stock.height_mm, n_slices)
        self.levels: NDArray[np.float32] = np.empty((64 if self.relief else 0, TILE, TILE), np.float32)

    @property
    def part_area_um2(self) -> float:
        """Area in um2 of one part of a cell."""
        return self.cell_um**2 / FULL

    def allocate(self, x_um: float, y_um: float, reach_um: float, lean_um: tuple[float, float] = (0.0, 0.0)) -> bool:
        """Allocate every tile within `reach_um` of a point; return whether any was new."""
        # with `lean_um`, of all points on the line from the point to the one displaced by it
        pieces = max(1, math.ceil(max(abs(lean) for lean in lean_um) / (4 * self.cell_um * TILE)))
        if pieces > 1:  # the rectangle around a long diagonal would be mostly empty
            u, v = (lean / pieces for lean in lean_um)
            new = False
            for k in range(pieces):
                new |= self.allocate(x_um + k * u, y_um + k * v, reach_um, (u, v))
            return new
        side = self.cell_um * TILE
        last = self.index.shape[0] - 1
        (x0, x1), (y0, y1) = (
            (
                min(max(int((place + min(lean, 0.0) - reach_um) // side), 0), last),
                min(max(int((place + max(lean, 0.0) + reach_um) // side), 0), last),
            )
            for place, lean in zip((x_um, y_um), lean_um, strict=True)
        )
        window = self.index[x0 : x1 + 1, y0 : y1 + 1]
        if window.min() >= 0:
            return False
        for tx, ty in np.argwhere(window < 0):
            self._add_tile(x0 + int(tx), y0 + int(ty))
        return True

    def _add_tile(self, tx: int, ty: int) -> None:
        if self.count == len(self.tiles):
            grown = np.empty((self.count * 3 // 2 + 1, *self.tiles.shape[1:]), np.uint16)
            grown[: self.count] = self.tiles
            self.tiles = grown
        parts = self._stock_tile(tx, ty)
        self.tiles[self.count] = parts
        self._stock_parts += int(parts.sum(dtype=np.int64)) * (self.n_slices if parts.ndim == 2 else 1)
        if self.relief is not None:
            self._add_levels(self.relief, tx, ty)
        self.index[tx, ty] = self.count
        self.count += 1

    def _add_levels(self, relief: Relief, tx: int, ty: int) -> None:
        if len(self.levels) < len(self.tiles):
            grown = np.empty((len(self.tiles), TILE, TILE), np.float32)
            grown[: self.count] = self.levels[: self.count]
            self.levels = grown
        self.levels[self.count] = relief.levels(*_centres_um(tx, ty, self.cell_um))
        last = slice(self.count, self.count + 1)
        self._stock_beyond += _beyond(self.tiles[last], self.levels[last])

    def stock_tile(self, tx: int, ty: int) -> NDArray[np.uint16]:
        """Return the parts of metal in a tile before the cut: (n_slices, TILE, TILE), read-only."""
        return np.broadcast_to(self._stock_tile(tx, ty), (self.n_slices, TILE, TILE))

    def _stock_tile(self, tx: int, ty: int) -> NDArray[np.uint16]:
        """Return the parts of metal in a tile before the cut; (TILE, TILE) if all slices are equal."""
        parts = self._blank_tile(tx, ty)
        gone = self._gone_in(tx, ty, self.gone)
        return parts if gone is None else np.where(gone, np.uint16(0), parts)

    def _blank_tile(self, tx: int, ty: int) -> NDArray[np.uint16]:
        """Return the parts of metal in a tile of the blank; (TILE, TILE) if all slices are equal."""
        if self.relief is not None:
            x, y = _centres_um(tx, ty, self.cell_um)
            metal = self.relief.metal(x, y, self.cell_um)
            if metal is not None:
                return _in_parts(self.stock.fraction(x, y, self.cell_um) * metal)
        return _even_parts(self._even, tx, ty, self.cell_um)

    def _gone_in(self, tx: int, ty: int, pieces: tuple[shapely.Polygon, ...]) -> NDArray[np.bool_] | None:
        """Return the cells (TILE, TILE) of a tile whose centres are in pieces; None if no piece is near."""
        if not pieces:
            return None
        side = self.cell_um * TILE
        box = shapely.box(tx * side, ty * side, (tx + 1) * side, (ty + 1) * side)
        near = [piece for piece in pieces if piece.intersects(box)]
        if not near:
            return None
        x, y = _centres_um(tx, ty, self.cell_um)
        return np.asarray(shapely.contains_xy(shapely.union_all(near), x[:, None], y[None, :]), np.bool_)

    def remove_piece(self, piece: shapely.Polygon) -> float:
        """Remove a piece that fell from the stock: in every slice, also where no tile is allocated yet."""
        # It then counts neither as removed metal nor as stock. Cells whose centres are in it are emptied.
        whole = isinstance(piece, shapely.Polygon) and piece.is_valid and not piece.is_empty
        if not whole or piece.interiors:  # snapshots store outlines
            raise InputError(f"a piece is a shapely.Polygon in um without holes or crossings, not {piece!r}")
        taken = 0
        for tx, ty, place in self.tile_places():
            gone = self._gone_in(tx, ty, (piece,))
            if gone is not None:
                taken += int(self.tiles[place][:, gone].sum(dtype=np.int64))
                if self.relief is not None:
                    self._stock_beyond -= _beyond(self.tiles[[place]], self.levels[[place]])
                self.tiles[place][:, gone] = 0
                if self.relief is not None:
                    self._stock_beyond += _beyond(self.tiles[[place]], self.levels[[place]])
        self._stock_parts -= taken
        self.gone = (*self.gone, piece)
        return taken * self.part_area_um2

    @property
    def removed_parts(self) -> int:
        """Parts of cells removed so far in all slices; exact."""
        return self._stock_parts - int(self.tiles[: self.count].sum(dtype=np.int64))

    @property
    def removed_um2(self) -> float:
        """Volume removed so far, over the height of a slice."""
        parts: float = self.removed_parts
        if self.relief is not None:
            parts += self._stock_beyond - _beyond(self.tiles[: self.count], self.levels[: self.count])
        return parts * self.part_area_um2

    def tile_places(self) -> Iterator[tuple[int, int, int]]:
        """Yield ``(tx, ty, place)`` of every allocated tile."""
        for tx, ty in np.argwhere(self.index >= 0):
            yield int(tx), int(ty), int(self.index[tx, ty])

    def patch(self, slice_index: int, ix0: int, ix1: int, iy0: int, iy1: int) -> NDArray[np.float64]:
        """Return the metal fraction (0..1) of the cells ``ix0 <= ix < ix1, iy0 <= iy < iy1`` of one slice."""
        out = np.empty((ix1 - ix0, iy1 - iy0))
        for tx in range(ix0 // TILE, (ix1 - 1) // TILE + 1):
            for ty in range(iy0 // TILE, (iy1 - 1) // TILE + 1):
                inside = 0 <= tx < self.index.shape[0] and 0 <= ty < self.index.shape[1]
                place = int(self.index[tx, ty]) if inside else -1
                tile = (self.stock_tile(tx, ty) if place < 0 else self.tiles[place])[slice_index]
                a0, a1 = max(ix0, tx * TILE), min(ix1, (tx + 1) * TILE)
                b0, b1 = max(iy0, ty * TILE), min(iy1, (ty + 1) * TILE)
                out[a0 - ix0 : a1 - ix0, b0 - iy0 : b1 - iy0] = (
                    tile[a0 - tx * TILE : a1 - tx * TILE, b0 - ty * TILE : b1 - ty * TILE] / FULL
                )
        return out

    def snapshot(self) -> dict[str, NDArray[np.generic]]:
        """Return a copy of the state as arrays."""
        return {
            "tiles": self.tiles[: self.count].copy(),
            "index": self.index.copy(),
            "stock_parts": np.array(self._stock_parts),
            "stock_beyond": np.array(self._stock_beyond),
            "gone": _rings(self.gone),
        }

    def restore(self, state: dict[str, NDArray[np.generic]]) -> None:
        """Load a `snapshot`."""
        self.tiles = np.array(state["tiles"], np.uint16)
        self.count = len(self.tiles)
        if self.count == 0:
            self.tiles = np.empty((64, self.n_slices, TILE, TILE), np.uint16)
        self.index = np.array(state["index"], np.int32)
        self._stock_parts = int(state["stock_parts"])
        self._stock_beyond = float(state["stock_beyond"])
        self.gone = _pieces(state["gone"])
        if self.relief is not None:
            self.levels = np.empty((len(self.tiles), TILE, TILE), np.float32)
            for tx, ty, place in self.tile_places():
                self.levels[place] = self.relief.levels(*_centres_um(tx, ty, self.cell_um))


def _centres_um(tx: int, ty: int, cell_um: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the centres of a tile's cells in x and y."""
    centres = np.arange(0.5, TILE, dtype=np.float64) * cell_um
    return tx * cell_um * TILE + centres, ty * cell_um * TILE + centres


def _in_parts(share: NDArray[np.float64]) -> NDArray[np.uint16]:
    return np.round(share * FULL).astype(np.uint16)


_WHOLE_TILE = np.full((TILE, TILE), FULL, np.uint16)


@functools.lru_cache(maxsize=1024)  # many episodes begin with the same stock; a tile takes 2 KB
def _even_parts(stock: Stock, tx: int, ty: int, cell_um: float) -> NDArray[np.uint16]:
    """Return the parts of metal in a tile (TILE, TILE) of a stock without lower regions; read-only."""
    side = cell_um * TILE
    x0, y0 = tx * side, ty * side
    if stock.is_whole(x0 - cell_um, y0 - cell_um, x0 + side + cell_um, y0 + side + cell_um):
        return _WHOLE_TILE
    return _in_parts(stock.fraction(*_centres_um(tx, ty, cell_um), cell_um))


def _rings(pieces: tuple[shapely.Polygon, ...]) -> NDArray[np.float64]:
    """Return the outlines of pieces as rows (piece, x, y)."""
    corners, numbers = shapely.get_coordinates([piece.exterior for piece in pieces], return_index=True)
    return np.column_stack([numbers, corners])


def _pieces(rows: NDArray[np.generic]) -> tuple[shapely.Polygon, ...]:
    """Return the pieces from the rows of `_rings`."""
    table = np.asarray(rows, np.float64)
    return tuple(shapely.Polygon(table[table[:, 0] == k, 1:]) for k in np.unique(table[:, 0]))


def _beyond(tiles: NDArray[np.uint16], levels: NDArray[np.float32]) -> float:
    """Return the parts of metal by which the topmost slices are higher than a slice; negative if lower."""
    top = np.ceil(levels - 0.5).astype(np.int64) - 1
    parts = np.take_along_axis(tiles, top[:, None], axis=1)[:, 0]
    return float((parts * (levels.astype(np.float64) - top - 1.0)).sum())


# --- compiled access of the pulse loop ---


_TILE_BITS, _TILE_MASK = np.uint64(5), np.uint64(TILE - 1)


@compiled
def _inside(px: float, py: float, index: NDArray[np.int32]) -> bool:
    """Return whether a point, in cells, is on the grid without its outermost cells, because of rounding."""
    limit = np.float64(index.shape[0] * TILE - 1)
    return bool(1.0 <= px < limit) and bool(1.0 <= py < limit)


@compiled
def _parts(
    tiles: NDArray[np.uint16], index: NDArray[np.int32], slice_index: int, cell_x: np.int64, cell_y: np.int64
) -> np.int64:
    """Return the parts of metal in a cell of the grid; full if its tile is not allocated."""
    # unsigned integers need no code for floor division and negative indices
    ix, iy = np.uint64(cell_x), np.uint64(cell_y)
    place = index[ix >> _TILE_BITS, iy >> _TILE_BITS]
    if place < 0:
        return np.int64(FULL)
    return np.int64(tiles[np.uint64(place), np.uint64(slice_index), ix & _TILE_MASK, iy & _TILE_MASK])


@compiled
def metal_height(
    index: NDArray[np.int32], levels: NDArray[np.float32], slice_index: int, cell_um: float, x: float, y: float
) -> float:
    """Return the height of a slice's metal at a point of a stepped stock, in slice heights: 0.5 to 1.5."""
    grid = 1.0 / cell_um
    if not _inside(x * grid, y * grid, index):
        return 1.0
    ix, iy = np.uint64(np.int64(x * grid)), np.uint64(np.int64(y * grid))
    place = index[ix >> _TILE_BITS, iy >> _TILE_BITS]
    if place < 0:
        return 1.0
    over = np.float64(levels[np.uint64(place), ix & _TILE_MASK, iy & _TILE_MASK]) - slice_index
    return over if 0.5 < over <= 1.5 else 1.0  # only the topmost slice may differ from 1


@compiled
def trace(
    tiles: NDArray[np.uint16], index: NDArray[np.int32], slice_index: int, cell_um: float, x: float, y: float,
    cosine: float, sine: float, start_um: float, end_um: float,
) -> float:
    """Return the distance in um from a point along a direction to the metal's edge; `NO_METAL_UM` without metal."""
    # the edge is one cell before the point at which the metal passed amounts to a cell, so it moves smoothly as a
    # cell is emptied
    grid = 1.0 / cell_um
    px, py = (x + cosine * start_um) * grid, (y + sine * start_um) * grid
    length = end_um - start_um
    if not (_inside(px, py, index) and _inside(px + length * cosine * grid, py + length * sine * grid, index)):
        return NO_METAL_UM  # there is no metal beyond the table
    # cell of the start, and lengths along the ray to the next cell border in x and in y
    ix, iy = np.int64(px), np.int64(py)
    per_x, per_y = cell_um / max(abs(cosine), PARALLEL), cell_um / max(abs(sine), PARALLEL)
    step_x, step_y = np.int64(1 if cosine > 0.0 else -1), np.int64(1 if sine > 0.0 else -1)
    next_x = (ix + 1 - px if cosine > 0.0 else px - ix) * per_x
    next_y = (iy + 1 - py if sine > 0.0 else py - iy) * per_y
    # metal passed so far, in parts times um, up to that of a full cell
    here, met, whole = 0.0, 0.0, FULL * cell_um
    while here < length:
        parts = np.float64(_parts(tiles, index, slice_index, ix, iy))
        along_x = next_x < next_y
        there = next_x if along_x else next_y
        # a cell counts by its share of metal and the length of the ray in it
        met += parts * (there - here)
        if met >= whole:
            # the full cell was reached within this step; the edge is one cell before
            return start_um + there - (met - whole) / parts - cell_um
        here = there
        ix += step_x if along_x else 0
        iy += 0 if along_x else step_y
        next_x += per_x if along_x else 0.0
        next_y += 0.0 if along_x else per_y
    return NO_METAL_UM


@compiled
def _clear_cells(
    tiles: NDArray[np.uint16], index: NDArray[np.int32], slice_index: int, ix: int, iy: int, step_x: int, step_y: int,
    length: int,
) -> float:
    """Return the number of empty cells before a row's metal, and the empty share of the first cell with metal."""
    limit = np.uint64(index.shape[0] * TILE)
    ux, uy = np.uint64(ix), np.uint64(iy)  # a cell below zero is one far beyond the limit
    left = length
    while left > 0 and ux < limit and uy < limit:
        place = index[ux >> _TILE_BITS, uy >> _TILE_BITS]
        if place < 0:  # untouched stock
            return float(length - left)
        row, column = ux & _TILE_MASK, uy & _TILE_MASK
        along = int(row) if step_x != 0 else int(column)
        run = min(left, TILE - along if step_x + step_y > 0 else along + 1)  # cells of the row in this tile
        tile, level = np.uint64(place), np.uint64(slice_index)
        for k in range(run):
            metal = np.int64(tiles[tile, level, row, column])
            if metal > 0:
                return length - left + k + 1.0 - metal * (1.0 / FULL)
            row += np.uint64(step_x)
            column += np.uint64(step_y)
        ux += np.uint64(step_x * run)
        uy += np.uint64(step_y * run)
        left -= run
    return float(length)


@compiled
def _carve_row(
    tiles: NDArray[np.uint16], index: NDArray[np.int32], slice_index: int, ix: int, iy: int, step_x: int, step_y: int,
    length: int, parts: int,
) -> int:
    """Remove `parts` from a row of `length` cells, from its beginning; return the parts that were not found."""
    quota = np.int64(parts)
    limit = np.uint64(index.shape[0] * TILE)
    ux, uy = np.uint64(ix), np.uint64(iy)  # a cell below zero is one far beyond the limit
    left = length
    while left > 0 and ux < limit and uy < limit:
        place = index[ux >> _TILE_BITS, uy >> _TILE_BITS]
        row, column = ux & _TILE_MASK, uy & _TILE_MASK
        along = int(row) if step_x != 0 else int(column)
        run = min(left, TILE - along if step_x + step_y > 0 else along + 1)  # cells of the row in this tile
        # without a tile the stock is untouched: the wire cannot be there
        if place >= 0:
            tile, level = np.uint64(place), np.uint64(slice_index)
            for _ in range(run):
                metal = np.int64(tiles[tile, level, row, column])
                if metal >= quota:
                    tiles[tile, level, row, column] = np.uint16(metal - quota)
                    return 0
                tiles[tile, level, row, column] = np.uint16(0)
                quota -= metal
                row += np.uint64(step_x)
                column += np.uint64(step_y)
        ux += np.uint64(step_x * run)
        uy += np.uint64(step_y * run)
        left -= run
    return int(quota)


@compiled
def carve_wall(
    tiles: NDArray[np.uint16], index: NDArray[np.int32], slice_index: int, cell_um: float, x: float, y: float,
    cosine: float, sine: float, edge_um: float, before_um: float, level_um: float, beyond_um: float,
    width_um: float, parts: int, rows: NDArray[np.float64],
) -> int:
    """Remove `parts` parts of metal from a wall; return the number of parts that were not found."""
    # The wall is perpendicular to a direction, at `edge_um` from the point, and `width_um` wide. Metal is searched
    # from `before_um` before it to `beyond_um` behind it. Discharges strike the nearest metal: a row of cells loses
    # less by a factor e for every `level_um` by which its metal is further away, which keeps the wall level between
    # rays. `rows` (2, `MOST_ROWS`) is a buffer.
    grid = 1.0 / cell_um
    # rows are parallel to the axis nearest to the direction, so each crosses the wall once
    along_x = abs(cosine) >= abs(sine)
    px, py = (x + cosine * edge_um) * grid, (y + sine * edge_um) * grid
    ahead, aside = (px, py) if along_x else (py, px)
    major, minor = (cosine, sine) if along_x else (sine, cosine)
    step = 1 if major > 0.0 else -1
    step_x, step_y = (step, 0) if along_x else (0, step)
    ahead -= step * before_um * grid
    length = int((before_um + beyond_um) * grid) + 1
    # width of the wall in rows
    extent = width_um * grid * abs(major)
    low, slant = aside - 0.5 * extent, minor / major
    high, fall = low + extent, abs(major) * cell_um / level_um
    first, weights = math.floor(low), 0.0
    count = min(math.floor(high) - first + 1, rows.shape[1])
    for n in range(count):
        row = first + n
        # place where this row meets the wall, which is oblique to the grid
        line = ahead - (row + 0.5 - aside) * slant
        cell = math.floor(line)
        ix, iy = (cell, row) if along_x else (row, cell)
        clear = _clear_cells(tiles, index, slice_index, ix, iy, step_x, step_y, length)
        behind = clear + (cell - line if step > 0 else line - cell - 1.0)
        weights += (min(high, row + 1.0) - max(low, float(row))) * exponential(-fall * behind)
        rows[0, n], rows[1, n] = clear, weights
    quota, spent, per_weight = 0, 0, parts / weights
    for n in range(count):
        # the last row gets the rest, so no part is lost
        due = parts if n == count - 1 else int(rows[1, n] * per_weight)
        quota += due - spent
        spent = due
        if quota > 0:
            row, clear = first + n, int(rows[0, n])
            cell = math.floor(ahead - (row + 0.5 - aside) * slant) + step * clear
            ix, iy = (cell, row) if along_x else (row, cell)
            quota = _carve_row(tiles, index, slice_index, ix, iy, step_x, step_y, length - clear, quota)
    return quota
