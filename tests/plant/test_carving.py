"""The kerf field seen and cut by rays: edges at any angle, craters exact to a part of a cell."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import edmsim
from edmsim.metrology.edges import metal_at
from edmsim.plant.kernel.state import MOST_ROWS, NO_METAL_UM, TILE
from edmsim.plant.workpiece.kerf_field import FULL, KerfField, Stock, carve_wall, trace

CELL = 4.0
MIDDLE = 512.0


def half_plane(angle, offset):
    """Field of metal where ``(x - MIDDLE) cos + (y - MIDDLE) sin > offset``, its cells filled by area."""
    field = KerfField(1, Stock((0.0, 0.0, 1.0, 1.0)), CELL, 4_000.0)
    field.allocate(MIDDLE, MIDDLE, 300.0)
    sub = (np.arange(TILE * 16) + 0.5) * CELL / 16
    for tx, ty, place in field.tile_places():
        x, y = tx * TILE * CELL + sub - MIDDLE, ty * TILE * CELL + sub - MIDDLE
        metal = x[:, None] * math.cos(angle) + y[None, :] * math.sin(angle) > offset
        share = metal.reshape(TILE, 16, TILE, 16).mean(axis=(1, 3))
        field.tiles[place, 0] = np.round(share * FULL)
    return field


def look(field, x, y, angle, start=0.0, end=300.0, number=0):
    return trace(field.tiles, field.index, number, field.cell_um, x, y, math.cos(angle), math.sin(angle), start, end)


@pytest.mark.slow
@given(st.floats(100.0, 400.0), st.floats(400.0, 600.0))
def test_a_ray_along_the_grid_finds_the_edge_exactly(edge, y):
    field = KerfField(1, Stock((edge, 0.0, 3_000.0, 3_000.0)), CELL, 4_000.0)
    field.allocate(300.0, 500.0, 400.0)
    assert look(field, 50.0, y, 0.0, end=400.0) == pytest.approx(edge - 50.0, abs=1e-3)


@pytest.mark.parametrize("degrees", [0, 7, 22.5, 30, 45, 63, 90, 135, 200, 301])
def test_an_edge_at_any_angle_is_found_within_a_cell_and_in_the_mean_within_a_fraction_of_a_um(degrees):
    angle = math.radians(degrees)
    errors = []
    for offset in (37.3, 38.9, 40.1):
        field = half_plane(angle, offset)
        for slant in (-0.5, -0.2, 0.0, 0.3, 0.6):
            for along in np.arange(-40.0, 40.0, 3.1):
                x, y = MIDDLE - along * math.sin(angle), MIDDLE + along * math.cos(angle)
                distance = look(field, x, y, angle + slant)
                errors.append(distance * math.cos(slant) - offset)
    assert abs(np.mean(errors)) < 0.25
    assert np.std(errors) < 0.8
    assert np.abs(errors).max() < CELL


def test_the_edge_recedes_smoothly_as_a_cell_is_emptied():
    field = KerfField(1, Stock((200.0, 0.0, 3_000.0, 3_000.0)), CELL, 4_000.0)
    field.allocate(200.0, 202.0, 200.0)
    cell = (50, 50)  # the first cell of metal
    place = field.index[cell[0] // TILE, cell[1] // TILE]
    edges = []
    for left in np.linspace(1.0, 0.0, 9):
        field.tiles[place, 0, cell[0] % TILE, cell[1] % TILE] = round(left * FULL)
        edges.append(look(field, 100.0, 202.0, 0.0))
    np.testing.assert_allclose(edges, np.linspace(100.0, 104.0, 9), atol=1e-3)


def test_where_no_metal_is_there_is_none():
    field = half_plane(0.0, 100.0)
    assert look(field, MIDDLE, MIDDLE, math.pi, end=200.0) == NO_METAL_UM  # in the opposite direction
    assert look(field, MIDDLE, MIDDLE, 0.0, end=90.0) == NO_METAL_UM  # the metal begins farther away
    assert look(field, 2.0, MIDDLE, math.pi, end=200.0) == NO_METAL_UM  # off the table


def test_a_ray_that_begins_in_the_metal_sees_its_own_start_at_most():
    field = half_plane(0.0, 0.0)
    assert look(field, MIDDLE + 50.0, MIDDLE, 0.0, start=10.0) == pytest.approx(10.0, abs=1e-6)


def cut(field, parts, *, angle=0.0, edge=20.0, width=40.0, beyond=40.0, place=(MIDDLE, MIDDLE), level=6.0):
    was = field.tiles[: field.count].astype(np.int64)
    left = carve_wall(
        field.tiles, field.index, 0, CELL, *place, math.cos(angle), math.sin(angle), edge, 12.0, level, beyond,
        width, parts, np.empty((2, MOST_ROWS)),
    )
    return was - field.tiles[: field.count], left


@pytest.mark.slow
@settings(max_examples=60)
@given(
    parts=st.integers(0, 80 * FULL), angle=st.floats(0.0, 6.3), width=st.floats(0.5, 80.0),
    edge=st.floats(0.0, 100.0), beyond=st.floats(0.0, 60.0),
)
def test_carving_removes_what_was_requested_less_what_it_reports(parts, angle, width, edge, beyond):
    field = KerfField(1, Stock((MIDDLE + 10.0, 0.0, 4_000.0, 4_000.0)), CELL, 4_000.0)
    field.allocate(MIDDLE, MIDDLE, 300.0)
    taken, left = cut(field, parts, angle=angle, width=width, edge=edge, beyond=beyond)
    assert taken.min() >= 0  # no cell gains metal, so none underflowed
    assert taken.sum() + left == parts
    assert 0 <= left <= parts
    assert field.removed_parts == taken.sum()
    places = {place: (tx, ty) for tx, ty, place in field.tile_places()}
    for place, ix, iy in np.argwhere(taken[:, 0] > 0):
        tx, ty = places[int(place)]
        x = (tx * TILE + ix + 0.5) * CELL - MIDDLE
        y = (ty * TILE + iy + 0.5) * CELL - MIDDLE
        ahead, aside = x * math.cos(angle) + y * math.sin(angle), y * math.cos(angle) - x * math.sin(angle)
        # metal is removed along the grid axis nearest to the direction, so it deviates sideways by at most this
        assert -12.0 - 2 * CELL <= ahead - edge <= beyond + width / 2 + 2 * CELL
        assert abs(aside) <= width / 2 + max(12.0, beyond) * abs(math.sin(2 * angle)) + 2 * CELL


def test_where_metal_runs_out_the_rest_is_reported():
    field = half_plane(0.0, 20.0)
    taken, left = cut(field, 10**9)
    assert 0 < taken.sum() < 10**9
    assert left == 10**9 - taken.sum()
    again, left = cut(field, 1_000, beyond=30.0)
    assert (again.sum(), left) == (0, 1_000)
    assert cut(field, 0)[1] == 0


@pytest.mark.parametrize("degrees", [0, 20, 44, 46, 90, 135, 200, 270])
def test_a_wall_recedes_where_it_was_carved_by_what_was_taken(degrees):
    angle = math.radians(degrees)
    field = half_plane(angle, 40.0)
    _, left = cut(field, int(40.0 * 3.0 / CELL**2 * FULL), angle=angle, edge=40.0)
    along = np.arange(-60.0, 61.0, 3.0)
    edges = np.array(
        [look(field, MIDDLE - u * math.sin(angle), MIDDLE + u * math.cos(angle), angle) for u in along]
    )
    assert left == 0
    assert edges[np.abs(along) < 15].mean() == pytest.approx(43.0, abs=0.4)
    assert edges[np.abs(along) > 30].mean() == pytest.approx(40.0, abs=0.4)


@pytest.mark.slow
def test_a_round_wall_stays_round_when_its_rays_carve_it():
    """After 200 windows of equal removal on 64 rays there are no ridges, at any angle to the grid."""
    x = MIDDLE + 0.3
    field = KerfField(1, Stock((0.0, 0.0, 1024.0, 1024.0), ((x, x, 150.0),)), CELL, 4_000.0)
    field.allocate(x, x, 300.0)
    jitter = np.random.default_rng(0)
    for _ in range(200):
        aside = jitter.uniform(-0.5, 0.5)
        for angle in 2 * math.pi * np.arange(64) / 64:
            edge = look(field, x, x, angle, start=117.0)
            width = edge * 2 * math.pi / 64
            place = (x - aside * width * math.sin(angle), x + aside * width * math.cos(angle))
            parts = int(width * 0.3 / CELL**2 * FULL)
            assert cut(field, parts, angle=angle, edge=edge, width=width, place=place)[1] == 0
    edges = [look(field, x, x, angle, start=117.0) for angle in np.linspace(0, 2 * math.pi, 500)]
    assert np.mean(edges) == pytest.approx(150.0 + 200 * 0.3, abs=0.5)
    assert np.std(edges) < 1.0
    assert np.ptp(edges) < CELL + 2.0


# --- removal by the plant ---


@pytest.mark.parametrize("resolution", ["fast", "default"])
def test_removed_metal_balances_the_craters(machine, drive, resolution):
    plant = edmsim.Plant(machine, seed=4, resolution=resolution)
    windows = drive(plant, 25.0, 5.0)
    assert plant.removed_mm3 > 0.3
    assert plant.removed_mm3 == pytest.approx(plant.craters_mm3, rel=1e-9)
    reported_mm3 = sum(w.crater_um3 for w in windows) * 1e-9
    assert plant.removed_mm3 == pytest.approx(reported_mm3, rel=1e-4)  # less remainders smaller than a part


def test_craters_wait_on_the_rays_until_they_are_traced_again(machine, drive):
    """At `fast` they are traced every fourth window; waiting craters count as removed, also after a new wire."""
    plant = edmsim.Plant(machine, seed=4, resolution="fast")
    assert plant.resolution.trace_windows == 4
    drive(plant, 25.0, 3.0)
    while plant.pulses % (4 * 255):
        plant.advance()
    def counted_mm3():
        """Return the removed volume, with remainders too small for a part of a cell."""
        return plant.removed_mm3 + plant.snapshot()["carry_um2"].sum() * 20e3 / plant.resolution.slices * 1e-9

    carved = [plant.field.removed_parts]
    for _ in range(5):
        counted = counted_mm3()
        window = plant.advance()
        assert window.crater_um3 > 0
        assert counted_mm3() == pytest.approx(counted + window.crater_um3 * 1e-9, rel=1e-9)
        carved.append(plant.field.removed_parts)
    assert carved[0] == carved[3] < carved[4] == carved[5]
    waiting = plant.removed_mm3
    x, y = plant.commanded_um
    plant.rethread((x - 20.0, y + 2_000.0), 60 * 10**9)
    assert plant.removed_mm3 == waiting
    drive(plant, 25.0, 4.0)
    assert plant.field.removed_parts > carved[5]
    assert plant.removed_mm3 == pytest.approx(plant.craters_mm3, rel=1e-9)


def test_energy_and_material_give_the_volume(machine, altered, drive):
    """Without loss by gas, metal per joule is the material's 9.3e-3 mm3/J, except for the little melted by shorts."""
    plant = edmsim.Plant(altered(machine, {"base.gas.ejection": 0.0}), seed=4, resolution="fast")
    windows = drive(plant, 15.0, 5.0)
    joule = sum(w.energy_J for w in windows)
    assert plant.removed_mm3 / joule == pytest.approx(9.3e-3, rel=0.02)


def test_a_row_of_cells_gives_less_the_further_away_its_metal_begins():
    field, y = half_plane(0.0, 40.0), MIDDLE + 64.0  # in the middle of a tile
    tile = field.tiles[field.index[int(MIDDLE + 40.0) // 128, int(y) // 128], 0]
    first, rows = int(MIDDLE + 40.0) // 4 % TILE, int(y) // 4 % TILE + np.arange(-5, 5)
    tile[first, rows[2]] = tile[first - 1, rows[6]] = FULL // 2  # edge half a cell, 2 um, farther away, and nearer
    taken, left = cut(field, 10 * FULL // 8, edge=40.0, level=4.0, place=(MIDDLE, y))
    assert left == 0
    lost = taken[taken.any(axis=(1, 2, 3)), 0].sum(axis=(0, 1))[rows]
    flat = np.delete(lost, [2, 6])
    assert np.ptp(flat) <= 2
    assert lost[2] == pytest.approx(flat[0] * math.exp(-0.5), rel=1e-3)
    assert lost[6] == pytest.approx(flat[0] * math.exp(0.5), rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("resolution", ["fast", "default"])
def test_the_front_of_a_straight_cut_is_level_between_the_rays(machine, drive, resolution):
    """Rays that keep their lines do not leave ridges between them, which no ray would see."""
    plant = edmsim.Plant(machine, seed=4, resolution=resolution)
    drive(plant, 28.0, 30.0)
    field, (x, y) = plant.field, plant.commanded_um
    ahead = np.radians(np.arange(-60.0, 61.0))
    for number in range(field.n_slices):
        edges = [look(field, x, y, angle, start=100.0, number=number) for angle in ahead]
        assert np.abs(np.diff(edges)).max() < field.cell_um
        assert np.ptp(edges) < 10.0


@pytest.mark.slow
@pytest.mark.parametrize("resolution", ["fast", "default"])
def test_no_metal_stays_where_the_wire_has_been(machine, drive, resolution):
    plant = edmsim.Plant(machine, seed=4, resolution=resolution)
    start, _ = plant.commanded_um
    drive(plant, 28.0, 40.0)
    end, y = plant.commanded_um
    along, across = np.arange(start + 150.0, end, 2.0), np.arange(y - 120.0, y + 121.0, 2.0)
    swept = np.stack(np.meshgrid(along, across, indexing="ij"), axis=-1).reshape(-1, 2)
    assert len(along) > 400
    assert metal_at(plant.field, swept).max() == 0.0
