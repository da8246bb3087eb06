"""The servo processor module's loop in whole numbers: PID with antidither and feed-forwards, trip and clamp.

With proportional gain 1250, an error of 10 counts makes 48 duty counts of 1024, 4.7 % of the supply.
The guide leaves the scale of gains open; here it is 1/256, like its other scales (row M-A9). The integral
accumulates its gain times the error, so a change of gain, as in the antidither region, does not shift the output. It
is limited to the clamp (ours: more can never act).
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis.extensions import (
    COMMAND,
    SATURATING,
    derive_command,
    feed_forward,
    holds_integrator,
    note_limit,
    start_command,
)  # fmt: skip
from edmsim.controllers.axis.servo_module import registers as at

Words: TypeAlias = NDArray[np.int64]
SCALE_ONE = 256  # K, F and the antidither bracket are in 1/256 (guide 4.5, 4.9)


@exactly_compiled
def wrapped(value: int, bits: int) -> int:
    """Return the lowest bits of a number, in two's complement."""
    half = 1 << (bits - 1)
    return ((value + half) & ((1 << bits) - 1)) - half


@exactly_compiled
def _report_saturation(reg: Words) -> None:
    """Set the flag that stays until R; a stopped loop has no output that could be saturated."""
    if reg[at.STATUS] & at.FAULT_BIT == 0:
        reg[at.STATUS] |= at.SATURATED_BIT


@exactly_compiled
def narrowed(reg: Words, value: int, bits: int) -> int:
    """Fit a number into a word: held at its limit and reported as saturated, or wrapped (row M-35)."""
    fits = wrapped(value, bits)
    if fits == value or reg[SATURATING] == 0:
        return fits
    _report_saturation(reg)
    limit = (1 << (bits - 1)) - 1
    return limit if value > 0 else -limit


@exactly_compiled
def towards_zero(value: int, divisor: int) -> int:
    """Divide, dropping what is less than one either way."""
    return value // divisor if value >= 0 else -(-value // divisor)


@exactly_compiled
def clamp_of(reg: Words) -> int:
    """Duty counts to either side that C allows; above the greatest it has no effect (guide 4.2)."""
    return int(min(reg[at.CLAMP], reg[at.GREATEST_CLAMP]))


@exactly_compiled
def put_duty(reg: Words, output: int) -> None:
    """Set output and duty: the offset comes behind the loop, the clamp behind the offset (row M-40)."""
    demand = output + reg[at.OFFSET]
    held = min(max(demand, -clamp_of(reg)), clamp_of(reg))
    if held != demand:
        _report_saturation(reg)
    note_limit(reg, reg[at.NOW_NS], (demand > held) - (demand < held))
    reg[at.OUTPUT] = output
    reg[at.DUTY] = reg[at.DUTY_CENTRE] + held


@exactly_compiled
def stop(reg: Words, cause: int) -> None:
    """Stop the loop; the cause is a bit of the status, or 0 (Q)."""
    reg[at.STATUS] |= at.FAULT_BIT | cause
    put_duty(reg, 0)


@exactly_compiled
def restart(reg: Words) -> None:
    """Start the loop where the motor is (guide 4.14), without memory of before."""
    reg[at.STATUS] &= ~at.CLEARED_BY_RESET
    reg[at.SETPOINT] = reg[at.POSITION]
    reg[at.LAST_SETPOINT] = reg[at.SETPOINT]
    reg[at.ERROR] = reg[at.LAST_ERROR] = reg[at.COMMANDED] = reg[at.ACCUMULATED] = reg[at.TICK] = reg[at.PEAK] = 0
    start_command(reg, reg[at.SETPOINT])
    reg[at.RELEASING] = 1
    put_duty(reg, 0)


@exactly_compiled
def _control(reg: Words, acceleration: int) -> int:
    """Return the output of a cycle in duty counts."""
    error = reg[at.ERROR]
    scale = reg[at.SCALE] if abs(error) <= reg[at.REGION] else SCALE_ONE
    reg[at.TICK] += 1
    if reg[at.TICK] >= reg[at.INTERVAL] and not holds_integrator(reg, error):
        reg[at.TICK] = 0
        most = clamp_of(reg) * reg[at.GAIN_SCALE]
        reg[at.ACCUMULATED] += reg[at.INTEGRAL] * scale // SCALE_ONE * error
        reg[at.ACCUMULATED] = min(max(reg[at.ACCUMULATED], -most), most)
    total = reg[at.PROPORTIONAL] * scale // SCALE_ONE * error + reg[at.ACCUMULATED]
    total += reg[at.DERIVATIVE] * scale // SCALE_ONE * (error - reg[at.LAST_ERROR])
    total += reg[at.VELOCITY_FF] * reg[at.COMMANDED] + reg[at.ACCELERATION_FF] * acceleration
    derive_command(reg, reg[COMMAND] + reg[at.COMMANDED])
    total += towards_zero(feed_forward(reg) * reg[at.GAIN_SCALE], SCALE_ONE)
    reg[at.LAST_ERROR] = error
    return narrowed(reg, towards_zero(narrowed(reg, total, 32), reg[at.GAIN_SCALE]), 16)


@exactly_compiled
def _measure(reg: Words) -> tuple[int, bool]:
    """Take error, velocities and limit; return the commanded acceleration, and whether the direction changed."""
    commanded = narrowed(reg, wrapped(reg[at.SETPOINT] - reg[at.LAST_SETPOINT], 32), 16)
    acceleration = commanded - reg[at.COMMANDED]
    reg[at.COMMANDED], reg[at.LAST_SETPOINT] = commanded, reg[at.SETPOINT]
    reg[at.VELOCITY] = wrapped(reg[at.POSITION] - reg[at.LAST_POSITION], 16)
    reg[at.LAST_POSITION] = reg[at.POSITION]
    reg[at.ERROR] = narrowed(reg, wrapped(reg[at.SETPOINT] - reg[at.POSITION], 32), 16)
    reg[at.LIMIT] = reg[at.ERROR_LIMIT] + abs(commanded) * reg[at.ERROR_SCALE] // SCALE_ONE
    before = reg[at.STATUS] & at.NEGATIVE_BIT
    if commanded != 0:
        reg[at.STATUS] = reg[at.STATUS] | at.NEGATIVE_BIT if commanded < 0 else reg[at.STATUS] & ~at.NEGATIVE_BIT
        reg[at.MOVED_NS] = reg[at.NOW_NS]
    return acceleration, bool(reg[at.STATUS] & at.NEGATIVE_BIT != before)


@exactly_compiled
def take_steps(reg: Words, edges: int) -> None:
    """Move the setpoint by the steps since the last call, each 1 + X counts (guide 4.18)."""
    steps = (edges - reg[at.EDGES]) * reg[at.STEP_SENSE]
    reg[at.SETPOINT] = wrapped(reg[at.SETPOINT] + steps * (1 + reg[at.MULTIPLIER]), 32)
    reg[at.EDGES] = edges


@exactly_compiled
def _take_count(reg: Words, count: int) -> None:
    """Read the encoder's counter, which is 0 at power-up."""
    count *= reg[at.ENCODER_SENSE]
    if reg[at.FRESH] != 0:
        reg[at.ORIGIN], reg[at.FRESH] = count, 0
    reg[at.POSITION] = wrapped(count - reg[at.ORIGIN], 32)


@exactly_compiled
def cycle(reg: Words, count: int, edges: int, fault: bool, time_ns: int) -> tuple[bool, bool]:
    """Run the loop on the counters of encoder and steps; returns whether it ran, and whether it changed direction."""
    reg[at.NOW_NS] = time_ns
    take_steps(reg, edges)
    _take_count(reg, count)
    if reg[at.SAVING] != 0:
        if time_ns - reg[at.SAVED_FROM_NS] < reg[at.SAVE_NS]:
            return False, False
        reg[at.SAVING] = 0
    acceleration, turned = _measure(reg)
    if reg[at.STATUS] & at.FAULT_BIT != 0:
        return False, turned
    reg[at.PEAK] = max(reg[at.PEAK], abs(reg[at.ERROR]))
    if fault and reg[at.RELEASING] == 0:
        stop(reg, at.EXTERNAL_BIT)
    elif reg[at.ERROR_LIMIT] <= at.NO_ERROR_LIMIT and abs(reg[at.ERROR]) > reg[at.LIMIT]:
        stop(reg, at.FOLLOWING_BIT)
    else:
        put_duty(reg, _control(reg, acceleration))
    reg[at.RELEASING] = 0
    return reg[at.STATUS] & at.FAULT_BIT == 0, turned
