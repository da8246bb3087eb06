"""Moves of a QEM EANPOS: positioning, jogs, changes in motion, and changes of the count.

A change in motion is accepted if the axis can still stop at its target with the present ramps (manual 1.4.2, 1.4.3).
A count changed in motion shifts the theoretical position too; the travel to the target changes by as much.
"""

import math

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis.eanpos import registers as at
from edmsim.controllers.axis.eanpos.registers import Reals, Words

# Speed profiles of a QEM EANPOS: a ramp, a constant speed and a ramp to rest, each evaluated in closed form.
# From 0 to 2000 units at 833 units/s with 1667 units/s^2 an axis moves for 2.9 s: 0.5 s up, 1.9 s at constant
# speed, 0.5 s down. A ramp is trapezoidal, epicycloidal (the manual's name for the cycloidal law of speed, row
# Q-40), or, beyond the manual, of limited jerk. All ramps are symmetrical about their middle: the mean speed is
# the mean of both ends, so one formula gives the travel. A change in motion makes a new profile from the present
# position and speed.

STRAIGHT, EPICYCLOID, STEEP_EPICYCLOID, JERK = range(4)
"""Laws of a ramp; a steep epicycloid takes the time of a straight ramp, and has twice its slope in the middle."""
_CLOSE = 1e-6  # distances are equal within this, in units: far below an edge
_HALVINGS = 60  # bisections to the last bit of a speed


@exactly_compiled
def slope_of(seconds: float, speed: float) -> float:
    """Return the inverse slope of a ramp that takes `seconds` from rest to a speed."""
    return seconds / speed if speed > 0.0 else 0.0


@exactly_compiled
def law_of(reg: Words, up: bool) -> int:
    """Return the law of a ramp: ramptype 1 is epicycloidal, 2 only in deceleration, 3 only in acceleration."""
    if reg[at.JERK_LIMIT] > 0:
        return JERK
    kind = reg[at.RAMPTYPE]
    if kind == 1 or kind == (3 if up else 2):
        return EPICYCLOID if reg[at.GRADIENT] != 0 else STEEP_EPICYCLOID
    return STRAIGHT


@exactly_compiled
def _ramp_s(change: float, slope: float, law: int, jerk: float) -> float:
    """Return the time of a ramp over a change of speed, 0 or more, with an inverse slope."""
    if law == JERK:
        if slope > 0.0 and change * slope * slope * jerk > 1.0:
            return change * slope + 1.0 / (slope * jerk)
        return 2.0 * math.sqrt(change / jerk)
    return change * slope * (2.0 if law == EPICYCLOID else 1.0)


@exactly_compiled
def _up_s(reg: Words, real: Reals, change: float) -> float:
    return float(_ramp_s(change, real[at.UP_SLOPE], reg[at.UP_LAW], float(reg[at.JERK_LIMIT])))


@exactly_compiled
def _down_s(reg: Words, real: Reals, change: float) -> float:
    return float(_ramp_s(change, real[at.DOWN_SLOPE], reg[at.DOWN_LAW], float(reg[at.JERK_LIMIT])))


@exactly_compiled
def stopping_distance(reg: Words, real: Reals, speed: float) -> float:
    """Return the distance of a ramp from a speed to rest."""
    return float(0.5 * speed * _down_s(reg, real, speed))


@exactly_compiled
def _distance_by(reg: Words, real: Reals, speed: float, peak: float) -> float:
    """Return the distance of the ramps from a speed up to a peak and down to rest."""
    return float(0.5 * (speed + peak) * _up_s(reg, real, peak - speed) + stopping_distance(reg, real, peak))


@exactly_compiled
def _peak(reg: Words, real: Reals, speed: float, top: float, distance: float) -> float:
    """Return the speed that ramps of the full slope reach on a distance too short for `top`."""
    if reg[at.UP_LAW] != JERK:
        up = real[at.UP_SLOPE] * (2.0 if reg[at.UP_LAW] == EPICYCLOID else 1.0)
        down = real[at.DOWN_SLOPE] * (2.0 if reg[at.DOWN_LAW] == EPICYCLOID else 1.0)
        return min(max(math.sqrt((2.0 * distance + speed * speed * up) / (up + down)), speed), top)
    low, high = speed, top
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if _distance_by(reg, real, speed, middle) < distance:
            low = middle
        else:
            high = middle
    return low


@exactly_compiled
def _put(
    real: Reals, top: float, first_s: float, even_s: float, last_s: float, distance: float, direction: int
) -> None:
    real[at.FROM], real[at.FIRST_SPEED], real[at.TOP_SPEED] = real[at.THEORY], real[at.SPEED], top
    real[at.FIRST_S], real[at.EVEN_S], real[at.LAST_S] = first_s, even_s, last_s
    real[at.GOAL] = real[at.THEORY] + direction * distance


@exactly_compiled
def plan(reg: Words, real: Reals, distance: float, top: float) -> bool:
    """Plan a profile over a distance (infinite in a search); False, without a change, if it is too short to stop."""
    speed, direction = real[at.SPEED], reg[at.DIRECTION]
    if distance < stopping_distance(reg, real, speed) - _CLOSE:
        return False
    reg[at.START_NS] = max(reg[at.NOW_NS], reg[at.START_NS])
    if top <= 0.0:
        _put(real, 0.0, _down_s(reg, real, speed), math.inf, 0.0, distance, direction)
        return True
    if speed > top:
        first_s, last_s = _down_s(reg, real, speed - top), _down_s(reg, real, top)
        even = distance - 0.5 * (speed + top) * first_s - 0.5 * top * last_s
        if even >= 0.0:
            _put(real, top, first_s, even / top, last_s, distance, direction)
            return True
        top = speed
    first_s, last_s = _up_s(reg, real, top - speed), _down_s(reg, real, top)
    even = distance - 0.5 * (speed + top) * first_s - 0.5 * top * last_s
    if even >= 0.0:
        _put(real, top, first_s, even / top, last_s, distance, direction)
        return True
    keeps_time = reg[at.RAMPTYPE] == 1 and reg[at.RTYPE] == 0 and reg[at.UP_LAW] != JERK
    if reg[at.MOVE] == at.PLACING and keeps_time and 2.0 * distance - speed * first_s > speed * (first_s + last_s):
        _put(real, (2.0 * distance - speed * first_s) / (first_s + last_s), first_s, 0.0, last_s, distance, direction)
        return True
    peak = _peak(reg, real, speed, top, distance)
    _put(real, peak, _up_s(reg, real, peak - speed), 0.0, _down_s(reg, real, peak), distance, direction)
    return True


@exactly_compiled
def since_s(reg: Words) -> float:
    """Return the time since the profile's begin, negative in a pause before it."""
    return float((reg[at.NOW_NS] - reg[at.START_NS]) * 1e-9)


@exactly_compiled
def in_first_ramp(reg: Words, real: Reals) -> bool:
    """Return whether the axis is in the profile's first ramp, which begins after a pause."""
    return bool(reg[at.MOVE] != at.RESTING and 0.0 <= since_s(reg) < real[at.FIRST_S])


@exactly_compiled
def in_last_ramp(reg: Words, real: Reals) -> bool:
    """Return whether the axis is in the ramp that ends at rest."""
    return bool(reg[at.MOVE] != at.RESTING and since_s(reg) >= real[at.FIRST_S] + real[at.EVEN_S])


@exactly_compiled
def keeps_first_ramp(reg: Words, real: Reals) -> bool:
    """Return whether the axis is in a first ramp that must be completed: any but a straight one."""
    law = reg[at.UP_LAW] if real[at.TOP_SPEED] >= real[at.FIRST_SPEED] else reg[at.DOWN_LAW]
    return in_first_ramp(reg, real) and law != STRAIGHT


@exactly_compiled
def lengthen(reg: Words, real: Reals, distance: float) -> bool:
    """Keep the first ramp and end the profile `distance` after its begin; False, without a change, if too short."""
    top = real[at.TOP_SPEED]
    last_s = _down_s(reg, real, top)
    even = distance - 0.5 * (real[at.FIRST_SPEED] + top) * real[at.FIRST_S] - 0.5 * top * last_s
    if even < -_CLOSE:
        return False
    real[at.EVEN_S], real[at.LAST_S] = max(even, 0.0) / top if top > 0.0 else math.inf, last_s
    real[at.GOAL] = real[at.FROM] + reg[at.DIRECTION] * distance
    return True


@exactly_compiled
def brake(reg: Words, real: Reals) -> None:
    """Stop the axis on its ramp; with ramptype 1 and stopt 0, a placement's first ramp is completed before."""
    if reg[at.MOVE] == at.RESTING:
        return
    rises = in_first_ramp(reg, real) and real[at.TOP_SPEED] > real[at.FIRST_SPEED]
    if rises and reg[at.MOVE] == at.PLACING and reg[at.RAMPTYPE] == 1 and reg[at.STOPT] == 0:
        distance = 0.5 * (real[at.FIRST_SPEED] + real[at.TOP_SPEED]) * real[at.FIRST_S]
        lengthen(reg, real, distance + stopping_distance(reg, real, real[at.TOP_SPEED]))
    elif not in_last_ramp(reg, real):
        speed = real[at.SPEED]
        reg[at.START_NS] = reg[at.NOW_NS]
        _put(real, speed, 0.0, 0.0, _down_s(reg, real, speed), stopping_distance(reg, real, speed), reg[at.DIRECTION])
    reg[at.MOVE] = at.ENDING


@exactly_compiled
def begin(reg: Words, real: Reals, direction: int, slopes: tuple[float, float]) -> None:
    """Prepare a move from rest: direction, pause if that has changed, and the ramps of the parameters."""
    reverses = direction != reg[at.DIRECTION] and reg[at.DIRECTION] != 0
    reg[at.DIRECTION], reg[at.ST_MOVDIR] = direction, 1 if direction < 0 else 0
    pause_ns = reg[at.TINVT] * 10_000_000 if reverses else 0
    reg[at.START_NS] = max(reg[at.NOW_NS], reg[at.STOPPED_NS] + pause_ns)
    real[at.UP_SLOPE], real[at.DOWN_SLOPE] = slopes
    reg[at.UP_LAW], reg[at.DOWN_LAW] = law_of(reg, True), law_of(reg, False)


@exactly_compiled
def _ramp(t: float, span: float, change: float, law: int, slope: float, jerk: float) -> tuple[float, float]:
    """Return the change of speed, and the distance beyond that at the first speed, at a time in a ramp."""
    if law == STRAIGHT:
        return change * t / span, 0.5 * change * t * t / span
    if law != JERK:
        s, turn = t / span, 2.0 * math.pi
        wave = math.cos(turn * s) - 1.0
        speed = change * (s - math.sin(turn * s) / turn)
        return speed, change * span * (0.5 * s * s + wave / (turn * turn))
    early = min(t, span - t)
    rise = span - abs(change) * slope if abs(change) * slope * slope * jerk > 1.0 else 0.5 * span
    signed = math.copysign(jerk, change)
    if early < rise:
        speed, distance = 0.5 * signed * early * early, signed * early**3 / 6.0
    else:
        steep = signed * rise
        speed = steep * (early - 0.5 * rise)
        distance = steep * (0.5 * early * early - 0.5 * rise * early + rise * rise / 6.0)
    if t > early:
        return change - speed, change * (t - 0.5 * span) + distance
    return speed, distance


@exactly_compiled
def _rest(reg: Words, real: Reals) -> None:
    real[at.SPEED] = 0.0
    reg[at.MOVE] = at.RESTING
    reg[at.ST_STILL] = 1
    reg[at.STOPPED_NS] = reg[at.NOW_NS]


@exactly_compiled
def follow(reg: Words, real: Reals) -> None:
    """Set theoretical position and speed, and the states of the motion, by the profile at the present time."""
    reg[at.ST_ACC] = reg[at.ST_DEC] = reg[at.ST_VCONST] = 0
    if reg[at.MOVE] == at.RESTING:
        return
    t, jerk = since_s(reg), float(reg[at.JERK_LIMIT])
    first, top, first_s, even_s = real[at.FIRST_SPEED], real[at.TOP_SPEED], real[at.FIRST_S], real[at.EVEN_S]
    distance = 0.0
    if t < 0.0:
        real[at.SPEED] = 0.0
    elif t < first_s:
        rises = top >= first
        law, slope = (reg[at.UP_LAW], real[at.UP_SLOPE]) if rises else (reg[at.DOWN_LAW], real[at.DOWN_SLOPE])
        change, more = _ramp(t, first_s, top - first, law, slope, jerk)
        real[at.SPEED], distance = first + change, first * t + more
        reg[at.ST_ACC if rises else at.ST_DEC] = 1
    elif t < first_s + even_s:
        real[at.SPEED] = top
        distance = 0.5 * (first + top) * first_s + top * (t - first_s)
        reg[at.ST_VCONST] = 1
    elif t < first_s + even_s + real[at.LAST_S]:
        since = t - first_s - even_s
        change, more = _ramp(since, real[at.LAST_S], -top, reg[at.DOWN_LAW], real[at.DOWN_SLOPE], jerk)
        real[at.SPEED] = top + change
        distance = 0.5 * (first + top) * first_s + top * (even_s + since) + more
        reg[at.ST_DEC] = 1
    else:
        real[at.THEORY] = real[at.GOAL]
        _rest(reg, real)
        return
    real[at.THEORY] = real[at.FROM] + reg[at.DIRECTION] * distance


@exactly_compiled
def break_off(reg: Words, real: Reals) -> None:
    """End the motion at once, without a ramp."""
    reg[at.ST_ACC] = reg[at.ST_DEC] = reg[at.ST_VCONST] = 0
    if reg[at.MOVE] != at.RESTING:
        _rest(reg, real)


_FINEST, _COARSEST = at.DEVICE["finest_resolution"], at.DEVICE["coarsest_resolution"]
_MINUTE = 60.0


@exactly_compiled
def warn(reg: Words, code: int, value: int) -> None:
    """Raise a warning; the axis continues."""
    reg[at.ST_WARNING], reg[at.WRNCODE], reg[at.WRNVALUE] = 1, code, value


@exactly_compiled
def fail(reg: Words, real: Reals, code: int, value: int) -> None:
    """Raise an error: the axis stops on its ramp, a homing search ends, and no move starts until RSERR."""
    if reg[at.ST_ERROR] == 0:
        reg[at.ST_ERROR], reg[at.ERRCODE], reg[at.ERRVALUE] = 1, code, value
    reg[at.HOME_PHASE] = reg[at.ST_PRSON] = 0
    brake(reg, real)


@exactly_compiled
def speed_unit(reg: Words) -> float:
    """Return the units of measure per s of a speed of 1: whole units, tenths ... per minute or per second."""
    per_s = 1.0 if reg[at.UNITVEL] != 0 else 1.0 / _MINUTE
    return float(10.0 ** reg[at.DECPT] * per_s)


@exactly_compiled
def top_speed(reg: Words) -> float:
    """Return the speed of 10 V in units of measure per s."""
    return float(reg[at.MAXVEL] * speed_unit(reg))


@exactly_compiled
def has_resolution(reg: Words) -> bool:
    """Return whether units of measure and edges can be converted; if not, the output has no scale and is 0 V."""
    return bool(reg[at.MEASURE] > 0 and reg[at.PULSE] > 0)


@exactly_compiled
def edges_a_sample(reg: Words) -> float:
    """Return the encoder edges per sample at full speed; with pgain 1000, this error makes 10 V."""
    if not has_resolution(reg):
        return 0.0
    return float(top_speed(reg) * reg[at.TCAMP_NS] * 1e-9 * reg[at.PULSE] / reg[at.MEASURE])


@exactly_compiled
def place(reg: Words) -> float:
    """Return the actual position in units of measure, with its fraction."""
    return float(reg[at.NUMERATOR] / reg[at.PULSE]) if reg[at.PULSE] > 0 else 0.0


@exactly_compiled
def check_resolution(reg: Words, real: Reals) -> None:
    """Raise an error for a resolution that the device cannot work with (row Q-A1)."""
    if not (reg[at.PULSE] > 0 and _FINEST * reg[at.PULSE] <= reg[at.MEASURE] <= _COARSEST * reg[at.PULSE]):
        fail(reg, real, at.BAD_RESOLUTION, 0)


@exactly_compiled
def take_edges(reg: Words, edges: int) -> None:
    """Add encoder edges to the count."""
    reg[at.ENCODER] += edges
    reg[at.NUMERATOR] += edges * reg[at.MEASURE]
    if reg[at.PULSE] > 0:
        reg[at.POSIT] = reg[at.NUMERATOR] // reg[at.PULSE]


@exactly_compiled
def slopes(reg: Words) -> tuple[float, float]:
    """Return the inverse slopes of the ramps of the parameters (rows Q-29, Q-39)."""
    up, down = (reg[at.TACC], reg[at.TDEC]) if reg[at.RAMPMODE] != 0 else (reg[at.TACCDEC], reg[at.TACCDEC])
    top = top_speed(reg)
    return slope_of(up * 0.01, top), slope_of(down * 0.01, top)


@exactly_compiled
def catch_up(reg: Words, real: Reals) -> None:
    """Set the theoretical position to the actual one, so that a closing loop makes no jump (row Q-62)."""
    ahead = real[at.THEORY] - place(reg)
    real[at.INTEGRAL], reg[at.LAST_ERROR] = 0.0, 0
    _slide(real, -ahead)
    if _is_bound(reg) and not _aim(reg, real, _goal(reg, real)):
        brake(reg, real)


@exactly_compiled
def _is_bound(reg: Words) -> bool:
    """Return whether the axis moves to a position at which it must stop: a target or a limit."""
    return bool(reg[at.MOVE] == at.PLACING or reg[at.MOVE] == at.JOGGING)


@exactly_compiled
def _slide(real: Reals, by: float) -> None:
    real[at.THEORY] += by
    real[at.FROM] += by
    real[at.GOAL] += by


@exactly_compiled
def _end(reg: Words) -> int:
    """Return the end of a placement: its target, clamped to the software limits."""
    return int(min(max(reg[at.TARGET], reg[at.MINPOS]), reg[at.MAXPOS]))


@exactly_compiled
def _aim(reg: Words, real: Reals, end: float) -> bool:
    """Change the end of a placement or a jog in motion; False, without a change, if the axis cannot stop there."""
    if keeps_first_ramp(reg, real):
        return lengthen(reg, real, reg[at.DIRECTION] * (end - real[at.FROM]))
    return plan(reg, real, reg[at.DIRECTION] * (end - real[at.THEORY]), reg[at.OLD_SETVEL] * speed_unit(reg))


@exactly_compiled
def start(reg: Words, real: Reals, target: int) -> None:
    """Move to a position at setvel, within the software limits; if the loop is open, from the actual position."""
    if reg[at.ST_LOOPON] == 0:
        catch_up(reg, real)
    reg[at.TARGET], reg[at.HAS_TARGET] = target, 1
    travel(reg, real, float(_end(reg)))


@exactly_compiled
def travel(reg: Words, real: Reals, end: float) -> None:
    """Move an axis at rest to `end`: the target in execution, or a limit before it."""
    reg[at.OLD_SETPOS], reg[at.OLD_SETVEL] = reg[at.SETPOS], reg[at.SETVEL]
    distance = end - real[at.THEORY]
    if distance == 0.0:
        return
    reg[at.ST_TOLL] = 0
    reg[at.SINCE_NS] = -1
    reg[at.MOVE], reg[at.ST_STILL] = at.PLACING, 0
    begin(reg, real, 1 if distance > 0.0 else -1, slopes(reg))
    plan(reg, real, abs(distance), reg[at.SETVEL] * speed_unit(reg))


@exactly_compiled
def jog(reg: Words, real: Reals, direction: int) -> None:
    """Move to a software limit at setvel; an axis beyond it does not move."""
    if reg[at.ST_LOOPON] == 0:
        catch_up(reg, real)
    real[at.LIMIT] = reg[at.MAXPOS] if direction > 0 else reg[at.MINPOS]
    distance = direction * (real[at.LIMIT] - real[at.THEORY])
    if distance > 0.0:
        reg[at.OLD_SETVEL] = reg[at.SETVEL]
        reg[at.MOVE], reg[at.ST_STILL] = at.JOGGING, 0
        begin(reg, real, direction, slopes(reg))
        plan(reg, real, distance, reg[at.SETVEL] * speed_unit(reg))


@exactly_compiled
def _epicycloid_ends(reg: Words) -> bool:
    """Return whether the axis is in an epicycloidal deceleration."""
    return bool(reg[at.ST_DEC] != 0 and (reg[at.RAMPTYPE] == 1 or reg[at.RAMPTYPE] == 2))


@exactly_compiled
def _goal(reg: Words, real: Reals) -> float:
    return float(_end(reg)) if reg[at.MOVE] == at.PLACING else real[at.LIMIT]


@exactly_compiled
def shift(reg: Words, real: Reals, numerator: int, always: bool) -> bool:
    """Change the count; False without a resolution or, unless `always`, if the axis could not stop at its end."""
    if reg[at.PULSE] <= 0:
        return False
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
    """Change the target of a placement in motion; False, without a change, if the axis cannot stop there."""
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
    """Use new ramp times if the axis can still stop at its target with them."""
    if _is_bound(reg) and not in_last_ramp(reg, real):
        up, down = real[at.UP_SLOPE], real[at.DOWN_SLOPE]
        real[at.UP_SLOPE], real[at.DOWN_SLOPE] = slopes(reg)
        if not _aim(reg, real, _goal(reg, real)):
            real[at.UP_SLOPE], real[at.DOWN_SLOPE] = up, down


@exactly_compiled
def take_writes(reg: Words, real: Reals) -> None:
    """Use parameters written since the last sample; speeds and ramp times wait for the end of a curved first ramp."""
    written = reg[at.WRITTEN]
    reg[at.WRITTEN] = 0
    if written & at.NEW_RESOLUTION:
        check_resolution(reg, real)
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
