"""What the servo module does beyond its guide, and its use from Python: settings by name, a machine's axis."""

from __future__ import annotations

import numpy as np
import pytest

import edmsim
from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis import ServoModule
from edmsim.controllers.axis.drive import axis_row
from edmsim.errors import InputError

from .module_bench import NO_TRIP, say


def bench_with(stored, **extensions):
    drive = ServoModule(axis_row("table"), {"error_limit": NO_TRIP, **stored})
    drive.extensions.update(extensions)
    bench = AxisBench({"x": drive})
    bench.run(0.02)
    bench.received("x")
    return bench


def test_the_third_feed_forward_acts_on_the_change_of_acceleration():
    outputs = []
    for gain in (0, 256):
        bench = bench_with({"proportional_gain": 0, "derivative_gain": 0}, jerk_feed_forward=gain)
        bench.hold("x", True)
        bench.trace = True
        bench.step_times("x", [30_000_000], 1)
        bench.run(0.05)
        outputs.append(np.round(bench.samples("x")["command"] * 1024).astype(int))
    assert set(outputs[0]) == {0}
    pulse = outputs[1][np.flatnonzero(outputs[1])]
    assert list(pulse) == [1, -2, 1]  # a step's third difference


def test_the_filtered_command_makes_the_feed_forward_smoother():
    rough = []
    for smoothing in (0, 4):
        gains = {"proportional_gain": 0, "derivative_gain": 0, "step_multiplier": 9}
        bench = bench_with(gains, velocity_feed_forward=2600, command_filter=smoothing)
        bench.hold("x", True)
        bench.steps("x", 1000, 1100.0, 20_000.0)
        bench.run(0.3)
        bench.trace = True
        bench.run(0.3)
        rough.append(float(np.std(bench.samples("x")["command"])))
    assert 0 < rough[1] < 0.5 * rough[0]


def test_parameters_are_set_by_name_and_shown_by_letter():
    bench = bench_with({})
    bench.drive("x").parameters["proportional_gain"] = 900
    bench.drive("x").parameters["output_offset"] = -3
    assert say(bench, "P") == "(P) - Kp: 900"
    assert say(bench, "O") == "(O) - Output Offset: -3"
    say(bench, "L2")
    assert bench.drive("x").parameters["loop_divider"] == 2


@pytest.mark.parametrize(("arguments", "says"), [
    ({"stored": {"gain": 1}}, "gain"), ({"stored": {"clamp": -1}}, "0 to 65535"), ({"law": {"speed": 1}}, "speed"),
    ({"stored": {"clamp": 1.5}}, "whole number"), ({"stored": {"output_offset": 40_000}}, "-32768 to 32767"),
])  # fmt: skip
def test_what_python_may_not_set_is_refused_in_one_line(arguments, says):
    with pytest.raises(InputError, match=says) as caught:
        ServoModule(**arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("mechanics", ["modal", "mujoco"])
def test_a_machine_s_axis_follows_its_steps_under_the_module(mechanics):
    machine = edmsim.Machine.load()
    plant = edmsim.Plant(
        machine, seed=1, resolution="fast", mechanics=mechanics, drives={"x": ServoModule.tuned()}
    )
    plant.switch_generator(False)
    start_um = plant.place_um[0]
    steps = [(10_000_000 + k * 2_000_000, 0, 1) for k in range(100)]  # 1 mm/s
    while plant.time_ns < 400_000_000:
        end = plant.time_ns + plant.longest_window_ns
        plant.advance(np.array([row for row in steps if plant.time_ns <= row[0] < end] or np.zeros((0, 3)), np.int64))
    assert plant.place_um[0] - start_um == pytest.approx(200.0, abs=2.0)
