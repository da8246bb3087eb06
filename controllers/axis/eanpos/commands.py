"""The 22 commands of a QEM EANPOS: their conditions and effects.

The commands of a sample are executed in order of priority, each on the state that the previous one leaves (manual
1.7.2, row Q-59). If a command's conditions fail, it does nothing and raises warning 1 (row Q-23).
"""

from __future__ import annotations

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis.eanpos import registers as at
from edmsim.controllers.axis.eanpos.homing import give_up, preset
from edmsim.controllers.axis.eanpos.moves import catch_up, check_resolution, jog, place, shift, start, warn
from edmsim.controllers.axis.eanpos.profile import brake, break_off
from edmsim.controllers.axis.eanpos.registers import Reals, Words

_ZERO_AT_INIT = (
    at.VOUT, at.FFWDREG, at.PROPREG, at.INTEG, at.DERREG, at.DELTA, at.ERRCODE, at.ERRVALUE, at.WRNCODE, at.WRNVALUE,
    at.FOLLERR, at.VEL, at.FRQ, at.ST_WARNING, at.ST_ERROR,
)  # fmt: skip
_N_COMMANDS = len(at.COMMANDS)
_WITHOUT_CONDITION = (1 << at.RSERR) | (1 << at.RSWRN) | (1 << at.RSPRSOK)


@exactly_compiled
def _may_move(reg: Words) -> bool:
    """Say whether a move may start: not in emergency, calibration, a search or an error (rows Q-A3, Q-61)."""
    blocked = reg[at.ST_REGOFF] + reg[at.ST_EMRG] + reg[at.ST_CAL] + reg[at.ST_PRSON] + reg[at.ST_ERROR]
    return bool(blocked == 0 and reg[at.ST_STILL] == 1)


@exactly_compiled
def _may(reg: Words, command: int) -> bool:
    """Say whether an initialised device's state allows a command."""
    if command == at.RESUME:
        return bool(reg[at.ST_EMRG] == 1)
    if command in (at.START, at.MANFW, at.MANBW):
        return _may_move(reg)
    if command == at.STOP:
        return bool(reg[at.ST_REGOFF] == 0 and reg[at.ST_EMRG] == 0 and reg[at.ST_STILL] == 0)
    if command == at.PRESET:
        blocked = reg[at.ST_REGOFF] + reg[at.ST_EMRG] + reg[at.ST_CAL] + reg[at.ST_ERROR]
        repeats = reg[at.ST_PRSON] != 0 and reg[at.SINGLE_HOMING] != 0
        return bool(blocked == 0 and not repeats)
    if command == at.CALOFF:
        return bool(reg[at.ST_CAL] == 1)
    if command == at.REGOFF:
        return bool(reg[at.ST_STILL] == 1)
    if command == at.REGON:
        return bool(reg[at.ST_REGOFF] == 1)
    if command == at.DELCNT:
        return bool(reg[at.ST_CAL] == 0 and reg[at.ST_PRSON] == 0)
    return True


@exactly_compiled
def _stop_all(reg: Words, real: Reals) -> None:
    """Break off what moves, without a ramp, and any search."""
    break_off(reg, real)
    give_up(reg)
    real[at.INTEGRAL], reg[at.LAST_ERROR] = 0.0, 0
    real[at.THEORY] = place(reg)


@exactly_compiled
def _initialise(reg: Words, real: Reals) -> None:
    for register in _ZERO_AT_INIT:
        reg[register] = 0
    reg[at.ST_INIT], reg[at.WRITTEN] = 1, 0
    reg[at.NUMERATOR] = reg[at.POSIT] * reg[at.PULSE]
    real[at.THEORY], real[at.INTEGRAL] = float(reg[at.POSIT]), 0.0
    reg[at.HAS_TARGET], reg[at.SINCE_NS], reg[at.EXCEEDED] = 0, -1, 0
    reg[at.GATE_NS], reg[at.GATE_EDGES] = reg[at.NOW_NS], reg[at.ENCODER]
    check_resolution(reg, real)


@exactly_compiled
def _on_motion(reg: Words, real: Reals, command: int) -> None:
    if command == at.EMRG:
        reg[at.ST_EMRG] = 1
        _stop_all(reg, real)
    elif command == at.START:
        start(reg, real, reg[at.SETPOS])
    elif command == at.STOP:
        brake(reg, real)
        give_up(reg)
    elif command == at.PRESET:
        preset(reg, real)
    elif command in (at.MANFW, at.MANBW):
        jog(reg, real, 1 if command == at.MANFW else -1)
    elif command == at.DELCNT and not shift(reg, real, reg[at.NUMERATOR] + reg[at.DELTA] * reg[at.PULSE], False):
        warn(reg, at.NOT_EXECUTED, at.DELCNT + 1)


@exactly_compiled
def _on_output(reg: Words, real: Reals, command: int) -> None:
    if command == at.RESUME:
        reg[at.ST_EMRG] = 0
        catch_up(reg, real)
    elif command == at.LOOPON:
        reg[at.ST_LOOPON] = 1
        catch_up(reg, real)
    elif command == at.LOOPOFF:
        reg[at.ST_LOOPON] = 0
    elif command == at.CALON:
        reg[at.ST_CAL] = 1
        _stop_all(reg, real)
    elif command == at.CALOFF:
        reg[at.ST_CAL], reg[at.VOUT] = 0, 0
        catch_up(reg, real)
    elif command == at.REGOFF:
        reg[at.ST_REGOFF] = 1
    elif command == at.REGON:
        reg[at.ST_REGOFF] = 0
        catch_up(reg, real)


@exactly_compiled
def _on_flags(reg: Words, command: int) -> None:
    if command in (at.CNTLOCK, at.CNTUNLOCK):
        reg[at.ST_CNTLOCK] = 1 if command == at.CNTLOCK else 0
    elif command in (at.CNTREV, at.CNTDIR):
        reg[at.ST_CNTREV] = 1 if command == at.CNTREV else 0
    elif command == at.RSERR:
        reg[at.ST_ERROR] = reg[at.ERRCODE] = reg[at.ERRVALUE] = 0
    elif command == at.RSWRN:
        reg[at.ST_WARNING] = reg[at.WRNCODE] = reg[at.WRNVALUE] = 0
    elif command == at.RSPRSOK:
        reg[at.ST_PRSOK] = 0


@exactly_compiled
def execute(reg: Words, real: Reals) -> None:
    """Execute the commands in the mailbox."""
    mailbox = reg[at.MAILBOX]
    reg[at.MAILBOX] = 0
    for command in range(_N_COMMANDS):
        if mailbox & (1 << command) == 0:
            continue
        free = _WITHOUT_CONDITION & (1 << command) != 0
        if command == at.INIT and reg[at.ST_INIT] == 0:
            _initialise(reg, real)
        elif command != at.INIT and (free or (reg[at.ST_INIT] == 1 and _may(reg, command))):
            _on_motion(reg, real, command)
            _on_output(reg, real, command)
            _on_flags(reg, command)
        elif not (reg[at.ALREADY_SO] != 0 and reg[at.ST_INIT] == 1 and (command in (at.RESUME, at.REGON))):
            warn(reg, at.NOT_EXECUTED, command + 1)
