"""Errors of screws and ways in the plant: the wire is where the table truly is, whatever moves it."""

import pickle

import numpy as np
import pytest

from edmsim.controllers import axis
from edmsim.errors import InputError
from edmsim.machine.components import Constant, Geometry, Positive
from edmsim.machine.machine import Machine
from edmsim.plant.axes.geometric_errors import StillTable, errors_um, geometric_errors_of
from edmsim.plant.plant import Plant

START_UM = (20_000.0, 30_000.0)
STEP_NS = 3_000_000


def machine_of(backlash_um=0.0, **errors):
    kinds = {"lead_mm": Positive}
    found = Geometry(**{k: kinds.get(k, Constant)(value=v, source="ours") for k, v in errors.items()})
    machine = Machine.load(height_mm=5.0)
    table = machine.base.table.model_copy(update={"backlash_um": Constant(value=backlash_um, source="ours")})
    return machine.model_copy(update={"base": machine.base.model_copy(update={"geometry": found, "table": table})})


def plant_of(machine, **options):
    plant = Plant(machine, seed=1, resolution="fast", position_um=START_UM, **options)
    plant.switch_generator(False)
    return plant


def step(plant, *counts, windows=2):
    """Make steps of x and y, slowly enough for a stepper, and let the table rest."""
    for k, count in enumerate(counts):
        left = abs(count)
        while left:
            start, now = plant.time_ns, min(left, plant.window_ns // STEP_NS)
            plant.advance([(start + STEP_NS * n + 1, k, 1 if count > 0 else -1) for n in range(now)])
            left -= now
        for _ in range(windows):
            plant.advance()


ERRORS = {
    "x_pitch_um_m": 300.0, "y_pitch_um_m": -200.0, "x_periodic_um": 5.0, "y_periodic_um": 4.0, "lead_mm": 4.0,
    "squareness_um_m": 400.0, "x_straightness_um": 3.0, "y_straightness_um": 2.0,
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"mechanics": "mujoco"}, {"drives": {"x": axis.make("servo")}}])
def test_the_table_is_off_by_the_errors_of_screws_and_ways(options):
    # E-31, E-32: the plant that compensations act on
    machine = machine_of(**ERRORS)
    plant = plant_of(machine, **options)
    step(plant, 40, -30, windows=6)
    commanded = np.array(plant.commanded_um)
    assert commanded == pytest.approx((START_UM[0] + 80.0, START_UM[1] - 60.0))
    expected = commanded - errors_um(geometric_errors_of(machine), *commanded, 0.0)
    assert plant.place_um == pytest.approx(expected, abs=0.3)
    assert np.hypot(*(commanded - plant.place_um)) > 5.0
    assert plant.following_error_um == pytest.approx((0.0, 0.0), abs=0.3)


@pytest.mark.parametrize("name", [n for n in ERRORS if n != "lead_mm"])
def test_each_error_alone_has_its_own_effect(name):
    machine = machine_of(**{name: ERRORS[name], "lead_mm": 4.0})
    middle = StillTable(machine).move((32_500.0, 32_500.0))
    assert middle == pytest.approx((32_500.0, 32_500.0))
    x, y = StillTable(machine).move((33_500.0 + 32_500.0 - 1_000.0, 0.0))
    off = np.array((65_000.0 - x, 0.0 - y))
    expected = {
        "x_pitch_um_m": (9.75, 0.0), "y_pitch_um_m": (0.0, 6.5), "squareness_um_m": (0.0, 13.0),
        "x_straightness_um": (0.0, 3.0), "y_straightness_um": (2.0, 0.0),
        "x_periodic_um": (5.0 * np.sin(2 * np.pi * 32.5 / 4.0), 0.0),
        "y_periodic_um": (0.0, -4.0 * np.sin(2 * np.pi * 32.5 / 4.0)),
    }  # fmt: skip
    assert off == pytest.approx(expected[name], abs=1e-6)


def test_squareness_may_change_with_the_third_axis():
    # E-32, E-46: straightness and squareness that vary with u
    errors = geometric_errors_of(machine_of(squareness_um_m=400.0, change_per_mm=0.05))
    assert errors_um(errors, 42_500.0, 32_500.0, 0.0)[1] == pytest.approx(4.0)
    assert errors_um(errors, 42_500.0, 32_500.0, 10_000.0)[1] == pytest.approx(6.0)


def test_a_reversal_loses_the_backlash():
    plant = plant_of(machine_of(backlash_um=10.0, x_pitch_um_m=1e-6))
    places = []
    for count in (10, -2, -10, 2, 10):
        step(plant, count)
        places.append(plant.place_um[0] - START_UM[0])
    assert places == pytest.approx([15.0, 15.0, 1.0, 1.0, 15.0], abs=0.2)


def test_backlash_alone_stays_out_of_the_modal_model():
    plant = plant_of(machine_of(backlash_um=10.0))
    step(plant, 10)
    assert plant.place_um[0] - START_UM[0] == pytest.approx(20.0, abs=0.2)


def test_threading_elsewhere_keeps_errors_and_slack():
    machine = machine_of(backlash_um=10.0, **ERRORS)
    plant, table = plant_of(machine), StillTable(machine)
    table.commanded_um[:] = START_UM
    for to in ((25_000.0, 31_000.0), (24_000.0, 35_000.0)):
        plant.rethread(to, 1000)
        assert plant.place_um == pytest.approx(table.move(to), abs=1e-9)


def test_a_plant_with_errors_goes_on_from_a_snapshot():
    plant = plant_of(machine_of(backlash_um=10.0, **ERRORS))
    step(plant, 7, -3)
    other = pickle.loads(pickle.dumps(plant))
    for each in (plant, other):
        step(each, -5, 4)
    assert plant.place_um == other.place_um


def test_a_periodic_error_needs_its_lead():
    with pytest.raises(ValueError, match="a periodic error needs lead_mm"):
        machine_of(x_periodic_um=5.0)
    with pytest.raises(InputError, match="unknown machine"):
        Machine.load("worn")


def test_machines_without_the_section_have_no_errors():
    assert not geometric_errors_of(Machine.load())["pitch"].any()
    assert not Machine.load().base.geometry.has_errors
    worn = Machine.load("worn-table")
    assert worn.base.geometry.has_errors
    assert all(constant["source"] for constant in dict(worn.base.geometry.model_dump(exclude_none=True)).values())
