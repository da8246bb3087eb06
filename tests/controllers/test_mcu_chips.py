"""The chips of the 1982 controller, each by itself, as their data sheets have them, and its lines."""

import json
import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.controllers.mcu.board import (
    DROPS_BELOW_V,
    NAMES,
    WIRE_BREAK,
    X_END,
    Y_END,
    Board,
    DropOut,
    Faults,
    Optocouplers,
    SafetySwitches,
    SerialNoise,
)
from edmsim.controllers.mcu.chips import bus, pic, pit, ppi, uart
from edmsim.controllers.mcu.chips.dac import Dac, PulseGeneratorLine, PulseSettings
from edmsim.controllers.mcu.chips.display import CLEAR, CTRL, READ_KEYS, SHIFT, Kdc8279, write_digit
from edmsim.controllers.mcu.computer import Computer
from edmsim.controllers.pulse_counters import PulseAnalyser
from edmsim.errors import InputError

from .test_mcu_computer import ready

BYTES = st.integers(0, 255)


def test_memory_is_8_k_of_each_and_eprom_keeps_its_bytes():  # T-20, T-A12
    memory = bus.Bus()
    assert len(bus.EPROM) == len(bus.RAM) == 8192
    for address in (0x2000, 0x3FDF, 0x3FE0, 0x3FFF):
        memory.write(address, 0x5A)
        assert memory.read(address) == 0x5A
    for address in (0x0000, 0x1FFF, 0x5000, 0xFFFF):
        before = memory.read(address)
        memory.write(address, before ^ 0xFF)
        assert memory.read(address) == before
    with pytest.raises(InputError, match=r"an address is 0\.\.FFFFH"):
        memory.read(0x10000)
    with pytest.raises(InputError, match=r"a byte is 0\.\.FFH, not 256"):
        memory.write(0x4020, 256)


def test_ports_lie_where_the_document_has_them():  # T-23
    board = Board()
    board.bus.write(0x4023, ppi.BASIC_OUTPUTS)
    board.bus.write(0x4020, 102)
    board.bus.write(0x4021, 170)
    assert board.codes == [102, 170]
    board.bus.write(0x4022, 0x1F)
    assert board.bus.read(0x4022) == 0x1F
    board.bus.write(0x4033, ppi.STROBED_INPUTS)
    board.counters.count_window(12, 34)
    assert (board.bus.read(0x4030), board.bus.read(0x4031)) == (12, 34)


def test_48_lines_and_what_each_drives():  # T-21
    """16 to the converters, 16 from the counters, 7 for their handshake, and 9 more, of which 1982 used 5."""
    board = Board()
    read, write = board.bus.read, board.bus.write
    write(bus.CPORT2, ppi.BASIC_OUTPUTS)
    write(bus.CPORT3, ppi.STROBED_INPUTS)
    converters = counters = handshake = 0
    for address, which in ((bus.PORT2A, 0), (bus.PORT2B, 1)):
        for bit in range(8):
            write(address, 1 << bit)
            converters += board.codes[which] == 1 << bit
    for bit in range(8):
        board.counters.put_result(1 << bit, 1 << bit)
        counters += (read(bus.PORT3A) == 1 << bit) + (read(bus.PORT3B) == 1 << bit)
    quiet = read(bus.PORT3C)
    for bit in (ppi.INTE_A_BIT, ppi.INTE_B_BIT):
        write(bus.CPORT3, bit << 1 | 1)
    board.counters.put_result(1, 1)
    handshake = (quiet ^ read(bus.PORT3C)).bit_count() + 1  # and the reset of the counters
    used = spare = 0
    for bit, name in enumerate(board.lines._fields):  # T-24, T-A9: the order in which 4022H is printed
        before = len(board.steps), board.generator_line.running, list(board.codes), board.low_tension
        write(bus.CPORT2, bit << 1 | 1)
        after = len(board.steps), board.generator_line.running, list(board.codes), board.low_tension
        changed = [a != b for a, b in zip(after, before, strict=True)]
        assert changed == [name.endswith("pulse"), name == "oev", name.endswith("coarse"), name == "low_tension"]
        used, spare = used + (bit < 5), spare + (bit >= 5)
    write(bus.CPORT3, 6 << 1 | 1)  # bit 6 of port 3C is free in mode 1
    spare += read(bus.PORT3C) >> 6 & 1
    assert board.lines._fields[:5] == ("oev", "x_direction", "x_pulse", "y_direction", "y_pulse")
    assert (converters, counters, handshake, used, spare) == (16, 16, 7, 5, 4)
    assert sum((converters, counters, handshake, used, spare)) == 48


@given(BYTES, BYTES, st.integers(0, 7), st.booleans())
def test_a_bit_of_port_c_is_set_alone(before, other, bit, on):  # T-23
    port = ppi.Ppi8255()
    port.write(ppi.CONTROL, ppi.BASIC_OUTPUTS)
    port.write(ppi.C, before)
    port.write(ppi.A, other)
    port.write(ppi.CONTROL, bit << 1 | on)
    assert port.read(ppi.C) == (before | 1 << bit if on else before & ~(1 << bit))
    assert port.read(ppi.A) == other


def test_strobed_input_latches_raises_ibf_and_interrupts_if_enabled():  # T-25, T-40
    port = ppi.Ppi8255()
    port.write(ppi.CONTROL, ppi.STROBED_INPUTS)
    assert port.read(ppi.C) & 0x3F == 0
    port.strobe(ppi.A, 7)
    assert port.full == (True, False)
    assert port.read(ppi.C) & 0x3F == ppi.IBF_A
    port.write(ppi.CONTROL, ppi.INTE_A_BIT << 1 | 1)
    assert port.read(ppi.C) & 0x3F == ppi.IBF_A | ppi.INTE_A | ppi.INTR_A
    port.strobe(ppi.B, 9)
    assert (port.read(ppi.A), port.read(ppi.B)) == (7, 9)
    assert port.read(ppi.C) & (ppi.IBF_A | ppi.INTR_A | ppi.IBF_B | ppi.INTR_B) == 0
    port.write(ppi.CONTROL, ppi.STROBED_INPUTS)  # a mode word clears the flags
    port.strobe(ppi.A, 1)
    assert not port.read(ppi.C) & ppi.INTR_A  # T-43


def test_ports_in_mode_0_read_their_pins():
    port = ppi.Ppi8255()
    port.inputs = [1, 2, 3]
    assert [port.read(p) for p in (ppi.A, ppi.B, ppi.C)] == [1, 2, 3]
    for word in (0xC0, 0xA0, 0x84):
        with pytest.raises(InputError, match=f"control word {word:02X}H"):
            port.write(ppi.CONTROL, word)


@pytest.mark.slow
@given(st.lists(st.sampled_from(["short", "open", "erosion"]), min_size=255, max_size=255))
def test_clocks_reach_the_latches_by_strobe_and_reset_the_counters(pulses):  # T-38, T-39, T-40, T-41
    board = Board()
    board.bus.write(bus.CPORT3, ppi.STROBED_INPUTS)
    for kind in pulses:
        assert board.bus.read(bus.PORT3C) & (ppi.IBF_A | ppi.IBF_B) == 0
        board.counters.clock(kind == "short", kind == "open")
    assert board.bus.read(bus.PORT3C) & (ppi.IBF_A | ppi.IBF_B) == ppi.IBF_A | ppi.IBF_B
    assert board.counters.pulses == 0
    assert board.bus.read(bus.PORT3A) == pulses.count("short")
    assert board.bus.read(bus.PORT3C) & (ppi.IBF_A | ppi.IBF_B) == ppi.IBF_B
    assert board.bus.read(bus.PORT3B) == pulses.count("open")


def test_unread_latches_keep_their_counts_and_the_window_is_missed():  # T-44
    board = Board()
    board.bus.write(bus.CPORT3, ppi.STROBED_INPUTS)
    for short in (1, 2, 3):
        board.counters.count_window(short, 0)
    assert board.counters.missed == 2
    assert board.bus.read(bus.PORT3A) == 1
    board.counters.count_window(4, 0)  # latch B is still full: only both together make a result
    assert board.counters.missed == 3
    board.bus.read(bus.PORT3B)
    board.counters.count_window(5, 0)
    assert board.bus.read(bus.PORT3A) == 5


def test_counting_a_whole_cycle_is_clocking_its_pulses():  # T-39, T-40
    clocked, counted = PulseAnalyser(), PulseAnalyser()
    for sc, op in [(True, False)] * 40 + [(False, True)] * 77 + [(False, False)] * 138:
        clocked.clock(sc, op)
    assert not counted.buffer_full
    counted.count_window(40, 77)
    assert clocked.snapshot() == counted.snapshot()
    assert counted.buffer_full
    assert (counted.read(), counted.buffer_full) == ((40, 77), False)


def test_an_analyser_continues_from_its_snapshot():
    analyser = PulseAnalyser()
    analyser.count_window(9, 99)
    analyser.count_window(9, 99)
    analyser.clock(True, False)
    copy = PulseAnalyser()
    copy.restore(json.loads(json.dumps(analyser.snapshot())))
    for _ in range(254):
        analyser.clock(False, True)
        copy.clock(False, True)
    assert copy.snapshot() == analyser.snapshot()
    assert copy.missed == 2
    assert copy.read() == analyser.read() == (9, 99)


def test_pulses_that_cannot_be_are_refused():  # T-38, T-41
    analyser = PulseAnalyser()
    with pytest.raises(InputError, match="short and open at once"):
        analyser.clock(True, True)
    for short, open_ in [(-1, 0), (0, -1), (128, 128)]:
        with pytest.raises(InputError, match=f"{short} short and {open_} open pulses"):
            analyser.count_window(short, open_)
    analyser.clock(False, False)
    with pytest.raises(InputError, match="not after 1 pulses"):
        analyser.count_window(0, 0)


def test_line_c7_resets_the_counters():  # T-23
    board = Board()
    board.bus.write(bus.CPORT3, ppi.STROBED_INPUTS)
    for _ in range(100):
        board.counters.clock(True, False)
    board.bus.write(bus.CPORT3, ppi.RESET_BIT << 1 | 1)
    assert (board.counters.pulses, board.counters.short) == (0, 0)


def loaded(mode, count):
    chip = pit.Pit8253()
    chip.write(pit.CONTROL, pit.control_word(0, mode))
    chip.write(0, count & 0xFF)
    chip.write(0, count >> 8)
    return chip


@given(st.integers(0, 65535), st.lists(st.integers(1, 70_000), max_size=20))
def test_a_counter_rises_when_its_count_has_run_out(count, portions):  # T-22, T-74
    once, again = loaded(pit.TERMINAL_COUNT, count).counters[0], loaded(pit.RATE, count).counters[0]
    period = count or 65_536
    passed = rises = periods = 0
    for ticks in portions:
        passed += ticks
        rises += once.run(ticks)
        periods += again.run(ticks)
        assert rises == (passed >= period)
        assert periods == passed // period
        assert again.ticks_to_rise == period - passed % period


def test_counts_are_written_and_read_low_byte_first():
    chip = loaded(pit.RATE, 0x1234)
    chip.counters[0].run(0x34)
    assert chip.read(0) | chip.read(0) << 8 == 0x1200
    chip.counters[0].run(1)
    chip.read(0)
    chip.write(pit.CONTROL, 0x00)  # latch counter 0: it counts on, and the count is read from its low byte
    chip.counters[0].run(5)
    assert chip.read(0) | chip.read(0) << 8 == 0x11FF
    assert chip.read(0) | chip.read(0) << 8 == 0x11FA
    for word in (0xC0, 0x31, 0x12, 0x38):
        with pytest.raises(InputError, match=f"control word {word:02X}H"):
            chip.write(pit.CONTROL, word)


def ready_pic():
    chip = pic.Pic8259()
    chip.write(0, pic.ICW1)
    chip.write(1, pic.ICW2)
    return chip


@given(st.lists(st.integers(0, 7), min_size=1, max_size=8, unique=True))
def test_requests_are_served_by_priority(levels):  # T-45
    chip = ready_pic()
    for level in levels:
        chip.request(level)
    served = []
    while chip.interrupting:
        served.append((chip.acknowledge() - pic.JUMP_TABLE) // 4)
        chip.write(0, pic.END_OF_INTERRUPT)
    assert served == sorted(levels)


def test_only_a_higher_priority_interrupts_a_routine():  # T-45
    assert pic.EMERGENCY < pic.X_STEPPER < pic.Y_STEPPER < pic.KEYBOARD
    chip = ready_pic()
    chip.request(pic.X_STEPPER)
    chip.acknowledge()
    for level in (pic.Y_STEPPER, pic.KEYBOARD, pic.X_STEPPER):
        chip.request(level)
        assert not chip.interrupting
    chip.request(pic.EMERGENCY)
    assert chip.interrupting
    assert chip.acknowledge() == 0x3FE0
    chip.write(0, pic.END_OF_INTERRUPT)
    assert not chip.interrupting  # the x routine goes on
    chip.write(0, pic.END_OF_INTERRUPT)
    assert chip.acknowledge() == 0x3FE4


def test_masks_spurious_requests_and_words_it_does_not_know():
    chip = ready_pic()
    chip.write(1, 1 << pic.KEYBOARD)
    chip.request(pic.KEYBOARD)
    assert not chip.interrupting
    assert chip.read(1) == 8
    assert chip.acknowledge() == 0x3FE0 + 4 * pic.SPURIOUS
    with pytest.raises(InputError, match="write ICW1 and ICW2 first"):
        pic.Pic8259().acknowledge()
    for word in (0x13, 0x60):
        with pytest.raises(InputError, match=f"{word:02X}H"):
            chip.write(0, word)


@given(st.lists(st.tuples(st.integers(0, 31), st.integers(0, 9)), max_size=60))
def test_a_digit_is_written_without_its_neighbour(writes):  # T-28
    chip, expected = Kdc8279(), [15] * 32
    for digit, value in writes:
        write_digit(chip, digit, value)
        expected[digit] = value
        assert chip.digits == expected


def test_words_of_both_digits_advance_where_the_command_says_so():  # T-28
    chip = Kdc8279()
    chip.write(1, 0x80 | 0x10 | 14)
    for word in (0x12, 0x34, 0x56):
        chip.write(0, word)
    assert (chip.digits[14], chip.digits[30], chip.digits[15], chip.digits[31]) == (1, 2, 3, 4)
    assert (chip.digits[0], chip.digits[16]) == (5, 6)
    with pytest.raises(InputError, match=r"digits 0\.\.31"):
        write_digit(chip, 32, 0)
    with pytest.raises(InputError, match="command A0H"):
        chip.write(1, 0xA0)
    chip.write(1, CLEAR)
    assert set(chip.digits) == {15}


@given(st.lists(st.booleans(), max_size=40), st.integers(1, 5), st.integers(0, 63), st.booleans(), st.booleans())
def test_a_key_counts_after_equal_scans_once(closed, needed, key, shift, ctrl):  # T-28
    chip = Kdc8279(needed)
    expected = run = 0
    for down in closed:
        run = run + 1 if down else 0
        expected += run == needed
        accepted = chip.scan(frozenset([key] if down else []), shift, ctrl)
        assert accepted == (run == needed)
    assert chip.waiting == min(expected, 8)
    chip.write(1, READ_KEYS)
    for _ in range(chip.waiting):
        assert chip.read(0) == key | SHIFT * shift | CTRL * ctrl
    with pytest.raises(InputError, match=r"a key is 0\.\.63"):
        chip.scan(frozenset([64]))


def test_nine_keys_unread_lose_one():  # T-28
    chip = Kdc8279(1)
    for key in range(9):
        chip.scan(frozenset([key]))
    assert (chip.waiting, chip.lost, chip.read(1) & 0x2F) == (8, 1, 0x28)


def channel():
    sent = []
    chip = uart.Usart8251(sent.append)
    chip.write(1, uart.MODE_8_BITS)
    chip.write(1, uart.COMMAND_RUN)
    return chip, sent


def test_a_serial_channel_sends_receives_and_is_overrun():  # T-59
    chip, sent = channel()
    chip.write(0, 0x41)
    assert sent == [0x41]
    assert chip.read(1) & uart.RX_READY == 0
    chip.arrive(0x42)
    assert chip.read(1) & (uart.RX_READY | uart.OVERRUN) == uart.RX_READY
    assert chip.read(0) == 0x42
    assert chip.read(1) & uart.RX_READY == 0
    chip.arrive(0x43)
    chip.arrive(0x44)
    assert chip.read(1) & uart.OVERRUN
    assert chip.read(0) == 0x44
    chip.write(1, uart.COMMAND_RUN | uart.COMMAND_RESET_ERRORS)
    assert not chip.read(1) & uart.OVERRUN
    chip.write(1, uart.COMMAND_RESET)
    chip.arrive(0x45)
    assert not chip.read(1) & uart.RX_READY
    with pytest.raises(InputError, match="mode word 7AH"):
        chip.write(1, 0x7A)


def test_switches_are_one_interrupt_and_act_by_themselves():  # T-46, T-47
    for name in NAMES:
        rises = []
        switches = SafetySwitches(lambda rises=rises: rises.append(1))
        switches.trip(name)
        switches.trip(name)
        assert (rises, switches.open) == ([1], (name,))
        assert switches.steppers_supplied == (name == WIRE_BREAK)
        assert switches.generator_allowed == (name in (X_END, Y_END))
        switches.trip(X_END)
        assert len(rises) == 1  # the ORed line is up already
        switches.release()
        assert (switches.steppers_supplied, switches.generator_allowed) == (True, True)
    with pytest.raises(InputError, match="no switch 'door'"):
        switches.trip("door")


def test_noise_comes_above_1_5_ampere_only_and_is_seeded():  # T-29
    def heard(seed, current_A):
        noise = SerialNoise(seed)
        return [noise(k & 0xFF, current_A) for k in range(2000)], noise

    quiet, _ = heard(1, 1.5)
    assert quiet == [k & 0xFF for k in range(2000)]
    loud, noise = heard(1, 1.51)
    wrong = [(k & 0xFF, byte) for k, byte in enumerate(loud) if byte != k & 0xFF]
    assert all((a ^ b).bit_count() == 1 and b <= 0xFF for a, b in wrong)
    assert len(wrong) == noise.disturbed
    assert 60 < len(wrong) < 150  # 5 % of 2000
    assert heard(1, 1.9)[0] == loud != heard(2, 1.9)[0]
    board = Board(faults=Faults(noise=SerialNoise(0, chance=1.0)))
    board.bus.write(bus.TERMINAL + 1, uart.MODE_8_BITS)
    board.bus.write(bus.TERMINAL + 1, uart.COMMAND_RUN)
    for current_A, right in ((1.0, True), (1.8, False)):
        board.mean_current_A = current_A
        board.receive(0x41)
        assert (board.bus.read(bus.TERMINAL) == 0x41) == right


def test_a_board_continues_from_its_snapshot():
    def board():
        return Board(faults=Faults(SerialNoise(3, 0.5), DropOut(3)))

    def disturb(b, rng):
        for _ in range(60):
            address = rng.choice([*range(0x2000, 0x2010), 0x4020, 0x4021, 0x4022, 0x4000, 0x4001, 0x4010])
            b.bus.write(address, rng.randrange(256))
            b.counters.clock(rng.random() < 0.2, False)
            b.timers.counters[0].run(rng.randrange(300))
            b.interrupts.request(rng.randrange(8))
            b.scan_keys(frozenset([rng.randrange(64)]))
            b.receive(rng.randrange(256))
            b.now_ns += rng.randrange(10**6)

    first, second = board(), board()
    first.mean_current_A, first.open_V = 1.8, 100.0
    first.bus.write(bus.CPORT2, ppi.BASIC_OUTPUTS)
    first.bus.write(bus.CPORT3, ppi.STROBED_INPUTS)
    first.bus.write(bus.TIMERS + 3, pit.control_word(0, pit.RATE))
    disturb(first, random.Random(1))
    first.switches.trip(X_END)
    second.restore(json.loads(json.dumps(first.snapshot())))
    assert second.snapshot() == first.snapshot()
    disturb(first, random.Random(2))
    disturb(second, random.Random(2))
    assert second.snapshot() == first.snapshot()


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
    starts = []
    for seed in range(40):  # INIT's 0 V do not decide: between the voltages a start may succeed
        computer = Computer(Board(faults=Faults(drop_out=DropOut(seed))))
        computer.init()
        computer.set_pulse_codes(0, 115)
        computer.start()
        starts.append(computer.board.generator_on)
    assert 10 < sum(starts) < 30


def moved(couplers):
    """Computer after INIT and a second of a move along +x, and the steps its motors made."""
    computer = ready(generator=False, board=Board(couplers=couplers))
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
    for response_ns, state in ((15_000, "running"), (500, "emergency")):
        computer, steps = moved(Optocouplers(response_ns=response_ns))
        computer.board.spark()
        computer.serve()
        assert (computer.state, len(steps)) == (state, 16)
    computer, steps = moved(Optocouplers(response_ns=100_000))
    assert (computer.position, steps) == ((30_032, 30_000), [])


def test_the_dip_of_oev_in_init_does_not_reach_the_generator():  # T-84, T-50
    computer = Computer()
    computer.board.open_V = 100.0
    computer.init()
    assert computer.bus.read(bus.PORT2C) & 1
    assert computer.board.generator_line.voltage_V(0) == 0.0
