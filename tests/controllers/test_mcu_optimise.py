"""The optimising routine in words, what its settings refuse, and the time it takes."""

import math
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.controllers import WindowObservation, make
from edmsim.controllers.feed.counts import CountsController
from edmsim.controllers.mcu.firmware.optimise import ALARM, State, fraction, optimise
from edmsim.controllers.mcu.firmware.timers import CPU_HZ, MAX_FEED_UM_S, POSCAL_BOUND_T, poscal_t_states
from edmsim.errors import InputError

SETTINGS = CountsController().settings(MAX_FEED_UM_S)
COUNTS = st.tuples(st.integers(0, 255), st.integers(0, 255)).filter(lambda c: sum(c) <= 255)


def window(short, open_, duration_s=0.0255, path_um=0.0):
    return WindowObservation(0.0, duration_s, short, open_, 40.0, 2.0, 9.0, 10.0, path_um)


@pytest.mark.slow
@given(st.lists(st.tuples(COUNTS, st.integers(1, 30_000), st.integers(-40, 40)), min_size=1, max_size=80))
def test_every_variable_stays_a_word(windows):  # T-15, T-60
    state, clock, path = State(speed=SETTINGS.start), 0, 0
    for (short, open_), ticks, way in windows:
        clock, path = clock + ticks & 0xFFFF, path + way & 0xFFFF
        speed, t_states = optimise(SETTINGS, state, short, open_, clock, path)
        assert all(type(v) is int and 0 <= v <= 0xFFFF for v in asdict(state).values())
        assert -SETTINGS.retract <= speed <= SETTINGS.limit
        assert POSCAL_BOUND_T < t_states < 0.030 * CPU_HZ  # T-A6
        assert (speed == 0) or state.phase != ALARM


@given(st.integers(0, 65535), st.integers(1, 65535))
def test_fraction_is_shift_and_subtract(part, whole):
    part = min(part, whole - 1)
    rest, quotient = part, 0
    for _ in range(16):
        rest, quotient = rest << 1, quotient << 1
        if rest >= whole:
            rest, quotient = rest - whole, quotient | 1
    assert fraction(part, whole) == quotient <= 0xFFFF


def test_the_integral_grows_as_its_constant_says():  # T-15
    """Nothing but open pulses below the air's share, and no filter: 30 um/s per s and unit of error."""
    law = CountsController(filter_s=0.0, proportional_um_s=0.0, start_feed_um_s=0.0)
    settings, state = law.settings(MAX_FEED_UM_S), State()
    for k in range(1, 41):
        optimise(settings, state, 0, 102, 255 * k, 0)
    error = 102 / 255 - law.open_target_share
    expected = law.integral_um_s2 * error * 40 * 0.0255 / 0.2625
    assert (state.speed + state.fraction / 65536) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("duration_s", [0.005, 0.0255, 0.09])
def test_the_filter_is_the_exponential_of_its_time_constant(duration_s):
    law = CountsController()
    settings, state = law.settings(MAX_FEED_UM_S), State()
    optimise(settings, state, 0, 200, round(duration_s * 1e4), 0)
    assert state.open / 256 == pytest.approx(-200 * math.expm1(-duration_s / law.filter_s), rel=0.05)


@pytest.mark.parametrize(("parameters", "words"), [
    ({"integral_um_s2": 400.0}, "integral_um_s2 of the counts controller is 400.0, but its sixteen-bit word"),
    ({"dwell_s": 7.0}, "dwell_s of the counts controller is 7.0, but its sixteen-bit word holds at most 6.5535"),
    ({"filter_s": 4.0}, "holds at most 3.2767"), ({"short_weight": 300.0}, "holds at most 255.996"),
    ({"retract_um": 600.0}, "retract_um of the counts controller is 600.0, but at 20.0 um/s"),
    ({"max_tries": 70_000}, "holds at most 65535"),
])  # fmt: skip
def test_what_does_not_fit_a_word_is_refused(parameters, words):  # T-60
    with pytest.raises(InputError) as refused:
        make("counts", **parameters).reset(MAX_FEED_UM_S)
    assert words in str(refused.value)


def test_feed_is_whole_units_also_on_a_faster_table():  # T-A1
    for most in (MAX_FEED_UM_S, 200.0):
        law = make("counts")
        command = law.reset(most)
        for _ in range(40):
            assert command.feed_um_s / 0.2625 == pytest.approx(round(command.feed_um_s / 0.2625), abs=1e-9)
            command = law.update(window(0, 255))
        assert most - 0.2625 < command.feed_um_s <= most


def test_the_new_feed_counts_after_the_time_the_routine_takes():  # T-77, T-A6
    law = make("counts")
    assert law.reset(MAX_FEED_UM_S).latency_s == 0
    commands = [law.update(window(s, o)) for s, o in [(0, 30), (200, 0), (0, 255), (10, 90)] * 4]
    assert all(POSCAL_BOUND_T / CPU_HZ < c.latency_s < 0.030 for c in commands)
    assert len({c.latency_s for c in commands}) > 1  # each path its own


def test_windows_shorter_than_the_routine_are_missed_and_the_oldest_counts_read():  # T-44
    law = make("counts", filter_s=0.0, proportional_um_s=0.0)
    law.reset(MAX_FEED_UM_S)
    period = 0.00051  # 500 kHz
    first = law.update(window(0, 20, period))
    busy = math.ceil(first.latency_s / period) - 1  # windows that end before the routine does
    waiting = [law.update(window(0, 255, period)) for _ in range(busy)]
    assert [c.feed_um_s for c in waiting] == [first.feed_um_s] * busy
    assert waiting[0].latency_s == pytest.approx(first.latency_s - period)
    assert law.missed_windows == busy - 1
    assert law.update(window(20, 0, period)).feed_um_s == MAX_FEED_UM_S  # read: the latch's, all open
    assert law.missed_windows == busy
    law.reset(MAX_FEED_UM_S)
    assert law.missed_windows == 0


def test_places_along_the_path_may_wrap():  # T-60
    """A path longer than 65 mm: the routine sees differences only."""
    def feeds(offset_um):
        law = make("counts")
        law.reset(MAX_FEED_UM_S)
        rng, path, feeds_um_s = np.random.default_rng(5), offset_um, []
        for _ in range(800):
            short = int(rng.integers(0, 255)) if rng.random() < 0.4 else 0
            command = law.update(window(short, int(rng.integers(0, 256 - short)), path_um=path))
            path += command.feed_um_s * 0.0255
            feeds_um_s.append(command.feed_um_s)
        return feeds_um_s

    assert feeds(10_000.0) == feeds(10_000.0 + 65_536 * 3 - 9_990)


@pytest.mark.slow
def test_poscal_costs_at_most_its_bound_and_30_ms():  # T-A6
    """All pairs of reduced components, halved as often as can be and not at all, where the divisions are longest."""
    most = max(poscal_t_states(dx << 8, dy << 8, 127) for dx in range(256) for dy in range(128, 256))
    most = max([most] + [poscal_t_states(dx, dy, 127) for dx in range(256) for dy in range(256)])
    assert 0.8 * POSCAL_BOUND_T < most < POSCAL_BOUND_T < 0.030 * CPU_HZ
