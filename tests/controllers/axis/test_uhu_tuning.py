"""How a UHU is tuned, on the bench's motor with its soft coupling: the manual's symptoms and its recipe."""

from __future__ import annotations

import numpy as np
import pytest

from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis.uhu.registers import LATCHED

from .uhu_bench import ask, error, register, traced, tuned

START = {  # "pretty safe" starting values
    "proportional_gain": 1000, "integral_gain": 25, "speed_gain": 255, "acceleration_gain": 1000, "speed_limit": 3000,
    "torque_limit": 255, "output_filter": 100, "error_limit": 5000,
}  # fmt: skip


def swing(bench: AxisBench, counts: int = 40) -> float:
    """Jerk the axis by a move, and return how many counts it still swings half a second later."""
    bench.drive("x").go(counts)
    bench.run(0.5)
    return float(np.ptp(traced(bench, 0.2)["count"]))


def swing_with(**parameters: int) -> float:
    return swing(tuned(**{**START, **parameters}))


def test_the_starting_values_are_stable() -> None:  # U-25, U-58
    bench = tuned(**START)
    assert swing(bench) <= 1
    assert error(bench) == 0


@pytest.mark.parametrize(
    ("good", "bad"),
    [
        ({"proportional_gain": 1000}, {"proportional_gain": 6000}),
        ({"integral_gain": 25}, {"integral_gain": 400}),
        ({"speed_gain": 6000, "proportional_gain": 3000}, {"speed_gain": 0}),
        ({"acceleration_gain": 10_000, "proportional_gain": 3000}, {"acceleration_gain": 0}),
    ],
)
def test_too_much_p_or_i_and_too_little_d_or_h_oscillate(good: dict[str, int], bad: dict[str, int]) -> None:  # U-57
    assert swing_with(**good) <= 2
    assert swing_with(**{**good, **bad}) > 10


def frequency_Hz(**parameters: int) -> float:
    """Of what a loop with these parameters does two seconds after a jump."""
    bench = tuned(**{**START, **parameters})
    bench.drive("x").go(40)
    bench.run(0.5)
    samples = traced(bench, 4.0)
    places = samples["count"] - samples["count"].mean()
    assert np.ptp(places) > 10
    spectrum = np.abs(np.fft.rfft(places * np.hanning(len(places))))
    interval_s = np.diff(samples["time_ns"]).mean() * 1e-9
    return float(np.fft.rfftfreq(len(places), interval_s)[spectrum.argmax()])


def test_too_much_p_oscillates_slower_than_too_much_i_or_too_little_d_or_h() -> None:  # U-57
    tight = {"proportional_gain": 5000, "speed_gain": 4000, "acceleration_gain": 20_000}
    assert swing_with(**tight) <= 2
    slow = frequency_Hz(**{**tight, "proportional_gain": 20_000})
    for wrong in ({"integral_gain": 120}, {"speed_gain": 0}, {"acceleration_gain": 0}):
        assert frequency_Hz(**{**tight, **wrong}) > slow


def test_a_senseless_set_is_stored_and_activated() -> None:  # U-47
    bench = tuned(**{**START, "error_limit": 30})
    assert ask(bench, "P20000") == "OK"
    assert ask(bench, "S0") == "OK"
    bench.talk(b"+\r")
    bench.drive("x").go(20)
    bench.run(1.0)
    assert register(bench, LATCHED) != 0


def test_play_before_the_encoder_cannot_be_tuned_away() -> None:  # U-59
    behind = {"backlash_um": 150.0, "on_table": 1.0}
    for gains in ({}, {"acceleration_gain": 5000}, {"proportional_gain": 500}):
        assert swing_with(**gains) <= 2
        assert swing(tuned(changes=behind, **{**START, **gains})) > 2


def test_a_lower_torque_limit_calms_an_unsuitable_motor() -> None:  # U-58
    wild, calm = (
        swing(tuned("low-impedance", **{**START, "torque_limit": limit}))
        for limit in (255, 50)
    )
    assert calm < wild


def test_the_bridge_needs_more_than_the_motor_s_voltage() -> None:  # U-49, U-A20
    bench = tuned(**{**START, "error_limit": 65535, "speed_limit": 65535})
    bench.drive("x").go(32_000)
    bench.run(0.3)
    motor = bench.motor("x")
    samples = traced(bench, 0.05)
    back_emf_V = float(np.mean(samples["speed_rad_s"])) * float(motor["torque_Nm_A"])
    assert 0.65 <= back_emf_V / float(motor["supply_V"]) <= 0.74
