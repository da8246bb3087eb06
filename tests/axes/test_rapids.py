"""Moves between contours: drives place their axes themselves, with the wire cut and the generator off."""

import numpy as np
import pytest

import edmsim
from edmsim.controllers import axis as axes
from edmsim.controllers.axis.eanpos import Eanpos
from edmsim.cosim.stops import StopCause
from edmsim.plant.axes.rapid import straight_moves
from tests.axes.test_drives import FAR, START
from tests.test_cosim import contour, run, simulation

SECOND_NS = 10**9


@pytest.fixture(scope="module")
def machine():
    return edmsim.Machine.load()


def plant_with(machine, drives, mechanics="modal"):
    return edmsim.Plant(
        machine, 1, stock=FAR, position_um=START, resolution="fast", mechanics=mechanics, drives=drives
    )


@pytest.mark.slow
@pytest.mark.parametrize("mechanics", ["modal", "mujoco"])
@pytest.mark.parametrize("name", ["uhu", "servo-module", "eanpos"])
def test_a_drive_places_its_axes_itself(machine, name, mechanics):
    """Row Q-2: EANPOS goes there by ramps of its own; the others follow the steps of a rapid of 1 mm/s."""
    plant = plant_with(machine, {axis: axes.from_text(name) for axis in "xy"}, mechanics)
    plant.advance()
    before = plant.snapshot()["axes"]["count"][:2].copy()
    plant.rethread((START[0] + 600.0, START[1] - 800.0), 3 * SECOND_NS)
    assert plant.following_error_um == pytest.approx((0.0, 0.0), abs=2.0)
    assert plant.commanded_um == (START[0] + 600.0, START[1] - 800.0)
    counts = plant.snapshot()["axes"]["count"][:2] - before
    assert counts / 600.0 == pytest.approx(counts[0] / 600.0 * np.array([1.0, -4.0 / 3.0]), abs=0.05)
    assert abs(counts[0]) > 1000  # the encoders saw the way
    plant.advance()
    assert plant.place_um == pytest.approx(plant.commanded_um, abs=1.0)


def test_a_rapid_lasts_until_the_axes_are_in_place(machine):
    """EANPOS travels at its setvel of 2 mm/s with ramps of 50 ms, whatever time the move was given."""
    plant = plant_with(machine, {"x": axes.from_text("eanpos")})
    plant.advance()
    start_ns = plant.time_ns
    plant.rethread((START[0] + 4000.0, START[1]), SECOND_NS)
    assert (plant.time_ns - start_ns) * 1e-9 == pytest.approx(2.05, abs=0.03)
    assert plant.place_um[0] == pytest.approx(START[0] + 4000.0, abs=2.0)


def test_a_rapid_goes_straight(machine):
    moves = straight_moves([300, -400, 0, 0], 5, 500.0, [False] * 4)
    assert list(moves["axis"]) == [0, 1]
    assert list(moves["count"]) == [300, -400]
    assert moves["rate_Hz"] == pytest.approx([300.0, 400.0])
    assert (moves["end_ns"] - 5) * 1e-9 == pytest.approx([1.1, 1.1])  # a ramp of 0.1 s


def test_a_plant_goes_on_alike_after_a_rapid(machine):
    plant = plant_with(machine, {"x": axes.from_text("uhu"), "y": axes.from_text("eanpos")})
    other = plant_with(machine, {"x": axes.from_text("uhu"), "y": axes.from_text("eanpos")})
    plant.advance()
    other.restore(plant.snapshot())
    for each in (plant, other):
        each.rethread((START[0] + 321.0, START[1] + 50.0), SECOND_NS)
        each.advance()
    a, b = plant.snapshot(), other.snapshot()
    assert all(a[name].tobytes() == b[name].tobytes() for name in b)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["eanpos", "servo-module"])
def test_a_cut_goes_from_contour_to_contour_under_its_drives(name):
    sim = simulation(
        contour([(0, 0), (30, 0)]), contour([(300, 401), (330, 401)]), drives={k: axes.from_text(name) for k in "xy"}
    )
    run(sim)
    assert sim.outcome == "finished"
    assert sim.plant.place_um == pytest.approx(sim.plant.commanded_um, abs=2.0)
    assert sim.position_um == pytest.approx(sim.commanded_um, abs=1.0)


@pytest.mark.slow
def test_a_drive_that_trips_between_contours_stops_the_cut():
    """Row Q-A26: a following error beyond maxfollerr."""
    drives = {"x": Eanpos.tuned(changes={"maxfollerr": 100, "feedfw": 0}), "y": axes.make("servo")}
    sim = simulation(contour([(0, 0), (4, 0)]), contour([(3000, 0), (3030, 0)]), drives=drives)
    run(sim)
    assert sim.cause is StopCause.DRIVE_TRIP
    assert sim.reason.startswith("between two contours the drive of x")
