"""Stepped workpieces: exact metal of each slice at each place, and its removal by a plant."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from edmsim.errors import InputError
from edmsim.plant.workpiece.height_steps import LowerRegion, Relief, slices_below
from edmsim.plant.workpiece.kerf_field import FULL, KerfField, Stock

BLANK = (100.0, 102.0, 5_000.0, 5_000.0)
HALF_PART = 0.5 / FULL  # a cell's share is rounded to whole parts


def stepped(*steps, n_slices=5, height_mm=10.0, holes=()):
    return KerfField(n_slices, Stock(BLANK, holes, tuple(LowerRegion(*step) for step in steps), height_mm))


def volume_mm3(field, box_um):
    """Metal of the untouched stock in a box of whole cells."""
    ix0, iy0, ix1, iy1 = (int(v / field.cell_um) for v in box_um)
    share = sum(field.patch(k, ix0, ix1, iy0, iy1).sum() for k in range(field.n_slices))
    return share * field.cell_um**2 * 10.0 / field.n_slices * 1e-9


coordinate = st.floats(400.0, 800.0)


@pytest.mark.slow
@settings(max_examples=15)
@given(st.lists(st.tuples(coordinate, coordinate), min_size=3, max_size=3), st.floats(1.1, 10.0))
def test_slices_hold_the_area_of_the_solid_with_the_step(corners, height):
    triangle = shapely.Polygon(corners)
    if triangle.area < 1.0:
        return
    cut_mm = slices_below(height, 10.0, 5) * 2.0
    box = (320.0, 320.0, 880.0, 880.0)
    expected = (560.0**2 * 10.0 - triangle.area * (10.0 - cut_mm)) * 1e-9
    field = stepped((triangle, height))
    rounding = 140**2 * HALF_PART * 16e-9 * 10.0
    assert volume_mm3(field, box) == pytest.approx(expected, abs=rounding)


def test_a_step_off_the_grid_leaves_the_exact_share_of_its_cells():
    field = stepped((shapely.box(601.0, 0.0, 5_000.0, 603.0), 6.0))
    top, below = (field.patch(k, 149, 152, 148, 152) for k in (3, 2))
    assert (below == 1.0).all()
    # the step's corner is at (601, 603), in the cell from (600, 600): in x 3/4 and in y 3/4 of it have no metal
    np.testing.assert_allclose(top, [[1, 1, 1, 1], [0.25, 0.25, 1 - 9 / 16, 1], [0, 0, 0.25, 1]], atol=HALF_PART)


@pytest.mark.parametrize(
    "region",
    [
        shapely.box(40.0, -50.0, 80.0, 300.0),  # edges between two cells
        shapely.box(41.5, 16.0, 90.25, 70.0),
        shapely.Point(64.0, 60.0).buffer(37.0),
        shapely.Polygon([(-20.0, 5.0), (150.0, 60.0), (30.0, 140.0)]),
        shapely.box(10.0, 10.0, 50.0, 50.0) | shapely.box(70.0, 60.5, 71.0, 128.0),  # two, one within a cell's width
        shapely.box(64.0, 0.0, 200.0, 128.0),  # up to the tile's edge
        shapely.box(128.0, 0.0, 300.0, 128.0),  # touches the tile
    ],
    ids=range(7),
)
def test_every_cell_of_a_tile_has_the_area_and_the_height_of_the_solid(region):
    relief = Relief([LowerRegion(region, 4.0)], 10.0, 5)
    centres = np.arange(0.5, 32) * 4.0
    x, y = np.meshgrid(centres, centres, indexing="ij")
    covered = shapely.area(shapely.intersection(region, shapely.box(x - 2, y - 2, x + 2, y + 2))) / 16.0
    metal = relief.metal(centres, centres, 4.0)
    for number in range(5):
        expected = 1.0 - covered if number >= 2 else 1.0
        np.testing.assert_allclose(1.0 if metal is None else metal[number], expected, atol=1e-9)
    lower = shapely.intersects(region, shapely.points(x, y))
    np.testing.assert_array_equal(relief.levels(centres, centres), np.where(lower, 2.0, 5.0))


def test_the_workpiece_stands_on_its_lower_face():
    field = stepped((shapely.box(0, 0, 5_000, 5_000), 4.5))
    assert [field.patch(k, 100, 110, 100, 110).mean() for k in range(5)] == [1, 1, 0, 0, 0]


@pytest.mark.parametrize(
    ("height", "slices"), [(1.01, 1), (3.0, 1), (3.01, 2), (4.0, 2), (5.1, 3), (8.9, 4), (9.01, 5), (10.0, 5)]
)
def test_a_slice_has_metal_where_its_middle_lies_below_the_height(height, slices):
    assert slices_below(height, 10.0, 5) == slices
    relief = Relief([LowerRegion(shapely.box(0, 0, 10, 10), height)], 10.0, 5)
    assert sum(void.is_empty for void in relief.voids_um) == slices
    inside, outside = relief.heights_mm(np.array([(5.0, 5.0), (20.0, 5.0)]))
    assert (inside, outside) == (height, 10.0)


def test_the_earlier_of_overlapping_steps_holds():
    field = stepped((shapely.box(600, 600, 1_000, 1_000), 8.0), (shapely.box(400, 400, 1_000, 1_000), 2.0))
    heights = field.relief.heights_mm(np.array([(800.0, 800.0), (500.0, 500.0), (300.0, 300.0)]))
    assert heights.tolist() == [8.0, 2.0, 10.0]
    assert field.patch(3, 200, 201, 200, 201) == 1.0
    assert field.patch(3, 125, 126, 125, 126) == 0.0
    assert field.patch(0, 125, 126, 125, 126) == 1.0


def test_steps_keep_start_holes_and_the_blanks_edge():
    plain = KerfField(5, Stock(BLANK, ((700.0, 700.0, 90.0),)))
    field = stepped((shapely.box(0, 0, 3_000, 3_000), 4.0), holes=((700.0, 700.0, 90.0),))
    for number in range(5):
        expected = plain.patch(number, 0, 400, 0, 400) if number < 2 else 0.0
        np.testing.assert_array_equal(field.patch(number, 0, 400, 0, 400), expected * np.ones((400, 400)))


def test_distance_to_where_a_slice_lacks_metal():
    relief = Relief([LowerRegion(shapely.box(0, 0, 100, 100), 6.0)], 10.0, 5)
    clear = relief.clearance_um(np.array([(50.0, 50.0), (130.0, 50.0)]))
    np.testing.assert_allclose(clear[:3], np.inf)
    np.testing.assert_allclose(clear[3:], [[0.0, 30.0]] * 2)


def test_exact_accounting_with_steps_and_a_snapshot():
    field = stepped((shapely.Point(800, 600).buffer(150), 4.0), (shapely.box(0, 0, 700, 5_000), 6.0))
    rng = np.random.default_rng(3)
    taken = 0
    for step in range(40):
        field.allocate(600.0 + 60.0 * step, 600.0, 200.0)  # new tiles do not count as removed
        assert field.removed_parts == taken
        tile = field.tiles[rng.integers(field.count)]
        place = tuple(int(v) for v in (rng.integers(5), *rng.integers(32, size=2)))
        parts = int(rng.integers(int(tile[place]) + 1))
        tile[place] -= parts
        taken += parts
    assert taken > 0
    other = stepped((shapely.Point(800, 600).buffer(150), 4.0), (shapely.box(0, 0, 700, 5_000), 6.0))
    other.restore(field.snapshot())
    other.allocate(600.0, 1_500.0, 200.0)
    assert other.removed_parts == taken


@pytest.mark.slow
def test_unallocated_and_allocated_metal_are_the_same():
    steps = (shapely.Point(800, 600).buffer(150), 4.0), (shapely.box(0, 0, 700, 5_000), 6.0)
    touched, untouched = stepped(*steps), stepped(*steps)
    touched.allocate(700.0, 600.0, 400.0)
    for number in range(5):
        np.testing.assert_array_equal(touched.patch(number, 0, 300, 0, 300), untouched.patch(number, 0, 300, 0, 300))
    assert untouched.count == 0


def test_a_whole_height_step_changes_nothing():
    plain, field = KerfField(5, Stock(BLANK)), stepped((shapely.box(500, 500, 900, 900), 9.5))
    np.testing.assert_array_equal(field.patch(4, 0, 300, 0, 300), plain.patch(4, 0, 300, 0, 300))
    assert field.relief.clearance_um(np.array([(600.0, 600.0)])).min() == np.inf


@pytest.mark.parametrize(("height", "named"), [
    (0.0, "0 mm"), (-2.0, "-2 mm"), (10.1, "up to 10 mm"), (np.nan, "nan mm"), (1.0, "above 1 mm"), (0.3, "2 mm"),
])  # fmt: skip
def test_a_height_that_does_not_fit_is_refused(height, named):
    with pytest.raises(InputError, match=named) as caught:
        stepped((shapely.box(0, 0, 10, 10), height))
    assert "\n" not in str(caught.value)


def test_steps_need_the_height_they_are_steps_of():
    with pytest.raises(InputError, match="height_mm"):
        Stock(BLANK, lower_regions=(LowerRegion(shapely.box(0, 0, 1, 1), 3.0),))
