"""What a QEM EANPOS moves to: placements, jogs, changes in motion, and the count under them.

A change in motion is taken where the axis can still stop at its target with the ramps in execution (manual 1.4.2,
1.4.3). A count rewritten in motion shifts the theoretical place as well, so that the axis travels on by as much.
"""

from __future__ import annotations

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis.eanpos_profile import (
    begin,
    brake,
    in_last_ramp,
    keeps_first_ramp,
    lengthen,
    plan,
    slope_of,
    stopping_way,
)
from edmsim.controllers.axis.eanpos_registers import (
    BAD_RESOLUTION,
    DECPT,
    DEVICE,
    DIRECTION,
    DOWN_SLOPE,
    ENCODER,
    ERRCODE,
    ERRVALUE,
    FROM,
    GOAL,
    HAS_TARGET,
    HOME_PHASE,
    INTEGRAL,
    JOGGING,
    LAST_ERROR,
    LIMIT,
    MAXPOS,
    MAXVEL,
    MEASURE,
    MINPOS,
    MOVE,
    NEW_POSIT,
    NEW_RAMPS,
    NEW_RESOLUTION,
    NEW_SETPOS,
    NEW_SETVEL,
    NOT_EXECUTED,
    NOT_WRITTEN,
    NUMERATOR,
    OLD_SETPOS,
    OLD_SETVEL,
    PLACING,
    POSIT,
    PULSE,
    RAMPMODE,
    RAMPTYPE,
    SETPOS,
    SETVEL,
    SINCE_NS,
    SPEED,
    ST_DEC,
    ST_ERROR,
    ST_LOOPON,
    ST_PRSON,
    ST_STILL,
    ST_TOLL,
    ST_WARNING,
    TACC,
    TACCDEC,
    TARGET,
    TCAMP_NS,
    TDEC,
    THEORY,
    UNITVEL,
    UP_SLOPE,
    WRITTEN,
    WRNCODE,
    WRNVALUE,
    Reals,
    Words,
)

_FINEST, _COARSEST = DEVICE["finest_resolution"], DEVICE["coarsest_resolution"]
_MINUTE = 60.0


@exactly_compiled
def warn(reg: Words, code: int, value: int) -> None:
    """Raise a warning; the axis works on."""
    reg[ST_WARNING], reg[WRNCODE], reg[WRNVALUE] = 1, code, value


@exactly_compiled
def fail(reg: Words, real: Reals, code: int, value: int) -> None:
    """Raise an error: the axis comes to rest, a homing search ends, and nothing moves until RSERR."""
    if reg[ST_ERROR] == 0:
        reg[ST_ERROR], reg[ERRCODE], reg[ERRVALUE] = 1, code, value
    reg[HOME_PHASE] = reg[ST_PRSON] = 0
    brake(reg, real)


@exactly_compiled
def speed_unit(reg: Words) -> float:
    """Return how many units of measure per s a speed of 1 is: whole units, tenths ... per minute or per second."""
    per_s = 1.0 if reg[UNITVEL] != 0 else 1.0 / _MINUTE
    return float(10.0 ** reg[DECPT] * per_s)


@exactly_compiled
def top_speed(reg: Words) -> float:
    """Return the speed of 10 V in units of measure per s."""
    return float(reg[MAXVEL] * speed_unit(reg))


@exactly_compiled
def edges_a_sample(reg: Words) -> float:
    """Return the encoder edges of a sample at full speed: the error that pgain 1000 makes 10 V of."""
    if reg[MEASURE] < 1:
        return 0.0
    return float(top_speed(reg) * reg[TCAMP_NS] * 1e-9 * reg[PULSE] / reg[MEASURE])


@exactly_compiled
def can_move(reg: Words, speed: int) -> bool:
    """Say whether a move at a set speed has a meaning: neither it nor the output's scale is nought."""
    return speed > 0 and edges_a_sample(reg) >= 1.0


@exactly_compiled
def place(reg: Words) -> float:
    """Return the actual place in units of measure, with its fraction."""
    return float(reg[NUMERATOR] / reg[PULSE]) if reg[PULSE] > 0 else 0.0


@exactly_compiled
def check_resolution(reg: Words, real: Reals) -> None:
    """Raise an error for a resolution that the device cannot work with (row Q-A1)."""
    if not (reg[PULSE] > 0 and _FINEST * reg[PULSE] <= reg[MEASURE] <= _COARSEST * reg[PULSE]):
        fail(reg, real, BAD_RESOLUTION, 0)


@exactly_compiled
def take_edges(reg: Words, edges: int) -> None:
    """Count some encoder edges."""
    reg[ENCODER] += edges
    reg[NUMERATOR] += edges * reg[MEASURE]
    if reg[PULSE] > 0:
        reg[POSIT] = reg[NUMERATOR] // reg[PULSE]


@exactly_compiled
def slopes(reg: Words) -> tuple[float, float]:
    """Return the inverse slopes of the ramps as they are set (rows Q-29, Q-39)."""
    up, down = (reg[TACC], reg[TDEC]) if reg[RAMPMODE] != 0 else (reg[TACCDEC], reg[TACCDEC])
    top = top_speed(reg)
    return slope_of(up * 0.01, top), slope_of(down * 0.01, top)


@exactly_compiled
def catch_up(reg: Words, real: Reals) -> None:
    """Take the theoretical place from the actual one, so that a loop that closes makes no jump (row Q-62)."""
    ahead = real[THEORY] - place(reg)
    real[INTEGRAL], reg[LAST_ERROR] = 0.0, 0
    _slide(real, -ahead)
    if reg[MOVE] == PLACING and not _aim(reg, real, float(_end(reg))):
        brake(reg, real)


@exactly_compiled
def _slide(real: Reals, by: float) -> None:
    real[THEORY] += by
    real[FROM] += by
    real[GOAL] += by


@exactly_compiled
def _end(reg: Words) -> int:
    """Return where a placement ends: at its target, within the software limits."""
    return int(min(max(reg[TARGET], reg[MINPOS]), reg[MAXPOS]))


@exactly_compiled
def _aim(reg: Words, real: Reals, end: float) -> bool:
    """Let a placement or a jog in motion end elsewhere; false, and no change, if the axis cannot stop there."""
    if keeps_first_ramp(reg, real):
        return lengthen(reg, real, reg[DIRECTION] * (end - real[FROM]))
    return plan(reg, real, reg[DIRECTION] * (end - real[THEORY]), reg[OLD_SETVEL] * speed_unit(reg))


@exactly_compiled
def start(reg: Words, real: Reals, target: int) -> None:
    """Move to a place at setvel, within the software limits; from the actual place where the loop is open."""
    if reg[ST_LOOPON] == 0:
        catch_up(reg, real)
    reg[TARGET], reg[HAS_TARGET] = target, 1
    travel(reg, real, float(_end(reg)))


@exactly_compiled
def travel(reg: Words, real: Reals, end: float) -> None:
    """Place an axis at rest at the target in execution, or where it has to end before."""
    reg[OLD_SETPOS], reg[OLD_SETVEL] = reg[SETPOS], reg[SETVEL]
    way = end - real[THEORY]
    if way == 0.0:
        return
    reg[ST_TOLL] = 0
    reg[SINCE_NS] = -1
    reg[MOVE], reg[ST_STILL] = PLACING, 0
    begin(reg, real, 1 if way > 0.0 else -1, slopes(reg))
    plan(reg, real, abs(way), reg[SETVEL] * speed_unit(reg))


@exactly_compiled
def jog(reg: Words, real: Reals, direction: int) -> None:
    """Move towards a software limit at setvel; beyond it the axis does not move."""
    if reg[ST_LOOPON] == 0:
        catch_up(reg, real)
    real[LIMIT] = reg[MAXPOS] if direction > 0 else reg[MINPOS]
    way = direction * (real[LIMIT] - real[THEORY])
    if way > 0.0:
        reg[OLD_SETVEL] = reg[SETVEL]
        reg[MOVE], reg[ST_STILL] = JOGGING, 0
        begin(reg, real, direction, slopes(reg))
        plan(reg, real, way, reg[SETVEL] * speed_unit(reg))


@exactly_compiled
def _epicycloid_ends(reg: Words) -> bool:
    """Say whether the axis is in a deceleration that is epicycloidal."""
    return bool(reg[ST_DEC] != 0 and (reg[RAMPTYPE] == 1 or reg[RAMPTYPE] == 2))


@exactly_compiled
def _goal(reg: Words, real: Reals) -> float:
    return float(_end(reg)) if reg[MOVE] == PLACING else real[LIMIT]


@exactly_compiled
def shift(reg: Words, real: Reals, numerator: int, always: bool) -> bool:
    """Put another count under the axis: theoretical and actual place move alike.

    Parameters
    ----------
    numerator : int
        New position in 1 / pulse of a unit.
    always : bool
        Whether it must be taken even if the axis can no longer stop at its target; it ends where its ramp leads then.

    Returns
    -------
    bool
        False, and nothing is changed, where a move in motion could not end at its target any more.
    """
    by = (numerator - reg[NUMERATOR]) / reg[PULSE]
    moving = reg[MOVE] == PLACING or reg[MOVE] == JOGGING
    if moving and not always:
        way = reg[DIRECTION] * (_goal(reg, real) - real[THEORY] - by)
        if _epicycloid_ends(reg) or way < stopping_way(reg, real, real[SPEED]):
            return False
    reg[NUMERATOR] = numerator
    reg[POSIT] = numerator // reg[PULSE]
    _slide(real, by)
    if moving:
        _aim(reg, real, _goal(reg, real))
    return True


@exactly_compiled
def retarget(reg: Words, real: Reals, target: int) -> bool:
    """Let a placement in motion end at another target; false, and no change, if the axis cannot stop there."""
    before = reg[TARGET]
    reg[TARGET] = target
    if _epicycloid_ends(reg) or not _aim(reg, real, float(_end(reg))):
        reg[TARGET] = before
        return False
    return True


@exactly_compiled
def _take_setpos(reg: Words, real: Reals) -> None:
    if reg[MOVE] == PLACING and not retarget(reg, real, reg[SETPOS]):
        reg[SETPOS] = reg[OLD_SETPOS]
        warn(reg, NOT_WRITTEN, SETPOS)
    reg[OLD_SETPOS] = reg[SETPOS]


@exactly_compiled
def _take_setvel(reg: Words, real: Reals) -> None:
    if reg[MOVE] == PLACING or reg[MOVE] == JOGGING:
        before = reg[OLD_SETVEL]
        reg[OLD_SETVEL] = reg[SETVEL]
        if reg[ST_DEC] != 0 or not can_move(reg, reg[SETVEL]) or not _aim(reg, real, _goal(reg, real)):
            reg[SETVEL] = before
            warn(reg, NOT_WRITTEN, SETVEL)
    reg[OLD_SETVEL] = reg[SETVEL]


@exactly_compiled
def _take_ramps(reg: Words, real: Reals) -> None:
    """Put new ramp times into execution if the axis can still stop at its target with them."""
    if (reg[MOVE] == PLACING or reg[MOVE] == JOGGING) and not in_last_ramp(reg, real):
        up, down = real[UP_SLOPE], real[DOWN_SLOPE]
        real[UP_SLOPE], real[DOWN_SLOPE] = slopes(reg)
        if not _aim(reg, real, _goal(reg, real)):
            real[UP_SLOPE], real[DOWN_SLOPE] = up, down


@exactly_compiled
def take_writes(reg: Words, real: Reals) -> None:
    """Take parameters written since the last sample that act on a motion or on the count.

    Speeds and ramp times wait for the end of a first ramp that is not broken off.
    """
    written = reg[WRITTEN]
    reg[WRITTEN] = 0
    if written & NEW_RESOLUTION:
        check_resolution(reg, real)
        if reg[PULSE] > 0:
            shift(reg, real, reg[POSIT] * reg[PULSE], True)
    if written & NEW_POSIT and reg[PULSE] > 0:
        asked = reg[POSIT]
        reg[POSIT] = reg[NUMERATOR] // reg[PULSE]
        if not shift(reg, real, asked * reg[PULSE], False):
            warn(reg, NOT_WRITTEN, POSIT)
    if written & NEW_SETPOS:
        _take_setpos(reg, real)
    waits = keeps_first_ramp(reg, real) and (reg[MOVE] == PLACING or reg[MOVE] == JOGGING)
    if waits:
        reg[WRITTEN] = written & (NEW_SETVEL | NEW_RAMPS)
        return
    if written & NEW_SETVEL:
        _take_setvel(reg, real)
    if written & NEW_RAMPS:
        _take_ramps(reg, real)


@exactly_compiled
def refuse(reg: Words, command: int) -> None:
    """Note that a command's conditions failed; the value is its number in order of priority, from 1 (ours)."""
    warn(reg, NOT_EXECUTED, command + 1)
