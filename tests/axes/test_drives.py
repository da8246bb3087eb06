"""Drives with a loop in a running plant: position, sampling instants, snapshots, faults, and four axes."""

import copy
import pickle
import subprocess
import sys

import numpy as np
import pytest

import edmsim
from edmsim.axis_bench import AxisBench
from edmsim.closed_loop.stops import StopCause
from edmsim.compiled.axis_rows import carray, sample
from edmsim.controllers import axis as axes
from edmsim.controllers.axis.drive import KP, PositionServo, axis_row
from edmsim.controllers.axis.eanpos import Eanpos
from edmsim.errors import EdmsimError, InputError
from edmsim.machine.setting import guide_bends
from edmsim.plant.axes.steps import straight_moves
from edmsim.plant.fleet import Fleet
from edmsim.plant.workpiece.kerf_field import Stock
from tests.test_closed_loop import contour, run, simulation

FAR = Stock((60_000.0, 60_000.0, 61_000.0, 61_000.0))
START = (10_000.0, 20_000.0)
WINDOW_NS = 25_500_000


@sample
def _nan(drive_at, axis_at):
    drive = carray(drive_at, 1)[0]
    drive.command = np.nan if drive.index > 150 else 0.0


@sample
def _full_speed(drive_at, axis_at):
    carray(drive_at, 1)[0].command = 1.0


@sample
def _count_samples(drive_at, axis_at):
    drive, axis = carray(drive_at, 1)[0], carray(axis_at, 1)[0]
    drive.reg[0] += 1
    drive.reg[1] = axis.time_ns
    drive.reg[2] = axis.lines
    drive.reg[3] = axis.ends


@sample
def _no_period(drive_at, axis_at):
    carray(drive_at, 1)[0].num = 0


class NoPeriod(PositionServo):
    sample = _no_period


class NanDrive(PositionServo):
    sample = _nan


class RunsAway(PositionServo):
    sample = _full_speed


class Counting(PositionServo):
    sample = _count_samples


def plant_with(machine, drives, mechanics="modal", **more):
    return edmsim.Plant(
        machine, 1, stock=FAR, position_um=START, resolution="fast", mechanics=mechanics, drives=drives, **more
    )


@pytest.fixture(scope="module")
def machine():
    return edmsim.Machine.load()


def steps(count, axis=0, first_ns=1_000_000, every_ns=2_000_000, way=1):
    return [(first_ns + k * every_ns, axis, way) for k in range(count)]


@pytest.mark.slow
@pytest.mark.parametrize("mechanics", ["modal", "mujoco"])
def test_a_servo_follows_its_steps(machine, mechanics):
    plant = plant_with(machine, {"x": axes.make("servo")}, mechanics)
    plant.advance([*steps(5), (12_000_000, 1, -1)])
    for _ in range(4):
        plant.advance()
    assert plant.commanded_um == (10_010.0, 19_998.0)
    x, y = plant.place_um
    assert x == pytest.approx(10_010.0, abs=0.3)  # half a count is 0.1 um
    assert y == pytest.approx(19_998.0, abs=0.3)
    assert plant.drive_faults == 0


@pytest.mark.slow
def test_both_integrators_move_a_servo_alike(machine):
    """Rigid in one, on the screw's spring in the other: the same rise to within 1.5 um of 10."""
    places = {}
    for mechanics in ("modal", "mujoco"):
        plant = plant_with(machine, {"x": axes.make("servo")}, mechanics)
        plant.advance([(t, 0, 1) for t in (0, 0, 0, 0, 0)])
        places[mechanics] = plant.place_um[0]
    assert places["modal"] == pytest.approx(places["mujoco"], abs=1.5)
    assert places["modal"] > 10_005.0


@pytest.mark.slow
def test_the_wire_is_where_a_servo_has_moved_it(machine):
    """The servo lags behind its setpoint: the metal must be met where the table is, not where it was commanded."""
    plant = plant_with(machine, {"x": axes.make("servo")})
    plant.advance([(WINDOW_NS - 2_000_000, 0, 1)])
    assert plant.commanded_um[0] == 10_002.0
    assert plant.axes_um[0] == pytest.approx(plant.place_um[0])
    assert 10_000.0 < plant.place_um[0] < 10_001.9


@pytest.mark.parametrize(("num", "den"), [(50 * 256_000, 24), (51_200 * 9, 1), (1_000_000, 1)])
def test_sampling_instants_never_drift(machine, num, den):
    drive = Counting()
    drive.record["num"], drive.record["den"], drive.record["reg"] = num, den, 0
    plant = plant_with(machine, {"x": drive})
    for _ in range(40):
        plant.advance()
    reg = plant.drives["x"].record["reg"][0]
    taken = int(reg[0])
    assert reg[1] == taken * num // den < plant.time_ns <= (taken + 1) * num // den


@pytest.mark.parametrize("mechanics", ["modal", "mujoco"])
@pytest.mark.parametrize("how", ["restore", "pickle", "deepcopy"])
def test_a_plant_with_a_servo_continues_bit_for_bit(machine, mechanics, how):
    plant = plant_with(machine, {"x": axes.make("servo"), "u": axes.make("servo")}, mechanics)
    plant.advance([*steps(4), *[(t + 9_000_000, 2, 1) for t, *_ in steps(2)]])
    if how == "restore":
        other = plant_with(machine, {"x": axes.make("servo"), "u": axes.make("servo")}, mechanics)
        other.restore(plant.snapshot())
    else:
        other = pickle.loads(pickle.dumps(plant)) if how == "pickle" else copy.deepcopy(plant)
    following = steps(3, first_ns=WINDOW_NS + 2_000_000)
    assert other.advance(following) == plant.advance(following)
    assert other.place_um == plant.place_um
    assert other.axes_um == plant.axes_um
    a, b = other.snapshot(), plant.snapshot()
    assert all(a[name].tobytes() == b[name].tobytes() for name in b)


def test_reset_switches_the_drives_on_again(machine):
    plant = plant_with(machine, {"x": axes.make("servo")})
    fresh = plant.snapshot()
    plant.drives["x"].record["reg"][0, KP] = 1
    plant.advance(steps(3))
    plant.reset(1, stock=FAR, position_um=START)
    again = plant.snapshot()
    assert again["drives"].tobytes() == fresh["drives"].tobytes()
    assert again["axes"].tobytes() == fresh["axes"].tobytes()


@pytest.mark.parametrize("mechanics", ["modal", "mujoco"])
def test_a_drive_whose_command_is_no_number_is_taken_out_of_service(machine, mechanics):
    plant = plant_with(machine, {"x": NanDrive(), "y": axes.make("servo")}, mechanics)
    plant.advance()
    assert plant.drive_faults == 0
    for _ in range(3):
        plant.advance()
    assert plant.drive_faults == 0b01
    assert plant.fault_reason == "the drive of x is out of service: it commanded what is not a share of its supply"


@pytest.mark.slow
def test_a_drive_that_sets_its_period_to_0_is_taken_out_of_service(machine):
    plant = plant_with(machine, {"x": NoPeriod()})
    plant.advance()
    plant.advance()
    assert plant.drive_faults == 0b01
    assert plant.fault_reason == "the drive of x is out of service: it set its period to 0/1 ns"
    bench = AxisBench({"x": NoPeriod()})
    with pytest.raises(EdmsimError, match="set its period to 0"):
        bench.run(1.0)


@pytest.mark.parametrize("mechanics", ["modal", "mujoco"])
@pytest.mark.parametrize("axis", ["x", "u"])
def test_an_axis_that_runs_away_within_a_window_ends_it(machine, mechanics, axis):
    """It ends with the pulse in which the axis is further from its path than the wire's radius, 125 um."""
    plant = plant_with(machine.with_(t_on_us=5.0, t_period_us=2_000.0), {axis: RunsAway()}, mechanics)
    window = plant.advance()
    assert 1 < window.pulses < 255
    assert plant.drive_faults == 1 << "xyuv".index(axis)
    assert plant.fault_reason.startswith(f"{axis} is 1")
    assert "from its path, more than the 125 um of the wire's radius" in plant.fault_reason


def test_a_servo_that_falls_behind_reports_its_fault(machine):
    drive = axes.make("servo")
    drive.record["reg"][0, 4] = 15
    plant = plant_with(machine, {"y": drive})
    plant.advance([(t, 1, 1) for t in (0, 0)])
    assert plant.drive_faults == 0b10


def test_plants_of_a_fleet_do_not_share_their_drives(machine):
    shared = axes.make("servo")
    alone = plant_with(machine, {"x": shared})
    both = [plant_with(machine, {"x": shared}) for _ in range(2)]
    fleet = Fleet(both, threads=2)
    fleet.steps[0, :4] = steps(4)
    fleet.advance(np.arange(2), np.array([4, 0]))
    alone.advance(steps(4))
    assert both[0].place_um == alone.place_um
    assert both[1].place_um == START
    assert (shared.record["setpoint"] == 0).all()


def test_input_lines_and_end_switches_reach_the_drive(machine):
    plant = edmsim.Plant(
        machine, 1, stock=FAR, position_um=(-2.0, 20_000.0), resolution="fast", drives={"x": Counting()}
    )
    plant.advance([(1_000_000, 4, 1), (2_000_000, 6, 1), (3_000_000, 4, 0)])
    reg = plant.drives["x"].record["reg"][0]
    assert (reg[2], reg[3]) == (0b100, 1)
    with pytest.raises(InputError, match="axis 0 to 3"):
        plant.advance([(plant.time_ns, 4, 2)])


def test_lines_without_a_drive_are_refused(machine):
    with pytest.raises(InputError, match="axis 0 to 3"):
        plant_with(machine, {}).advance([(0, 4, 1)])


def test_an_encoder_loses_edges_that_are_too_fast(machine):
    def place_and_count(rate_Hz):
        drive = axes.make("servo")
        drive.motor["edge_rate_Hz"] = rate_Hz
        plant = plant_with(machine, {"x": drive})
        plant.advance([(0, 0, 1)] * 10)
        for _ in range(3):
            plant.advance()
        row = plant.snapshot()["axes"][0]
        return plant.place_um[0], row["count"], row["missed"]

    place, count, missed = place_and_count(1e6)
    assert (round(place - 10_000.0), missed) == (20, 0)
    slow_place, slow_count, slow_missed = place_and_count(9e3)
    assert slow_missed != 0
    assert slow_place - 10_000.0 == pytest.approx((slow_count + slow_missed) / 5.0, abs=0.2)
    assert count == pytest.approx(100, abs=1)


def test_the_index_mark_is_latched_where_it_lies(machine):
    """Marks stand every 400 um of the scale, the table starts at 9998: the mark at 10000 is 10 counts further."""
    plant = edmsim.Plant(
        machine, 1, stock=FAR, position_um=(9_998.0, 20_000.0), resolution="fast", drives={"x": axes.make("servo")}
    )
    plant.advance([(0, 0, 1)] * 5)
    plant.advance()
    row = plant.snapshot()["axes"][0]
    assert (row["indexes"], row["index_at"]) == (1, 10)


# --- four axes ---


def test_u_and_v_lean_the_wire_by_height(machine):
    plant = plant_with(machine, {})
    plant.advance([(k * 1_000_000, 2, 1) for k in range(20)])
    assert plant.axes_um == (10_000.0, 20_000.0, 40.0, 0.0)
    assert plant.commanded_um == START
    for _ in range(4):
        plant.advance()
    bend_mm = guide_bends(machine).stiff_mm  # inside either guide
    heights = (np.arange(5) + 0.5) / 5 * machine.height_mm + machine.base.guides.clearance_mm.value
    expected = 10_000.0 + 40.0 * (heights - bend_mm) / (machine.guide_distance_mm - 2 * bend_mm)
    measured = [plant.walls_um(s)[0][0] for s in range(5)]
    deflection = plant.deflections_um()[:, 0]
    np.testing.assert_allclose(measured - deflection, expected, atol=0.01)


def test_a_leaning_wire_finds_metal_at_the_top_only(machine):
    x, y = START
    stock = Stock((x + 145.0, y - 3_000.0, x + 3_000.0, y + 3_000.0))
    plant = edmsim.Plant(machine, 1, stock=stock, position_um=START, resolution="fast")
    plant.switch_generator(False)  # sparks would change the gaps
    for _ in range(8):
        plant.advance([(plant.time_ns + k * 1_000_000, 2, 1) for k in range(2)])
    plant.advance()
    least = [plant.walls_um(s)[1].min() for s in range(5)]
    assert least == sorted(least, reverse=True)
    assert least[0] - least[-1] == pytest.approx(32.0 * 16.0 / machine.guide_distance_mm, abs=3.0)


# --- refusals, and what is compiled ---


def test_wrong_drives_are_refused(machine):
    with pytest.raises(InputError, match="the drive of x is 'servo': give one of"):
        edmsim.Plant(machine, drives={"x": "servo"}, resolution="fast")
    plant = plant_with(machine, {"x": axes.make("servo")})
    for axis, fault, said in (("y", "stuck", "no servo axis 'y'"), ("x", "stick", "mean 'stuck'")):
        with pytest.raises(InputError, match=said):
            plant.break_axis(axis, fault)
    with pytest.raises(InputError, match="no axis 'z'"):
        plant_with(machine, {"z": axes.make("servo")})
    drive = axes.make("servo")
    drive.motor["resistance_ohm"] = np.nan
    with pytest.raises(InputError, match="resistance_ohm is nan"):
        plant_with(machine, {"x": drive})
    for part, wrong, said in (
        ("record", None, "record of the x drive is not one row of"), ("motor", "table", "motor of the x drive"),
        ("sample", len, "sample of the x drive lacks the decorator"),
    ):  # fmt: skip
        drive = axes.make("servo")
        setattr(drive, part, wrong)
        with pytest.raises(InputError, match=said):
            plant_with(machine, {"x": drive})
    drive = axes.make("servo")
    drive.record["num"] = 10
    with pytest.raises(InputError, match="period is 10/1 ns"):
        plant_with(machine, {"x": drive})


@pytest.mark.slow
def test_a_plant_with_another_drive_compiles_nothing(machine):
    """The window and the servo's sample come from the cache in a new process."""
    plant_with(machine, {"x": axes.make("servo")}).advance()
    code = (
        "import edmsim, numba\n"
        "from numba.core import event\n"
        "from edmsim.controllers import axis\n"
        "with event.install_recorder('numba:compile') as seen:\n"
        "    p = edmsim.Plant(edmsim.Machine.load(), 1, resolution='fast', drives={'x': axis.make('servo')})\n"
        "    p.advance([(1000, 0, 1)])\n"
        "print([e.data['dispatcher'].py_func.__name__ for _, e in seen.buffer])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "fire_window" not in done.stdout
    assert "_servo" not in done.stdout


MECHANICS = ("modal", "mujoco")


def drives_of(plant):
    return plant._drives


def course(machine, mechanics, drive, steps_of_window, windows=4):
    """Place of the table and current of the motor at the end of every window."""
    plant = plant_with(machine, {"x": drive}, mechanics)
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
        plant = plant_with(machine, {"x": axes.make("uhu")}, mechanics)
        row = drives_of(plant).axes.rows[0]
        row["hand_Nm"] = 0.02
        plant.advance()
        row["hand_Nm"] = 0.0
        plant.advance()
        places.append(plant.place_um[0] - 10_000.0)
    assert places[0] > 4.0
    assert places[0] == pytest.approx(places[1], rel=0.05)


def test_the_screw_of_x_and_y_is_the_machine_s(machine):
    plant = plant_with(machine, {"x": axes.Uhu(axis_row("bench"))})
    motor = drives_of(plant).axes.motors[0]
    assert motor["um_per_rad"] == pytest.approx(63.662, rel=1e-4)
    assert motor["table_kg"] == pytest.approx(45.3)
    assert motor["way_friction_N"] == machine.base.table.friction_N.value
    assert motor["inertia_kg_m2"] == axis_row("bench")["inertia_kg_m2"][0]


SECOND_NS = 10**9


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
