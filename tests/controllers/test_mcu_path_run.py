"""The machine of 1982 itself: its own timers make the steps of a cut with `poscal-literal`, its switches stop it."""

import json
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edmsim.controllers.mcu.board import NAMES, STOP_BUTTON
from edmsim.controllers.mcu.chips.bus import TIMERS
from edmsim.controllers.mcu.computer import EMERGENCY, Computer, PathRun
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.controllers.mcu.firmware.timers import CPU_HZ, ENTRY_T, LOAD_T, POSITI_T, PULSE_T, RETURN_T
from edmsim.controllers.planner.registry import make_planner
from edmsim.errors import InputError
from edmsim.machine.machine import Machine

from .test_mcu_controller import ZIGZAG, rows, run, simulation

START = (30_000, 30_000)
SECOND = 1_000_000_000
WINDOW = 25_500_000
TICK_NS = SECOND / 8601.6
ROUTINE_T = ENTRY_T + LOAD_T + PULSE_T + POSITI_T + RETURN_T


def ns(t_states):
    return t_states * SECOND / CPU_HZ


def machine(*points, unit="um"):
    computer = Computer(unit=unit, wrap=True)
    computer.init()
    computer.set_position(*points[0])
    computer.set_speed(127)
    computer.start()
    return PathRun(computer, points), computer


def follow(follower, speeds, window=WINDOW, first=0):
    """Steps of windows one after the other, from a number of windows on."""
    steps = []
    for k, speed in enumerate(speeds, first):
        steps += follower.advance(k * window, (k + 1) * window, speed)
    return steps


def deviation_um(sim, points=ZIGZAG):
    """Largest distance of the position counters from the path."""
    columns = rows(sim)
    places = np.column_stack([columns["x_um"], columns["y_um"]])
    corners = np.array(points, float) + START
    away = []
    for a, b in pairwise(corners):
        share = np.clip((places - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        away.append(np.hypot(*(places - a - np.outer(share, b - a)).T))
    return float(np.min(away, axis=0).max())


def spoil(computer, which):
    """Put nonsense wherever the program stores a speed or loads a count."""
    bus = computer.board.bus
    store, write = bus.store, bus.write
    words = {"XVELOC": at.XVELOC, "YVELOC": at.YVELOC}
    ports = {"count of x": TIMERS, "count of y": TIMERS + 1}
    bus.store = lambda address, word: store(address, 9 if word and address == words.get(which) else word)
    bus.write = lambda address, byte: write(address, 0x21 if address == ports.get(which) else byte)


@pytest.fixture(scope="module")
def sound():
    return run(simulation(("mcu",), "poscal-literal"))


@pytest.mark.parametrize("which", ["XVELOC", "YVELOC", "count of x", "count of y"])
def test_a_spoilt_speed_or_count_wrecks_the_cut(which, sound):  # T-87, T-22, T-69, T-76
    assert sound.outcome == "finished"
    sim = simulation(("mcu",), "poscal-literal")
    spoil(sim.controller.computer, which)
    run(sim, 300)
    assert deviation_um(sim) > 4 * deviation_um(sound)


def test_a_planner_that_makes_the_steps_does_not_read_them():  # T-87
    ends = []
    for spoilt in (False, True):
        sim = simulation(("mcu",))
        if spoilt:
            spoil(sim.controller.computer, "YVELOC")
        run(sim, 60)
        ends.append((sim.plant.commanded_um, sim.plant.removed_mm3))
    assert ends[0] == ends[1]


def test_counters_position_and_plant_agree(sound):  # T-70, T-71
    computer = sound.controller.computer
    assert computer.position == sound.plant.commanded_um == tuple(np.array(ZIGZAG[-1]) + START)
    assert not computer.moving
    assert len({*rows(sound)["feed_um_s"]}) > 5


@pytest.mark.slow
@given(st.lists(st.tuples(st.integers(-40, 40), st.integers(-40, 40)), min_size=1, max_size=3), st.integers(20, 127))
@settings(max_examples=20)
def test_it_runs_as_the_literal_algorithm_but_as_late_as_its_routines(moves, speed):  # T-G6, T-71
    points = [START]
    for dx, dy in moves:
        points.append((points[-1][0] + 14 * dx, points[-1][1] + 14 * dy))
    if len({*points}) < 2 or any(a == b for a, b in pairwise(points)):
        return
    literal, (real, computer) = make_planner("poscal-literal", np.array(points)), machine(*points)
    ideal, made = (follow(who, [speed] * 40, 20 * SECOND) for who in (literal, real))
    assert (real.done, real.position_um, real.path_um) == (literal.done, literal.position_um, literal.path_um)
    for axis in (0, 1):
        assert [s.direction for s in made if s.axis == axis] == [s.direction for s in ideal if s.axis == axis]
    assert computer.position == real.position_um


def test_a_step_comes_when_its_interrupt_has_been_served():  # T-45, T-77
    both, _ = machine(START, (30_100, 30_100))
    steps = follow(both, [127] * 20)
    x, y = ([s.time_ns for s in steps if s.axis == axis] for axis in (0, 1))
    assert np.subtract(y, x) == pytest.approx(np.full(len(x), ns(ROUTINE_T)), abs=4)  # x is served first
    assert np.diff(x) == pytest.approx(np.full(len(x) - 1, 728 * TICK_NS), abs=4)  # 65536 div 90
    assert x[0] % TICK_NS == pytest.approx(ns(ENTRY_T + LOAD_T + PULSE_T), abs=4)


def test_a_new_speed_waits_for_the_optimising_routine_and_steps_put_it_off():  # T-77, T-44
    real, computer = machine(START, (30_400, 30_300))
    follow(real, [127] * 10)
    computer.steppers.busy(400_000)
    undisturbed_ns = computer.steppers.free_ns
    assert computer.bus.word(at.XVELOC) == 127 * 4 // 5
    steps = real.advance(10 * WINDOW, undisturbed_ns, 10)
    assert computer.bus.word(at.XVELOC) == 127 * 4 // 5
    assert len(steps) >= 3
    assert computer.steppers.free_ns - undisturbed_ns == pytest.approx(len(steps) * ns(ROUTINE_T), abs=4 * len(steps))
    real.advance(undisturbed_ns, undisturbed_ns + WINDOW, 10)
    assert (computer.bus.word(at.CUTVEL), computer.bus.word(at.XVELOC)) == (10, 8)


@pytest.mark.parametrize("window", [7_000_000, 25_500_000, 400_000_000])
def test_windows_may_be_cut_anywhere(window):
    points = [START, (30_101, 30_053), (30_040, 30_160)]
    (one, _), (other, _) = machine(*points), machine(*points)
    assert one.advance(0, 40 * SECOND, 127) == follow(other, [127] * (40 * SECOND // window), window)


def test_it_runs_back_the_way_it_came_and_stops_at_the_start():
    real, _ = machine(START, (30_060, 30_020), (30_060, 30_060))
    forth = follow(real, [127] * 150)
    assert real.done
    back = follow(real, [-127] * 250, first=150)
    assert not real.done
    assert (real.position_um, real.path_um) == (START, 0.0)
    assert len(back) == len(forth)
    again = follow(real, [127] * 400, first=400)
    assert real.done
    assert len(again) == len(forth)


def test_a_run_that_begins_backwards_at_the_start_makes_the_whole_path_all_the_same():
    real, computer = machine(START, (30_060, 30_020), (30_060, 30_060))
    assert real.advance(0, SECOND, -127) == []
    assert real.advance(SECOND, 2 * SECOND, 127)
    assert (real.done, computer.bus.word(at.NEWX), computer.bus.word(at.NEWY)) == (False, 30_060, 30_020)
    real.advance(2 * SECOND, 20 * SECOND, 127)
    assert (real.done, computer.position) == (True, (30_060, 30_060))


def test_speed_zero_stops_the_timers_and_the_move_goes_on():  # T-76
    real, computer = machine(START, (30_100, 30_040))
    follow(real, [127] * 20)
    place = computer.position
    assert follow(real, [0] * 20, first=20) == []
    assert computer.position == place
    assert [c.left for c in computer.board.timers.counters[:2]] == [0, 0]
    follow(real, [127] * 260, first=40)
    assert real.done
    assert computer.position == (30_100, 30_040)


def test_a_table_that_counts_steps():  # T-61
    real, computer = machine((10_000, 10_000), (10_050, 10_020), unit="step")
    steps = follow(real, [127] * 200)
    assert computer.position == (10_050, 10_020)
    assert real.position_um == (20_100, 20_040)
    assert real.path_um == pytest.approx(np.hypot(100, 40))
    assert len(steps) == 70


def test_a_path_that_is_none_is_refused():
    for points, words in (([START, START], "two different points"), ([START, (70_000, 0)], "a position is 0..65535")):
        with pytest.raises(InputError, match=words):
            machine(*points)
    real, _ = machine(START, (30_100, 30_000))
    with pytest.raises(InputError, match=r"must be -127\.\.127 units, not 128"):
        real.advance(0, WINDOW, 128)
    with pytest.raises(InputError, match="must not end before it starts"):
        real.advance(WINDOW, 0, 1)


@pytest.mark.parametrize("planner", ["poscal", "poscal-literal"])
@pytest.mark.parametrize("switch", NAMES)
def test_a_switch_opened_at_the_board_stops_the_cut(planner, switch):  # T-46, T-49
    sim = simulation(("mcu",), planner)
    run(sim, 40)
    board = sim.controller.computer.board
    board.switches.trip(switch)
    place = sim.plant.commanded_um
    sim.step()
    assert (sim.plant.commanded_um, sim.outcome) == (place, "emergency-stop")
    x, y = sim.controller.computer.position
    assert sim.reason == (
        f"the controller's emergency routine ({switch}) stopped the machine at x {x / 1e3:.3f} y {y / 1e3:.3f} mm"
    )
    assert (board.generator_on, board.codes) == (False, [0, 0])


@pytest.mark.parametrize("controller", ["counts", "mcu"])
def test_the_emergency_button_ends_a_cut(controller):  # T-49
    sim = run(simulation((controller,)), 20)
    sim.emergency_stop()
    assert sim.outcome == "emergency-stop"
    assert sim.reason.startswith("the emergency stop was pressed")
    assert ("emergency routine (emergency stop)" in sim.reason) == (controller == "mcu")
    if controller == "mcu":
        assert (sim.controller.computer.state, sim.controller.computer.cause) == (EMERGENCY, (STOP_BUTTON,))


def test_wire_break_and_end_switch_of_the_machine_reach_the_routine(monkeypatch):  # T-46, T-47
    broken = simulation(("mcu",), "poscal-literal", tension=0.98 * Machine.load().breaking_force)
    run(broken, 3000)
    assert broken.outcome == "wire-break"
    assert "the wire broke" in broken.reason
    assert "the controller's emergency routine (wire break) stopped the machine at x 30." in broken.reason
    away = simulation(("mcu",), "poscal-literal")
    run(away, 20)
    monkeypatch.setattr(type(away.plant), "place_um", (30_000.0, -3.0))
    away.step()
    assert away.outcome == "limit-switch"
    assert away.controller.computer.cause == ("y end",)
    assert away.reason.startswith("an end switch of the table opened at x 30.000 y -0.003 mm; the controller's")


def test_a_persistent_short_runs_the_emergency_routine():  # T-49
    sim = simulation(("mcu", ("max_tries", 0), ("patience_s", 0.0), ("shorted_share", 0.0)))
    run(sim, 400)
    assert sim.outcome == "persistent-short"
    assert "persistent short; the controller's emergency routine stopped" in sim.reason
    assert not sim.controller.computer.board.generator_on


def test_a_snapshot_holds_a_routine_under_way():
    real, computer = machine(START, (30_100, 30_060))
    (step, *_) = follow(make_planner("poscal-literal", np.array([START, (30_100, 30_060)])), [127] * 10)
    late_ns = real.advance(0, step.time_ns + 5_000_000, 127)
    other, _ = machine(START, (30_100, 30_060))
    other.restore(json.loads(json.dumps(real.snapshot())))
    start = computer.board.now_ns
    assert other.advance(start, start + SECOND, 90) == real.advance(start, start + SECOND, 90) != late_ns
