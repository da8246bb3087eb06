"""After `reset` a plant equals a new one, and its defaults are those of its machine."""

import math

import numpy as np
import pytest

import edmsim
from edmsim.errors import InputError


def same(a, b):
    """Whether two snapshots are equal to the bit."""
    return a.keys() == b.keys() and all(a[name].tobytes() == b[name].tobytes() for name in a)


def test_reset_restores_generator_and_setting(machine):
    plant = edmsim.Plant(machine, 4, resolution="fast")
    fresh, first = plant.snapshot(), plant.advance()
    plant.set_generator(10.0, 100.0)
    plant.switch_generator(False)
    plant.advance([(plant.time_ns, 2, 1)])
    plant.reset(4)
    assert plant.generator_on
    assert plant.machine is machine
    assert same(plant.snapshot(), fresh)
    assert plant.advance() == first


def cut(plant, windows):
    """Move the wire towards +x, 8 um per window, and return the windows."""
    return [plant.advance([(plant.time_ns + k * 3_000_000, 0, 1) for k in range(8)]) for _ in range(windows)]


def test_reset_with_another_machine_is_a_plant_made_with_it(machine):
    other = machine.with_(height_mm=8.0, tension=9.0).sample(np.random.default_rng(3))
    plant, made = edmsim.Plant(machine, 4, resolution="fast"), edmsim.Plant(other, 7, resolution="fast")
    cut(plant, 10)
    assert plant.craters_mm3 > 0
    plant.set_generator(10.0, 100.0)
    plant.rethread((30_000.0, 31_000.0), 10**9)
    plant.advance()
    plant.reset(7, machine=other)
    assert plant.machine is other
    assert same(plant.snapshot(), made.snapshot())
    assert cut(plant, 10) == cut(made, 10)
    assert made.craters_mm3 > 0
    assert same(plant.snapshot(), made.snapshot())
    plant.reset(7)
    assert plant.machine is other


def test_a_drift_changes_the_water_and_nothing_else(machine):
    """A leaning wire bends at the same points; jets of other pressures then meet at another height."""
    leaning = (*machine.base.table.centre_um, 0.0, -8_000.0)
    plant, other = (edmsim.Plant(machine, 4, position_um=leaning, resolution="fast") for _ in range(2))
    assert cut(plant, 10) == cut(other, 10)
    plant.drift(machine)
    assert repr(cut(plant, 4)) == repr(cut(other, 4))
    from_below = machine.with_(flushing_upper_Pa=0.0)
    expected = edmsim.Plant(from_below, 4, resolution="fast").snapshot()["entering"]
    plant.drift(from_below)
    for moved_on in (plant, other.with_machine(from_below)):
        np.testing.assert_array_equal(moved_on.snapshot()["entering"], expected)


def test_a_leaning_wire_is_where_it_bends_from_the_first_pulse_of_a_pass(machine):
    """If rays were traced as if it bent at the guides, they would begin in the metal, and all pulses be shorts."""
    leaning = (*machine.base.table.centre_um, 0.0, -8_000.0)
    plant = edmsim.Plant(machine, 4, position_um=leaning, resolution="fast")
    for k in range(80):
        plant.advance([(plant.time_ns, 0, 1)] if k % 8 == 0 else [])
    plant.change_setup(machine)
    assert plant.advance().short < 50


def test_reset_after_a_pickle_restores_the_first_setting(machine):
    import pickle

    plant = edmsim.Plant(machine, 4, resolution="fast")
    fresh = plant.snapshot()
    plant.set_generator(10.0, 100.0)
    other = pickle.loads(pickle.dumps(plant))
    assert other.machine.t_on_us == 10.0
    other.reset(4)
    assert same(other.snapshot(), fresh)


def test_a_plant_starts_in_the_middle_of_its_own_table(machine, altered):
    small = altered(machine, {"base.table.travel_mm": 30.0})
    assert small.base.table.centre_um == (15_000.0, 15_000.0)
    plant = edmsim.Plant(small, 1, resolution="fast")
    assert plant.commanded_um == (15_000.0, 15_000.0)
    assert plant.advance().pulses == 255
    plant.reset(1)
    assert plant.commanded_um == (15_000.0, 15_000.0)


def test_a_single_pulse_leaves_the_wire_whole_and_the_pulses_after_it(machine):
    plant = edmsim.Plant(machine, 4, resolution="fast")
    counted = [plant.advance_pulse().pulses for _ in range(3)]
    assert counted == [1, 1, 1]
    assert plant.pulses == 3
    assert plant.advance().pulses == 255


def test_a_place_is_two_or_four_numbers_on_the_table(machine):
    plant = edmsim.Plant(machine, position_um=np.array([30_000.0, 31_000.0]), resolution="fast")
    assert plant.commanded_um == (30_000.0, 31_000.0)
    for place, said in (((), "0 numbers"), ((1.0, 2.0, 3.0), "3 numbers"), ((math.nan, 0.0), "nan"),
                        ((-3e3, 0.0), "X -3000 Y 0 um, is not on the table"), ((0.0, 1e9), "not on the table")):
        with pytest.raises(InputError, match=said):
            plant.reset(0, position_um=place)
        with pytest.raises(InputError, match=said):
            plant.rethread(place, 0)
    with pytest.raises(InputError, match="duration_ns is -1"):
        plant.rethread((30_000.0, 31_000.0), -1)
    with pytest.raises(InputError, match=r"seed is 1\.5: give a whole number"):
        plant.reset(1.5)
    assert plant.commanded_um == (30_000.0, 31_000.0)
