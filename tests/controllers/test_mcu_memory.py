"""What lies in the 8 K of RAM, INIT's copy into it, tapes, and the 8085 that runs machine code from it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.consoles.computer_1982.line_input import InputBuffer, getnum
from edmsim.consoles.computer_1982.monitor import punch, read_tape
from edmsim.consoles.computer_1982.words import Move, ProgramStore, Setting
from edmsim.controllers.mcu.chips import bus, pic, uart
from edmsim.controllers.mcu.chips.cpu import CARRY, SIGN, ZERO, A, B, Cpu8085, D, E, NoCodeError
from edmsim.controllers.mcu.computer import Computer
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.controllers.mcu.firmware.optimise import Settings, State
from edmsim.errors import InputError

from .test_mcu_computer import ready

WORDS, BYTES = st.integers(0, 0xFFFF), st.integers(0, 0xFF)


def started():
    computer = ready(speed=100, generator=False)
    computer.move_to(30_500, 30_300)
    computer.run_until(1_000_000_000)
    return computer


def test_every_area_lies_in_ram_and_touches_no_other():  # T-20
    inside = [area for area in at.MAP if area.first != at.MAXVEL]  # one of the optimiser's words
    ends = [area.first + area.bytes for area in inside]
    assert all(a <= b.first for a, b in zip(ends, inside[1:], strict=False))
    assert inside[0].first == bus.RAM[0]
    assert ends[-1] == bus.RAM[-1] + 1
    for address, reason in ((0x0100, "0100H is EPROM"), (0x5000, "nothing answers at 5000H")):
        with pytest.raises(InputError, match=reason):
            bus.Bus().check_writable(address)


def test_init_copies_its_table_and_keeps_positions_and_targets():  # T-80, T-A14, T-49
    computer = started()
    place, target = computer.position, (computer.bus.word(at.NEWX), computer.bus.word(at.NEWY))
    assert computer.bus.word(at.XVELOC) != 0
    first = sum(size for area, size in at.START_AREAS if area < at.ENTRY)
    computer.bus.write(at.START_VALUES + first, 42)
    for stop in (computer.emergency, computer.init):
        stop()
        assert (computer.position, (computer.bus.word(at.NEWX), computer.bus.word(at.NEWY))) == (place, target)
        assert [computer.bus.word(a) for a in (at.XVELOC, at.YVELOC, at.CUTVEL)] == [0, 0, 0]
        assert computer.bus.word(at.ENTRY) == 42
        assert computer.speed == 100
        assert computer.run_until(9_000_000_000) == []


def test_the_monitor_sets_up_the_serial_lines_and_init_leaves_them():  # T-81
    computer = Computer()
    assert computer.board.timers.counters[2].reload == 20
    assert [c.reload for c in computer.board.timers.counters[:2]] == [0, 0]
    computer.board.receive(ord("A"))
    assert computer.streams.ci() == ord("A")
    assert computer.state == "off"
    computer.bus.write(bus.TERMINAL + 1, uart.COMMAND_RESET)
    computer.init()
    computer.board.receive(ord("B"))
    assert computer.streams.ci() is None
    computer.reset()
    computer.board.receive(ord("C"))
    assert (computer.streams.ci(), computer.state) == (ord("C"), "off")


def test_the_jump_table_decides_what_an_interrupt_runs():  # T-82
    computer = started()
    entry, place = 0x3FE0 + 4 * pic.X_STEPPER, computer.position
    assert [computer.bus.read(entry + k) for k in range(4)] == [0xC3, at.X_ENTRY & 0xFF, at.X_ENTRY >> 8, 0]
    assert bus.RAM[-1] + 1 == 0x3FE0 + 32
    computer.bus.store(entry + 1, at.NO_ROUTINE)  # I1AD leads elsewhere: x stands, y goes on
    computer.run_until(2_000_000_000)
    assert computer.position[0] == place[0]
    assert computer.position[1] > place[1]
    computer.bus.write(0x3FE0 + 4 * pic.Y_STEPPER, 0x08)
    computer.run_until(3_000_000_000)
    assert computer.state == "emergency"
    assert computer.cause == ("interrupt: 08H at 3FE8H is not an instruction of the 8085",)
    computer.init()  # the jump table comes from the start values again
    assert computer.bus.read(0x3FE0 + 4 * pic.Y_STEPPER) == 0xC3


def test_numbers_of_a_line_come_through_the_redirected_stream():  # T-83, T-58
    computer = Computer()
    buffer, addresses = InputBuffer(b"123 456", computer.streams), []
    fetch = computer.streams.inputs[at.BUFFER_IN]
    computer.streams.inputs[at.BUFFER_IN] = lambda: addresses.append(computer.bus.word(at.CIADR)) or fetch()
    assert getnum(buffer) == 123
    assert addresses == 4 * [at.BUFFER_IN]
    assert computer.bus.word(at.CIADR) == at.TERMINAL_IN
    assert bytes(computer.bus.read(at.BPTR_DATA + k) for k in range(8)) == b"123 456\0"
    assert computer.bus.word(at.BPTR) == at.BPTR_DATA + 3


def test_the_optimiser_keeps_its_words_in_ram():  # T-20
    memory = bus.Bus()
    constants = Settings(*range(1, 18))._replace(limit=127)
    at.set_constants(memory, constants)
    at.set_variables(memory, State(*range(20, 30)))
    assert memory.word(at.MAXVEL) == 127
    assert at.constants(memory) == constants
    assert at.variables(memory) == State(*range(20, 30))
    memory.store(at.MAXVEL, 5)
    assert at.constants(memory).slow == 5


ENTRIES = st.one_of(
    st.builds(Move, st.tuples(WORDS, WORDS), st.none(), st.just(False)),
    st.builds(Move, st.tuples(WORDS, WORDS), st.tuples(WORDS, WORDS), st.booleans()),
    st.builds(Setting, *[st.none() | BYTES] * 3),
)


@pytest.mark.slow
@given(st.lists(ENTRIES, max_size=6))
def test_a_program_stands_in_ram_as_bytes(entries):
    memory = bus.Bus()
    store = ProgramStore(memory, at.PROGRAM, 5)
    store.write(entries[:5])
    assert store.read() == entries[:5]
    memory.write(at.PROGRAM, 0x7F)
    with pytest.raises(InputError, match="the program's byte at 2180H is 7FH, which begins no entry"):
        store.read()


def test_a_program_whose_end_was_overwritten_is_refused():
    memory = bus.Bus()
    for k in range(30):
        memory.write(at.PROGRAM + k, 1)
    with pytest.raises(InputError, match="the program at 2180H has no end"):
        ProgramStore(memory, at.PROGRAM, 2).read()


@given(st.binary(max_size=70), st.integers(0, 0xFF00))
def test_a_tape_that_was_punched_is_read_back(data, first):  # T-78
    tape = punch(data, first)
    assert read_tape(tape.encode()) == ({first + k: byte for k, byte in enumerate(data)}, 0)
    assert all(sum(bytes.fromhex(line[1:])) & 0xFF == 0 for line in tape.splitlines())


@pytest.mark.parametrize(("text", "reason"), [
    (b":0121000055AA\n:00000001FF", "line 1 of the tape: its checksum is AAH where 89H were right"),
    (b"\0\0\n:012100005589\n:02210000558F\n", "line 3 of the tape: the record says 2 bytes and has 1"),
    (b":012100005589\n", "the tape ends without its last record, :00000001FF"),
    (b"hello\n", "line 1 of the tape: a record is a colon and at least 10 hexadecimal figures"),
    (b":020000040000FA\n", "line 1 of the tape: a record of kind 04 is not for sixteen bits of address"),
])  # fmt: skip
def test_a_bad_tape_is_one_line(text, reason):
    with pytest.raises(InputError) as refused:
        read_tape(text)
    assert refused.value.reason.startswith(reason)


def run(code, **registers):
    """Run code at 3400H up to its HLT; returns the processor and its T-states."""
    memory = bus.Bus()
    for k, byte in enumerate(code + b"\x76"):
        memory.write(0x3400 + k, byte)

    def no_routine(address):
        raise NoCodeError(f"{address:04X}H")

    cpu, cost = Cpu8085(memory, no_routine), 0
    cpu.pc, cpu.sp = 0x3400, at.STACK
    for name, value in registers.items():
        cpu.registers["bcdehl_a".index(name)] = value
    while not cpu.halted:
        cost += cpu.step()
    return cpu, cost


@given(BYTES, BYTES, BYTES, BYTES)
def test_sums_and_differences_of_words(b, c, d, e):
    cpu, cost = run(bytes.fromhex("79 83 4F 78 8A 47"), b=b, c=c, d=d, e=e)  # MOV ADD MOV MOV ADC MOV
    assert (cpu.registers[0] << 8 | cpu.registers[1]) == ((b << 8 | c) + (d << 8 | e)) & 0xFFFF
    assert bool(cpu.flags & CARRY) == ((b << 8 | c) + (d << 8 | e) > 0xFFFF)
    assert cost == 6 * 4 + 5
    cpu, _ = run(bytes.fromhex("79 93 4F 78 9A 47"), b=b, c=c, d=d, e=e)  # SUB, SBB
    left = (b << 8 | c) - (d << 8 | e)
    assert (cpu.registers[0] << 8 | cpu.registers[1], bool(cpu.flags & CARRY)) == (left & 0xFFFF, left < 0)
    assert bool(cpu.flags & SIGN) == bool(cpu.registers[0] & 0x80)
    assert bool(cpu.flags & ZERO) == (cpu.registers[A] == 0)


@given(st.integers(0, 99), st.integers(0, 99))
def test_decimal_figures_add_up(a, b):
    cpu, _ = run(bytes.fromhex("80 27"), a=int(str(a), 16), b=int(str(b), 16))  # ADD B, DAA
    total = f"{cpu.flags & CARRY}{cpu.registers[A]:02X}"
    assert int(total) == a + b


@given(BYTES, BYTES)
def test_a_product_by_shifts_takes_the_manuals_time(d, e):
    # MVI B,8; LXI H,0; loop: DAD H; MOV A,C; RAL; MOV C,A; JNC next; DAD D; next: DCR B; JNZ loop
    code = "06 08 21 00 00 29 79 17 4F D2 0D 34 19 05 C2 05 34"
    cpu, cost = run(bytes.fromhex(code), c=d, d=0, e=e)
    assert (cpu.registers[4] << 8 | cpu.registers[5]) == d * e
    ones = bin(d).count("1")
    # DAD 10, MOV 4, RAL 4, MOV 4, JNC 10 or 7 with DAD 10 behind it, DCR 4, JNZ 10 or 7
    assert cost == 7 + 10 + 8 * (10 + 12) + (8 - ones) * 10 + ones * 17 + 8 * 4 + 7 * 10 + 7 + 5
    assert (cpu.registers[B], cpu.registers[D], cpu.registers[E]) == (0, 0, e)


@pytest.mark.parametrize(("code", "expected", "cost"), [
    ("3E 80 07 4F", {"c": 0x01}, 7 + 4 + 4),  # RLC
    ("3E 01 0F 4F", {"c": 0x80}, 15),  # RRC
    ("37 3E 01 1F 4F", {"c": 0x80}, 19),  # STC, RAR
    ("3E 0F 2F 4F", {"c": 0xF0}, 15),  # CMA
    ("21 00 36 36 5A 34 4E", {"c": 0x5B}, 10 + 10 + 10 + 7),  # MVI M, INR M
    ("3E 5A 32 01 36 2A 00 36 4C", {"c": 0x5A}, 7 + 13 + 16 + 4),  # STA, LHLD
    ("01 34 12 C5 E1 4C", {"c": 0x12}, 10 + 12 + 10 + 4),  # PUSH B, POP H
    ("3E 5A 37 F5 C1", {"b": 0x5A, "c": 0x03}, 7 + 4 + 12 + 10),  # PUSH PSW with its carry, POP B
    ("21 34 12 22 00 36 2A 00 36 44 4D", {"b": 0x12, "c": 0x34}, 10 + 16 + 16 + 4 + 4),  # SHLD, LHLD
    ("21 34 12 11 78 56 EB 4D", {"c": 0x78}, 10 + 10 + 4 + 4),  # XCHG
    ("3E 05 FE 05 CA 0A 34 0E 01 76 0E 02", {"c": 2}, 7 + 7 + 10 + 7),  # CPI, JZ
    ("CD 06 34 0E 07 76 3E 01 C9", {"c": 7, "a": 1}, 18 + 7 + 10 + 7),  # CALL, RET
    ("3E 00 B7 C0 C8", {}, 7 + 4 + 6 + 12),  # RNZ not taken, RZ taken: into a stack of zeros
])  # fmt: skip
def test_instructions_do_what_the_manual_says(code, expected, cost):
    if not expected:
        with pytest.raises(NoCodeError, match="0000H"):
            run(bytes.fromhex(code))
        return
    cpu, spent = run(bytes.fromhex(code))
    assert {name: cpu.registers["bcdehl_a".index(name)] for name in expected} == expected
    assert spent == cost + 5


def test_every_byte_is_an_instruction_or_is_refused():
    for op in range(256):
        cpu = run(b"")[0]
        cpu._memory.write(0x3400, op)
        cpu.pc, cpu.halted = 0x3400, False
        if op in (0x08, 0x10, 0x18, 0x28, 0x38, 0xCB, 0xD9, 0xDD, 0xED, 0xFD):
            with pytest.raises(NoCodeError, match=f"{op:02X}H at 3400H is not an instruction of the 8085"):
                cpu.step()
        else:
            assert 4 <= cpu.step() <= 18
