"""The bench under MuJoCo: the machine's table moves as under edmsim's own integrator, and its ends stop it."""

import numpy as np
import pytest

import edmsim
from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis import CHIPS, tuned

from .puppet import Puppet, command


@pytest.fixture(scope="module")
def machine():
    return edmsim.Machine.load()


def course(machine, mechanics, name):
    """Samples of x while both axes of the table move there and back, and half a second after."""
    bench = AxisBench({"x": tuned(name), "y": tuned(name)}, mechanics=mechanics, machine=machine)
    bench.run(0.02)
    bench.trace = True
    bench.steps("x", 60, 300.0, 3_000.0)
    bench.steps("x", -20)
    bench.steps("y", -30, 100.0)
    bench.run(0.8)
    return bench.samples("x"), bench.samples("y")


@pytest.mark.parametrize("name", CHIPS)
def test_a_move_under_each_chip_is_the_same_in_both_mechanics(machine, name):
    """A ramp of 120 um and 40 um at once: the table within 0.3 um at every sample, the count within 3."""
    for modal, mujoco in zip(course(machine, "modal", name), course(machine, "mujoco", name), strict=True):
        assert modal["time_ns"].tolist() == mujoco["time_ns"].tolist()
        assert np.ptp(modal["place_um"]) > 55.0
        np.testing.assert_allclose(modal["place_um"], mujoco["place_um"], atol=0.3)
        np.testing.assert_allclose(modal["count"], mujoco["count"], atol=3)


def test_a_bench_with_a_machine_has_its_screws_and_stands_in_the_middle_of_its_travel(machine):
    bench = AxisBench({"x": tuned("uhu"), "u": tuned("uhu")}, machine=machine)
    assert bench.axis("x")["place_um"] == machine.base.table.centre_um[0]
    assert bench.motor("x")["table_kg"] == pytest.approx(45.3)
    assert bench.motor("u")["table_kg"] == 45.0
    assert bench.motor("x")["way_friction_N"] == machine.base.table.friction_N.value


def test_the_end_of_the_travel_stops_the_table_under_mujoco(machine):
    bench = AxisBench({"y": Puppet(tuned("uhu").motor)}, mechanics="mujoco")
    command(bench, 0.9, "y", run_s=3.0)
    row, travel_um = bench.axis("y"), machine.base.table.travel_mm.value * 1e3
    assert travel_um < row["place_um"] < travel_um + 1_200.0
    assert row["ends"] == 2
    assert abs(row["speed_rad_s"]) < 1.0
    assert row["current_A"] > 20.0


def test_a_rotor_that_is_held_and_one_that_is_turned_by_hand_are_so_under_mujoco():
    bench = AxisBench({"x": Puppet(tuned("uhu").motor)}, mechanics="mujoco")
    start_um = float(bench.axis("x")["place_um"])
    bench.hold("x", True)
    command(bench, 0.3, run_s=0.1)
    assert bench.axis("x")["rotor_um"] == start_um
    bench.hold("x", False)
    command(bench, 0.0)
    bench.torque("x", -0.3)
    bench.run(0.2)
    assert bench.axis("x")["place_um"] < start_um - 10.0
