"""The EANPOS' commands of one sample go by their priority; functions under PLCopen's names."""

from __future__ import annotations

import pytest

from edmsim.controllers.axis.eanpos.registers import COMMANDS
from tests.controllers.axis.eanpos_bench import Positioner, moving, refused


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
