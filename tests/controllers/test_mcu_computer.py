"""The routines of the 1982 controller: INIT, the emergency routine, the stepper interrupt, the generator's codes."""


import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from edmsim.controllers.mcu.board import STOP_BUTTON, WIRE_BREAK, X_END, Y_END, Board, LineOrder
from edmsim.controllers.mcu.chips import bus, pic, ppi
from edmsim.controllers.mcu.chips.dac import MOST_CODE, PulseSettings
from edmsim.controllers.mcu.computer import Computer
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.controllers.mcu.firmware.poscal import poscal
from edmsim.controllers.mcu.firmware.timers import CPU_HZ, ENTRY_T, LOAD_T, PULSE_T
from edmsim.controllers.planner.registry import PLANNERS, make_planner
from edmsim.controllers.protocols import Step
from edmsim.errors import InputError

START = (30_000, 30_000)
SECOND = 1_000_000_000
TICK_NS = SECOND / 8601.6
FIRST_STEP_NS = (ENTRY_T + LOAD_T + PULSE_T) * SECOND // CPU_HZ


def ready(*, speed=127, start=True, generator=True, **options):
    computer = Computer(**options)
    computer.init()
    computer.set_position(*START)
    computer.set_speed(speed)
    if start:
        computer.start(generator)
    return computer


def record_writes(computer):
    writes, write = [], computer.board.bus.write
    store = computer.board.bus.store

    def note(address, byte):
        writes.append((address, byte))
        write(address, byte)

    def note_word(address, word):
        writes.append((address, word))
        store(address, word)

    computer.board.bus.write, computer.board.bus.store = note, note_word
    return writes


def test_init_leaves_a_safe_stand_by():  # T-43, T-51, T-50
    with pytest.raises(InputError, match="INIT first"):
        Computer().start()
    computer = ready()
    computer.set_pulse_codes(102, 170)
    computer.move_to(31_000, 30_000)
    assert len(computer.run_until(SECOND)) > 10
    place = computer.position
    computer.init()
    assert computer.state == "stand-by"
    assert (computer.position, computer.pulse_codes) == (place, (0, 0))
    assert computer.bus.read(0x4022) & 1  # OEV
    assert not computer.board.generator_on
    assert computer.bus.read(0x4032) & (ppi.INTE_A | ppi.INTE_B | ppi.IBF_A | ppi.IBF_B) == 0
    assert computer.run_until(5 * SECOND) == computer.drive([Step(6 * SECOND, 0, 1)]) == []
    assert computer.position == place


def test_init_keeps_the_documents_order():  # T-50, T-48
    computer = Computer()
    writes = record_writes(computer)
    computer.init()
    addresses = [address for address, _ in writes]
    order = [
        at.XVELOC, 0x3FE0, bus.TIMERS + 3, bus.CPORT2, bus.PORT2C, bus.PORT2A, bus.PORT2B, bus.CPORT3, bus.INTERRUPTS,
    ]  # fmt: skip
    first = [addresses.index(address) for address in order]
    assert first == sorted(first)
    assert dict(writes)[bus.PORT2A] == dict(writes)[bus.PORT2B] == 0
    table = [computer.bus.read(0x3FE0 + 4 * level) for level in range(8)]
    assert table == [0xC3] * 8  # JMP
    assert computer.bus.word(0x3FE1 + 4 * pic.EMERGENCY) == at.EMERGENCY_ROUTINE


def test_emergency_copies_its_data_before_it_changes_outputs():  # T-49
    computer = ready()
    computer.set_pulse_codes(102, 170)
    computer.move_to(30_500, 29_000)
    computer.run_until(SECOND)
    place = computer.position
    moving = computer.bus.word(at.XVELOC), computer.bus.word(at.YVELOC)
    assert 0 not in moving
    writes = record_writes(computer)
    computer.emergency()
    ports = [k for k, (address, _) in enumerate(writes) if address >= 0x4000]
    copies = [k for k, (address, _) in enumerate(writes) if at.SAVED <= address < at.SAVED + 10]
    assert len(copies) == len(at.SAVED_WORDS)
    assert max(copies) < min(ports)
    saved = [computer.bus.word(at.SAVED + 2 * k) for k in range(5)]
    assert saved == [place[0], moving[0], place[1], moving[1], 127]
    assert (computer.position, computer.pulse_codes, computer.board.generator_on) == (place, (0, 0), False)


@pytest.mark.parametrize("switch", [X_END, Y_END, WIRE_BREAK, STOP_BUTTON])
def test_nothing_moves_after_an_emergency_until_init(switch):  # T-46, T-47, T-49
    computer = ready()
    computer.move_to(31_000, 30_000)
    before = len(computer.run_until(SECOND))
    computer.board.switches.trip(switch)
    assert computer.board.switches.steppers_supplied == (switch == WIRE_BREAK)
    assert computer.run_until(2 * SECOND) == []
    assert (computer.state, computer.cause) == ("emergency", (switch,))
    place = computer.position
    assert place[0] == START[0] + 2 * before
    for refused in (
        computer.start, lambda: computer.set_pulse_codes(1, 200), lambda: computer.move_to(30_000, 30_000)
    ):  # fmt: skip
        with pytest.raises(InputError):
            refused()
    assert computer.drive([Step(3 * SECOND, 0, 1)]) == computer.run_until(4 * SECOND) == []
    computer.board.bus.write(bus.CPORT2, 0)  # even a program gone wild: OEV 0
    assert computer.board.generator_on == (switch in (X_END, Y_END))
    computer.init()
    with pytest.raises(InputError, match=f"the {switch} switch is open"):
        computer.start()
    computer.board.switches.release()
    computer.start()
    computer.move_to(30_000, 30_000)
    assert len(computer.run_until(10 * SECOND)) == before
    assert computer.position == START


def test_hardware_cuts_the_steppers_even_where_the_program_goes_on():  # T-47
    computer = ready()
    computer.board.switches.trip(X_END)
    for bit in (2, 4):
        computer.bus.write(bus.CPORT2, bit << 1 | 1)
    assert computer.board.steps == []


def test_the_emergency_comes_before_a_step_that_is_due():  # T-45
    computer = ready()
    computer.board.interrupts.request(pic.X_STEPPER)
    computer.bus.store(at.XVELOC, 127)
    computer.board.switches.trip(WIRE_BREAK)
    computer.serve()
    assert (computer.state, computer.position) == ("emergency", START)


@given(st.integers(-40, 40), st.integers(-40, 40), st.integers(1, 127))
@settings(max_examples=40)
def test_a_move_is_the_literal_planners(dx, dy, speed):  # T-16, T-17, T-70, T-71, T-76, T-69
    target = START[0] + 20 * dx, START[1] + 20 * dy
    assume(poscal(START, target, speed) == poscal(START, target, speed, literal_wrap=True))
    computer = ready(speed=speed, generator=False)
    computer.move_to(*target)
    end = 3 * SECOND
    if target == START:
        assert not computer.moving
        return
    assert (computer.bus.signed(at.XVELOC), computer.bus.signed(at.YVELOC)) == poscal(START, target, speed)
    ideal_steps = make_planner("poscal-literal", np.array([START, target])).advance(0, end, speed)
    made = [s for k in range(1, 31) for s in computer.run_until(k * end // 30)]
    made += computer.board.steps  # of a routine that was under way at the end
    for axis in (0, 1):
        ideal, real = ([s for s in steps if s.axis == axis] for steps in (ideal_steps, made))
        assert [s.direction for s in real] == [s.direction for s in ideal][: len(real)]
        assert len(ideal) - len(real) in (0, 1)  # one may be due at the very end
        late = [b.time_ns - a.time_ns for a, b in zip(ideal, real, strict=False)]
        # the routine's way to the port, and now and then a tick where the other axis came first
        assert not late or (min(late) >= FIRST_STEP_NS and max(late) < FIRST_STEP_NS + 10 * TICK_NS)
    moved = [sum(2 * s.direction for s in made if s.axis == axis) for axis in (0, 1)]
    assert computer.position == (START[0] + moved[0], START[1] + moved[1])


def test_a_move_ends_at_its_target_and_a_new_speed_counts_from_the_next_step():  # T-76, T-52
    computer = ready(speed=64)
    computer.move_to(30_100, 30_000)
    with pytest.raises(InputError, match="the table is moving: a new move"):
        computer.move_to(30_000, 30_000)
    with pytest.raises(InputError, match="the table is moving: the position"):
        computer.set_position(0, 0)
    first = computer.run_until(SECOND // 4)
    computer.set_speed(127)
    rest = computer.run_until(10 * SECOND)
    times = np.diff([s.time_ns for s in first + rest])
    assert times[:1] == pytest.approx([1024 / 8601.6 * 1e9], abs=2)
    assert times[2:] == pytest.approx([516 / 8601.6 * 1e9] * 47, abs=2e5)
    assert (computer.position, computer.moving) == ((30_100, 30_000), False)


def test_only_rising_edges_step():  # T-16, T-17
    computer = ready(start=False)
    for byte, steps in ((0x01, 0), (0x05, 1), (0x05, 1), (0x01, 1), (0x07, 2), (0x1F, 3), (0x00, 3)):
        computer.bus.write(0x4022, byte)
        assert len(computer.board.steps) == steps
    assert [(s.axis, s.direction) for s in computer.board.steps] == [(0, -1), (0, 1), (1, 1)]


def test_another_order_of_the_lines():  # T-24, T-A9
    lines = LineOrder(7, 0, 1, 2, 3, 4, 5, 6)
    computer = ready(board=Board(lines=lines))
    assert computer.bus.read(0x4022) & 0x80 == 0
    computer.move_to(30_010, 29_990)
    assert {(s.axis, s.direction) for s in computer.run_until(SECOND)} == {(0, 1), (1, -1)}
    computer.stop()
    assert computer.bus.read(0x4022) & 0x80
    computer.set_pulse_codes(0x180, 0x1FF)
    assert computer.bus.read(0x4022) == 0x80 | 0x30 | computer.bus.read(0x4022) & 0x05
    with pytest.raises(InputError, match="bits 0 to 7, each once"):
        Board(lines=LineOrder(oev=7))


@pytest.mark.parametrize("planner", list(PLANNERS))
def test_a_planners_steps_come_out_of_the_port_as_they_went_in(planner):  # T-71
    points = np.array([START, (30_101, 30_053), (30_040, 30_160)])
    planned, computer = make_planner(planner, points), ready()
    planned_steps, driven = [], []
    for k, speed in enumerate([127, 30, -60, 1, 0, 127, 127, 127] * 3):
        units = round(speed * 262.5 / planned.speed_unit_nm_s)
        steps = planned.advance(k * SECOND // 2, (k + 1) * SECOND // 2, units)
        planned_steps += steps
        driven += computer.drive(steps)
        assert computer.position == planned.position_um
    assert driven == planned_steps
    assert len(planned_steps) >= 50


def test_positions_wrap_on_request_and_may_count_steps():  # T-61, T-A11
    for wrap, unit, end in ((True, "um", 65_535), (True, "step", 65_535)):
        computer = ready(wrap=wrap, unit=unit)
        computer.set_position(65_534, 0)
        computer.drive([Step(k * SECOND, 0, 1) for k in (1, 2)])
        assert computer.position == ((65_534 + (4 if unit == "um" else 2)) & end, 0)
    computer = ready()
    computer.set_position(65_534, 0)
    with pytest.raises(InputError, match="soft limit"):
        computer.drive([Step(SECOND, 0, 1)])
    assert computer.position == (65_534, 0)


def test_more_than_2_ampere_is_refused_and_the_old_pair_stays():  # T-34
    computer = ready()
    computer.set_pulse_codes(102, 170)
    with pytest.raises(InputError, match=r"draws 3\.31 A, above the generator's 2 A: t\(p\) must be at least 197 us"):
        computer.set_pulse_codes(255, 170)
    with pytest.raises(InputError, match=r"draws 5\.00 A, above the generator's 2 A: no t\(p\) is long enough"):
        PulseSettings(pulse_A=50.0).check(MOST_CODE, MOST_CODE)
    assert computer.pulse_codes == (102, 170)
    assert (computer.bus.read(0x4020), computer.bus.read(0x4021)) == (102, 170)
    with pytest.raises(InputError):
        computer.set_pulse_codes(102.0, 170)


@given(*[st.integers(0, 0x1FF)] * 4, st.sampled_from(["period", "frequency"]))
def test_no_pair_on_the_way_draws_too_much(a, b, c, d, law):  # T-34, T-35
    pulses = PulseSettings(law=law)
    if pulses.mean_current_A(a, b) > 2 or pulses.mean_current_A(c, d) > 2:
        return
    computer = Computer(Board(pulses))
    computer.init()
    computer.set_pulse_codes(a, b)
    drawn, write = [], computer.board.bus.write

    def note(address, byte):
        write(address, byte)
        drawn.append(pulses.mean_current_A(*computer.board.codes))

    computer.board.bus.write = note
    computer.set_pulse_codes(c, d)
    assert max(drawn) <= 2.0
    assert computer.pulse_codes == (c, d)
    assert (computer.bus.read(0x4020), computer.bus.read(0x4021)) == (c & 0xFF, d & 0xFF)


def test_streams_go_where_the_two_words_point():  # T-58, T-59
    computer = ready()
    assert computer.streams.ci() is None
    computer.board.receive(ord("A"))
    computer.board.receive(ord("H"), from_host=True)
    assert computer.streams.ci() == ord("A")
    computer.bus.store(at.CIADR, at.HOST_IN)
    assert computer.streams.ci() == ord("H")
    computer.streams.co(ord("x"))
    computer.bus.store(at.COADR, at.HOST_OUT)
    computer.streams.co(ord("y"))
    assert (computer.board.sent, computer.board.sent_to_host) == (b"x", b"y")
    characters = []
    computer.streams.outputs[0x2400] = characters.append
    computer.bus.store(at.COADR, 0x2400)
    computer.streams.co(ord("z"))
    assert characters == [ord("z")]
    computer.bus.store(at.CIADR, 0x1234)
    with pytest.raises(InputError, match="CIADR holds 1234H"):
        computer.streams.ci()


def test_bit_rate_is_counter_2_and_the_others_are_the_axes():  # T-22
    computer = ready()
    counters = computer.board.timers.counters
    assert CPU_HZ / counters[2].reload / 16 == 9600
    assert counters[2].mode == 3
    computer.move_to(30_200, 30_100)
    assert counters[0].left == 65_536 // abs(computer.bus.signed(at.XVELOC))
    assert counters[1].left == 65_536 // abs(computer.bus.signed(at.YVELOC))


@pytest.mark.parametrize(("do", "words"), [
    (lambda c: c.set_speed(128), "the cutting speed is 0..127 units of 262.5 nm/s, not 128"),
    (lambda c: c.set_speed(-1), "not -1"), (lambda c: c.set_position(0, 65_536), "a position is 0..65535, not 65536"),
    (lambda c: c.move_to(-1, 0), "a position is 0..65535, not -1"),
    (lambda c: (c.stop(), c.move_to(0, 0)), "the machine is not started"),
    (lambda c: (c.set_speed(0), c.move_to(0, 0)), "the cutting speed is 0"),
])  # fmt: skip
def test_what_cannot_be_done_is_refused(do, words):  # T-A1, T-60
    computer = ready()
    with pytest.raises(InputError) as refused:
        do(computer)
    assert words in str(refused.value)
    assert computer.position == START
