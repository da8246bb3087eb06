"""A sample of a QEM EANPOS: count, execute writes and commands, move the theoretical position, set the output.

The output is the sum of feed-forward, proportional, integral and derivative parts in shares of 10 V. With pgain 1000,
an error as large as the travel in a sample at full speed makes 10 V; at 4 ms, 1666.7 units/s and pgain 10, one unit
makes 15 mV (rows Q-45, Q-67). The digital-to-analogue converter has 16 bits with sign.
"""

from __future__ import annotations

import math
from typing import Any

from edmsim.compiled.axis_rows import FAULT, HOLDS_OUTPUT, SHARED_IN, carray, sample
from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis.eanpos import registers as at
from edmsim.controllers.axis.eanpos.commands import execute
from edmsim.controllers.axis.eanpos.homing import hold_loaded, search
from edmsim.controllers.axis.eanpos.moves import (
    edges_a_sample,
    fail,
    place,
    retarget,
    speed_unit,
    take_edges,
    take_writes,
    top_speed,
)
from edmsim.controllers.axis.eanpos.profile import follow
from edmsim.controllers.axis.eanpos.registers import Reals, Words

FULL_SCALE = 32768  # codes of 10 V: 16 bits with sign
_GATE_NS, _HOLD_NS = at.DEVICE["speed_gate_ns"], at.DEVICE["following_hold_ns"]
_EDGES_A_LINE = 4


@exactly_compiled
def _code(share: float) -> int:
    return min(max(math.floor(share * FULL_SCALE + 0.5), -FULL_SCALE), FULL_SCALE - 1)


@exactly_compiled
def _count(reg: Words, count: int) -> None:
    """Take what the counter has moved by; nothing is made up that it moved while idle or locked (row Q-78)."""
    edges = count - reg[at.LAST_COUNT] if reg[at.FRESH] == 0 else 0
    reg[at.LAST_COUNT], reg[at.FRESH] = count, 0
    if reg[at.ST_INIT] == 1 and reg[at.ST_CNTLOCK] == 0 and reg[at.RESOURCES] & at.HAS_COUNTER:
        take_edges(reg, -edges if reg[at.ST_CNTREV] != 0 else edges)


@exactly_compiled
def _follow_steps(reg: Words, real: Reals, edges: int) -> None:
    """Beyond the manual: go where step edges lead, as a program would that writes setpos and sends START."""
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
    elif reg[at.MOVE] == at.PLACING and retarget(reg, real, reg[at.FOLLOWED]):
        reg[at.SETPOS] = reg[at.FOLLOWED]


@exactly_compiled
def _following_error(reg: Words, real: Reals) -> int:
    """Return the error in edges, and judge it (row Q-A26)."""
    error: int = math.floor((real[at.THEORY] - place(reg)) * reg[at.PULSE] / reg[at.MEASURE] + 0.5)
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
    top, unit = top_speed(reg), edges_a_sample(reg)
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
    """Set the converter's code: kept with the regulation off, 0 in emergency, vout in calibration."""
    if reg[at.ST_EMRG] + reg[at.ST_CAL] + reg[at.ST_REGOFF] > 0:
        real[at.THEORY], real[at.INTEGRAL] = place(reg), 0.0
    error = _following_error(reg, real)
    if reg[at.ST_REGOFF] == 1:
        return
    if reg[at.ST_EMRG] == 1:
        share = 0.0
        reg[at.FFWDREG] = reg[at.PROPREG] = reg[at.INTEG] = reg[at.DERREG] = 0
    elif reg[at.ST_CAL] == 1:
        share = reg[at.VOUT] * 0.01
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
    reg[at.VEL] = math.floor(edges * reg[at.MEASURE] / reg[at.PULSE] / seconds / speed_unit(reg) + 0.5)
    reg[at.GATE_NS], reg[at.GATE_EDGES] = reg[at.NOW_NS], reg[at.ENCODER]


@exactly_compiled
def start_refused(reg: Words) -> bool:
    """Say whether the last warning is that START was not executed."""
    return bool(reg[at.ST_WARNING] == 1 and reg[at.WRNCODE] == at.NOT_EXECUTED and reg[at.WRNVALUE] == at.START + 1)


@exactly_compiled
def _judge_tolerance(reg: Words) -> None:
    """Set st_toll once the axis has been near its target for toldly (row Q-A32)."""
    if reg[at.HAS_TARGET] == 0 or abs(reg[at.TARGET] - reg[at.POSIT]) > abs(reg[at.TOLL]):
        reg[at.SINCE_NS], reg[at.ST_TOLL] = -1, 0
        return
    if reg[at.SINCE_NS] < 0:
        reg[at.SINCE_NS] = reg[at.NOW_NS]
    if reg[at.NOW_NS] - reg[at.SINCE_NS] >= reg[at.TOLDLY] * 10_000_000:
        reg[at.ST_TOLL] = 1


@exactly_compiled
def _run(reg: Words, real: Reals, cam_before: int, marks: int, index_at: int) -> None:
    """Do what an initialised device does at a sample."""
    if reg[at.HOME_PHASE] != 0:
        search(reg, real, cam_before, marks, index_at)
    hold_loaded(reg, real)
    follow(reg, real)
    if reg[at.RESOURCES] & at.HAS_COUNTER == 0 and reg[at.PULSE] > 0:
        reg[at.NUMERATOR] = math.floor(real[at.THEORY] * reg[at.PULSE] + 0.5)
        reg[at.POSIT] = reg[at.NUMERATOR] // reg[at.PULSE]
    if reg[at.MEASURE] > 0 and reg[at.PULSE] > 0:
        _put_out(reg, real)
        _measure_speed(reg)
    _judge_tolerance(reg)


@sample
def eanpos_sample(drive_at: Any, axis_at: Any) -> None:
    """Do what the device does at a sampling instant."""
    drive, axis = carray(drive_at, 1)[0], carray(axis_at, 1)[0]
    reg, real = drive.reg, drive.real
    reg[at.NOW_NS] = drive.now_ns
    follow(reg, real)
    if reg[at.FRESH] != 0:
        reg[at.EDGES], reg[at.MODE2_ARMED] = drive.setpoint, 0
    _follow_steps(reg, real, drive.setpoint)
    if reg[at.ST_INIT] == 1 and reg[at.WRITTEN] != 0:
        take_writes(reg, real)
    _count(reg, axis.count)
    cam_before = reg[at.CAM]
    reg[at.CAM] = axis.home if reg[at.RESOURCES] & at.HAS_HOME else 0
    reg[at.ST_INT] = axis.index_on if reg[at.RESOURCES] & at.HAS_INDEX else 0
    if reg[at.MAILBOX] != 0:
        execute(reg, real)
    if reg[at.ST_INIT] == 1:
        if axis.lines & SHARED_IN and reg[at.ST_REGOFF] == 0:
            fail(reg, real, at.OUTPUT_TAKEN, 0)
        _run(reg, real, cam_before, axis.indexes, axis.index_at)
    held = reg[at.ST_INIT] == 0 or reg[at.ST_REGOFF] == 1 or reg[at.RESOURCES] & at.HAS_OUTPUT == 0
    drive.command = reg[at.CODE] / FULL_SCALE if reg[at.RESOURCES] & at.HAS_OUTPUT else 0.0
    lost = reg[at.FOLLOW_STEP] != 0 and (reg[at.ST_FOLLER] + reg[at.ST_EMRG] > 0 or start_refused(reg))
    if lost and reg[at.ST_EMRG] == 0:
        reg[at.MAILBOX] |= 1 << at.EMRG
    drive.lines = (HOLDS_OUTPUT if held else 0) | (FAULT if lost or reg[at.ST_ERROR] == 1 else 0)
