"""The monitor at the terminal: memory and registers, tapes, the host, programs; and tables of any size."""

import re

import pytest

from edmsim.consoles.computer_1982.monitor import punch
from edmsim.consoles.computer_1982.operation import Operation
from edmsim.consoles.computer_1982.rig import Rig
from edmsim.consoles.computer_1982.session import Session
from edmsim.consoles.devices import Interrupts
from edmsim.controllers.mcu.firmware import memory_map as at

from .conftest import Script, run_script

SET = "TI 30 TP 100"
STEPS = bytes.fromhex(
    "06 05  3E 03 32 23 40"  # MVI B,5; X direction up, by 4023H
    "3E 05 32 23 40  11 00 02 1B 7A B3 C2 0F 34"  # pulse up; wait 4 ms
    "3E 04 32 23 40  05 C2 07 34"  # pulse down; five times
    "0E 4F CD 10 01  0E 4B CD 10 01  C9"  # O and K by the routine at 0110H
)


@pytest.fixture
def sit(rig, tmp_path):
    """Type a script into the monitor that power-up leads to; returns the exit status and the lines shown."""
    return lambda *lines, **options: run_script(rig, *lines, **{"monitor": True, "tapes": tmp_path, **options})[:2]


def after(lines, typed):
    return lines[lines.index(typed) + 1]


def test_power_up_leads_to_the_monitor_and_main_is_started_from_it(sit, rig):  # T-78, T-81, T-52
    status, lines = sit("G", "D 4020,4022", "D 2000", "G 0400", "X 20", "WAIT", "MON", "G", "POS", "MON", "G 0300")
    assert lines[0].startswith("MONITOR 8085")
    assert after(lines, ". G") == "? MAIN was not started yet; G 0400 starts it"
    assert after(lines, ". D 4020,4022") == "4020  00 00 01"
    assert after(lines, ". D 2000") == "2000  F4 7E" + 14 * " 00"
    assert after(lines, ". G 0400").startswith("AGIECUT-DEM15")
    assert after(lines, "> POS") == "POSITION X 32520 Y 32500 um"
    assert rig.place_um == (32_520.0, 32_500.0)
    assert status == 2


def test_memory_and_registers_are_altered_and_act(sit, rig):  # T-78, T-20
    cut = (SET, "NEW 32700 32500", "START", "WAIT 1", "STATUS", "MON")
    slow = f"S {at.MAXVEL:04X} 05 00"
    _, lines = sit("G 0400", *cut, slow, "S 2040", " ", "S 4021 FF", "G", "WAIT 1", "STATUS", "MON", "S 4022 01", "G",
                   "WAIT 1", "STATUS")  # fmt: skip
    assert re.match(r"\. S 204C 7F-05 00-00", lines[lines.index("> MON") + 1])
    states = [line for line in lines if line.startswith("SPEED")]
    assert int(states[0].split()[1]) > 5
    assert states[1].startswith("SPEED 5 OF 5 UNITS")
    periods = [line.split("t(p) ")[1] for line in lines if line.startswith("t(i)")][1:]
    assert periods == ["100 us (AAH)", "150 us (FFH)", "150 us (FFH)"]
    assert rig.plant.machine.t_period_us == 150.0
    assert [line.split()[1] for line in lines if line.startswith("GENERATOR")] == ["ON", "ON", "OFF"]


def test_a_cut_at_the_greatest_speed_0_is_not_waited_for(sit):
    status, lines = sit("G 0400", SET, "NEW 32700 32500", "START", "MON", f"S {at.MAXVEL:04X} 00", "G", "WAIT")
    assert status == 2
    refused = [line for line in lines if line.startswith("?")]
    assert [line.partition("; ")[2] for line in refused] == ["WAIT s waits s seconds", "it is left unfinished"]


def test_a_step_and_a_pulse_by_hand(sit, rig):  # T-78, T-16
    _, lines = sit("G 0400", "MON", "S 4023 03", "S 4023 05", "S 4023 04", "S 4023 05 05", "G", "WAIT 1")
    assert "? nothing answers at 4024H" in lines  # the space behind the byte goes on there
    assert rig.place_um == (32_504.0, 32_500.0)
    assert rig.computer.position == (32_500, 32_500)  # no routine counted


def test_a_counter_altered_in_a_cut_ends_at_the_soft_limit(sit, rig):  # T-A11
    _, lines = sit("G 0400", SET, "NEW 32700 32500", "START", "WAIT 1", "MON", "S 2000 FE FF", "G", "WAIT 1", "X 20")
    (message,) = [line for line in lines if line.startswith("EMERGENCY")]
    assert message.startswith("EMERGENCY: SOFT LIMIT: A STEP TO 65536 UM WOULD LEAVE THE TABLE'S 0..65535 UM;")
    assert "only INIT helps" in after(lines, "> X 20")
    status = Operation(rig).status()
    assert (status.short, status.open, status.erosion) == (0, 0, 0)


def test_routines_are_started_at_their_addresses_in_a_cut(sit, rig):  # T-78, T-49
    cut = (SET, "START", "WAIT 1", "MON")
    _, lines = sit("G 0400", "NEW 32700 32500", *cut, "G 0200", "G 0300", "G", *cut, "S 3400 CD 00 03 C9", "G 3400",
                   "G", "STATUS", *cut, "G 0210", "D 2000,2001")  # fmt: skip
    assert any(line.startswith("EMERGENCY: CALLED FROM THE MONITOR; NOTHING MOVES UNTIL INIT") for line in lines)
    assert any(line.startswith("STOPPED BY A PROGRAM   X 325") for line in lines)
    assert lines[lines.index("> STATUS") + 1].startswith("STAND-BY")


def test_altered_bytes_of_path_and_line_are_reported_or_passed_over(sit, rig):  # T-20
    _, lines = sit("G 0400", "NEW 1 2", "MON", "D 20F0,20F5", "S 20F0 33", "D 20A0,20A7", "G", "STATUS", "MAIN", "",
                   "3 4", "HELP MON", "MON", "D 20F0,20F5", "S 2180 33", "G", "LIST", "RUN")  # fmt: skip
    assert after(lines, ". D 20F0,20F5") == "20F0  01 01 00 02 00 00"
    assert after(lines, ". D 20A0,20A7") == "20A0  A5 20 4D 4F 4E 00 31 20"  # MON, and what NEW 1 2 left
    assert "STAND-BY   POSITION X 32500 Y 32500 um   NO NEW POSITION" in lines
    assert "20F0  01 03 00 04 00 00" in lines
    for line in ("> LIST", "> RUN"):
        assert after(lines, line) == "? the program's byte at 2180H is 33H, which begins no entry"


def test_a_setting_beyond_the_generator_is_refused_and_the_old_one_stays(sit, rig):  # T-34
    _, lines = sit("G 0400", SET, "GEN ON", "MON", "S 4020 FF", "G", "WAIT 1", "STATUS")
    assert any(line.startswith("? ") and "the generator keeps its old setting" in line for line in lines)
    assert rig.plant.machine.t_on_us == 30.0


def test_tapes_are_punched_and_read(sit, rig, tmp_path):  # T-78
    status, lines = sit("S 3400 11 22 33", "P 3400,3402,THREE.HEX", "S 3400 00 00 00", "R THREE.HEX", "D 3400,3402",
                        "P 3400,3402,THREE.HEX", "R NONE.HEX")  # fmt: skip
    assert (tmp_path / "THREE.HEX").read_text() == ":0334000011223363\n:00000001FF\n"
    assert "3 BYTES ON TAPE THREE.HEX" in lines
    assert "3 BYTES, 3400H TO 3402H" in lines
    assert after(lines, ". D 3400,3402") == "3400  11 22 33"
    assert [line for line in lines if line.startswith("? ")] == [
        "? there is a tape THREE.HEX already, and no hole can be closed: name another",
        "? the tape NONE.HEX cannot be read: No such file or directory",
    ]
    assert status == 2


def test_a_tape_with_a_mistake_loads_nothing(sit, rig, tmp_path):
    (tmp_path / "BAD.HEX").write_text(":0334000011223364\n:00000001FF\n")
    (tmp_path / "ROM.HEX").write_text(punch(b"\x11" * 20, 0x1FF0))
    _, lines = sit("R BAD.HEX", "R ROM.HEX", "D 3400,3402", "D 2000,2003")
    assert after(lines, ". R BAD.HEX") == "? line 1 of the tape: its checksum is 64H where 63H were right"
    assert after(lines, ". R ROM.HEX") == "? the tape is for 1FF0H, which is not RAM; nothing was loaded"
    assert after(lines, ". D 3400,3402") == "3400  00 00 00"
    assert after(lines, ". D 2000,2003") == "2000  F4 7E 00 00"


def test_machine_code_from_the_host_steps_the_table(sit, rig, tmp_path):  # T-79, T-16
    host = tmp_path / "steps.hex"
    host.write_text(punch(STEPS, 0x3400))
    status, lines = sit("S 4023 80", "H", "G 3400", "D 2000,2001", host=host)
    assert after(lines, ". H") == f"{len(STEPS)} BYTES, 3400H TO {0x3400 + len(STEPS) - 1:04X}H"
    assert after(lines, ". G 3400").startswith("OK")
    assert rig.place_um == (32_510.0, 32_500.0)
    assert rig.time_ns == pytest.approx(30e6, abs=26e6)
    assert status == 0


@pytest.mark.parametrize(("code", "reason"), [
    ("08", "08H at 3400H is not an instruction of the 8085"),
    ("C3 00 04", "there is no 8085 code at 0400H: the listings of 1982 are lost"),
    ("C3 00 34", "the program was broken off at 3400H"),
    ("3E C0 32 23 40 C9", "control word C0H: this 8255 has mode 0 and, for input only, mode 1"),
])  # fmt: skip
def test_machine_code_that_cannot_run_is_reported(sit, tmp_path, monkeypatch, code, reason):
    monkeypatch.setattr("edmsim.consoles.computer_1982.session.PROGRAM_NS", 30_000_000)
    (tmp_path / "CODE.HEX").write_text(punch(bytes.fromhex(code), 0x3400))
    _, lines = sit("R CODE.HEX", "G 3400", "D 3400,3400")
    assert [line for line in lines if line.startswith("? ")] == [f"? {reason}"]
    assert lines[-3] == f"3400  {code[:2]}"


def test_every_character_is_handled_at_once(rig):  # T-83
    screen = Script(b"")
    session = Session(rig, screen, Interrupts(), person=True, monitor=True)
    session._press_reset()
    for typed, shown in ((b"D", "D"), (b"2", "2"), (b"X", "X\r\n? a hexadecimal number of up to 4 figures")):
        screen.printed.clear()
        session._take(typed[0])
        assert shown in screen.printed.decode()
    screen.printed.clear()
    for character in b"S 3400 ":
        session._take(character)
    assert screen.printed.decode().endswith("S 3400 00-")


@pytest.mark.parametrize(("line", "reason"), [
    ("K", "K is not a command; ? shows them"), ("%", "% is not a command; ? shows them"),
    ("D", "an address is expected"),
    ("D 12345", "a hexadecimal number of up to 4 figures is expected, not 5"),
    ("D 2010,2000", "the last address, 2000H, lies before the first, 2010H"),
    ("D 2010,", "a first and a last address are expected"),
    ("S", "an address is expected"),
    ("S 0100 12", "0100H is EPROM, which cannot be written"),
    ("S 5000 12", "nothing answers at 5000H"),
    ("S 3400 123", "a hexadecimal number of up to 2 figures is expected, not 3"),
    ("S 4003 FF", "control word FFH: the counters of this 8253 take two bytes in binary, in mode 0, 2 or 3"),
    ("P 3400,3410", "a first and a last address are expected, and a name"),
    ("P 3400,3410,", "a tape's name of up to 32 letters"),
    ("P 4020,4022,X", "4022H is not memory; 0000H to 3FFFH are punched"),
    ("R ../X", "a tape's name has letters, figures, points and dashes"),
    ("H", "no host is connected; edmsim console 1982 --host FILE connects one"),
    ("M 1", "RETURN is expected here"),
    ("G 0108", "there is no 8085 code at 0108H: the listings are lost; M shows what starts"),
    ("G 4020", "there is no 8085 code at 4020H"),
    ("D 20\x1b", "ended by the operator"),
])  # fmt: skip
def test_what_is_wrong_is_one_line_and_does_nothing(sit, rig, line, reason):
    before = bytes(rig.board.bus.ram)
    status, lines = sit(line)
    refused = [message for message in lines if message.startswith("? ")]
    assert len(refused) == 1
    assert refused[0].startswith(f"? {reason}")
    assert bytes(rig.board.bus.ram)[0x100:] == before[0x100:]
    assert status == 2


def test_the_reset_button_brings_a_dead_terminal_back(sit, rig):  # T-81
    _, lines = sit("S 4019 40", "D 2000\x1cD 2000,2001", "S 3FD2 34 12", "S 3FD0 34", "D 2000,2001", "G 0400", "POS")
    assert sum(line.startswith("MONITOR 8085") for line in lines) >= 3
    assert any("COADR holds 0134H: there is no output routine" in line for line in lines)
    assert "2000  F4 7E" in lines


def test_help_and_map_fit_the_screen(sit):
    _, lines = sit("?", "M")
    assert all(len(line) <= 80 for line in lines)
    assert lines.index(". M") - lines.index(". ?") <= 13
    assert any(line.startswith("2100-2145  INIT'S TABLE OF START VALUES") for line in lines)


def on_a_table_of(machine, travel_mm):
    table = machine.base.table
    travel = table.travel_mm.model_copy(update={"value": travel_mm})
    base = machine.base.model_copy(update={"table": table.model_copy(update={"travel_mm": travel})})
    return machine.model_copy(update={"base": base})


def test_a_large_table_counts_steps_and_says_so(machine):  # T-61
    rig = Rig(on_a_table_of(machine, 130.0), seed=1, resolution="fast")
    status, lines, _ = run_script(
        rig, "POS", "X -10", "WAIT", "X 33060", SET, "NEW 32500 32480", "START", "WAIT 1", "EM", "INIT", SET, "GO",
        "WAIT", "CCW 32490 32490 32490 32480", "START", "WAIT", "KEY X+", "WAIT",
    )  # fmt: skip
    assert "THE TABLE HAS 130 mm: PLACES AND WAYS ARE STEPS OF 2 um HERE, NOT um" in lines
    assert after(lines, "> POS") == "POSITION X 32500 Y 32500 STEPS"
    assert "READY   X 32490 Y 32500 STEPS" in lines
    assert after(lines, "> X 33060") == "? soft limit: the counters hold 0 to 65535 STEPS, not 65550"
    assert "READY   X 32500 Y 32480 STEPS" in lines
    assert "READY   X 32490 Y 32490 STEPS" in lines
    assert rig.place_um == (64_982.0, 64_980.0)
    assert status in (0, 2)


def test_a_small_table_starts_in_its_middle_and_counts_um(machine):  # T-61
    rig = Rig(on_a_table_of(machine, 40.0), seed=1, resolution="fast")
    lines = run_script(rig, "POS", "X 10", "WAIT").lines
    assert "POSITION X 20000 Y 20000 um" in lines
    assert not [line for line in lines if "STEPS" in line]
    assert rig.place_um == (20_010.0, 20_000.0)
