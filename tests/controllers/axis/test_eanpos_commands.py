"""The EANPOS' 22 commands: conditions, order of priority, warnings, and what each does to the axis."""

import pytest

from edmsim.controllers.axis.eanpos.registers import COMMANDS
from edmsim.errors import InputError
from tests.controllers.axis.eanpos_bench import Positioner, moving, refused

MOTIONS = ("START", "STOP", "PRESET", "MANFW", "MANBW")


def test_nothing_but_init_and_resets_before_init():  # Q-8, Q-58
    p = Positioner(ready=False)
    p.sample()
    assert p.on == {"st_still"}
    for command in COMMANDS:
        if command != "INIT":
            assert refused(p, command) != command.startswith("RS")
    p.push()
    assert p.true_um > 10.0
    assert p["posit"] == p["encoder"] == p["vel"] == p.device.output_V == 0
    p.do("INIT")
    assert (p["st_init"], p["posit"]) == (1, 0)
    assert refused(p, "INIT")  # Q-8: st_init = 0


def test_a_refused_command_does_nothing_but_warn():  # Q-23
    p = Positioner()
    before = p.device.record["reg"][0, :41].copy()
    p.do("STOP")
    assert (p.warning, p["wrnvalue"]) == (1, 5)
    p.do("RSWRN")
    assert p.warning == 0
    assert (p.device.record["reg"][0, :41] == before).all()
    with pytest.raises(InputError, match="no command 'GO'; it has INIT"):
        p.do("GO")


def test_emergency_stops_without_a_ramp_and_locks_the_axis_until_resume():
    # Q-9, Q-10, Q-62, Q-A2, Q-A16, Q-A17, Q-A25
    p = moving(offset=200)
    p.do("EMRG")
    assert p.on >= {"st_emrg", "st_still", "st_loopon"}
    assert p.device.output_V == 0.0
    assert p.bench.axis()["speed_um_s"] > 100.0  # the axis coasts
    place = p["posit"]
    p.run(0.5)
    assert p["posit"] > place
    assert p.bench.axis()["speed_um_s"] == pytest.approx(0.0, abs=0.1)
    assert all(refused(p, command) for command in MOTIONS)  # Q-A3
    p["offset"] = 0
    p.do("RESUME")
    place = p.true_um
    assert (p["st_loopon"], p["st_emrg"]) == (1, 0)
    p.run(1.0)
    assert (p.true_um, p["st_still"]) == (pytest.approx(place, abs=1.0), True)
    assert refused(p, "RESUME")
    p.do("START")
    p.until("st_still")
    assert p["posit"] == pytest.approx(2000, abs=5)


@pytest.mark.parametrize("loop", [True, False])
def test_reaction_and_motion_by_loop_and_emergency(loop):  # Q-10, Q-14, Q-A16
    p = Positioner(maxfollerr=1)
    p.do("LOOPON" if loop else "LOOPOFF")
    p.slip(400)
    assert (abs(p.device.output_V) > 0.1) == loop
    assert not refused(p, "START")
    p = Positioner()
    p.do("LOOPON" if loop else "LOOPOFF")
    p.do("EMRG")
    p.slip(400)
    assert p.device.output_V == 0.0  # no reaction in emergency
    assert refused(p, "START")
    p.do("RESUME")
    assert p["st_loopon"] == loop
    p.slip(400)
    assert (abs(p.device.output_V) > 0.1) == loop


def test_start_needs_a_still_axis_that_may_move():  # Q-11, Q-A3
    p = moving()
    assert refused(p, "START")
    p.until("st_still")
    assert p.theory[0] == 2000.0  # a warning does not stop the axis: Q-61
    for hinders, ends in (("REGOFF", "REGON"), ("CALON", "CALOFF")):
        p.do(hinders)
        assert refused(p, "START")
        assert refused(p, "MANFW")
        p.do(ends)
    assert not refused(p, "START")


def test_speeds_are_no_condition_but_without_one_the_axis_waits_under_way():  # Q-11, Q-42, 1.7.2
    for changes in ({"setvel": 0}, {"maxvel": 0}, {"maxvel": 3}, {"prsvel": 0, "sprsvel": 0}):  # 3: 0.05 um/s at 10 V
        for command in ("START", "MANFW", "MANBW", "PRESET"):
            assert not refused(Positioner(**changes), command)
    for command in ("START", "MANFW"):
        p = Positioner(setvel=0)
        p.do(command, run_s=2.0)
        assert (p["st_still"], p.true_um) == (0, 0.0)
        p["setvel"] = 50000
        p.run(1.5)
        assert p.true_um > 500.0
        p["setvel"] = 0  # and it stops on its ramp, and waits
        p.run(2.0)
        place = p.true_um
        p.run(1.0)
        assert (p["st_still"], p.true_um) == (0, pytest.approx(place, abs=0.5))


def test_loopoff_keeps_the_motion_without_the_loop():  # Q-13
    p = moving(pgain=200, gain_error=-0.03)
    assert p["propreg"] > 0
    p.do("LOOPOFF")
    assert (p["st_loopon"], p["st_still"], p["propreg"]) == (0, 0, 0)
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
    p.until("st_still", run_s=1.0)
    assert p["posit"] == pytest.approx(2000, abs=1)
    p.do("LOOPOFF")
    p.slip(2000)  # pushed by 500 Um
    p.do("LOOPON")
    assert (p["follerr"], p.device.output_V) == (0, 0.0)
    jog = Positioner(maxpos=1000, pgain=50)  # Q-77: a jog keeps its limit
    jog.do("LOOPOFF")
    jog.do("MANFW", run_s=0.5)
    jog.slip(-200)
    jog.do("LOOPON")
    jog.until("st_still")
    assert jog.theory[0] == 1000.0


def test_cntlock_loses_what_the_axis_moves_and_cntrev_turns_later_counts_about():  # Q-15, Q-16, Q-78
    p = Positioner()
    p.do("LOOPOFF")
    p.do("CNTLOCK")
    p.push()
    moved = p.true_um
    assert moved > 100.0
    assert (p["posit"], p["st_cntlock"]) == (0, 1)
    p.do("CNTUNLOCK", run_s=0.1)
    assert (p["posit"], p.true_um) == (0, pytest.approx(moved))
    p.do("CNTLOCK", "CNTUNLOCK")
    assert not p["st_cntlock"]
    for command, place in ((None, 100), ("CNTREV", 0), ("CNTDIR", 100)):
        if command:
            before = p["posit"]
            p.do(command)
            assert (p["posit"], p["st_cntrev"]) == (before, command == "CNTREV")
        p.slip(400)
        assert p["posit"] == place


def test_a_wrong_sign_runs_away_until_cntrev():  # Q-16, Q-A14
    p = Positioner(pgain=100, maxfollerr=1000)
    p.bench.swap_phases("x")
    p.do("START")
    p.until("st_foller")
    p.do("EMRG", run_s=0.5)
    p.do("CNTREV", "RESUME")
    p["posit"] = 0
    p.run(1.0)
    assert p.move() == pytest.approx(2.9, abs=0.01)
    assert p["posit"] == pytest.approx(2000, abs=5)


def test_calibration_makes_the_output_a_source():  # Q-18, Q-37, Q-66, Q-A29
    p = moving()
    p.do("CALON")
    assert p.on >= {"st_still", "st_cal"}
    assert p.device.output_V == 0.0
    p["vout"] = 15
    p.sample()
    assert p.device.output_V == pytest.approx(1.5, abs=2e-4)
    p.run(1.0)
    assert (p["vel"], p["frq"]) == (pytest.approx(15000, rel=0.01), pytest.approx(250, abs=3))
    assert refused(p, "START")
    p.do("CALOFF")
    assert (p["st_cal"], p["vout"]) == (0, 0)
    assert refused(p, "CALOFF")
    p["vout"] = 5
    p.sample()
    assert (p["vout"], p.warning) == (0, 2)  # st_cal = 1


@pytest.mark.parametrize(("command", "back", "limit"), [("MANFW", "MANBW", 300), ("MANBW", "MANFW", -300)])
def test_jog_stops_at_the_limit_on_its_ramp(command, back, limit):  # Q-19, Q-77
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
    p["posit"] = round(1.034 * limit)
    p.sample()
    assert not refused(p, command)
    assert p["st_still"]  # beyond the limit it does not move
    p.do(back)
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
    assert (p.theory[0], p["st_toll"]) == (500.0, 0)


def test_regoff_keeps_the_voltage_and_refuses_motion():  # Q-20
    p = Positioner(offset=300)
    p.sample()
    held = p.device.output_V
    assert held == pytest.approx(300 * 20 / 65536, abs=0.01)
    p.do("REGOFF")
    p["offset"] = 0
    p.slip(4000)
    assert (p.device.output_V, p["st_regoff"]) == (held, 1)
    assert all(refused(p, command) for command in MOTIONS)
    p.do("REGON")
    assert not p["st_regoff"]
    assert abs(p["follerr"]) < 10
    assert refused(p, "REGON")
    p.do("START")
    assert refused(p, "REGOFF")


def test_an_emergency_after_regoff_leaves_the_converter_alone():
    # Q-9 "output 0 V" and Q-20 "DAC not updated, keeps last voltage" disagree: another device may own the converter
    p = Positioner(offset=300)
    p.sample()
    held = p.device.output_V
    p.do("REGOFF", "EMRG")
    p.sample()
    assert (p.device.output_V, p["st_emrg"]) == (held, 1)
    p.do("REGON")
    p.sample()
    assert (p.device.output_V, p["st_emrg"]) == (0.0, 1)


def test_delcnt_keeps_the_fraction_and_posit_drops_it():  # Q-21, Q-54, Q-A10
    for by_command, place in ((True, 6), (False, 5)):
        p = Positioner(measure=23, pulse=100)
        p.do("LOOPOFF")
        p.slip(10)  # 2.3 units
        assert p["posit"] == 2
        if by_command:
            p["delta"] = 3
            p.do("DELCNT")
        else:
            p["posit"] = p["posit"] + 3
        assert p["posit"] == 5
        p.slip(4)  # 0.92 more: 6.22, or 5.92
        assert p["posit"] == place


def test_delcnt_in_motion_unless_it_would_turn_about_or_could_not_end_at_its_target():  # Q-21, Q-A4, Q-A24
    p = moving()
    p["delta"] = 1500
    assert refused(p, "DELCNT")
    p["delta"] = -500
    before = p["posit"]
    assert not refused(p, "DELCNT")
    assert p["posit"] < before
    p.until("st_still", run_s=5.0)
    assert p.true_um == pytest.approx(2500, abs=6)
    for at_s, delta in ((2.6, -10), (0.25, 1700)):  # slowing down; 269 um left, and 178 + 208 still needed
        q = Positioner(ramptype=1)
        q.do("START")
        q.run(at_s)
        q["delta"] = delta
        assert q["st_dec"] == (at_s > 2)
        assert refused(q, "DELCNT")
        q.until("st_still")
        assert q.theory[0] == 2000.0


@pytest.mark.parametrize(("read_between", "place"), [(True, 43), (False, 40)])
def test_delcnt_twice_in_a_sample_counts_once(read_between, place):  # Q-60
    p = Positioner()
    p["delta"] = 3
    p.device.command("DELCNT")
    if read_between:
        p.sample()
    p["delta"] = 40
    p.device.command("DELCNT")
    p.sample()
    assert p["posit"] == place


def test_resets_need_no_condition():  # Q-22, Q-61
    p = Positioner(ready=False, measure=1, pulse=999999)
    p.do("INIT")
    assert p.error == 4  # Q-A1, Q-A36
    p["measure"], p["pulse"] = 10000, 40000
    p.sample()
    assert p.error == 4
    assert refused(p, "START")
    p.do("RSERR", "RSWRN")
    assert (p.error, p.warning, p["errcode"], p["wrncode"]) == (0, 0, 0, 0)
    p.do("START")
    assert not p["st_still"]


def test_an_error_stops_the_axis_on_its_ramp():  # Q-61
    p = moving(resources=(True, False, False, True))
    p.do("PRESET")
    assert (p.error, p["st_dec"], p["st_still"]) == (5, 1, 0)  # Q-76
    p.until("st_still")
    assert p["posit"] == pytest.approx(833, abs=10)
    p.do("RSERR")
    assert not refused(p, "START")


@pytest.mark.parametrize("backwards", [False, True], ids=["as listed", "sent the other way round"])
@pytest.mark.parametrize(("before", "commands", "on", "off", "warned"), [
    ("", "EMRG START", {"st_emrg", "st_still"}, set(), "START"),
    ("EMRG", "RESUME START", set(), {"st_emrg", "st_still"}, None), ("", "START STOP", {"st_still"}, set(), None),
    ("", "START MANFW", set(), {"st_still"}, "MANFW"), ("", "MANFW MANBW", set(), {"st_still", "st_movdir"}, "MANBW"),
    ("", "LOOPON LOOPOFF", set(), {"st_loopon"}, None), ("", "CNTLOCK CNTUNLOCK", set(), {"st_cntlock"}, None),
    ("", "CNTREV CNTDIR", set(), {"st_cntrev"}, None), ("", "CALON CALOFF", set(), {"st_cal"}, None),
    ("", "START REGOFF", set(), {"st_still", "st_regoff"}, "REGOFF"),
    ("REGOFF", "REGON START", {"st_still"}, {"st_regoff"}, "START"), ("", "REGOFF REGON", set(), {"st_regoff"}, None),
    ("", "PRESET MANFW", {"st_prson"}, {"st_still"}, "MANFW"), ("CALON", "CALOFF DELCNT", set(), {"st_cal"}, None),
    ("", "STOP RSWRN", {"st_still"}, {"st_warning"}, None),
])  # fmt: skip
def test_commands_of_one_sample_go_by_priority(before, commands, on, off, warned, backwards):  # Q-59
    p = Positioner()
    if before:
        p.do(before)
    p.do(*commands.split()[:: -1 if backwards else 1])
    assert on <= p.on
    assert not off & p.on
    assert (p["wrnvalue"] if p["st_warning"] else 0) == (COMMANDS.index(warned) + 1 if warned else 0)


def test_init_comes_before_start_and_emergency_before_resume():  # Q-59
    p = Positioner(ready=False)
    p.do("START", "INIT")
    assert (p["st_init"], p["st_still"], p.warning) == (1, 0, 0)
    q = moving()
    q.do("RESUME", "EMRG")
    assert (q["st_still"], q["st_emrg"], q.warning) == (1, 0, 0)


def test_a_command_that_is_fulfilled_already_warns_unless_set_otherwise():  # Q-A20
    p = Positioner()
    for fine in (0, 1):
        p.device.settings["already_so_is_fine"] = fine
        assert [refused(p, command) for command in ("RESUME", "REGON")] == [not fine] * 2


def test_names_of_plcopen():
    """Beyond the manual: PLCopen's functions by name."""
    p = Positioner()
    p.device.move_absolute(500, 100000)
    p.sample()
    p.device.move_absolute(900, 50000)
    p.until("st_still")
    assert (p.theory[0], p["setvel"]) == (900.0, 50000)
    p.device.move_velocity(50000, forward=False)
    p.run(0.5)
    assert p["st_movdir"]
    p.device.halt()
    p.until("st_still")
    p.device.set_position(0)
    p.device.stop()
    p.sample()
    assert (p["st_emrg"], p["posit"]) == (1, 0)
    p.device.power()
    p.sample()
    assert (p["st_emrg"], p["st_loopon"]) == (0, 1)
    p.device.power(on=False)
    p.device.home()
    p.sample()
    assert (p["st_prson"], p["st_loopon"]) == (1, 0)
    p.device.reset()
    p.sample()
    assert p.warning == 0
