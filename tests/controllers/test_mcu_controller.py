"""The 1982 controller in the loop: the same cut as its law alone, through registers and interrupts."""

import copy
import json
import pickle

import numpy as np
import pytest

from edmsim.closed_loop.simulation import Simulation
from edmsim.controllers import WindowObservation, make
from edmsim.controllers.mcu.computer import before_corner
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.controllers.mcu.firmware.timers import MAX_FEED_UM_S
from edmsim.controllers.planner.registry import PLANNERS
from edmsim.controllers.protocols import Step
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.program.path import CutPath, WireContour
from edmsim.recording.windows import WindowTable

from .test_mcu_optimise import window

START = (30_000, 30_000)
ZIGZAG = [(0, 0), (101, 53), (40, 160)]


def simulation(controller, planner="poscal", dwells=(), points=ZIGZAG, **setup):
    points_um = np.array(points, np.int64) + START
    contour = WireContour(points_um, 0, points_um * 1e-3, False, "left", dwells, (1,) * (len(points) - 1))
    path = CutPath((contour,), (25.0, 25.0, 40.0, 40.0), 0.13, (30.0, 30.0), (), "test")
    machine = Machine.load(**{"height_mm": 10, **setup})
    return Simulation(machine, path, make(*controller[:1], **dict(controller[1:])), planner=planner, seed=1,
                      resolution="fast", recorders=[WindowTable()])  # fmt: skip


def run(sim, windows=10_000):
    while sim.outcome is None and windows:
        sim.step()
        windows -= 1
    return sim


def rows(sim):
    table = sim.recorders[0].to_arrow()
    return {name: table.column(name).to_numpy() for name in table.column_names}


def assert_same(a, b):
    first, second = rows(a), rows(b)
    assert first.keys() == second.keys()
    for name, column in first.items():
        np.testing.assert_array_equal(column, second[name], err_msg=name)
    assert (a.outcome, a.plant.time_ns, a.plant.removed_mm3) == (b.outcome, b.plant.time_ns, b.plant.removed_mm3)


@pytest.mark.slow
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda controller: pickle.loads(pickle.dumps(controller))])
def test_a_copy_under_way_has_a_computer_of_its_own(copied):
    first, second = run(simulation(("mcu",)), 40).controller, run(simulation(("mcu",)), 40).controller
    twin = copied(first)
    windows = [WindowObservation(1.02 + 0.0255 * k, 0.0255, 6 * k, 40, 15.0, 1.0, 3.0, 10.0, 12.0) for k in range(20)]
    assert [twin.update(window) for window in windows] == [second.update(window) for window in windows]
    steps = [Step(10**7 * (k + 1), 0, 1) for k in range(5)]
    assert twin.drive(steps) == second.drive(steps)
    assert twin.snapshot() == second.snapshot() != first.snapshot()


@pytest.mark.slow
@pytest.mark.parametrize("generator", ["iso-pulse", "iso-energetic"])
@pytest.mark.parametrize("planner", [name for name in PLANNERS if name != "poscal-literal"])
def test_registers_and_law_cut_the_same_bit_for_bit(planner, generator):  # T-15, T-16, T-40, T-71
    law = run(simulation(("counts",), planner, ((1, 0.2),), generator=generator))
    whole = run(simulation(("mcu",), planner, ((1, 0.2),), generator=generator))
    assert_same(law, whole)
    assert law.outcome == "finished"
    computer = whole.controller.computer
    assert computer.position == whole.plant.commanded_um
    shown = rows(whole)
    assert (computer.bus.word(at.SHORTS), computer.bus.word(at.OPENS)) == (shown["short"][-1], shown["open"][-1])
    assert computer.t_states > 0
    assert len({*shown["feed_um_s"]}) > 5  # the law has had its say


@pytest.mark.slow
@pytest.mark.parametrize(("planner", "generator"), [
    ("poscal", "iso-pulse"), ("poscal-literal", "iso-pulse"), ("poscal-literal", "iso-energetic"),
])  # fmt: skip
def test_an_interrupted_cut_continues_bit_for_bit(planner, generator):
    options = {"planner": planner, "dwells": ((1, 0.2),), "generator": generator}
    whole = run(simulation(("mcu",), **options))
    assert whole.outcome == "finished"
    half = len(rows(whole)["t_s"]) // 2
    first, second = simulation(("mcu",), **options), simulation(("mcu",), **options)
    run(first, half)
    arrays, values = first.snapshot()
    second.restore(arrays, json.loads(json.dumps(values)))
    assert_same(run(second), whole)
    assert second.controller.snapshot() == whole.controller.snapshot()


def test_the_steps_are_the_programs_own(monkeypatch):
    """Without its interrupts the table stands still."""
    sim = simulation(("mcu",))
    monkeypatch.setattr(sim.controller.computer, "serve", lambda: False)
    run(sim, 40)
    assert sim.plant.commanded_um == START


def test_counts_come_through_latches_and_the_law_is_the_same_where_windows_are_missed():  # T-44
    law, whole = make("counts"), make("mcu")
    assert law.reset(MAX_FEED_UM_S) == whole.reset(MAX_FEED_UM_S)
    rng = np.random.default_rng(2)
    for k in range(3000):
        short = int(rng.integers(0, 256)) if rng.random() < 0.2 else 0
        observation = window(short, int(rng.integers(0, 256 - short)), 0.00051 if k % 200 < 100 else 0.0255, k * 0.01)
        assert law.update(observation) == whole.update(observation)
    assert law.missed_windows == whole.missed_windows > 100


@pytest.mark.slow
@pytest.mark.parametrize("controller", ["counts", "mcu"])
def test_a_cut_tells_of_windows_that_were_missed(controller):  # T-44
    legs = ((1, 0.02), (2, 0.02))
    fast = run(simulation((controller,), dwells=legs, t_on_us=3.0, t_period_us=20.0), 300)
    # windows of 5 ms, a routine of 8 to 10 ms: the first result is read at once, of two or three others one is,
    # and the rest found it waiting
    others = 300 - 1
    assert others // 2 <= fast.missed_windows <= 2 * others // 3
    assert run(simulation((controller,), dwells=legs), 300).missed_windows == 0


def test_axis_speeds_follow_path_and_counts():  # T-69
    whole = make("mcu")
    whole.set_up(Machine.load(), np.array([START, (30_300, 30_400), (30_300, 30_000)]), 0.0)
    whole.reset(MAX_FEED_UM_S)
    for path_um, direction in ((10.0, (3, 4)), (490.0, (3, 4)), (510.0, (0, -1))):
        computer = whole.computer
        if path_um > 500:
            computer.bus.store(at.XPOS, 30_300)
            computer.bus.store(at.YPOS, 30_400)
        for _ in range(60):
            whole.update(window(0, 255, path_um=path_um))
        assert computer.bus.signed(at.CUTVEL) == 127
        speeds = np.array([computer.bus.signed(at.XVELOC), computer.bus.signed(at.YVELOC)])
        assert speeds == pytest.approx(127 * np.array(direction) / np.hypot(*direction), abs=2)


def test_the_generator_is_set_from_the_dials_within_its_limit():  # T-34
    for t_on_us, t_period_us in ((20.0, 100.0), (30.0, 100.0), (200.0, 5000.0), (30.2, 100.0)):
        whole = make("mcu")
        machine = Machine.load(t_on_us=t_on_us, t_period_us=t_period_us)
        whole.set_up(machine, np.array([START, (30_300, 30_400)]), 0.0)
        whole.reset(MAX_FEED_UM_S)
        board = whole.computer.board
        assert board.times_us == pytest.approx((t_on_us, t_period_us), rel=0.02)
        assert board.settings.mean_current_A(*board.codes) <= 2.0
        assert board.generator_on


def test_before_corner_shortens_t_i_only_near():
    assert before_corner(100, 50, 50, 128) == 100
    assert before_corner(100, 49, 50, 128) == 50
    assert before_corner(100, 0, 50, 256) == 100
    assert before_corner(1, 0, 50, 1) == 1
    assert before_corner(0, 0, 50, 128) == 0


@pytest.mark.slow
def test_less_energy_before_a_corner():
    points = [(0, 0), (260, 0), (260, 120)]
    machine = {"t_on_us": 20.0, "t_period_us": 100.0}
    sim = run(simulation(("mcu", ("corner_um", 60.0), ("corner_share", 0.5)), points=points, **machine))
    assert sim.outcome == "finished"
    columns = rows(sim)
    near = (columns["path_um"] > 205) & (columns["path_um"] < 257)
    far = (columns["path_um"] < 195) | (columns["path_um"] > 265)
    assert set(columns["t_on_us"][near]) == {10.0}
    assert set(columns["t_on_us"][far]) == {20.0}
    assert set(columns["t_period_us"]) == {100.0}


def test_it_knows_the_corners_of_a_later_leg():
    points = np.array([(30_000, 30_000), (30_300, 30_000), (30_300, 30_200)])
    commands = []
    for start_um in (0.0, 812.0):
        whole = make("mcu", corner_um=50.0)
        whole.set_up(Machine.load(), points, start_um)
        whole.reset(MAX_FEED_UM_S)
        places = (np.arange(0.0, 480.0, 10.0) + start_um).tolist()
        commands.append([whole.update(window(10, 30, path_um=place)).t_on_us for place in places])
    assert commands[0] == commands[1]
    assert min(commands[0]) < commands[0][0]


def test_less_energy_at_a_corner_is_refused_beyond_what_the_codes_mean():  # T-34
    points = np.array([(30_000, 30_000), (30_300, 30_000), (30_300, 30_200)])
    machine = Machine.load(generator="powercore-v3")
    make("mcu").set_up(machine, points, 0.0)
    with pytest.raises(InputError, match=r"corner_um .* at most 2 A, but t_on 10 us in t_period 100 us"):
        make("mcu", corner_um=50.0).set_up(machine, points, 0.0)


def test_nothing_survives_a_reset():
    whole = make("mcu")
    whole.set_up(Machine.load(), np.array([START, (30_300, 30_400)]), 0.0)
    at_start = whole.reset(MAX_FEED_UM_S), whole.snapshot()
    for k in range(200):
        whole.update(window(255, 0, path_um=k))
    whole.computer.emergency()
    assert (whole.reset(MAX_FEED_UM_S), whole.snapshot()) == at_start
