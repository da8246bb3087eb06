"""The timers' arithmetic: clock and reload counts."""

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.controllers.mcu.firmware import timers
from edmsim.errors import InputError


def test_clock_follows_from_the_speed_unit():  # T-74, T-75, T-A1
    assert timers.timer_clock_hz(262.5) == Fraction(43_008, 5)
    assert float(timers.timer_clock_hz(252.6)) == pytest.approx(8277.1968)
    assert pytest.approx(2000.25 / 60) == timers.MAX_FEED_UM_S


@pytest.mark.parametrize(("unit", "words"), [
    *((unit, "speed unit must be above 0 nm/s") for unit in (0.0, -262.5, float("nan"))),
    (999_999_999.123, "choose a rounder one"),
])  # fmt: skip
def test_a_speed_unit_that_cannot_be_used_is_refused(unit, words):
    with pytest.raises(InputError, match=words):
        timers.timer_clock_hz(unit)


def test_reload_counts():  # T-76
    rows = {1: 65_536, 2: 32_768, 3: 21_845, 10: 6_553, 64: 1_024, 127: 516}
    assert {v: timers.reload_count(v) for v in rows} == rows
    worst = max(1 - timers.reload_count(v) * v / 65_536 for v in range(1, 128))
    assert 100 * worst == pytest.approx(0.171, abs=0.001)
    assert timers.reload_count(127) / timers.timer_clock_hz(262.5) * 1000 == pytest.approx(59.989, abs=5e-4)


@given(st.integers(0, 10**15), st.sampled_from([262.5, 252.6]))
def test_ticks_are_counted_exactly(time_ns, unit):  # T-74
    hertz, per = timers.timer_clock_hz(unit).as_integer_ratio()
    tick = timers.tick_before(time_ns, hertz, per)
    assert timers.tick_time_ns(tick, hertz, per) < time_ns <= timers.tick_time_ns(tick + 1, hertz, per)
    exact = Fraction(tick * per, hertz) * 1_000_000_000
    assert 0 <= timers.tick_time_ns(tick, hertz, per) - exact < 1


@pytest.mark.parametrize(("step_um", "hertz"), [(2, Fraction(43_008, 5)), (5, Fraction(86_016, 25)), (2.5, 6881.28)])
def test_a_unit_is_one_step_per_65536_ticks_whatever_the_step(step_um, hertz):  # T-74
    assert float(timers.timer_clock_hz(262.5, step_um)) == pytest.approx(float(hertz))
