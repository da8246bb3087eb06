"""The kerf field as a store: counts, snapshots, and tiles that are invisible from outside."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from edmsim.plant.workpiece.kerf_field import FULL, TILE, KerfField, Stock

STOCK = Stock((100.0, 102.0, 5_000.0, 5_000.0), ((700.0, 700.0, 90.0),))


def visited(n_slices=2):
    field = KerfField(n_slices, STOCK)
    field.allocate(600.0, 600.0, 200.0)
    return field


def test_stock_is_metal_inside_the_rectangle_and_outside_the_hole():
    field = KerfField(1, STOCK)
    patch = field.patch(0, 0, 400, 0, 400)
    assert patch[:25].max() == 0.0  # x below 100 um
    assert patch[30, 25] == pytest.approx(0.5, abs=1e-4)  # the rim at 102 um is in the middle of this cell
    assert patch[30, 26:].min() == 1.0
    hole_um2 = (1 - patch[150:200, 150:200]).sum() * 16.0
    assert hole_um2 == pytest.approx(np.pi * 90.0**2, rel=1e-3)


@pytest.mark.parametrize("cell_um", [4.0, 6.0, 8.0])
def test_holes_that_overlap_take_away_what_lies_in_any_of_them(cell_um):
    holes = [(x, 700.0, 90.0) for x in np.arange(400.0, 701.0, 20.0)]
    field = KerfField(1, Stock((100.0, 102.0, 5_000.0, 5_000.0), tuple(holes)), cell_um)
    within = np.full(2, int(1_200 / cell_um))
    gone_um2 = (1 - field.patch(0, within[0] // 4, within[0], within[1] // 4, within[1])).sum() * cell_um**2
    union = shapely.union_all([shapely.Point(x, y).buffer(r, 256) for x, y, r in holes])
    assert gone_um2 == pytest.approx(union.area, rel=2e-3)


@given(st.integers(0, 40), st.integers(0, 40), st.floats(2.0, 9.0))
def test_a_tile_called_whole_is_whole(tx, ty, cell_um):
    side = TILE * cell_um
    corner = np.array([tx, ty]) * side
    x, y = (start + (np.arange(TILE) + 0.5) * cell_um for start in corner)
    if STOCK.is_whole(*(corner - cell_um), *(corner + side + cell_um)):
        assert (np.round(STOCK.fraction(x, y, cell_um) * FULL) == FULL).all()
    elif (corner > 1_000.0).all() and (corner + 2 * side < 5_000.0).all():
        raise AssertionError("far from every edge it is whole")


@pytest.mark.slow
@given(st.integers(0, 200), st.integers(1, 100), st.integers(0, 200), st.integers(1, 100))
def test_a_patch_does_not_show_the_tiles(ix, nx, iy, ny):
    field = visited()
    field.tiles[: field.count, 1] //= 3
    whole = field.patch(1, 0, 320, 0, 320)
    np.testing.assert_array_equal(field.patch(1, ix, ix + nx, iy, iy + ny), whole[ix : ix + nx, iy : iy + ny])


def test_a_patch_tells_the_slices_apart_and_adds_no_tiles():
    field = visited()
    count = field.count
    cell = 600 // 4
    field.tiles[field.index[cell // TILE, cell // TILE], 1, cell % TILE, cell % TILE] = FULL // 4
    assert field.patch(0, cell, cell + 1, cell, cell + 1) == 1.0
    assert field.patch(1, cell, cell + 1, cell, cell + 1) == 0.25
    field.patch(0, 0, 1_000, 0, 1_000)
    assert field.count == count


def test_allocate_says_whether_it_added_tiles_and_keeps_what_was_cut():
    field = KerfField(1, STOCK)
    assert field.allocate(600.0, 600.0, 200.0)
    assert not field.allocate(600.0, 600.0, 200.0)
    field.tiles[: field.count] = 7
    before = field.count
    for x in range(600, 4_000, 100):  # beyond the initial capacity
        field.allocate(float(x), 600.0, 200.0)
    assert field.count > 64
    assert (field.tiles[:before] == 7).all()
    places = sorted(place for _, _, place in field.tile_places())
    assert places == list(range(field.count))


def test_a_snapshot_brings_everything_back():
    field = visited()
    field.tiles[0, 0, :5] = 11
    state, removed = field.snapshot(), field.removed_parts
    patch = field.patch(0, 0, 300, 0, 300)
    field.tiles[: field.count] = 0
    field.allocate(2_000.0, 2_000.0, 300.0)
    other = KerfField(2, STOCK)
    for target in (field, other):
        target.restore(state)
        assert target.removed_parts == removed
        np.testing.assert_array_equal(target.patch(0, 0, 300, 0, 300), patch)
        target.allocate(3_000.0, 600.0, 200.0)
        assert target.removed_parts == removed
    field.tiles[0] = 0
    other.restore(state)  # the snapshot shares no memory with a field restored from it
    assert other.removed_parts == removed


def test_a_snapshot_of_an_untouched_field_can_be_taken_back():
    field = KerfField(3, STOCK)
    state = field.snapshot()
    field.allocate(600.0, 600.0, 200.0)
    field.restore(state)
    assert field.count == 0
    assert field.allocate(600.0, 600.0, 200.0)
    assert field.removed_parts == 0
