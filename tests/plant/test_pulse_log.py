"""Records of single pulses of a window: their places; recording changes nothing else."""

import copy

import numpy as np
import pytest

import edmsim
from edmsim.plant.kernel.state import OPEN, PULSE
from edmsim.plant.workpiece.kerf_field import Stock

# a straight edge 12 um in front of the wire: sparks, opens and, as it is driven on, contacts
STOCK = Stock((32_500.0 + 125.0 + 12.0, 0.0, 65_000.0, 65_000.0))


def machine(**setting):
    return edmsim.Machine.load(height_mm=5.0, **setting)


def driven(plant, windows=12):
    """Advance with two motor steps of 2 um in every window."""
    observed = []
    for _ in range(windows):
        now = plant.time_ns
        window = plant.advance([(now + 1_000_000, 0, 1), (now + 2_000_000, 0, 1)])
        observed.append((window, plant.last_pulses()))
    return observed


def test_discharges_lie_in_front_of_the_wire_where_the_metal_is():
    plant = edmsim.Plant(machine(), 3, stock=STOCK, resolution="fast")
    plant.watch_pulses()
    pulses = np.concatenate([pulses for _, pulses in driven(plant, 4)])
    placed = pulses[pulses["slice"] >= 0]
    assert len(placed) > 100
    assert {int(s) for s in placed["slice"]} == set(range(plant.resolution.slices))
    angle = 2 * np.pi * placed["ray"] / plant.resolution.rays
    x = placed["x_um"] + (125.0 + placed["gap_um"]) * np.cos(angle)
    assert np.all(x > STOCK.rectangle_um[0] - 8.0)  # a motor step may press the wire slightly into the metal
    assert np.all(x < STOCK.rectangle_um[0] + 60.0)
    assert np.all(pulses["slice"][pulses["kind"] == OPEN] == -1)


@pytest.mark.slow
@pytest.mark.parametrize("mechanics", ["modal", "mujoco"])
def test_watching_changes_no_bit(mechanics):
    plants = [
        edmsim.Plant(machine(), 5, stock=STOCK, resolution="fast", mechanics=mechanics) for _ in range(2)
    ]
    plants[1].watch_pulses()
    blind, watched = (driven(plant, 3) for plant in plants)
    assert [w for w, _ in blind] == [w for w, _ in watched]
    assert all(len(pulses) == 0 and pulses.dtype == PULSE for _, pulses in blind)
    for name, value in plants[0].snapshot().items():
        np.testing.assert_array_equal(value, plants[1].snapshot()[name])


def test_a_copy_goes_on_watching():
    plant = edmsim.Plant(machine(), 3, stock=STOCK, resolution="fast")
    plant.watch_pulses()
    driven(plant, 1)
    twin = copy.deepcopy(plant)
    assert twin.last_pulses().tobytes() == plant.last_pulses().tobytes()
    assert driven(twin, 1)[0][1].tobytes() == driven(plant, 1)[0][1].tobytes()


def test_a_pulse_without_a_place_has_that_of_no_other():
    plants = [edmsim.Plant(machine(), 3, stock=STOCK, resolution="fast") for _ in range(2)]
    plants[0].watch_pulses()
    driven(plants[0], 5)
    plants[1].restore(plants[0].snapshot())
    plants[1].watch_pulses()
    first, resumed = (driven(plant, 1)[0][1] for plant in plants)
    assert resumed.tobytes() == first.tobytes()
    nowhere = first[first["slice"] < 0]
    assert len(nowhere) > 0
    assert np.isnan([nowhere[name] for name in ("gap_um", "x_um", "y_um")]).all()
    assert set(nowhere["ray"]) == {-1}


def test_walls_are_observed_from_where_the_wire_was():
    plant = edmsim.Plant(machine(), 3, stock=STOCK, resolution="fast")
    plant.advance()
    place, gaps = plant.walls_um(2)
    assert place == pytest.approx((32_500.0, 32_500.0), abs=1.0)
    assert gaps[0] == pytest.approx(12.0, abs=4.0)  # towards the edge, within a cell
    assert gaps[plant.resolution.rays // 2] > 1e5  # away from it there is no metal
