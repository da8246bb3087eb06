"""What goes wrong at the machine: switches, broken wires, shorts, late counts, the faults of 1982."""

import re

import pytest

import edmsim
from edmsim.consoles.computer_1982.operation import Operation
from edmsim.consoles.computer_1982.rig import Rig
from edmsim.consoles.computer_1982.session import REFUSED, choose_faults
from edmsim.controllers.mcu.board import DropOut, Faults, SerialNoise
from edmsim.controllers.mcu.firmware import memory_map as at

from .conftest import run_script

SET = "TI 30 TP 100"
MOVING_WORDS = ("X 20", "Y -20", "START", "GO", "GEN ON", "POS 1 1", SET, "SPEED 9", "WIRE", "STOP")


def emergencies(lines):
    return [line for line in lines if line.startswith("EMERGENCY")]


# T-49
def test_an_emergency_stop_in_a_script_forgets_the_partial_line(rig):
    status, lines, _ = run_script(rig, "NEW 3\x03INIT", "STATUS")
    assert (status, [line for line in lines if line.startswith("? ")]) == (0, [])
    assert any(line.startswith("STAND-BY") for line in lines)


# T-49, T-51: nothing moves after an emergency stop until INIT
def test_nothing_moves_after_an_emergency_stop_until_init(rig):
    cut = SET, "NEW 33000 32500", "START", "WAIT 1", "EM"
    status, lines, _ = run_script(rig, *cut, *MOVING_WORDS, "WAIT 5", "STATUS")
    (message,) = [line for line in emergencies(lines) if "UNTIL INIT" in line]
    assert message.startswith("EMERGENCY: STOP BY THE OPERATOR; NOTHING MOVES UNTIL INIT")
    place = re.search(r"X \d+ Y \d+", message).group()
    assert f"EMERGENCY: STOP BY THE OPERATOR   POSITION {place} um   NEW 33000 32500" in lines
    assert len([line for line in lines if "only INIT helps" in line]) == len(MOVING_WORDS)
    assert rig.place_um[0] == int(place.split()[1])
    assert status == 3


# T-49, T-A14: at rest as well, twice, before INIT and after it
def test_an_emergency_at_rest_stops_what_stands_and_keeps_the_place(rig):
    cut = (SET, "START", "WAIT", "EM", "STATUS")
    status, lines, _ = run_script(rig, SET, "NEW 32560 32500", "EM", "STATUS", "EM", "X 20", "INIT", "STATUS", *cut)
    message = [line.split(";")[0] for line in emergencies(lines) if ";" in line]
    assert message == 3 * ["EMERGENCY: STOP BY THE OPERATOR"]
    assert "EMERGENCY: STOP BY THE OPERATOR   POSITION X 32500 Y 32500 um   NEW 32560 32500" in lines
    assert "STAND-BY   POSITION X 32500 Y 32500 um   NEW 32560 32500" in lines
    assert "EMERGENCY: STOP BY THE OPERATOR   POSITION X 32560 Y 32500 um   NEW 32560 32500" in lines
    assert rig.place_um == (32_560.0, 32_500.0)
    shown = Operation(rig).status()
    assert (shown.short, shown.open, shown.erosion) == (0, 0, 0)  # no pulses, so none that eroded
    assert not shown.generator_on
    assert status == 3


@pytest.mark.parametrize("stop", [("EM",), ("MON", "S 3400 CD 00 02 C9", "G 3400", "G")])  # by hand, by machine code
def test_a_stopped_cut_goes_on_after_init(rig, stop):
    cut = SET, "NEW 32560 32500", "START", "WAIT 1"
    status, lines, _ = run_script(rig, *cut, *stop, "INIT", "GO", SET, "GO", "WAIT")
    assert [line for line in lines if line.startswith("?")] == ["? t(i) and t(p) are not set; TI us TP us sets them"]
    assert "READY   X 32560 Y 32500 um" in lines
    assert status == 2


# T-87: the timers' own cut, stopped and gone on with
def test_the_timers_cut_stop_and_go_on_from_the_same_place_only(machine):
    rig = Rig(machine, seed=1, resolution="fast", planner="poscal-literal")
    lines = run_script(
        rig, SET, "NEW 32560 32540", "START", "WAIT 1", "STOP", "Y 20", "WAIT", "GO", "Y -20", "WAIT", "GO", "WAIT"
    ).lines
    assert len([line for line in lines if line.startswith("? the cut stopped at X ")]) == 1
    assert "READY   X 32560 Y 32540 um" in lines
    assert rig.place_um == (32_560.0, 32_540.0)
    spoilt = Rig(machine, seed=1, resolution="fast", planner="poscal-literal")
    store = spoilt.board.bus.store
    spoilt.board.bus.store = lambda address, word: store(address, 3 if word and address == at.YVELOC else word)
    lines = run_script(spoilt, SET, "NEW 32560 32540", "START", "WAIT 1", "STOP").lines
    ((x, y),) = re.findall(r"STOPPED   X (\d+) Y (\d+)", "\n".join(lines))
    assert int(x) - 32_500 > 4 * (int(y) - 32_500)


def test_ctrl_c_in_a_script_is_the_emergency_stop(rig):
    status, lines, _ = run_script(rig, "X 100", "WAIT 1", "\x03")
    assert len(emergencies(lines)) == 1
    assert status == 3


# T-46, T-47: end switch
def test_an_end_switch_stops_a_jog_and_can_only_be_left_backwards(rig):
    rig.plant.reset(1, position_um=(32_500.0, 10.0))
    status, lines, _ = run_script(
        rig, "Y -40", "WAIT", "Y -20", "INIT", "Y -20", "Y 20", "WAIT", "Y -20", "WAIT", "INIT", "Y 20", "WAIT"
    )
    first, second = emergencies(lines)
    assert first.startswith("EMERGENCY: Y END SWITCH; NOTHING MOVES UNTIL INIT   X 32500 Y 32486 um")
    assert "? emergency (Y END SWITCH): only INIT helps" in lines
    assert "? the y end switch is open; jog back from it" in lines
    assert second.split(";")[0] == first.split(";")[0]
    assert rig.place_um == (32_500.0, 16.0)
    assert status == 2


def stuck(machine, name):
    return Rig(machine, seed=1, resolution="fast", faults=choose_faults([name], seed=0))


# T-46, T-47: an end switch that never opens, with counters that were set to another place
@pytest.mark.slow
def test_a_stuck_end_switch_lets_the_table_run_into_its_stop_and_lose_steps(machine):
    travel_um, unseen = machine.base.table.travel_mm.value * 1e3, stuck(machine, "stuck-end-switch")
    unseen.plant.reset(1, position_um=(32_500.0, travel_um - 100))
    status, lines, _ = run_script(unseen, "POS 32500 100", "Y 1300", "WAIT", "Y -1300", "WAIT", "POS")
    assert emergencies(lines) == []
    assert "READY   X 32500 Y 1400 um" in lines
    # the MJCF's stop is 1 mm behind the travel: of the way there the last 200 um were lost, of the way back none
    assert unseen.place_um == (32_500.0, travel_um + 1000 - 1300)
    assert status == 0
    noticed = Rig(machine, seed=1, resolution="fast")
    noticed.plant.reset(1, position_um=(32_500.0, travel_um - 100))
    lines = run_script(noticed, "POS 32500 100", "Y 1300", "WAIT").lines
    assert emergencies(lines)[0].startswith("EMERGENCY: Y END SWITCH; NOTHING MOVES UNTIL INIT   X 32500 Y 204 um")


# T-46, T-47: wire break
def test_a_wire_break_stops_all_and_the_cut_goes_on_with_a_new_wire(machine):
    rig = Rig(machine.with_(tension=0.98 * machine.breaking_force), seed=1, resolution="fast")
    cut = (SET, "NEW 32900 32500", "START", "WAIT")
    lines = run_script(rig, *cut, "INIT", SET, "START", "GO", "WIRE", SET, "STATUS", "GO", "WAIT 2").lines
    broken = emergencies(lines)[0]
    assert broken.startswith("EMERGENCY: WIRE BREAK ")
    place = re.search(r"X \d+ Y \d+", broken).group()
    assert lines.count("? the wire is broken; WIRE threads a new one") == 2
    assert f"NEW WIRE   {place} um" in lines
    before = float(re.search(r"TIME (\S+) s", "\n".join(lines)).group(1))
    assert before >= machine.base.table.threading_s.value


# T-46, T-49: a sensor that never tells
def test_with_a_stuck_wire_sensor_the_cut_goes_on_in_the_open_until_its_end(machine):
    hot = machine.with_(tension=0.98 * machine.breaking_force)
    rig = stuck(hot, "stuck-wire-sensor")
    cut = (SET, "NEW 32900 32500", "START", "WAIT")
    after = ("STATUS", "GEN ON", "WAIT 1", "STATUS", "GEN OFF", "WIRE", "X -400", "WAIT", "WIRE", "WIRE")
    lines = run_script(rig, *cut, *after).lines
    assert emergencies(lines) == []
    assert "READY   X 32900 Y 32500 um" in lines
    assert "? the wire's place is inside the workpiece; jog back first" in lines
    (gap,) = re.findall(r"GENERATOR ON   GAP (\d+) V (\S+) A", "\n".join(lines))
    assert int(gap[0]) == 0.3 * machine.generator.open_voltage_V.value  # 30 of every 100 us, all of them open
    assert float(gap[1]) == 0.0
    assert lines.count("NEW WIRE   X 32500 Y 32500 um") == 1
    assert "? the wire is whole" in lines


@pytest.mark.slow
def test_a_wire_pressed_into_the_workpiece_breaks_and_can_be_brought_out(rig):
    status, lines, _ = run_script(rig, "X 1200", "WAIT", "INIT", "WIRE", "X -1200", "WAIT", "WIRE", "X 20", "WAIT")
    assert emergencies(lines)[0].startswith("EMERGENCY: THE WIRE WAS PRESSED AGAINST THE WORKPIECE AND BROKE")
    assert lines[-2].startswith("READY") or "READY" in lines[-3]
    refused = [line for line in lines if line.startswith("? ")]
    assert (status, refused) == (REFUSED, ["? the wire's place is inside the workpiece; jog back first"])


def test_a_short_that_stays_stops_the_machine(machine):
    rig = Rig(machine, seed=1, resolution="fast")
    lines = run_script(rig, "X 36", "WAIT", "TI 06H TP FFH", "NEW 33000 32500", "START", "WAIT 60").lines
    assert emergencies(lines)[0].startswith("EMERGENCY: PERSISTENT SHORT")


# T-44: windows not read in time
@pytest.mark.slow
def test_windows_that_come_faster_than_the_program_are_missed_and_counted(rig):
    cut = "TI 06H TP 6", "NEW 33000 32500", "START", "WAIT 1", "STATUS"
    lines = run_script(rig, *cut, SET, "WAIT 1", "STATUS").lines
    (read, missed), (read_later, missed_later) = (
        map(int, found) for found in re.findall(r"WINDOWS (\d+), MISSED (\d+)", "\n".join(lines))
    )
    assert missed > read > 50  # the routine takes several windows of 1.5 ms
    assert read + missed == pytest.approx(1 / (255 * rig.board.settings.times_us(6, 10)[1] * 1e-6), rel=0.05)
    assert missed_later - missed <= 1  # at 25 ms it keeps up
    assert read_later > read


# T-29: noise on the serial lines above 1.5 A
def test_serial_noise_disturbs_what_is_typed_while_the_current_is_high(machine):
    def type_in_a_short(faults):
        rig = Rig(machine, seed=1, resolution="fast", faults=faults)
        return run_script(rig, "X 100", "WAIT", SET, "GEN ON", "WAIT 0", "STATUS", "GEN OFF", "POS").lines

    clean = type_in_a_short(Faults())
    assert not [line for line in clean if line.startswith("?")]
    (current,) = re.findall(r"V (\S+) A", "\n".join(clean))
    assert float(current) > 1.5
    noisy = type_in_a_short(Faults(noise=SerialNoise(1, chance=0.5)))
    same = [a == b for a, b in zip(clean, noisy, strict=False)]
    assert all(same[:9])  # as long as there is no current
    assert not all(same)


# T-30: the generator drops out at low V(t(p))
@pytest.mark.slow
def test_a_generator_that_drops_out_stops_the_cut(machine):
    rig = Rig(machine, seed=1, resolution="fast", faults=Faults(drop_out=DropOut(1)))
    cut = ("TI 10 TP 60", "NEW 32900 32500", "START", "WAIT")
    lines = run_script(rig, *cut, "STATUS", SET, "GO", "WAIT 1", "STATUS").lines
    (message,) = [line for line in lines if line.startswith("NO PULSES")]
    assert message.startswith("NO PULSES COME: THE GENERATOR DROPPED OUT AT LOW V(t(p)); STOPPED   X 325")
    generator = [line for line in lines if line.startswith("GENERATOR")]
    assert [line.split()[1] for line in generator] == ["OFF", "ON"]


# T-27: voltage stays on the wire
def test_voltage_stays_on_the_wire_after_a_stop(rig):
    lines = run_script(rig, SET, "GEN ON", "WAIT 1", "GEN OFF", "STATUS", "WAIT 5", "STATUS").lines
    first, later = (int(v) for v in re.findall(r"GENERATOR OFF   GAP (\d+) V", "\n".join(lines)))
    assert first == edmsim.Machine.load().generator.open_voltage_V.value
    assert 0 < later < first / 2
