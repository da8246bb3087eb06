"""A sample of a QEM EANPOS: it counts, takes writes and commands, moves its theoretical place, and sets its output.

The output is feed-forward, proportional, integral and derivative part in shares of 10 V. With pgain 1000 an error of
what the axis travels in a sample at full speed makes 10 V: at 4 ms, 1666.7 units/s and pgain 10, one unit makes 15 mV
(rows Q-45, Q-67). The digital-to-analogue converter has 16 bits with sign.
"""

from __future__ import annotations

import math
from typing import Any

from edmsim.compiled.axis_rows import FAULT, HOLDS_OUTPUT, SHARED_IN, carray, sample
from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis.eanpos_commands import execute
from edmsim.controllers.axis.eanpos_homing import hold_loaded, search
from edmsim.controllers.axis.eanpos_moves import (
    edges_a_sample,
    fail,
    place,
    retarget,
    speed_unit,
    take_edges,
    take_writes,
    top_speed,
)
from edmsim.controllers.axis.eanpos_profile import follow
from edmsim.controllers.axis.eanpos_registers import (
    CAM,
    CODE,
    DELAYS_FOLLOWING,
    DERIVT,
    DERREG,
    DEVICE,
    EDGES,
    EMRG,
    ENCODER,
    EXCEEDED,
    EXCESS_NS,
    FEEDFW,
    FFWDREG,
    FOLLERR,
    FOLLOW_STEP,
    FOLLOWED,
    FRESH,
    FRQ,
    GATE_EDGES,
    GATE_NS,
    DIRECTION,
    HAS_COUNTER,
    HAS_HOME,
    HAS_INDEX,
    HAS_OUTPUT,
    HAS_TARGET,
    HOME_PHASE,
    IDEAL_PID,
    INTEG,
    INTEGRAL,
    INTEGT,
    LAST_COUNT,
    LAST_ERROR,
    MAILBOX,
    MAXFOLLERR,
    MEASURE,
    MODE2_ARMED,
    MOVE,
    NOW_NS,
    NUMERATOR,
    OFFSET,
    OUTPUT_TAKEN,
    PGAIN,
    PLACING,
    POSIT,
    PROPREG,
    PULSE,
    RESOURCES,
    RESTING,
    SETPOS,
    SINCE_NS,
    SPEED,
    ST_CAL,
    ST_CNTLOCK,
    ST_CNTREV,
    ST_EMRG,
    ST_ERROR,
    ST_FOLLER,
    ST_INIT,
    ST_INT,
    ST_LOOPON,
    ST_REGOFF,
    ST_STILL,
    ST_TOLL,
    START,
    TARGET,
    TCAMP_NS,
    THEORY,
    TOLDLY,
    TOLL,
    VEL,
    VOUT,
    WRITTEN,
    Reals,
    Words,
)

FULL_SCALE = 32768
"""Codes of 10 V: 16 bits with sign."""
_GATE_NS, _HOLD_NS = DEVICE["speed_gate_ns"], DEVICE["following_hold_ns"]
_EDGES_A_LINE = 4


@exactly_compiled
def _code(share: float) -> int:
    return min(max(math.floor(share * FULL_SCALE + 0.5), -FULL_SCALE), FULL_SCALE - 1)


@exactly_compiled
def _count(reg: Words, count: int) -> None:
    """Take what the counter has moved by; nothing is made up that it moved while idle or locked (row Q-78)."""
    edges = count - reg[LAST_COUNT] if reg[FRESH] == 0 else 0
    reg[LAST_COUNT], reg[FRESH] = count, 0
    if reg[ST_INIT] == 1 and reg[ST_CNTLOCK] == 0 and reg[RESOURCES] & HAS_COUNTER:
        take_edges(reg, -edges if reg[ST_CNTREV] != 0 else edges)


@exactly_compiled
def _follow_steps(reg: Words, real: Reals, edges: int) -> None:
    """Beyond the manual: place the axis where step edges lead, as a program would that writes setpos and sends START."""
    moved = edges - reg[EDGES]
    reg[EDGES] = edges
    if reg[FOLLOW_STEP] == 0 or reg[ST_INIT] == 0:
        return
    if reg[HAS_TARGET] == 0:
        reg[FOLLOWED] = reg[TARGET] = reg[POSIT]
        reg[HAS_TARGET] = 1
    reg[FOLLOWED] += moved * reg[FOLLOW_STEP]
    if reg[FOLLOWED] == reg[TARGET]:
        return
    if reg[MOVE] == RESTING:
        reg[SETPOS] = reg[FOLLOWED]
        reg[MAILBOX] |= 1 << START
    elif reg[MOVE] == PLACING and retarget(reg, real, reg[FOLLOWED]):
        reg[SETPOS] = reg[FOLLOWED]


@exactly_compiled
def _following_error(reg: Words, real: Reals) -> int:
    """Return the error in edges, and judge it (row Q-A26)."""
    error = math.floor((real[THEORY] - place(reg)) * reg[PULSE] / reg[MEASURE] + 0.5)
    reg[FOLLERR] = error
    if abs(error) > reg[MAXFOLLERR]:
        if reg[EXCEEDED] == 0 or reg[DELAYS_FOLLOWING] == 0:
            reg[EXCESS_NS] = reg[NOW_NS]
        reg[EXCEEDED] = 1
        if reg[DELAYS_FOLLOWING] == 0 or reg[NOW_NS] - reg[EXCESS_NS] >= _HOLD_NS:
            reg[ST_FOLLER] = 1
    elif reg[DELAYS_FOLLOWING] != 0 or (reg[EXCEEDED] != 0 and reg[NOW_NS] - reg[EXCESS_NS] >= _HOLD_NS):
        reg[ST_FOLLER] = reg[EXCEEDED] = 0
    return error


@exactly_compiled
def _regulate(reg: Words, real: Reals, error: int) -> float:
    """Return the output as a share of 10 V, before the offset (rows Q-44 to Q-46, Q-67)."""
    top, unit = top_speed(reg), edges_a_sample(reg)
    reg[FFWDREG] = reg[PROPREG] = reg[INTEG] = reg[DERREG] = 0
    if unit < 1.0:
        return 0.0
    forward = reg[FEEDFW] / 1000 * reg[DIRECTION] * real[SPEED] / top
    proportional = integral = derivative = 0.0
    step_ms = reg[TCAMP_NS] * 1e-6
    if reg[ST_LOOPON] == 1:
        gain = reg[PGAIN] / 1000
        others = gain if reg[IDEAL_PID] != 0 else 1.0
        proportional = gain * error / unit
        derivative = others * reg[DERIVT] / step_ms * (error - reg[LAST_ERROR]) / unit
        before = real[INTEGRAL]
        if reg[INTEGT] > 0:
            real[INTEGRAL] += others * step_ms / reg[INTEGT] * error / unit
        else:
            real[INTEGRAL] = 0.0
        integral = real[INTEGRAL]
        if abs(forward + proportional + integral + derivative) > 1.0 and abs(integral) > abs(before):
            real[INTEGRAL] = integral = before
    else:
        real[INTEGRAL] = 0.0
    reg[LAST_ERROR] = error
    reg[FFWDREG], reg[PROPREG] = _code(forward), _code(proportional)
    reg[INTEG], reg[DERREG] = _code(integral), _code(derivative)
    return forward + proportional + integral + derivative


@exactly_compiled
def _put_out(reg: Words, real: Reals) -> None:
    """Set the converter's code: kept with the regulation off, 0 in emergency, vout in calibration."""
    if reg[ST_EMRG] + reg[ST_CAL] + reg[ST_REGOFF] > 0:
        real[THEORY], real[INTEGRAL] = place(reg), 0.0
    error = _following_error(reg, real)
    if reg[ST_REGOFF] == 1:
        return
    if reg[ST_EMRG] == 1:
        share = 0.0
        reg[FFWDREG] = reg[PROPREG] = reg[INTEG] = reg[DERREG] = 0
    elif reg[ST_CAL] == 1:
        share = reg[VOUT] * 0.01
        reg[FFWDREG] = reg[PROPREG] = reg[INTEG] = reg[DERREG] = 0
    else:
        share = _regulate(reg, real, error)
    offset = 0 if reg[ST_EMRG] == 1 else reg[OFFSET]
    reg[CODE] = min(max(math.floor(share * FULL_SCALE + 0.5) + offset, -FULL_SCALE), FULL_SCALE - 1)


@exactly_compiled
def _measure_speed(reg: Words) -> None:
    """Update vel and frq every 250 ms (rows Q-37, Q-70)."""
    since_ns = reg[NOW_NS] - reg[GATE_NS]
    if since_ns < _GATE_NS:
        return
    edges, seconds = reg[ENCODER] - reg[GATE_EDGES], since_ns * 1e-9
    reg[FRQ] = math.floor(abs(edges) / _EDGES_A_LINE / seconds + 0.5)
    reg[VEL] = math.floor(edges * reg[MEASURE] / reg[PULSE] / seconds / speed_unit(reg) + 0.5)
    reg[GATE_NS], reg[GATE_EDGES] = reg[NOW_NS], reg[ENCODER]


@exactly_compiled
def _judge_tolerance(reg: Words) -> None:
    """Set st_toll once the axis has been near its target for toldly (row Q-A32)."""
    if reg[HAS_TARGET] == 0 or abs(reg[TARGET] - reg[POSIT]) > abs(reg[TOLL]):
        reg[SINCE_NS], reg[ST_TOLL] = -1, 0
        return
    if reg[SINCE_NS] < 0:
        reg[SINCE_NS] = reg[NOW_NS]
    if reg[NOW_NS] - reg[SINCE_NS] >= reg[TOLDLY] * 10_000_000:
        reg[ST_TOLL] = 1


@exactly_compiled
def _run(reg: Words, real: Reals, cam_before: int, marks: int, index_at: int) -> None:
    """Do what an initialised device does at a sample."""
    if reg[HOME_PHASE] != 0:
        search(reg, real, cam_before, marks, index_at)
    hold_loaded(reg, real)
    follow(reg, real)
    if reg[RESOURCES] & HAS_COUNTER == 0 and reg[PULSE] > 0:
        reg[NUMERATOR] = math.floor(real[THEORY] * reg[PULSE] + 0.5)
        reg[POSIT] = reg[NUMERATOR] // reg[PULSE]
    if reg[MEASURE] > 0 and reg[PULSE] > 0:
        _put_out(reg, real)
        _measure_speed(reg)
    _judge_tolerance(reg)


@sample
def eanpos_sample(drive_at: Any, axis_at: Any) -> None:
    """Do what the device does at a sampling instant."""
    drive, axis = carray(drive_at, 1)[0], carray(axis_at, 1)[0]
    reg, real = drive.reg, drive.real
    reg[NOW_NS] = drive.now_ns
    follow(reg, real)
    if reg[FRESH] != 0:
        reg[EDGES], reg[MODE2_ARMED] = drive.setpoint, 0
    _follow_steps(reg, real, drive.setpoint)
    if reg[ST_INIT] == 1 and reg[WRITTEN] != 0:
        take_writes(reg, real)
    _count(reg, axis.count)
    cam_before = reg[CAM]
    reg[CAM] = axis.home if reg[RESOURCES] & HAS_HOME else 0
    reg[ST_INT] = axis.index_on if reg[RESOURCES] & HAS_INDEX else 0
    if reg[MAILBOX] != 0:
        execute(reg, real)
    if reg[ST_INIT] == 1:
        if axis.lines & SHARED_IN and reg[ST_REGOFF] == 0:
            fail(reg, real, OUTPUT_TAKEN, 0)
        _run(reg, real, cam_before, axis.indexes, axis.index_at)
    held = reg[ST_INIT] == 0 or reg[ST_REGOFF] == 1 or reg[RESOURCES] & HAS_OUTPUT == 0
    drive.command = reg[CODE] / FULL_SCALE if reg[RESOURCES] & HAS_OUTPUT else 0.0
    lost = reg[FOLLOW_STEP] != 0 and reg[ST_FOLLER] == 1
    if lost:
        reg[MAILBOX] |= 1 << EMRG
    drive.lines = (HOLDS_OUTPUT if held else 0) | (FAULT if lost or reg[ST_ERROR] == 1 else 0)
