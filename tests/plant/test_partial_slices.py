"""Heights that are not whole numbers of slices: the topmost slice is weighted by its metal."""

import numpy as np
import pytest
import shapely

import edmsim
from edmsim.closed_loop.straight import Traverse
from edmsim.errors import InputError
from edmsim.metrology.edges import metal_at
from edmsim.plant.plant import Plant
from edmsim.plant.workpiece.blanks import started_slot
from edmsim.plant.workpiece.height_steps import LowerRegion
from edmsim.plant.workpiece.kerf_field import TILE, KerfField, Stock

FEED_UM_S = 30.0
EVERYWHERE = shapely.box(0, 0, 65_000, 65_000)


def stepped_plant(full_mm, lowered, *, resolution="fast", mechanics="modal", seed=1):
    """Return a plant in a slot; `lowered` has lengths of cut in mm and the lower heights from there on."""
    machine = edmsim.Machine.load(height_mm=full_mm)
    x, y = machine.base.table.centre_um
    lower = [
        LowerRegion(EVERYWHERE if at is None else shapely.box(x + 1e3 * at, 0, 65_000, 65_000), height)
        for at, height in reversed(lowered)  # the first region that matches applies
    ]
    stock = started_slot(machine, (x, y), lower_regions=lower)
    return Plant(machine, seed, stock=stock, position_um=(x, y), resolution=resolution, mechanics=mechanics)


class Stretch:
    """A cut at constant feed, after some seconds of settling."""

    def __init__(self, plant, settle_s, seconds):
        traverse = Traverse(plant, FEED_UM_S)
        traverse.run(settle_s)
        self.plant, self.from_um, ns = plant, plant.commanded_um[0], plant.time_ns
        removed, craters = plant.removed_mm3, plant.craters_mm3
        self.windows = traverse.run(seconds)
        self.seconds = 1e-9 * (plant.time_ns - ns)
        self.travel_mm = 1e-3 * (plant.commanded_um[0] - self.from_um)
        self.removed_mm3, self.craters_mm3 = plant.removed_mm3 - removed, plant.craters_mm3 - craters

    @property
    def J_per_mm3(self):
        return sum(w.energy_J for w in self.windows) / self.removed_mm3

    @property
    def kerf_mm(self):
        """Width of the kerf in the lowest slice, where the wire has passed completely."""
        x, y = self.from_um, self.plant.machine.base.table.centre_um[1]
        along = np.arange(x, x + 1e3 * self.travel_mm - 200.0, 4.0)
        places = np.stack(np.meshgrid(along, y + np.arange(-300.0, 300.0, 2.0), indexing="ij"), axis=-1)
        return float((1.0 - metal_at(self.plant.field, places.reshape(-1, 2))[0]).sum() / len(along) * 2e-3)

    @property
    def height_mm(self):
        """Height that was cut: volume over the kerf's area."""
        return self.removed_mm3 / (self.kerf_mm * self.travel_mm)


@pytest.fixture(scope="module")
def of_10_mm():
    return Stretch(stepped_plant(10.0, []), 4.0, 14.0)


@pytest.mark.slow
@pytest.mark.parametrize("resolution", ["fast", "default"])
def test_10_mm_next_to_30_are_cut_as_10(of_10_mm, resolution):
    cut = Stretch(stepped_plant(30.0, [(None, 10.0)], resolution=resolution), 4.0, 14.0)
    assert cut.height_mm == pytest.approx(10.0, rel=0.02)
    assert cut.removed_mm3 == pytest.approx(cut.craters_mm3, rel=1e-9)
    assert cut.removed_mm3 / cut.seconds == pytest.approx(of_10_mm.removed_mm3 / of_10_mm.seconds, rel=0.03)
    assert cut.J_per_mm3 == pytest.approx(of_10_mm.J_per_mm3, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("height", [9.1, 13.0, 17.9, 26.0])  # shares of the topmost slice: 0.52, 1.17, 0.98, 1.33
def test_a_height_that_is_no_multiple_of_a_slice_is_cut_as_it_is(height):
    cut = Stretch(stepped_plant(30.0, [(None, height)]), 4.0, 12.0)
    assert cut.height_mm == pytest.approx(height, rel=0.025)
    assert cut.removed_mm3 == pytest.approx(cut.craters_mm3, rel=1e-9)


@pytest.mark.slow
def test_three_heights_follow_each_other_and_nothing_is_lost():
    plant = stepped_plant(30.0, [(0.2, 10.0), (1.0, 13.0)])
    heights = []
    for settle_s, seconds in ((14.0, 12.0), (16.0, 12.0)):  # from 0.42 mm and from 1.26 mm on
        heights.append(Stretch(plant, settle_s, seconds).height_mm)
    assert heights == pytest.approx([10.0, 13.0], rel=0.04)
    assert plant.removed_mm3 == pytest.approx(plant.craters_mm3, rel=5e-3)


@pytest.mark.slow
def test_the_topmost_slice_gets_discharges_by_its_metal():
    """26 of 30 mm in slices of 6 mm: the topmost of the four slices with metal represents 8 mm."""
    plant = stepped_plant(30.0, [(None, 26.0)])
    traverse = Traverse(plant, FEED_UM_S)
    traverse.run(4.0)
    plant.watch_pulses()
    counts = np.zeros(5)
    for _ in range(400):
        traverse.window()
        pulses = plant.last_pulses()
        counts += np.bincount(pulses["slice"][pulses["kind"] == 1], minlength=5)
    assert counts[4] == 0
    assert counts[3] / counts[:3].mean() == pytest.approx(8 / 6, rel=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("mechanics", ["modal", "mujoco"])
def test_same_seed_same_bits_and_a_snapshot_goes_on_alike(mechanics):
    """Across the step, where rays reach both heights."""
    plant, other = (stepped_plant(30.0, [(0.02, 10.0)], mechanics=mechanics, seed=5) for _ in range(2))
    first, second = Traverse(plant, FEED_UM_S), Traverse(other, FEED_UM_S)
    assert [first.window() for _ in range(40)] == [second.window() for _ in range(40)]
    metal = plant._arrays.metal
    assert 0.66 < metal[1] < 1.0
    snapshot = plant.snapshot()
    after = [plant.advance() for _ in range(30)]
    again = stepped_plant(30.0, [(0.02, 10.0)], mechanics=mechanics)
    again.restore(snapshot)
    assert [again.advance() for _ in range(30)] == after
    assert (again.removed_mm3, again.craters_mm3) == (plant.removed_mm3, plant.craters_mm3)
    plant.reset(5, stock=None)
    assert (plant._arrays.metal == 1.0).all()


@pytest.mark.parametrize("name", ["metal", "ray_metal"])
def test_a_snapshot_with_heights_no_slice_has_is_refused(name):
    plant = stepped_plant(30.0, [(None, 10.0)])
    state = plant.snapshot()
    state[name][0] = 0.0
    with pytest.raises(InputError, match=f"{name} is not within 0.5..1.5"):
        plant.restore(state)


def test_a_snapshot_whose_mean_height_is_rounded_is_restored():
    """At 15 of 30 mm the topmost slice has 1.5 times its metal, and the mean of its rays is a little larger."""
    plant = stepped_plant(30.0, [(None, 15.0)])
    state = plant.snapshot()
    state["metal"][:2] = np.nextafter(0.5, 0.0), np.nextafter(1.5, 2.0)
    plant.restore(state)
    np.testing.assert_array_equal(plant.snapshot()["metal"], state["metal"])


@pytest.mark.parametrize("heights", [(6.3,), (4.0, 7.1), (2.1, 5.0, 8.99), (9.2,)])
def test_the_field_counts_the_true_volume(heights):
    """Bands aligned with the cells; all metal in reach is removed, also after restoring a snapshot."""
    bands = [LowerRegion(shapely.box(400.0 + 200 * k, 0, 600.0 + 200 * k, 5_000), h) for k, h in enumerate(heights)]
    stock = Stock((0.0, 0.0, 5_000.0, 5_000.0), (), tuple(bands), 10.0)
    field, other = KerfField(5, stock), KerfField(5, stock)
    field.allocate(800.0, 800.0, 500.0)
    side = TILE * field.cell_um
    squares = [shapely.box(x * side, y * side, (x + 1) * side, (y + 1) * side) for x, y, _ in field.tile_places()]
    area = shapely.union_all(squares)
    volume = 10.0 * area.area - sum((10.0 - h) * band.intersection(area).area for band, h in bands)
    other.restore(field.snapshot())
    for each in (field, other):
        assert each.removed_um2 == 0.0
        each.tiles[: each.count] = 0
        assert each.removed_um2 * 2.0 == pytest.approx(volume, rel=1e-6)
