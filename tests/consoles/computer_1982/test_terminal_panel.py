"""The front panel, the trims, the couplers and the wire's tension, in the running machine."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edmsim.consoles.computer_1982.operation import FIELDS, KEYS, TYPED, read_keys, typed_keys
from edmsim.consoles.computer_1982.rig import UNKNOWN_CAUSE, Rig, lay_out
from edmsim.consoles.computer_1982.words import Move, Setting
from edmsim.controllers.mcu.board import Faults, Optocouplers, SerialNoise
from edmsim.controllers.mcu.chips import pic
from edmsim.controllers.mcu.chips.dac import Dac
from edmsim.controllers.mcu.chips.display import SCAN_NS, SHIFT, Kdc8279

PAGE = (Path(__file__).parents[3] / "docs" / "terminal.md").read_text(encoding="utf-8")
SET = "TI 30 TP 100"


def shown(rig, field):
    first, count = FIELDS[field]
    return "".join(str(d) if d <= 9 else " " for d in rig.board.display.digits[first : first + count])


def cutting(rig, t_i_us, t_p_us, distance_um=1000):
    """Start a cut in +x and return the rig's windows as they come."""
    settings = rig.board.settings
    rig.set(Setting(settings.code_of_t_i(t_i_us), settings.code_of_t_p(t_p_us)))
    x, y = rig.computer.position
    rig.begin_cut(lay_out((x, y), [Move((x + distance_um, y))]))
    while rig.moving:
        rig.advance()
        yield rig.plant.window()


# T-28, T-45: keys are scanned in the running machine, obeyed by KBD's interrupt, and shown
def test_keys_set_up_and_run_a_cut_and_the_digits_show_it(operate, rig):
    served, acknowledge = [], rig.board.interrupts.acknowledge

    def note():
        entry = acknowledge()
        served.append((entry - pic.JUMP_TABLE) // pic.ENTRY_BYTES)
        return entry

    rig.board.interrupts.acknowledge = note
    shown_digits = []
    advance = rig.advance

    def watch():
        advance()
        shown_digits.append((shown(rig, "x"), shown(rig, "speed"), shown(rig, "entry")))

    rig.advance = watch
    session = operate(
        "KEY 1000 SHIFT X 2000 SHIFT Y", "KEY 100 T(P) 30 T(I) 110 SPEED 1080 X START", "KEY 42", "STATUS", "WAIT",
        "WAIT 1",
    )
    assert not session.refusals
    assert session.after("STATUS").startswith("CUTTING   POSITION X 10")
    assert session.after("STATUS").endswith(" Y 2000 um   NEW 1080 2000")
    assert "READY   X 1080 Y 2000 um" in session.lines
    assert "t(i) 30 us (99H)   t(p) 100 us (AAH)" in session.lines
    assert any("OF 110 UNITS" in line for line in session.lines)
    assert pic.KEYBOARD in served  # 4 and 2, while timers and interrupts are on
    assert pic.X_STEPPER in served
    assert {"   30", "  110", "   42"} <= {entry for _, _, entry in shown_digits}
    assert {" 1000", " 1080"} <= {x for x, _, _ in shown_digits}
    assert any(speed.strip() not in ("", "0") for _, speed, _ in shown_digits)


@pytest.mark.parametrize(("keys", "place", "state"), [
    ("40 X-", (-40, 0), "READY"), ("X+", (2, 0), "READY"), ("30 Y+", (0, 30), "READY"),
    ("SHIFT 5 Y-", (0, -2), "? key 5 has no meaning"), ("500 X- STOP", (None, 0), "STOPPED"),
    ("12 CLEAR 6 Y-", (0, -6), "READY"), ("100 T(P) 30 T(I) 32540 X START STOP GO", (40, 0), "READY"),
    ("100 T(P) 30 T(I) INIT GO", (0, 0), "? no cut was stopped"), ("GO", (0, 0), "? no cut was stopped"),
])  # fmt: skip
def test_every_key_does_what_the_page_says(operate, keys, place, state):  # T-28
    session = operate(f"KEY {keys}", "WAIT")
    x, y = (at - 32_500 for at in session.rig.place_um)
    assert y == place[1]
    assert -40 <= x < 0 if place[0] is None else x == place[0]
    assert any(line.startswith(state) for line in session.lines)


def test_the_page_has_every_key_and_its_letter():  # T-28
    table = re.findall(r"^\| (\S.*?) \| (\S.*?) \| .* \|$", PAGE.split("## The front panel")[1], re.MULTILINE)[1:]
    names = {name for cell, _ in table for name in cell.split(", ")}
    assert names == {*KEYS, "0 to 9", "SHIFT X", "SHIFT Y"}
    assert sorted(set(TYPED.values())) == sorted([*range(10), *KEYS.values(), KEYS["X"] | SHIFT, KEYS["Y"] | SHIFT])
    letters = {"Enter": "\r", "space": " "}
    for cell, typed in table[1:-1]:
        keys = [KEYS[n.removeprefix("SHIFT ")] | SHIFT * n.startswith("SHIFT ") for n in cell.split(", ")]
        assert typed_keys("".join(letters.get(t, t) for t in typed.split(", ")).encode()) == keys


def test_a_held_key_counts_once_and_a_brief_touch_does_not(rig):  # T-28
    scans = []
    scan = rig.board.display.scan
    rig.board.display.scan = lambda closed, *lines: scans.append((closed, scan(closed, *lines)))
    assert typed_keys(b"\x1b[Cq7") == [KEYS["X+"], 7]
    from edmsim.consoles.computer_1982.operation import Operation

    operation = Operation(rig)
    operation.press(read_keys("7 7"))
    while operation.presses.busy:
        operation.advance()
    assert sum(accepted for _, accepted in scans) == 2
    assert shown(rig, "entry") == "   77"
    assert rig.time_ns >= 200_000_000


# T-28: "several" equal scans are three, at the chip and for an operator's finger in the running machine
@pytest.mark.parametrize(("scans", "counts"), [(1, False), (2, False), (3, True), (4, True)])
def test_a_key_needs_three_scans(operate, rig, monkeypatch, scans, counts):
    chip = Kdc8279()
    for _ in range(scans):
        chip.scan(frozenset([KEYS["X-"]]))
    chip.scan(frozenset())
    assert chip.waiting == counts
    monkeypatch.setattr("edmsim.consoles.computer_1982.operation.HELD_NS", scans * SCAN_NS)
    session = operate("KEY 6 X-", "WAIT")
    assert session.rig.place_um == ((32_500 - 6 if counts else 32_500), 32_500)
    assert session.lines.count("READY   X 32494 Y 32500 um") == counts


def test_status_shows_where_the_machine_cuts_to_by_word_and_by_key(operate):
    typed, keyed = "NEW 32530 32500", "KEY 32500 X 32540 Y START"
    stopped = "STOP", "STATUS", "GO", "WAIT 0", "STATUS"
    session = operate(SET, typed, "START", "WAIT", keyed, "WAIT 1", "STATUS", *stopped)
    shown = [line.split(" um   ")[1] for line in session.lines if " POSITION X " in line]
    assert shown == ["NEW 32500 32540", "NEW 32530 32500", "NEW 32500 32540"]  # stopped, where START would


# T-29: sparks of a usual job in 25 mm draw more than 1.5 A now and then, and that disturbs the serial lines
@pytest.mark.slow
def test_noise_comes_with_the_current_of_a_usual_job(machine):
    noise = SerialNoise(1, chance=0.5)
    rig = Rig(machine.with_(height_mm=25.0), seed=1, resolution="fast", faults=Faults(noise=noise))
    current, sparks, disturbed = [], [], []
    for window in cutting(rig, 30, 100, 600):
        before = noise.disturbed
        for _ in range(20):
            rig.board.receive(ord("A"))
        current.append(window.mean_current_A)
        sparks.append(window.spark + window.arc)
        disturbed.append(noise.disturbed - before)
    # with its last window the cut has ended, and the noise with it
    current, sparks, disturbed = np.array(current[:-1]), np.array(sparks[:-1]), np.array(disturbed[:-1])
    loud = current > 1.5
    assert 0.005 < loud.mean() < 0.3
    assert sparks[loud].mean() > 128  # not a short circuit's current
    assert current.max() < 2.5
    assert np.all(disturbed[~loud] == 0)
    assert np.all(disturbed[loud] > 0)


def test_a_trim_that_is_turned_changes_the_pulses_of_the_machine(operate, rig):  # T-33
    rig.board.settings = replace(rig.board.settings, t_i=Dac(5.0, gain=1.1), t_p=Dac(15.0, offset_V=0.5))
    session = operate("TI 66H TP AAH", "GEN ON", "WAIT 1", "STATUS")
    assert "t(i) 22 us (66H)   t(p) 105 us (AAH)" in session.lines
    assert (rig.plant.machine.t_on_us, rig.plant.machine.t_period_us) == (22.0, 105.0)


@pytest.mark.slow
def test_the_longest_pulses_can_be_set_and_fired(operate, rig):  # T-1, T-2, T-32, T-42, T-A15
    session = operate("TI 1000 TP 10000", "GEN ON", "WAIT 5", "STATUS", "TI 1 TP 2", "TI 1 TP 5", "WAIT 1")
    assert "t(i) 1000 us (1FFH)   t(p) 10000 us (1FFH)" in session.lines
    assert session.refusals == [
        "? t(i) 1.176 us in t(p) 2 us draws 3.89 A, above the generator's 2 A: t(p) must be at least 5 us"
    ]
    assert rig.time_ns >= 2 * 2_550_000_000
    assert (rig.plant.machine.t_on_us, rig.plant.machine.t_period_us) == pytest.approx((1.18, 5.29), abs=0.3)


# T-84: without couplers that are slower than the sparks' impulses, the first spark is an emergency
def test_couplers_keep_the_sparks_out_of_the_control(machine):
    rigs = [Rig(machine, seed=1, resolution="fast") for _ in range(2)]
    rigs[1].board.couplers = Optocouplers(response_ns=500)
    for rig in rigs:
        for _ in cutting(rig, 30, 100, 60):
            pass
    assert [rig.in_emergency for rig in rigs] == [False, True]
    assert (rigs[0].computer.position[0], rigs[1].cause) == (32_560, UNKNOWN_CAUSE)


# T-85: a spare output halves the wire's tension, and the wire bows twice as far
@pytest.mark.slow
def test_a_spare_line_lowers_the_wires_tension(operate, machine):
    rig = operate("TENSION LOW", "WAIT 1").rig
    assert rig.plant.machine.tension == pytest.approx(machine.tension / 2)
    rig.advance()  # INIT, at the end of the session, gives it back
    assert rig.plant.machine.tension == machine.tension
    bows = []
    for low in (False, True):
        rig = Rig(machine, seed=1, resolution="fast")
        rig.board.bus.write(0x4023, 7 << 1 | low)
        bows.append(np.mean([window.deflection_um[0] for window in cutting(rig, 30, 100, 300)][200:]))
        assert rig.plant.machine.tension == pytest.approx(machine.tension * (0.5 if low else 1.0))
    assert 1.5 < bows[1] / bows[0] < 2.5
