"""The EANPOS' 22 commands: conditions, order of priority, warnings, and what each does to the axis."""

from __future__ import annotations

import pytest

from edmsim.controllers.axis.eanpos.registers import COMMANDS
from edmsim.errors import InputError
from tests.controllers.axis.eanpos_bench import Positioner, moving, refused


def test_nothing_but_init_and_resets_before_init():  # Q-8, Q-58
    p = Positioner(ready=False)
    p.sample()
    assert p.on == {"st_still"}
    for command in COMMANDS:
        if command != "INIT":
            assert refused(p, command) != command.startswith("RS")
    p.push()
    assert p.true_um > 10.0
    assert p["posit"] == p["encoder"] == p["vel"] == 0
    assert p.device.output_V == 0.0
    p.do("INIT")
    assert p["st_init"]
    assert p["posit"] == 0
    assert refused(p, "INIT")  # Q-8: st_init = 0


def test_a_refused_command_does_nothing_but_warn():  # Q-23
    p = Positioner()
    before = p.device.record["reg"][0, :45].copy()
    p.do("STOP")
    assert (p.warning, p["wrnvalue"]) == (1, 5)
    p.do("RSWRN")
    assert p.warning == 0
    assert (p.device.record["reg"][0, :41] == before[:41]).all()
    with pytest.raises(InputError, match="no command 'GO'; it has INIT"):
        p.do("GO")


def test_emergency_stops_without_a_ramp_and_locks_the_axis():  # Q-9, Q-A17, Q-A25
    p = moving(offset=200)
    p.do("EMRG")
    assert p.on >= {"st_emrg", "st_still", "st_loopon"}
    assert p.device.output_V == 0.0
    speed = p.bench.axis()["speed_um_s"]
    assert speed > 100.0  # the axis coasts
    place = p["posit"]
    p.run(0.5)
    assert p["posit"] > place
    assert p.bench.axis()["speed_um_s"] == pytest.approx(0.0, abs=0.1)
    for command in ("START", "STOP", "PRESET", "MANFW", "MANBW"):  # Q-A3
        assert refused(p, command)


def test_resume_closes_the_loop_and_stays():  # Q-10, Q-A2, Q-A16, Q-62
    p = moving()
    p.do("EMRG")
    p.run(0.5)
    p.do("RESUME")
    place = p.true_um
    assert p["st_loopon"]
    assert not p["st_emrg"]
    p.run(1.0)
    assert p.true_um == pytest.approx(place, abs=1.0)
    assert p["st_still"]
    assert refused(p, "RESUME")
    p.do("START")
    p.until("st_still")
    assert p["posit"] == pytest.approx(2000, abs=5)


@pytest.mark.parametrize(
    ("loop", "emergency", "resists", "moves"),
    [(True, False, True, True), (True, True, False, False), (False, False, False, True), (False, True, False, False)],
)
def test_reaction_and_motion_by_loop_and_emergency(loop, emergency, resists, moves):  # Q-14
    p = Positioner(maxfollerr=1)
    p.do("LOOPON" if loop else "LOOPOFF")
    if emergency:
        p.do("EMRG")
    p.slip(400)
    assert (abs(p.device.output_V) > 0.1) == resists
    assert refused(p, "START") != moves


@pytest.mark.parametrize("loop", [True, False])
def test_resume_gives_the_loop_back_if_it_was_on(loop):  # Q-10, Q-A16
    p = Positioner()
    p.do("LOOPON" if loop else "LOOPOFF")
    p.do("EMRG")
    p.slip(400)
    assert p.device.output_V == 0.0  # no reaction in emergency
    p.do("RESUME")
    assert p["st_loopon"] == loop
    p.slip(400)
    assert (abs(p.device.output_V) > 0.1) == loop


def test_start_needs_a_still_axis_that_may_move():  # Q-11, Q-A3
    p = moving()
    assert refused(p, "START")
    p.until("st_still")
    assert p.theory[0] == 2000.0  # a warning does not stop the axis: Q-61
    p.do("REGOFF")
    assert refused(p, "START")
    p.do("REGON")
    p.do("CALON")
    assert refused(p, "START")
    assert refused(p, "MANFW")
    p.do("CALOFF")
    assert not refused(p, "START")


@pytest.mark.parametrize("changes", [{"setvel": 0}, {"maxvel": 0}, {"maxvel": 3}, {"prsvel": 0, "sprsvel": 0}])
def test_speeds_are_no_condition_of_a_command(changes):  # Q-11, 1.7.2; maxvel 3 is 0.05 um/s at 10 V
    for command in ("START", "MANFW", "MANBW", "PRESET"):
        assert not refused(Positioner(**changes), command)


@pytest.mark.parametrize("command", ["START", "MANFW"])
def test_an_axis_without_a_speed_is_under_way_until_it_gets_one(command):  # Q-11, Q-42
    p = Positioner(setvel=0)
    p.do(command)
    p.run(2.0)
    assert not p["st_still"]
    assert p.true_um == 0.0
    p["setvel"] = 50000
    p.run(1.5)
    assert p.true_um > 500.0
    p["setvel"] = 0  # and it stops on its ramp, and waits
    p.run(2.0)
    place = p.true_um
    p.run(1.0)
    assert not p["st_still"]
    assert p.true_um == pytest.approx(place, abs=0.5)


def test_loopoff_keeps_the_motion_without_the_loop():  # Q-13
    p = moving(pgain=200, gain_error=-0.03)
    assert p["propreg"] > 0
    p.do("LOOPOFF")
    assert not p["st_loopon"]
    assert not p["st_still"]
    assert p["propreg"] == 0
    assert p.device.output_V == pytest.approx(5.0, abs=0.001)
    p.until("st_still")
    assert p.true_um < 1990.0


def test_loopon_neither_stops_nor_jumps():  # Q-13, Q-62
    p = moving(pgain=200)
    p.do("LOOPOFF")
    p.slip(400)
    assert p["follerr"] < -390
    p.do("LOOPON")
    assert abs(p["follerr"]) <= 30
    assert not p["st_still"]
    p.until("st_still")
    p.run(1.0)
    assert p["posit"] == pytest.approx(2000, abs=1)
    p.do("LOOPOFF")
    p.slip(2000)  # pushed by 500 Um
    p.do("LOOPON")
    assert p["follerr"] == 0
    assert p.device.output_V == 0.0


def test_cntlock_loses_what_the_axis_moves():  # Q-15, Q-78
    p = Positioner()
    p.do("LOOPOFF")
    p.do("CNTLOCK")
    p.push()
    moved = p.true_um
    assert moved > 100.0
    assert p["posit"] == 0
    assert p["st_cntlock"]
    p.do("CNTUNLOCK")
    p.run(0.1)
    assert p["posit"] == 0
    assert p.true_um == pytest.approx(moved)
    p.do("CNTLOCK", "CNTUNLOCK")
    assert not p["st_cntlock"]


def test_cntrev_turns_later_counts_about():  # Q-16, Q-78
    p = Positioner()
    p.do("LOOPOFF")
    p.slip(400)
    assert p["posit"] == 100
    p.do("CNTREV")
    assert p["posit"] == 100
    assert p["st_cntrev"]
    p.slip(400)
    assert p["posit"] == 0
    p.do("CNTDIR")
    p.slip(400)
    assert p["posit"] == 100


def test_a_wrong_sign_runs_away_until_cntrev():  # Q-16, Q-A14
    p = Positioner(pgain=100, maxfollerr=1000)
    p.bench.swap_phases("x")
    p.do("START")
    p.until("st_foller")
    p.do("EMRG")
    p.run(0.5)
    p.do("CNTREV", "RESUME")
    p["posit"] = 0
    p.run(1.0)
    assert p.move() == pytest.approx(2.9, abs=0.01)
    assert p["posit"] == pytest.approx(2000, abs=5)


def test_calibration_makes_the_output_a_source():  # Q-18, Q-37, Q-66, Q-A29
    p = moving()
    p.do("CALON")
    assert p["st_still"]
    assert p["st_cal"]
    assert p.device.output_V == 0.0
    p["vout"] = 15
    p.sample()
    assert p.device.output_V == pytest.approx(1.5, abs=2e-4)
    p.run(1.0)
    assert p["vel"] == pytest.approx(15000, rel=0.01)
    assert p["frq"] == pytest.approx(250, abs=3)
    assert refused(p, "START")
    p.do("CALOFF")
    assert not p["st_cal"]
    assert p["vout"] == 0
    assert refused(p, "CALOFF")
    p["vout"] = 5
    p.sample()
    assert (p["vout"], p.warning) == (0, 2)  # st_cal = 1


@pytest.mark.parametrize(("command", "limit"), [("MANFW", 300), ("MANBW", -300)])
def test_jog_stops_at_the_limit_on_its_ramp(command, limit):  # Q-19, Q-77
    p = Positioner(maxpos=300, minpos=-300, pgain=50)
    p.do(command)
    speeds = []
    while not p["st_still"]:
        speeds.append(p.theory[1])
        p.sample()
    assert p.theory == (limit, 0.0)
    assert speeds[-1] < 20.0
    p.run(1.0)
    assert p["posit"] == pytest.approx(limit, abs=1)
    p["posit"] = limit + 10 if limit > 0 else limit - 10
    p.sample()
    assert not refused(p, command)
    assert p["st_still"]  # beyond the limit it does not move
    p.do("MANBW" if limit > 0 else "MANFW")
    assert not p["st_still"]
    p.run(0.1)
    p.do("STOP")
    p.until("st_still")
    assert abs(p["posit"]) < 310


def test_a_placement_ends_at_the_software_limit():
    """The manual leaves open whether START is held there; here it is, and the axis is not in tolerance."""
    p = Positioner(maxpos=500)
    p["setpos"] = 2000
    p.move()
    assert p.theory[0] == 500.0
    assert not p["st_toll"]


def test_regoff_keeps_the_voltage_and_refuses_motion():  # Q-20
    p = Positioner(offset=300)
    p.sample()
    held = p.device.output_V
    assert held == pytest.approx(300 * 20 / 65536, abs=0.01)
    assert held != 0.0
    p.do("REGOFF")
    p["offset"] = 0
    p.slip(4000)
    assert p.device.output_V == held
    assert p["st_regoff"]
    for command in ("START", "STOP", "PRESET", "MANFW", "MANBW"):
        assert refused(p, command)
    p.do("REGON")
    assert not p["st_regoff"]
    assert abs(p["follerr"]) < 10
    assert refused(p, "REGON")
    p.do("START")
    assert refused(p, "REGOFF")


def test_delcnt_keeps_the_fraction_and_posit_drops_it():  # Q-21, Q-54, Q-A10
    p = Positioner(measure=23, pulse=100)
    p.do("LOOPOFF")
    p.slip(10)  # 2.3 units
    assert p["posit"] == 2
    p["delta"] = 3
    p.do("DELCNT")
    assert p["posit"] == 5
    p.slip(4)  # 0.92 more: 6.22
    assert p["posit"] == 6
    q = Positioner(measure=23, pulse=100)
    q.do("LOOPOFF")
    q.slip(10)
    q["posit"] = q["posit"] + 3
    q.slip(4)  # 5.00 + 0.92
    assert q["posit"] == 5


def test_delcnt_in_motion_unless_it_would_turn_about():  # Q-21, Q-A4, Q-A24
    p = moving()
    p["delta"] = 1500
    assert refused(p, "DELCNT")
    p["delta"] = -500
    before = p["posit"]
    assert not refused(p, "DELCNT")
    assert p["posit"] < before
    p.until("st_still")
    p.run(5.0)
    assert p.true_um == pytest.approx(2500, abs=6)
    q = Positioner(ramptype=1)
    q.do("START")
    q.run(2.6)
    q["delta"] = -10
    assert q["st_dec"]
    assert refused(q, "DELCNT")
    early = Positioner(ramptype=1)
    early.do("START")
    early.run(0.25)
    early["delta"] = 1700  # 269 um are left, and 178 + 208 still needed: it could not end at its target
    assert refused(early, "DELCNT")
    early.until("st_still")
    assert early.theory[0] == 2000.0


def test_delcnt_twice_in_a_sample_counts_once():  # Q-60
    def count(read_between):
        p = Positioner()
        p["delta"] = 3
        p.device.command("DELCNT")
        if read_between:
            p.sample()
        p["delta"] = 40
        p.device.command("DELCNT")
        p.sample()
        return p["posit"]

    assert (count(True), count(False)) == (43, 40)


def test_resets_need_no_condition():  # Q-22, Q-61
    p = Positioner(ready=False, measure=1, pulse=999999)
    p.do("INIT")
    assert p.error == 4  # Q-A1, Q-A36
    p["measure"], p["pulse"] = 10000, 40000
    p.sample()
    assert p.error == 4
    assert refused(p, "START")
    assert p["st_warning"]
    p.do("RSERR", "RSWRN")
    assert (p.error, p.warning, p["errcode"], p["wrncode"]) == (0, 0, 0, 0)
    p.do("START")
    assert not p["st_still"]


def test_an_error_stops_the_axis_on_its_ramp():  # Q-61
    p = moving(resources=(True, False, False, True))
    p.do("PRESET")
    assert p.error == 5  # Q-76
    assert p["st_dec"]
    assert not p["st_still"]
    p.until("st_still")
    assert p["posit"] == pytest.approx(833, abs=10)
    p.do("RSERR")
    assert not refused(p, "START")


def test_loopon_in_a_jog_keeps_its_limit():  # Q-62, Q-77
    p = Positioner(maxpos=1000, pgain=50)
    p.do("LOOPOFF")
    p.do("MANFW")
    p.run(0.5)
    p.slip(-200)
    p.do("LOOPON")
    p.until("st_still")
    assert p.theory[0] == 1000.0


def in_one_sample(p, *commands):
    for command in commands:
        p.device.command(command)
    p.sample()
    return p


@pytest.mark.parametrize("backwards", [False, True], ids=["as listed", "sent the other way round"])
@pytest.mark.parametrize(
    ("before", "commands", "on", "off", "warned"),
    [
        ((), ("EMRG", "START"), {"st_emrg", "st_still"}, set(), "START"),
        (("EMRG",), ("RESUME", "START"), set(), {"st_emrg", "st_still"}, None),
        ((), ("START", "STOP"), {"st_still"}, set(), None),
        ((), ("START", "MANFW"), set(), {"st_still"}, "MANFW"),
        ((), ("MANFW", "MANBW"), set(), {"st_still", "st_movdir"}, "MANBW"),
        ((), ("LOOPON", "LOOPOFF"), set(), {"st_loopon"}, None),
        ((), ("CNTLOCK", "CNTUNLOCK"), set(), {"st_cntlock"}, None),
        ((), ("CNTREV", "CNTDIR"), set(), {"st_cntrev"}, None),
        ((), ("CALON", "CALOFF"), set(), {"st_cal"}, None),
        ((), ("START", "REGOFF"), set(), {"st_still", "st_regoff"}, "REGOFF"),
        (("REGOFF",), ("REGON", "START"), {"st_still"}, {"st_regoff"}, "START"),
        ((), ("REGOFF", "REGON"), set(), {"st_regoff"}, None),
        ((), ("PRESET", "MANFW"), {"st_prson"}, {"st_still"}, "MANFW"),
        (("CALON",), ("CALOFF", "DELCNT"), set(), {"st_cal"}, None),
        ((), ("STOP", "RSWRN"), {"st_still"}, {"st_warning"}, None),
    ],
)
def test_commands_of_one_sample_go_by_priority(before, commands, on, off, warned, backwards):  # Q-59
    p = Positioner()
    if before:
        p.do(*before)
    in_one_sample(p, *(reversed(commands) if backwards else commands))
    assert on <= p.on
    assert not off & p.on
    assert (p["wrnvalue"] if p["st_warning"] else 0) == (COMMANDS.index(warned) + 1 if warned else 0)


def test_init_and_start_in_the_first_sample():  # Q-59
    p = in_one_sample(Positioner(ready=False), "START", "INIT")
    assert p["st_init"]
    assert not p["st_still"]
    assert p.warning == 0


def test_emergency_and_resume_break_a_move_off():  # Q-59
    p = in_one_sample(moving(), "RESUME", "EMRG")
    assert p["st_still"]
    assert not p["st_emrg"]
    assert p.warning == 0


def test_a_command_that_is_fulfilled_already_warns_unless_set_otherwise():  # Q-A20
    p = Positioner()
    assert refused(p, "RESUME")
    assert refused(p, "REGON")
    p.device.settings["already_so_is_fine"] = 1
    assert not refused(p, "RESUME")
    assert not refused(p, "REGON")


def test_names_of_plcopen():
    """Beyond the manual: PLCopen's functions by name."""
    p = Positioner()
    p.device.move_absolute(500, 100000)
    p.sample()
    p.device.move_absolute(900, 50000)
    p.until("st_still")
    assert p.theory[0] == 900.0
    assert p["setvel"] == 50000
    p.device.move_velocity(50000, forward=False)
    p.run(0.5)
    assert p["st_movdir"]
    p.device.halt()
    p.until("st_still")
    p.device.set_position(0)
    p.device.stop()
    p.sample()
    assert p["st_emrg"]
    assert p["posit"] == 0
    p.device.power()
    p.sample()
    assert not p["st_emrg"]
    assert p["st_loopon"]
    p.device.power(on=False)
    p.device.home()
    p.sample()
    assert p["st_prson"]
    assert not p["st_loopon"]
    p.device.reset()
    p.sample()
    assert p.warning == 0
