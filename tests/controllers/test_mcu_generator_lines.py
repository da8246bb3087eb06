"""The lines to generator, motors and switches: converters, their ranges and trims, couplers, stored voltage."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.controllers.mcu.board import Board, Faults, Optocouplers
from edmsim.controllers.mcu.chips import bus, ppi
from edmsim.controllers.mcu.chips.dac import Dac, PulseGeneratorLine, PulseSettings
from edmsim.controllers.mcu.chips.faults import DROPS_BELOW_V, DropOut
from edmsim.controllers.mcu.computer import Computer
from edmsim.errors import InputError

BYTES = st.integers(0, 255)


def test_dac_steps_are_the_documents():  # T-31, T-32, T-37
    t_i, t_p = PulseSettings().t_i, PulseSettings().t_p
    assert t_i.volts(1) == pytest.approx(0.01961, abs=5e-6)
    assert t_p.volts(1) == pytest.approx(0.05882, abs=5e-6)
    assert (t_i.volts(255), t_p.volts(255)) == (5.0, 15.0)
    assert t_p.volts(119) == pytest.approx(7.0)
    assert t_p.volts(110) < 6.5 < t_p.volts(111)


@pytest.mark.slow
@given(BYTES, st.floats(0.5, 1.5), st.floats(-0.3, 0.3))
def test_trims_turn_gain_and_zero(code, gain, offset_V):  # T-33
    dac = Dac(5.0, gain, offset_V)
    assert dac.volts(code) == max(gain * 5.0 * code / 255 + offset_V, 0.0)
    trimmed = PulseSettings(t_i=dac)
    if dac.volts(code):
        assert trimmed.code_of_t_i(trimmed.times_us(code, 0)[0]) == code


@given(BYTES, BYTES, BYTES, BYTES, st.sampled_from([0, 0x100]), st.sampled_from(["period", "frequency"]))
def test_mean_current_is_monotonic(t_i, t_p, other_i, other_p, coarse, law):  # T-35, T-A16
    pulses = PulseSettings(law=law)
    t_i, t_p, other_i, other_p = (code | coarse for code in (t_i, t_p, other_i, other_p))
    shorter, longer = (max, min) if law == "frequency" else (min, max)
    assert pulses.mean_current_A(max(t_i, other_i), t_p) >= pulses.mean_current_A(t_i, t_p)
    assert pulses.mean_current_A(t_i, longer(t_p, other_p)) <= pulses.mean_current_A(t_i, shorter(t_p, other_p))


def test_codes_of_times_and_what_cannot_be_reached():  # T-32, T-36, T-1, T-2, T-A15
    pulses = PulseSettings()
    assert (pulses.code_of_t_i(20), pulses.code_of_t_p(100)) == (102, 170)
    assert pulses.times_us(102, 170) == (20.0, 100.0)
    assert pulses.times_us(0, 0) == (0.0, 2.0)
    assert (pulses.code_of_t_i(50), pulses.code_of_t_p(150)) == (0xFF, 0xFF)
    assert (pulses.code_of_t_i(51), pulses.code_of_t_p(151)) == (0x10D, 0x104)
    assert pulses.times_us(0x1FF, 0x1FF) == (1000.0, 10_000.0)
    assert pulses.times_us(pulses.code_of_t_i(1), 0)[0] == pytest.approx(6 * 50 / 255)  # 1 us at least
    for us in (*range(2, 60), *range(60, 1001, 20)):
        assert abs(pulses.times_us(pulses.code_of_t_i(us), 0)[0] - us) <= (0.1 if us <= 50 else 1.97)
    with pytest.raises(InputError, match=r"t\(p\) is 10001 us, but the voltage reaches from 0 to 10000 us only"):
        pulses.code_of_t_p(10_001)
    with pytest.raises(InputError, match=r"the code of t\(p\) is 0\.\.511, not 512"):
        pulses.check(1, 512)


def test_by_the_law_of_frequency_usual_periods_lie_where_the_generator_drops_out():  # T-A16
    period, frequency = PulseSettings(), PulseSettings(law="frequency")
    volts = [laws.t_p.volts(laws.code_of_t_p(100) & 0xFF) for laws in (period, frequency)]
    assert volts[0] == 10.0
    assert volts[1] < 0.2 < DROPS_BELOW_V
    steps = [frequency.times_us(0, code)[1] for code in (1, 2, 3)]
    assert steps == [150.0, 75.0, 50.0]  # nothing lies between
    assert frequency.times_us(0, 0)[1] == math.inf


def test_a_stopped_generator_keeps_its_voltage_for_a_while():  # T-27
    line = PulseGeneratorLine(decay_s=5.0)
    assert line.voltage_V(0) == 0
    line.switch(False, 1_000_000_000, 100.0)
    assert (line.running, line.voltage_V(9_000_000_000)) == (True, 100.0)
    line.switch(True, 10_000_000_000, 100.0)
    volts = [line.voltage_V(round((10 + s) * 1e9)) for s in (0, 1, 5, 25)]
    assert not line.running
    assert volts == pytest.approx([100.0, 81.87, 36.79, 0.674], abs=0.01)


def test_drop_out_has_two_voltages():  # T-30, T-A5, T-37
    volts = PulseSettings().t_p.volts
    certain = DropOut(0)
    out = [certain.set(volts(code)) for code in (170, 110, 115, 118, 119, 120)]
    assert out == [False, True, True, True, False, False]
    between = [DropOut(seed).set(volts(111)) for seed in range(200)]
    assert 60 < sum(between) < 140
    assert between == [DropOut(seed).set(volts(111)) for seed in range(200)]
    board = Board(faults=Faults(drop_out=DropOut(0)))
    board.bus.write(bus.CPORT2, ppi.BASIC_OUTPUTS)  # clears OEV: the generator runs
    for code, on in ((170, True), (110, False), (118, False), (119, True)):
        board.bus.write(bus.PORT2B, code)
        assert board.generator_on == on


def moved(couplers):
    """Computer after INIT and a second of a move along +x, and the steps its motors made."""
    computer = Computer(Board(couplers=couplers))
    computer.init()
    computer.set_position(30_000, 30_000)
    computer.set_speed(127)
    computer.start(generator=False)
    computer.move_to(31_000, 30_000)
    return computer, computer.run_until(1_000_000_000)


def test_a_lit_led_is_a_logic_0_at_the_machine():  # T-84, T-A17
    sinking, sourcing = Optocouplers(), Optocouplers(led_lit_at=1)
    for byte in range(256):
        assert sinking.lines(byte) == byte  # the LED inverts, and so does the FET
        assert sourcing.lines(byte) == byte ^ 0xFF
    computer, steps = moved(sinking)
    assert {step.direction for step in steps} == {1}
    assert not computer.board.generator_on
    computer, steps = moved(sourcing)  # what the program writes would be wrong by that reading
    assert [step.direction for step in steps[-10:]] == 10 * [-1]
    assert computer.board.generator_on


def test_what_is_shorter_than_the_couplers_response_does_not_pass():  # T-84
    """Impulses of sparks stay out, the steps get through; slower couplers stop the motors, the counter counts on."""
    computer, steps = moved(Optocouplers())
    computer.board.spark()
    computer.serve()
    assert (computer.state, len(steps)) == ("running", 16)
    computer, steps = moved(Optocouplers(response_ns=500))
    computer.board.spark()
    computer.serve()
    assert (computer.state, len(steps)) == ("emergency", 16)
    computer, steps = moved(Optocouplers(response_ns=100_000))
    assert (computer.position, steps) == ((30_032, 30_000), [])


def test_the_dip_of_oev_in_init_does_not_reach_the_generator():  # T-84, T-50
    computer = Computer()
    computer.board.open_V = 100.0
    computer.init()
    assert computer.read(bus.PORT2C) & 1
    assert computer.board.generator_line.voltage_V(0) == 0.0
