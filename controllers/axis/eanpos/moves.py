"""Moves of a QEM EANPOS: positioning, jogs, changes in motion, and changes of the count.

A change in motion is accepted if the axis can still stop at its target with the present ramps (manual 1.4.2, 1.4.3).
A count changed in motion shifts the theoretical position too; the travel to the target changes by as much.
"""

from __future__ import annotations

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis.eanpos import registers as at
from edmsim.controllers.axis.eanpos.profile import (
    begin,
    brake,
    in_last_ramp,
    keeps_first_ramp,
    lengthen,
    plan,
    slope_of,
)
from edmsim.controllers.axis.eanpos.registers import Reals, Words

_FINEST, _COARSEST = at.DEVICE["finest_resolution"], at.DEVICE["coarsest_resolution"]
_MINUTE = 60.0


@exactly_compiled
def warn(reg: Words, code: int, value: int) -> None:
    """Raise a warning; the axis works on."""
    reg[at.ST_WARNING], reg[at.WRNCODE], reg[at.WRNVALUE] = 1, code, value


@exactly_compiled
def fail(reg: Words, real: Reals, code: int, value: int) -> None:
    """Raise an error: the axis comes to rest, a homing search ends, and nothing moves until RSERR."""
    if reg[at.ST_ERROR] == 0:
        reg[at.ST_ERROR], reg[at.ERRCODE], reg[at.ERRVALUE] = 1, code, value
    reg[at.HOME_PHASE] = reg[at.ST_PRSON] = 0
    brake(reg, real)


@exactly_compiled
def speed_unit(reg: Words) -> float:
    """Return how many units of measure per s a speed of 1 is: whole units, tenths ... per minute or per second."""
    per_s = 1.0 if reg[at.UNITVEL] != 0 else 1.0 / _MINUTE
    return float(10.0 ** reg[at.DECPT] * per_s)


@exactly_compiled
def top_speed(reg: Words) -> float:
    """Return the speed of 10 V in units of measure per s."""
    return float(reg[at.MAXVEL] * speed_unit(reg))


@exactly_compiled
def edges_a_sample(reg: Words) -> float:
    """Return the encoder edges of a sample at full speed: the error that pgain 1000 makes 10 V of."""
    if reg[at.MEASURE] < 1:
        return 0.0
    return float(top_speed(reg) * reg[at.TCAMP_NS] * 1e-9 * reg[at.PULSE] / reg[at.MEASURE])


@exactly_compiled
def place(reg: Words) -> float:
    """Return the actual place in units of measure, with its fraction."""
    return float(reg[at.NUMERATOR] / reg[at.PULSE]) if reg[at.PULSE] > 0 else 0.0


@exactly_compiled
def check_resolution(reg: Words, real: Reals) -> None:
    """Raise an error for a resolution that the device cannot work with (row Q-A1)."""
    if not (reg[at.PULSE] > 0 and _FINEST * reg[at.PULSE] <= reg[at.MEASURE] <= _COARSEST * reg[at.PULSE]):
        fail(reg, real, at.BAD_RESOLUTION, 0)


@exactly_compiled
def take_edges(reg: Words, edges: int) -> None:
    """Count some encoder edges."""
    reg[at.ENCODER] += edges
    reg[at.NUMERATOR] += edges * reg[at.MEASURE]
    if reg[at.PULSE] > 0:
        reg[at.POSIT] = reg[at.NUMERATOR] // reg[at.PULSE]


@exactly_compiled
def slopes(reg: Words) -> tuple[float, float]:
    """Return the inverse slopes of the ramps as they are set (rows Q-29, Q-39)."""
    up, down = (reg[at.TACC], reg[at.TDEC]) if reg[at.RAMPMODE] != 0 else (reg[at.TACCDEC], reg[at.TACCDEC])
    top = top_speed(reg)
    return slope_of(up * 0.01, top), slope_of(down * 0.01, top)


@exactly_compiled
def catch_up(reg: Words, real: Reals) -> None:
    """Set the theoretical position to the actual one; then a closing loop makes no jump (row Q-62)."""
    ahead = real[at.THEORY] - place(reg)
    real[at.INTEGRAL], reg[at.LAST_ERROR] = 0.0, 0
    _slide(real, -ahead)
    if _is_bound(reg) and not _aim(reg, real, _goal(reg, real)):
        brake(reg, real)


@exactly_compiled
def _is_bound(reg: Words) -> bool:
    """Say whether the axis moves to a goal that it has to stop at: a target or a limit."""
    return bool(reg[at.MOVE] == at.PLACING or reg[at.MOVE] == at.JOGGING)


@exactly_compiled
def _slide(real: Reals, by: float) -> None:
    real[at.THEORY] += by
    real[at.FROM] += by
    real[at.GOAL] += by


@exactly_compiled
def _end(reg: Words) -> int:
    """Return where a placement ends: at its target, within the software limits."""
    return int(min(max(reg[at.TARGET], reg[at.MINPOS]), reg[at.MAXPOS]))


@exactly_compiled
def _aim(reg: Words, real: Reals, end: float) -> bool:
    """Let a placement or a jog in motion end elsewhere; false, and no change, if the axis cannot stop there."""
    if keeps_first_ramp(reg, real):
        return lengthen(reg, real, reg[at.DIRECTION] * (end - real[at.FROM]))
    return plan(reg, real, reg[at.DIRECTION] * (end - real[at.THEORY]), reg[at.OLD_SETVEL] * speed_unit(reg))


@exactly_compiled
def start(reg: Words, real: Reals, target: int) -> None:
    """Move to a place at setvel, within the software limits; from the actual place where the loop is open."""
    if reg[at.ST_LOOPON] == 0:
        catch_up(reg, real)
    reg[at.TARGET], reg[at.HAS_TARGET] = target, 1
    travel(reg, real, float(_end(reg)))


@exactly_compiled
def travel(reg: Words, real: Reals, end: float) -> None:
    """Place an axis at rest at the target in execution, or where it has to end before."""
    reg[at.OLD_SETPOS], reg[at.OLD_SETVEL] = reg[at.SETPOS], reg[at.SETVEL]
    way = end - real[at.THEORY]
    if way == 0.0:
        return
    reg[at.ST_TOLL] = 0
    reg[at.SINCE_NS] = -1
    reg[at.MOVE], reg[at.ST_STILL] = at.PLACING, 0
    begin(reg, real, 1 if way > 0.0 else -1, slopes(reg))
    plan(reg, real, abs(way), reg[at.SETVEL] * speed_unit(reg))


@exactly_compiled
def jog(reg: Words, real: Reals, direction: int) -> None:
    """Move towards a software limit at setvel; beyond it the axis does not move."""
    if reg[at.ST_LOOPON] == 0:
        catch_up(reg, real)
    real[at.LIMIT] = reg[at.MAXPOS] if direction > 0 else reg[at.MINPOS]
    way = direction * (real[at.LIMIT] - real[at.THEORY])
    if way > 0.0:
        reg[at.OLD_SETVEL] = reg[at.SETVEL]
        reg[at.MOVE], reg[at.ST_STILL] = at.JOGGING, 0
        begin(reg, real, direction, slopes(reg))
        plan(reg, real, way, reg[at.SETVEL] * speed_unit(reg))


@exactly_compiled
def _epicycloid_ends(reg: Words) -> bool:
    """Say whether the axis is in a deceleration that is epicycloidal."""
    return bool(reg[at.ST_DEC] != 0 and (reg[at.RAMPTYPE] == 1 or reg[at.RAMPTYPE] == 2))


@exactly_compiled
def _goal(reg: Words, real: Reals) -> float:
    return float(_end(reg)) if reg[at.MOVE] == at.PLACING else real[at.LIMIT]


@exactly_compiled
def shift(reg: Words, real: Reals, numerator: int, always: bool) -> bool:
    """Put another count under the axis; False, unless `always`, where it cannot stop at its target any more."""
    by = (numerator - reg[at.NUMERATOR]) / reg[at.PULSE]
    bound = _is_bound(reg)
    if bound and not always and _epicycloid_ends(reg):
        return False
    _slide(real, by)
    if bound and not _aim(reg, real, _goal(reg, real)) and not always:
        _slide(real, -by)
        return False
    reg[at.NUMERATOR] = numerator
    reg[at.POSIT] = numerator // reg[at.PULSE]
    return True


@exactly_compiled
def retarget(reg: Words, real: Reals, target: int) -> bool:
    """Let a placement in motion end at another target; false, and no change, if the axis cannot stop there."""
    before = reg[at.TARGET]
    reg[at.TARGET] = target
    if _epicycloid_ends(reg) or not _aim(reg, real, float(_end(reg))):
        reg[at.TARGET] = before
        return False
    return True


@exactly_compiled
def _take_setpos(reg: Words, real: Reals) -> None:
    if reg[at.MOVE] == at.PLACING and not retarget(reg, real, reg[at.SETPOS]):
        reg[at.SETPOS] = reg[at.OLD_SETPOS]
        warn(reg, at.NOT_WRITTEN, at.SETPOS)
    reg[at.OLD_SETPOS] = reg[at.SETPOS]


@exactly_compiled
def _take_setvel(reg: Words, real: Reals) -> None:
    if _is_bound(reg):
        before = reg[at.OLD_SETVEL]
        reg[at.OLD_SETVEL] = reg[at.SETVEL]
        if reg[at.ST_DEC] != 0 or not _aim(reg, real, _goal(reg, real)):
            reg[at.SETVEL] = before
            warn(reg, at.NOT_WRITTEN, at.SETVEL)
    reg[at.OLD_SETVEL] = reg[at.SETVEL]


@exactly_compiled
def _take_ramps(reg: Words, real: Reals) -> None:
    """Put new ramp times into execution if the axis can still stop at its target with them."""
    if _is_bound(reg) and not in_last_ramp(reg, real):
        up, down = real[at.UP_SLOPE], real[at.DOWN_SLOPE]
        real[at.UP_SLOPE], real[at.DOWN_SLOPE] = slopes(reg)
        if not _aim(reg, real, _goal(reg, real)):
            real[at.UP_SLOPE], real[at.DOWN_SLOPE] = up, down


@exactly_compiled
def take_writes(reg: Words, real: Reals) -> None:
    """Take parameters written since the last sample; speeds and ramp times wait for the end of a first ramp."""
    written = reg[at.WRITTEN]
    reg[at.WRITTEN] = 0
    if written & at.NEW_RESOLUTION:
        check_resolution(reg, real)
        if reg[at.PULSE] > 0:
            shift(reg, real, reg[at.POSIT] * reg[at.PULSE], True)
    if written & at.NEW_POSIT and reg[at.PULSE] > 0:
        target = reg[at.POSIT]
        reg[at.POSIT] = reg[at.NUMERATOR] // reg[at.PULSE]
        if not shift(reg, real, target * reg[at.PULSE], False):
            warn(reg, at.NOT_WRITTEN, at.POSIT)
    if written & at.NEW_SETPOS:
        _take_setpos(reg, real)
    if _is_bound(reg) and keeps_first_ramp(reg, real):
        reg[at.WRITTEN] = written & (at.NEW_SETVEL | at.NEW_RAMPS)
        return
    if written & at.NEW_SETVEL:
        _take_setvel(reg, real)
    if written & at.NEW_RAMPS:
        _take_ramps(reg, real)


@exactly_compiled
def refuse(reg: Words, command: int) -> None:
    """Note that a command's conditions failed; the value is its number in order of priority, from 1 (ours)."""
    warn(reg, at.NOT_EXECUTED, command + 1)
