"""MuJoCo and the plant's own integrator move an axis under a servo drive alike, with all that it has."""

from __future__ import annotations

import numpy as np
import pytest

import edmsim
from edmsim.controllers import axis as axes
from edmsim.controllers.axis.drive import axis_row
from edmsim.plant.axes.drives import Drives
from edmsim.plant.workpiece.kerf_field import Stock

FAR = Stock((60_000.0, 60_000.0, 61_000.0, 61_000.0))
MECHANICS = ("modal", "mujoco")


@pytest.fixture(scope="module")
def machine():
    return edmsim.Machine.load()


def plant_of(machine, mechanics, drive):
    return edmsim.Plant(
        machine, 1, stock=FAR, position_um=(10_000.0, 20_000.0), resolution="fast", mechanics=mechanics,
        drives={"x": drive},
    )


def drives_of(plant) -> Drives:
    return plant._drives


def course(machine, mechanics, drive, steps_of_window, windows=4):
    """Place of the table and current of the motor at the end of every window."""
    plant = plant_of(machine, mechanics, drive)
    found = []
    for k in range(windows):
        plant.advance(steps_of_window(k, plant.time_ns))
        row = drives_of(plant).axes.rows[0]
        found.append((float(row["place_um"]), float(row["rotor_um"]), int(row["count"])))
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["uhu", "servo-module", "eanpos"])
def test_both_integrators_move_an_axis_alike(machine, name):
    """Twelve steps there, a rest, twelve back, with stiction, friction and the screw's spring: within 0.5 um."""

    def steps(k, now_ns):
        way = {0: 1, 2: -1}.get(k, 0)
        return [(now_ns + j * 1_500_000, 0, way) for j in range(12)] if way else []

    modal, mujoco = (course(machine, mechanics, axes.tuned(name), steps) for mechanics in MECHANICS)
    assert modal[1, 0] == pytest.approx(10_024.0, abs=1.0)
    np.testing.assert_allclose(modal[:, 0], mujoco[:, 0], atol=0.5)
    np.testing.assert_allclose(modal[:, 2], mujoco[:, 2], atol=3)


def test_both_integrators_let_a_pushed_table_freewheel_alike(machine):
    """As delivered the UHU's output is off: a push by hand moves table and rotor against friction alone."""
    places = []
    for mechanics in MECHANICS:
        plant = plant_of(machine, mechanics, axes.make("uhu"))
        row = drives_of(plant).axes.rows[0]
        row["hand_Nm"] = 0.02
        plant.advance()
        row["hand_Nm"] = 0.0
        plant.advance()
        places.append(plant.place_um[0] - 10_000.0)
    assert places[0] > 4.0
    assert places[0] == pytest.approx(places[1], rel=0.05)


def test_the_screw_of_x_and_y_is_the_machine_s(machine):
    plant = plant_of(machine, "modal", axes.Uhu(axis_row("bench")))
    motor = drives_of(plant).axes.motors[0]
    assert motor["um_per_rad"] == pytest.approx(63.662, rel=1e-4)
    assert motor["table_kg"] == pytest.approx(45.3)
    assert motor["way_friction_N"] == machine.base.table.friction_N.value
    assert motor["inertia_kg_m2"] == axis_row("bench")["inertia_kg_m2"][0]
