"""The bench refuses what is not a number at once, by either mechanics; an axis that runs away ends the run."""

import math

import numpy as np
import pytest

from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis import tuned
from edmsim.errors import EdmsimError, InputError

INPUTS = {
    "force": lambda bench, x: bench.force("x", x), "torque": lambda bench, x: bench.torque("x", x),
    "supply": lambda bench, x: bench.supply("x", x), "rail": lambda bench, x: bench.rail("x", x),
    "run": lambda bench, x: bench.run(x), "run_to": lambda bench, x: bench.run_to(x),
    "stall": lambda bench, x: bench.stall("x", x), "power_cycle": lambda bench, x: bench.power_cycle("x", x),
    "host_baud": lambda bench, x: bench.host_baud(x),
    "pulse_encoder": lambda bench, x: bench.pulse_encoder("x", "A", x),
    "slip_encoder": lambda bench, x: bench.slip_encoder("x", x), "steps": lambda bench, x: bench.steps("x", x),
    "rate_Hz": lambda bench, x: bench.steps("x", 5, rate_Hz=x),
    "accel_Hz_s": lambda bench, x: bench.steps("x", 5, 100.0, x),
    "step_times": lambda bench, x: bench.step_times("x", [100, x], 1),
    "direction": lambda bench, x: bench.step_times("x", [100], x),
    "low_um": lambda bench, x: bench.home_cam("x", x, 5.0), "high_um": lambda bench, x: bench.home_cam("x", 0.0, x),
    "hysteresis_um": lambda bench, x: bench.home_cam("x", 0.0, 5.0, hysteresis_um=x),
    "bounce_s": lambda bench, x: bench.home_cam("x", 0.0, 5.0, bounce_s=x),
    "filter_s": lambda bench, x: bench.home_cam("x", 0.0, 5.0, filter_s=x),
    "flip_bits": lambda bench, x: bench.flip_bits("x", [x]),
}  # fmt: skip
BY_HAND = {
    "hand_N": lambda bench, x: bench.axis("x").__setitem__("hand_N", x),
    "hand_Nm": lambda bench, x: bench.axis("x").__setitem__("hand_Nm", x),
    "speed_rad_s": lambda bench, x: bench.axis("x").__setitem__("speed_rad_s", x),
    "supply_V": lambda bench, x: bench.motor("x").__setitem__("supply_V", x),
    "load_N": lambda bench, x: bench.motor("x").__setitem__("load_N", x),
}


@pytest.fixture(scope="module")
def bench():
    """A bench whose drive holds its place; what is refused leaves it as it was."""
    made = AxisBench({"x": tuned("uhu")})
    made.run(0.02)
    return made


@pytest.mark.parametrize("name", INPUTS)
def test_an_input_that_is_not_a_finite_number_is_refused_at_once(bench, name):
    for value in (math.nan, math.inf, -math.inf, np.float32("nan"), "5", None, True):
        before = bench.axis("x").tobytes(), bench.motor("x").tobytes(), bench.time_s
        with pytest.raises(InputError, match=r"give a (finite|whole) number"):
            INPUTS[name](bench, value)
        assert (bench.axis("x").tobytes(), bench.motor("x").tobytes(), bench.time_s) == before


def test_a_cam_that_ends_before_it_begins_is_refused(bench):
    with pytest.raises(InputError, match="high_um is 500: give a finite number of 900 or more"):
        bench.home_cam("x", 900, 500)


def test_numbers_of_every_kind_are_taken(bench):
    for value in (2, 2.0, np.float32(2), np.int16(2), np.array(2.0)):
        bench.force("x", value)
        assert bench.axis("x")["hand_N"] == 2.0
    bench.force("x", 0.0)


@pytest.mark.parametrize("mechanics", ["modal", "mujoco"])
@pytest.mark.parametrize("name", BY_HAND)
def test_what_is_written_into_a_row_ends_the_run_in_place_of_never_coming_back(mechanics, name):
    for value in (math.nan, math.inf, *((1e300,) if name != "supply_V" else ())):
        made = AxisBench({"x": tuned("uhu")}, mechanics=mechanics)
        made.run(0.01)
        BY_HAND[name](made, value)
        with pytest.raises(EdmsimError, match="run away"):
            made.run(0.5)
