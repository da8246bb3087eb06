"""The 22 commands of a QEM EANPOS: their conditions, and what they do.

All commands of one sample are executed in order of priority, each against the state that the one before has left
(manual 1.7.2, row Q-59). One whose conditions fail does nothing and raises warning 1 (row Q-23).
"""

from __future__ import annotations

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis.eanpos_homing import can_home, give_up, preset
from edmsim.controllers.axis.eanpos_moves import (
    can_move,
    catch_up,
    check_resolution,
    jog,
    place,
    shift,
    start,
    warn,
)
from edmsim.controllers.axis.eanpos_profile import brake, break_off
from edmsim.controllers.axis.eanpos_registers import (
    ALREADY_SO,
    CALOFF,
    CALON,
    CNTDIR,
    CNTLOCK,
    CNTREV,
    CNTUNLOCK,
    COMMANDS,
    DELCNT,
    DELTA,
    DERREG,
    EMRG,
    ENCODER,
    ERRCODE,
    ERRVALUE,
    EXCEEDED,
    FFWDREG,
    FOLLERR,
    GATE_EDGES,
    GATE_NS,
    HAS_TARGET,
    INIT,
    INTEG,
    INTEGRAL,
    LAST_ERROR,
    LOOPOFF,
    LOOPON,
    MAILBOX,
    MANBW,
    MANFW,
    NOT_EXECUTED,
    NOW_NS,
    NUMERATOR,
    POSIT,
    PRESET,
    PROPREG,
    PULSE,
    REGOFF,
    REGON,
    RESUME,
    RSERR,
    RSPRSOK,
    RSWRN,
    SETPOS,
    SETVEL,
    SINCE_NS,
    SINGLE_HOMING,
    ST_CAL,
    ST_CNTLOCK,
    ST_CNTREV,
    ST_EMRG,
    ST_ERROR,
    ST_INIT,
    ST_LOOPON,
    ST_PRSOK,
    ST_PRSON,
    ST_REGOFF,
    ST_STILL,
    ST_WARNING,
    START,
    STOP,
    THEORY,
    VOUT,
    WRNCODE,
    WRNVALUE,
    WRITTEN,
    Reals,
    Words,
)

_N_COMMANDS = len(COMMANDS)
_WITHOUT_CONDITION = (1 << RSERR) | (1 << RSWRN) | (1 << RSPRSOK)


@exactly_compiled
def _may_move(reg: Words) -> bool:
    """Say whether a move may start; in emergency, calibration, a search or an error none does (rows Q-A3, Q-61)."""
    blocked = reg[ST_REGOFF] + reg[ST_EMRG] + reg[ST_CAL] + reg[ST_PRSON] + reg[ST_ERROR]
    return bool(blocked == 0 and reg[ST_STILL] == 1 and can_move(reg, reg[SETVEL]))


@exactly_compiled
def _may(reg: Words, command: int) -> bool:
    """Say whether an initialised device's state allows a command."""
    if command == RESUME:
        return bool(reg[ST_EMRG] == 1)
    if command == START or command == MANFW or command == MANBW:
        return _may_move(reg)
    if command == STOP:
        return bool(reg[ST_REGOFF] == 0 and reg[ST_EMRG] == 0 and reg[ST_STILL] == 0)
    if command == PRESET:
        blocked = reg[ST_REGOFF] + reg[ST_EMRG] + reg[ST_CAL] + reg[ST_ERROR]
        repeats = reg[ST_PRSON] != 0 and reg[SINGLE_HOMING] != 0
        return bool(blocked == 0 and can_home(reg) and not repeats)
    if command == CALOFF:
        return bool(reg[ST_CAL] == 1)
    if command == REGOFF:
        return bool(reg[ST_STILL] == 1)
    if command == REGON:
        return bool(reg[ST_REGOFF] == 1)
    if command == DELCNT:
        return bool(reg[ST_CAL] == 0 and reg[ST_PRSON] == 0)
    return True


@exactly_compiled
def _stop_all(reg: Words, real: Reals) -> None:
    """Break off what moves, without a ramp, and any search."""
    break_off(reg, real)
    give_up(reg)
    real[INTEGRAL], reg[LAST_ERROR] = 0.0, 0
    real[THEORY] = place(reg)


@exactly_compiled
def _initialise(reg: Words, real: Reals) -> None:
    for register in (VOUT, FFWDREG, PROPREG, INTEG, DERREG, DELTA, ERRCODE, ERRVALUE, WRNCODE, WRNVALUE, FOLLERR):
        reg[register] = 0
    reg[ST_INIT], reg[WRITTEN] = 1, 0
    reg[NUMERATOR] = reg[POSIT] * reg[PULSE]
    real[THEORY], real[INTEGRAL] = float(reg[POSIT]), 0.0
    reg[HAS_TARGET], reg[SINCE_NS], reg[EXCEEDED] = 0, -1, 0
    reg[GATE_NS], reg[GATE_EDGES] = reg[NOW_NS], reg[ENCODER]
    check_resolution(reg, real)


@exactly_compiled
def _on_motion(reg: Words, real: Reals, command: int) -> None:
    if command == EMRG:
        reg[ST_EMRG] = 1
        _stop_all(reg, real)
    elif command == START:
        start(reg, real, reg[SETPOS])
    elif command == STOP:
        brake(reg, real)
        give_up(reg)
    elif command == PRESET:
        preset(reg, real)
    elif command == MANFW or command == MANBW:
        jog(reg, real, 1 if command == MANFW else -1)
    elif command == DELCNT and not shift(reg, real, reg[NUMERATOR] + reg[DELTA] * reg[PULSE], False):
        warn(reg, NOT_EXECUTED, DELCNT + 1)


@exactly_compiled
def _on_output(reg: Words, real: Reals, command: int) -> None:
    if command == RESUME:
        reg[ST_EMRG] = 0
        catch_up(reg, real)
    elif command == LOOPON:
        reg[ST_LOOPON] = 1
        catch_up(reg, real)
    elif command == LOOPOFF:
        reg[ST_LOOPON] = 0
    elif command == CALON:
        reg[ST_CAL] = 1
        _stop_all(reg, real)
    elif command == CALOFF:
        reg[ST_CAL], reg[VOUT] = 0, 0
        catch_up(reg, real)
    elif command == REGOFF:
        reg[ST_REGOFF] = 1
    elif command == REGON:
        reg[ST_REGOFF] = 0
        catch_up(reg, real)


@exactly_compiled
def _on_flags(reg: Words, command: int) -> None:
    if command == CNTLOCK or command == CNTUNLOCK:
        reg[ST_CNTLOCK] = 1 if command == CNTLOCK else 0
    elif command == CNTREV or command == CNTDIR:
        reg[ST_CNTREV] = 1 if command == CNTREV else 0
    elif command == RSERR:
        reg[ST_ERROR] = reg[ERRCODE] = reg[ERRVALUE] = 0
    elif command == RSWRN:
        reg[ST_WARNING] = reg[WRNCODE] = reg[WRNVALUE] = 0
    elif command == RSPRSOK:
        reg[ST_PRSOK] = 0


@exactly_compiled
def execute(reg: Words, real: Reals) -> None:
    """Execute the commands in the mailbox."""
    mailbox = reg[MAILBOX]
    reg[MAILBOX] = 0
    for command in range(_N_COMMANDS):
        if mailbox & (1 << command) == 0:
            continue
        free = _WITHOUT_CONDITION & (1 << command) != 0
        if command == INIT and reg[ST_INIT] == 0:
            _initialise(reg, real)
        elif command != INIT and (free or (reg[ST_INIT] == 1 and _may(reg, command))):
            _on_motion(reg, real, command)
            _on_output(reg, real, command)
            _on_flags(reg, command)
        elif not (reg[ALREADY_SO] != 0 and reg[ST_INIT] == 1 and (command == RESUME or command == REGON)):
            warn(reg, NOT_EXECUTED, command + 1)
