"""A stuck wire sensor: what a machine does that does not notice that its wire broke."""

import math

import numpy as np
import pytest

from edmsim.closed_loop.simulation import Simulation
from edmsim.controllers import axis, make
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.machine.setting import open_V
from edmsim.plant.kernel.state import OPEN
from edmsim.program.path import CutPath, WireContour
from edmsim.recording.windows import WindowTable

START_UM = 30_000
LENGTH_UM = 1_500
UNNOTICED = "its stuck sensor did not see that, and the machine went on without a wire"


def straight_cut(machine, contours=1, **options):
    """Return a cut along +x at a constant feed from a hole that the wire nearly fills, perhaps made again."""
    points_um = np.array([(START_UM, START_UM), (START_UM + LENGTH_UM, START_UM)], np.int64)
    line = WireContour(points_um, 0, points_um * 1e-3, False, "left", (), (1,))
    path = CutPath((line,) * contours, (25.0, 25.0, 35.0, 35.0), 0.16, (30.0, 30.0), (), "test")
    law = make("fixed", feed_um_s=30.0)
    return Simulation(machine, path, law, recorders=[WindowTable()], resolution="fast", seed=1, **options)


@pytest.fixture
def hot(hot_machine):
    return Machine.load(hot_machine, height_mm=20, tension=35.0)


@pytest.mark.slow
def test_a_stuck_wire_sensor_lets_the_machine_go_on_without_a_wire(hot):
    noticed, unnoticed = straight_cut(hot), straight_cut(hot, stuck_wire_sensor=True)
    noticed.run()
    unnoticed.run()
    assert (noticed.outcome, unnoticed.outcome) == ("wire-break", "finished")
    assert unnoticed.reason == f"{noticed.reason}; {UNNOTICED}"
    rows = unnoticed.recorders[0].to_arrow().to_pandas()
    broke = len(noticed.recorders[0].to_arrow())
    before, after = rows[:broke], rows[broke:]
    assert before["spark"].sum() > 0
    assert set(after["open"]) == {255}
    assert after["mean_current_A"].max() == 0.0
    assert before["wire_temperature_K"].notna().all()
    assert after["wire_temperature_K"].isna().all()
    share = hot.t_on_us / hot.t_period_us
    assert after["mean_voltage_V"].unique() == pytest.approx([open_V(hot) * share])
    assert after["path_um"].iloc[-1] == pytest.approx(LENGTH_UM, abs=2)
    assert unnoticed.plant.removed_mm3 == noticed.plant.removed_mm3
    assert unnoticed.plant.place_um == pytest.approx((START_UM + LENGTH_UM, START_UM), abs=2)


@pytest.mark.slow
def test_a_cut_without_a_wire_goes_on_from_a_snapshot(hot):
    first = straight_cut(hot, stuck_wire_sensor=True)
    while first.reason is None:
        first.step()
    first.step()
    second = straight_cut(hot, stuck_wire_sensor=True)
    second.restore(*first.snapshot())
    assert second.run() == first.run() == "finished"
    assert second.plant.time_ns == first.plant.time_ns
    assert second.plant.commanded_um == first.plant.commanded_um
    one, other = (cut.recorders[0].to_arrow().to_pandas() for cut in (first, second))
    assert one.equals(other)


@pytest.mark.slow
def test_the_wire_threaded_for_the_next_contour_cuts_again(hot):
    cut = straight_cut(hot, contours=2, stuck_wire_sensor=True)
    while cut.leg == 0:
        cut.step()
    removed_mm3 = cut.plant.removed_mm3
    cut.run()
    assert cut.leg == 1
    assert cut.plant.removed_mm3 > removed_mm3


@pytest.mark.slow
def test_the_time_limit_of_a_cut_without_a_wire_is_reported_as_well(hot):
    cut = straight_cut(hot, stuck_wire_sensor=True, max_time_s=40.0)
    assert cut.run() == "time-limit"
    assert UNNOTICED in cut.reason
    assert cut.reason.endswith("the time limit of 40 s of machine time was reached")


def test_servo_drives_follow_their_steps_without_a_wire():
    drives = {name: axis.from_text("uhu") for name in "xy"}
    plant = straight_cut(Machine.load(height_mm=5), drives=drives).plant
    plant.advance()
    plant.continue_without_wire()
    moved_um = 0.0
    for _ in range(40):
        begin_ns = plant.time_ns
        steps = [(begin_ns + k * 20_000_000 // 10, 0, 1) for k in range(10)]
        window = plant.advance(steps)
        moved_um += 10 * plant.machine.base.table.step_um.value
        assert window.open == window.pulses == 255
        assert math.isnan(window.gap_um)
    assert plant.commanded_um[0] == START_UM + moved_um
    behind_um = plant.commanded_um[0] - plant.place_um[0]
    assert 0 < abs(behind_um) < 20
    for _ in range(20):
        plant.advance()
    assert plant.place_um[0] == pytest.approx(START_UM + moved_um, abs=2)


@pytest.mark.parametrize("generator", ["iso-pulse", "iso-energetic", "ignition-pulse"])
def test_pulses_without_a_wire_take_as_long_as_open_ones(generator):
    machine = Machine.load(generator=generator, height_mm=5)
    far = straight_cut(machine).plant
    far.reset(1, stock=far.field.stock, position_um=(10_000.0, 10_000.0))  # 15 mm off the metal: all pulses are open
    open_ = far.advance()
    assert open_.open == 255
    far.continue_without_wire()
    bare = far.advance()
    assert (bare.open, bare.duration_ns) == (255, open_.duration_ns)
    assert bare.mean_voltage_V == pytest.approx(open_.mean_voltage_V, rel=0.02)  # a wire leaks a little


def test_watched_pulses_without_a_wire_are_open_and_there_is_no_gas():
    plant = straight_cut(Machine.load(height_mm=5)).plant
    plant.watch_pulses()
    while not plant.coverage().any():
        plant.advance()
    assert (plant.last_pulses()["kind"] != OPEN).any()
    plant.continue_without_wire()
    window = plant.advance(pulses=100)
    pulses = plant.last_pulses()
    assert set(pulses["kind"]) == {OPEN}
    assert set(pulses["slice"]) == {-1}
    np.testing.assert_allclose(np.diff(pulses["start_us"]), window.duration_ns * 1e-5, rtol=1e-4)
    assert not plant.coverage().any()


def test_steps_without_a_wire_are_checked(hot):
    plant = straight_cut(hot).plant
    plant.continue_without_wire()
    with pytest.raises(InputError, match="a step needs axis 0 to 3"):
        plant.advance([(0, 7, 1)])
    plant.rethread(plant.commanded_um, 0)
    assert plant.advance().pulses == 255
