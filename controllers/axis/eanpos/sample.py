"""A sample of a QEM EANPOS: count, execute writes and commands, move the theoretical position, set the output.

The output is the sum of feed-forward, proportional, integral and derivative parts in shares of 10 V. With pgain 1000,
an error as large as the travel in a sample at full speed makes 10 V; at 4 ms, 1666.7 units/s and pgain 10, one unit
makes 15 mV (rows Q-45, Q-67). The digital-to-analogue converter has 16 bits with sign.
"""

import math
from typing import Any

from edmsim.compiled.axis_rows import FAULT, HOLDS_OUTPUT, SHARED_IN, carray, sample
from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis.eanpos import moves
from edmsim.controllers.axis.eanpos import registers as at
from edmsim.controllers.axis.eanpos.registers import Reals, Words

# The homing search of a QEM EANPOS ("preset search", manual 1.3.9): to the cam, back off it, to the zero pulse.
# In mode 0, an axis 500 units before the cam reaches it at 333 units/s, reverses, and leaves it at 167 units/s.
# There the count becomes prspos; the axis stops and returns to prspos. In mode 1, the first zero pulse after the
# cam loads the count. In mode 2 nothing moves: each closing of the cam loads it.

NONE, FAST, TURNING, SLOW, TO_MARK, OVERRUN, RETURNING, REVERSING = range(8)
"""`HOME_PHASE`: no search; moving to the cam; stopping on it; leaving it; moving to the zero pulse; stopping after
prspos was loaded; returning to prspos; stopping to reverse."""


@exactly_compiled
def _search(reg: Words, real: Reals, direction: int, speed: int, phase: int) -> None:
    """Move at a speed without an end, in a phase of a search."""
    reg[at.MOVE], reg[at.ST_STILL], reg[at.HOME_PHASE] = at.SEARCHING, 0, phase
    moves.begin(reg, real, direction, moves.slopes(reg))
    moves.plan(reg, real, math.inf, speed * moves.speed_unit(reg))
    real[at.SEARCHED_FROM] = real[at.THEORY]


@exactly_compiled
def give_up(reg: Words) -> None:
    """End a search without success."""
    reg[at.HOME_PHASE], reg[at.ST_PRSON] = NONE, 0


@exactly_compiled
def preset(reg: Words, real: Reals) -> None:
    """Start a search, or reverse a running one (row Q-A28)."""
    needed = at.HAS_HOME | at.HAS_INDEX if reg[at.PRSMODE] == 1 else at.HAS_HOME
    if reg[at.RESOURCES] & needed != needed:
        moves.fail(reg, real, at.RESOURCE_MISSING, reg[at.PRSMODE])
        return
    reg[at.ST_PRSOK] = 0
    if reg[at.PRSMODE] == 2:
        return
    again = reg[at.HOME_PHASE] != NONE
    reg[at.ST_PRSON] = 1
    if not again:
        reg[at.HOME_DIR] = -1 if reg[at.PRMDIR] != 0 else 1
        if reg[at.ST_LOOPON] == 0:
            moves.catch_up(reg, real)
    elif reg[at.HOME_PHASE] == FAST:
        reg[at.HOME_DIR] = -reg[at.HOME_DIR]
    if reg[at.MOVE] != at.RESTING:
        moves.brake(reg, real)
        reg[at.MOVE], reg[at.HOME_PHASE] = at.ENDING, REVERSING
    else:
        _set_out(reg, real, again)


@exactly_compiled
def _set_out(reg: Words, real: Reals, again: bool) -> None:
    """Move to the cam; an axis on the cam at the first PRESET leaves it at once (row Q-53)."""
    if reg[at.CAM] != 0 and not again:
        _search(reg, real, -reg[at.HOME_DIR], reg[at.SPRSVEL], SLOW)
    else:
        _search(reg, real, reg[at.HOME_DIR], reg[at.PRSVEL], FAST)


@exactly_compiled
def _load(reg: Words, real: Reals, edges_since: int) -> None:
    """Set the count so that it was prspos `edges_since` ago; if the count is locked, end the search instead."""
    moves.brake(reg, real)
    if reg[at.ST_CNTLOCK] != 0:
        give_up(reg)
        return
    moves.shift(reg, real, reg[at.PRSPOS] * reg[at.PULSE] + edges_since * reg[at.MEASURE], True)
    reg[at.HOME_PHASE] = OVERRUN


@exactly_compiled
def _edges_since_mark(reg: Words, index_at: int) -> int:
    edges: int = reg[at.LAST_COUNT] - index_at
    return -edges if reg[at.ST_CNTREV] != 0 else edges


@exactly_compiled
def search(reg: Words, real: Reals, cam_before: int, marks: int, index_at: int) -> None:
    """Advance a search by a sample; `cam_before` is the last sample's enabling input, `index_at` the last mark."""
    phase, rests = reg[at.HOME_PHASE], reg[at.MOVE] == at.RESTING
    if phase == FAST and reg[at.CAM] != 0:  # also if a second PRESET begins on it
        moves.brake(reg, real)
        reg[at.HOME_PHASE] = TURNING
    elif phase == TURNING and rests:
        _search(reg, real, -reg[at.HOME_DIR], reg[at.SPRSVEL], SLOW)
    elif phase == SLOW and reg[at.CAM] < cam_before:
        reg[at.MARKS] = marks
        if reg[at.PRSMODE] == 0:
            _load(reg, real, 0)
        else:
            reg[at.HOME_PHASE] = TO_MARK
            real[at.SEARCHED_FROM] = real[at.THEORY]
    elif phase == TO_MARK and marks != reg[at.MARKS]:
        _load(reg, real, _edges_since_mark(reg, index_at))
    elif phase == OVERRUN and rests:
        reg[at.SETPOS], reg[at.SETVEL] = reg[at.PRSPOS], reg[at.SPRSVEL]
        reg[at.TARGET], reg[at.HAS_TARGET] = reg[at.PRSPOS], 1
        reg[at.HOME_PHASE] = RETURNING
        moves.travel(reg, real, float(reg[at.PRSPOS]))
    elif phase == RETURNING and rests:
        give_up(reg)
        reg[at.ST_PRSOK] = 1
    elif phase == REVERSING and rests:
        _search(reg, real, reg[at.HOME_DIR], reg[at.PRSVEL], FAST)
    _bound(reg, real)


@exactly_compiled
def _bound(reg: Words, real: Reals) -> None:
    """Beyond the manual: raise an error if a phase of a search exceeds a distance."""
    searched = abs(real[at.THEORY] - real[at.SEARCHED_FROM])
    if reg[at.MOVE] == at.SEARCHING and reg[at.HOME_LIMIT] > 0 and searched > reg[at.HOME_LIMIT]:
        what = at.MARK_NOT_FOUND if reg[at.HOME_PHASE] == TO_MARK else at.CAM_NOT_FOUND
        moves.fail(reg, real, what, reg[at.PRSMODE])


@exactly_compiled
def hold_loaded(reg: Words, real: Reals) -> None:
    """Mode 2: load prspos while the input is closed, if it has been open before (row Q-52)."""
    if reg[at.CAM] == 0:
        reg[at.MODE2_ARMED] = 1
    elif reg[at.PRSMODE] == 2 and reg[at.MODE2_ARMED] != 0 and reg[at.ST_CNTLOCK] == 0:
        if reg[at.MODE2_ARMED] == 1:
            reg[at.ST_PRSOK], reg[at.MODE2_ARMED] = 1, 2
        if reg[at.NUMERATOR] != reg[at.PRSPOS] * reg[at.PULSE]:
            moves.shift(reg, real, reg[at.PRSPOS] * reg[at.PULSE], True)


# The 22 commands of a QEM EANPOS: their conditions and effects.
# The commands of a sample are executed in order of priority, each in the state after the previous one (manual
# 1.7.2, row Q-59). If a command's conditions fail, it does nothing and raises warning 1 (row Q-23).

_ZERO_AT_INIT = (
    at.VOUT, at.FFWDREG, at.PROPREG, at.INTEG, at.DERREG, at.DELTA, at.ERRCODE, at.ERRVALUE, at.WRNCODE, at.WRNVALUE,
    at.FOLLERR, at.VEL, at.FRQ, at.ST_WARNING, at.ST_ERROR,
)  # fmt: skip
_N_COMMANDS = len(at.COMMANDS)
_WITHOUT_CONDITION = (1 << at.RSERR) | (1 << at.RSWRN) | (1 << at.RSPRSOK)


@exactly_compiled
def _may_move(reg: Words) -> bool:
    """Return whether a move may start: not in emergency, calibration, a search or an error (rows Q-A3, Q-61)."""
    blocked = reg[at.ST_REGOFF] + reg[at.ST_EMRG] + reg[at.ST_CAL] + reg[at.ST_PRSON] + reg[at.ST_ERROR]
    return bool(blocked == 0 and reg[at.ST_STILL] == 1)


@exactly_compiled
def _may(reg: Words, command: int) -> bool:
    """Return whether an initialised device's state allows a command."""
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
    """End any motion, without a ramp, and any search."""
    moves.break_off(reg, real)
    give_up(reg)
    real[at.INTEGRAL], reg[at.LAST_ERROR] = 0.0, 0
    real[at.THEORY] = moves.place(reg)


@exactly_compiled
def _initialise(reg: Words, real: Reals) -> None:
    for register in _ZERO_AT_INIT:
        reg[register] = 0
    reg[at.ST_INIT], reg[at.WRITTEN] = 1, 0
    reg[at.NUMERATOR] = reg[at.POSIT] * reg[at.PULSE]
    real[at.THEORY], real[at.INTEGRAL] = float(reg[at.POSIT]), 0.0
    reg[at.HAS_TARGET], reg[at.SINCE_NS], reg[at.EXCEEDED] = 0, -1, 0
    reg[at.GATE_NS], reg[at.GATE_EDGES] = reg[at.NOW_NS], reg[at.ENCODER]
    moves.check_resolution(reg, real)


@exactly_compiled
def _on_motion(reg: Words, real: Reals, command: int) -> None:
    if command == at.EMRG:
        reg[at.ST_EMRG] = 1
        _stop_all(reg, real)
    elif command == at.START:
        moves.start(reg, real, reg[at.SETPOS])
    elif command == at.STOP:
        moves.brake(reg, real)
        give_up(reg)
    elif command == at.PRESET:
        preset(reg, real)
    elif command in (at.MANFW, at.MANBW):
        moves.jog(reg, real, 1 if command == at.MANFW else -1)
    elif command == at.DELCNT and not moves.shift(
        reg, real, reg[at.NUMERATOR] + reg[at.DELTA] * reg[at.PULSE], False
    ):
        moves.warn(reg, at.NOT_EXECUTED, at.DELCNT + 1)


@exactly_compiled
def _on_output(reg: Words, real: Reals, command: int) -> None:
    if command == at.RESUME:
        reg[at.ST_EMRG] = 0
        moves.catch_up(reg, real)
    elif command == at.LOOPON:
        reg[at.ST_LOOPON] = 1
        moves.catch_up(reg, real)
    elif command == at.LOOPOFF:
        reg[at.ST_LOOPON] = 0
    elif command == at.CALON:
        reg[at.ST_CAL] = 1
        _stop_all(reg, real)
    elif command == at.CALOFF:
        reg[at.ST_CAL], reg[at.VOUT] = 0, 0
        moves.catch_up(reg, real)
    elif command == at.REGOFF:
        reg[at.ST_REGOFF] = 1
    elif command == at.REGON:
        reg[at.ST_REGOFF] = 0
        moves.catch_up(reg, real)


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
            moves.warn(reg, at.NOT_EXECUTED, command + 1)


FULL_SCALE = 32768  # code of 10 V: 16 bits with sign
_GATE_NS, _HOLD_NS = at.DEVICE["speed_gate_ns"], at.DEVICE["following_hold_ns"]
_EDGES_A_LINE = 4


@exactly_compiled
def _code(share: float) -> int:
    return min(max(math.floor(share * FULL_SCALE + 0.5), -FULL_SCALE), FULL_SCALE - 1)


@exactly_compiled
def _count(reg: Words, count: int) -> None:
    """Count the counter's edges since the last sample; edges while idle or locked are lost (row Q-78)."""
    edges = count - reg[at.LAST_COUNT] if reg[at.FRESH] == 0 else 0
    reg[at.LAST_COUNT], reg[at.FRESH] = count, 0
    if reg[at.ST_INIT] == 1 and reg[at.ST_CNTLOCK] == 0 and reg[at.RESOURCES] & at.HAS_COUNTER:
        moves.take_edges(reg, -edges if reg[at.ST_CNTREV] != 0 else edges)


@exactly_compiled
def _follow_steps(reg: Words, real: Reals, edges: int) -> None:
    """Beyond the manual: follow step edges, like a program that writes setpos and sends START."""
    moved = edges - reg[at.EDGES]
    reg[at.EDGES] = edges
    if reg[at.FOLLOW_STEP] == 0 or reg[at.ST_INIT] == 0:
        return
    if reg[at.HAS_TARGET] == 0:
        reg[at.FOLLOWED] = reg[at.TARGET] = reg[at.POSIT]
        reg[at.HAS_TARGET] = 1
    reg[at.FOLLOWED] += moved * reg[at.FOLLOW_STEP]
    if reg[at.FOLLOWED] == reg[at.TARGET]:
        return
    if reg[at.MOVE] == at.RESTING:
        reg[at.SETPOS] = reg[at.FOLLOWED]
        reg[at.MAILBOX] |= 1 << at.START
    elif reg[at.MOVE] == at.PLACING and moves.retarget(reg, real, reg[at.FOLLOWED]):
        reg[at.SETPOS] = reg[at.FOLLOWED]


@exactly_compiled
def _following_error(reg: Words, real: Reals) -> int:
    """Return the following error in edges, and update st_foller (row Q-A26); 0 without a resolution."""
    if not moves.has_resolution(reg):
        reg[at.FOLLERR] = 0
        return 0
    error: int = math.floor((real[at.THEORY] - moves.place(reg)) * reg[at.PULSE] / reg[at.MEASURE] + 0.5)
    reg[at.FOLLERR] = error
    if abs(error) > reg[at.MAXFOLLERR]:
        if reg[at.EXCEEDED] == 0 or reg[at.DELAYS_FOLLOWING] == 0:
            reg[at.EXCESS_NS] = reg[at.NOW_NS]
        reg[at.EXCEEDED] = 1
        if reg[at.DELAYS_FOLLOWING] == 0 or reg[at.NOW_NS] - reg[at.EXCESS_NS] >= _HOLD_NS:
            reg[at.ST_FOLLER] = 1
    elif reg[at.DELAYS_FOLLOWING] != 0 or (reg[at.EXCEEDED] != 0 and reg[at.NOW_NS] - reg[at.EXCESS_NS] >= _HOLD_NS):
        reg[at.ST_FOLLER] = reg[at.EXCEEDED] = 0
    return error


@exactly_compiled
def _regulate(reg: Words, real: Reals, error: int) -> float:
    """Return the output as a share of 10 V, before the offset (rows Q-44 to Q-46, Q-67)."""
    top, unit = moves.top_speed(reg), moves.edges_a_sample(reg)
    reg[at.FFWDREG] = reg[at.PROPREG] = reg[at.INTEG] = reg[at.DERREG] = 0
    if unit <= 0.0:  # the output has no scale
        return 0.0
    forward = reg[at.FEEDFW] / 1000 * reg[at.DIRECTION] * real[at.SPEED] / top
    proportional = integral = derivative = 0.0
    step_ms = reg[at.TCAMP_NS] * 1e-6
    if reg[at.ST_LOOPON] == 1:
        gain = reg[at.PGAIN] / 1000
        others = gain if reg[at.IDEAL_PID] != 0 else 1.0
        proportional = gain * error / unit
        derivative = others * reg[at.DERIVT] / step_ms * (error - reg[at.LAST_ERROR]) / unit
        before = real[at.INTEGRAL]
        if reg[at.INTEGT] > 0:
            real[at.INTEGRAL] += others * step_ms / reg[at.INTEGT] * error / unit
        else:
            real[at.INTEGRAL] = 0.0
        integral = real[at.INTEGRAL]
        if abs(forward + proportional + integral + derivative) > 1.0 and abs(integral) > abs(before):
            real[at.INTEGRAL] = integral = before
    else:
        real[at.INTEGRAL] = 0.0
    reg[at.LAST_ERROR] = error
    reg[at.FFWDREG], reg[at.PROPREG] = _code(forward), _code(proportional)
    reg[at.INTEG], reg[at.DERREG] = _code(integral), _code(derivative)
    return float(forward + proportional + integral + derivative)


@exactly_compiled
def _put_out(reg: Words, real: Reals) -> None:
    """Set the converter's code: unchanged with the regulation off, 0 in emergency, vout in calibration."""
    if reg[at.ST_EMRG] + reg[at.ST_CAL] + reg[at.ST_REGOFF] > 0:
        real[at.THEORY], real[at.INTEGRAL] = moves.place(reg), 0.0
    error = _following_error(reg, real)
    if reg[at.ST_REGOFF] == 1:
        return
    if reg[at.ST_EMRG] == 1 or reg[at.ST_CAL] == 1:
        share = 0.0 if reg[at.ST_EMRG] == 1 else reg[at.VOUT] * 0.01
        reg[at.FFWDREG] = reg[at.PROPREG] = reg[at.INTEG] = reg[at.DERREG] = 0
    else:
        share = _regulate(reg, real, error)
    offset = 0 if reg[at.ST_EMRG] == 1 else reg[at.OFFSET]
    reg[at.CODE] = min(max(math.floor(share * FULL_SCALE + 0.5) + offset, -FULL_SCALE), FULL_SCALE - 1)


@exactly_compiled
def _measure_speed(reg: Words) -> None:
    """Update vel and frq every 250 ms (rows Q-37, Q-70)."""
    since_ns = reg[at.NOW_NS] - reg[at.GATE_NS]
    if since_ns < _GATE_NS:
        return
    edges, seconds = reg[at.ENCODER] - reg[at.GATE_EDGES], since_ns * 1e-9
    reg[at.FRQ] = math.floor(abs(edges) / _EDGES_A_LINE / seconds + 0.5)
    reg[at.VEL] = math.floor(edges * reg[at.MEASURE] / reg[at.PULSE] / seconds / moves.speed_unit(reg) + 0.5)
    reg[at.GATE_NS], reg[at.GATE_EDGES] = reg[at.NOW_NS], reg[at.ENCODER]


@exactly_compiled
def start_refused(reg: Words) -> bool:
    """Return whether the last warning is that START was not executed."""
    return bool(reg[at.ST_WARNING] == 1 and reg[at.WRNCODE] == at.NOT_EXECUTED and reg[at.WRNVALUE] == at.START + 1)


@exactly_compiled
def _judge_tolerance(reg: Words) -> None:
    """Set st_toll if the axis has been near its target for toldly (row Q-A32)."""
    if reg[at.HAS_TARGET] == 0 or abs(reg[at.TARGET] - reg[at.POSIT]) > abs(reg[at.TOLL]):
        reg[at.SINCE_NS], reg[at.ST_TOLL] = -1, 0
        return
    if reg[at.SINCE_NS] < 0:
        reg[at.SINCE_NS] = reg[at.NOW_NS]
    if reg[at.NOW_NS] - reg[at.SINCE_NS] >= reg[at.TOLDLY] * 10_000_000:
        reg[at.ST_TOLL] = 1


@exactly_compiled
def _run(reg: Words, real: Reals, cam_before: int, marks: int, index_at: int) -> None:
    """Run a sample of an initialised device."""
    if reg[at.HOME_PHASE] != 0:
        search(reg, real, cam_before, marks, index_at)
    hold_loaded(reg, real)
    moves.follow(reg, real)
    if reg[at.RESOURCES] & at.HAS_COUNTER == 0 and reg[at.PULSE] > 0:
        reg[at.NUMERATOR] = math.floor(real[at.THEORY] * reg[at.PULSE] + 0.5)
        reg[at.POSIT] = reg[at.NUMERATOR] // reg[at.PULSE]
    _put_out(reg, real)
    if moves.has_resolution(reg):
        _measure_speed(reg)
    _judge_tolerance(reg)


@sample
def eanpos_sample(drive_at: Any, axis_at: Any) -> None:
    """Run a sample of the device."""
    drive, axis = carray(drive_at, 1)[0], carray(axis_at, 1)[0]
    reg, real = drive.reg, drive.real
    reg[at.NOW_NS] = drive.now_ns
    moves.follow(reg, real)
    if reg[at.FRESH] != 0:
        reg[at.EDGES], reg[at.MODE2_ARMED] = drive.setpoint, 0
    _follow_steps(reg, real, drive.setpoint)
    if reg[at.ST_INIT] == 1 and reg[at.WRITTEN] != 0:
        moves.take_writes(reg, real)
    _count(reg, axis.count)
    cam_before = reg[at.CAM]
    reg[at.CAM] = axis.home if reg[at.RESOURCES] & at.HAS_HOME else 0
    reg[at.ST_INT] = axis.index_on if reg[at.RESOURCES] & at.HAS_INDEX else 0
    if reg[at.MAILBOX] != 0:
        execute(reg, real)
    if reg[at.ST_INIT] == 1:
        if axis.lines & SHARED_IN and reg[at.ST_REGOFF] == 0:
            moves.fail(reg, real, at.OUTPUT_TAKEN, 0)
        _run(reg, real, cam_before, axis.indexes, axis.index_at)
    held = reg[at.ST_INIT] == 0 or reg[at.ST_REGOFF] == 1 or reg[at.RESOURCES] & at.HAS_OUTPUT == 0
    drive.command = reg[at.CODE] / FULL_SCALE if reg[at.RESOURCES] & at.HAS_OUTPUT else 0.0
    lost = reg[at.FOLLOW_STEP] != 0 and (reg[at.ST_FOLLER] + reg[at.ST_EMRG] > 0 or start_refused(reg))
    if lost and reg[at.ST_EMRG] == 0:
        reg[at.MAILBOX] |= 1 << at.EMRG
    drive.lines = (HOLDS_OUTPUT if held else 0) | (FAULT if lost or reg[at.ST_ERROR] == 1 else 0)
