"""The UHU's recalculation, in whole numbers: an extended PID with feedback of speed and of speed's change.

Gains are 16-bit words of 8.8 fixed point (row U-12). The control variable is counted in units of T, of which 255 are
the full swing of the duty cycle, and carries eight more bits inside the loop. The log of the manual names a 16-bit
limiter and 16 x 16 multiplication; here nothing wraps: the error is limited to 16 bits, sums are of 64.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis.extensions import derive_command, feed_forward, holds_integrator, note_limit

P, I, D, H, X, T, N, E, M, O, C = range(11)  # noqa: E741
"""Registers of the parameters, in the order of the help text."""
SETTINGS = (
    CONTROL_FULL, INTEGRAL_DIVISOR, SPEED_DIVISOR, FILTER_OFFSET, STREAM_EVERY, STREAM_ZERO, CALCULATION_NS,
    INTERRUPT_NS, STEP_SENSE, ENCODER_SENSE,
) = tuple(range(11, 21))  # fmt: skip
"""Registers of what the manual leaves open, in the order of the table ``law`` in ``models/drives/uhu.toml``."""
(
    TARGET, LAST_EDGES, REFERENCE, POSITION, SPEED, CHANGE, INTEGRAL, CONTROL, LAST_ILLEGAL, LAST_INTERRUPTS,
    ZERO_COUNT,
) = range(21, 32)  # fmt: skip
"""What the loop remembers: setpoint in counts and the step edges in it, the reference that X holds back (counts times
SPEED_DIVISOR), position, speed and its change at the last sample, the integrator and the control variable (both
times 256), the illegal transitions counted in O, the encoder's edges that took time, and its count where the chip
counts 0."""
LATCHED, RESTART = 32, 33
"""Why the output is off, bits of what follows; and the reset that the next sample carries out."""
TRACKING, ERROR_INPUT, WATCHDOG, BAD_BANK = 1, 2, 4, 8
OWN_FAULTS = TRACKING | WATCHDOG | BAD_BANK
SOFT, HARD = 1, 2
STREAM_ON, STREAM_WAIT = 34, 35
"""Whether the stream of tracking errors is on, and intervals since its last byte."""

_ONE = 256
_LARGEST_ERROR = 32767
_LARGEST_WORD = 65535


@exactly_compiled
def take_steps(reg: NDArray[np.int64], edges: int) -> None:
    """Let the step edges since the last call move the setpoint, each by M + 1 counts (row U-22)."""
    reg[TARGET] += reg[STEP_SENSE] * (edges - reg[LAST_EDGES]) * (reg[M] + 1)
    reg[LAST_EDGES] = edges


@exactly_compiled
def restart(reg: NDArray[np.int64], edges: int, count: int, illegal: int) -> None:
    """Carry out a reset: the setpoint becomes the position, nothing of the motion before is left (row U-A25).

    A hard reset counts from 0 again.
    """
    if reg[RESTART] == HARD:
        reg[ZERO_COUNT] = reg[ENCODER_SENSE] * count
        reg[LAST_ILLEGAL] = illegal
    reg[RESTART] = 0
    reg[TARGET] = reg[POSITION] = reg[ENCODER_SENSE] * count - reg[ZERO_COUNT]
    reg[REFERENCE] = reg[TARGET] * reg[SPEED_DIVISOR]
    reg[LAST_EDGES] = edges
    reg[SPEED] = reg[CHANGE] = reg[INTEGRAL] = reg[CONTROL] = 0


@exactly_compiled
def judge(reg: NDArray[np.int64], illegal: int, error_input_low: bool) -> None:
    """Count false transitions of the encoder, and latch what shuts the output off (rows U-6, U-21, U-50).

    What its own error output does to the net is no news, and a motor that is off has nothing to follow.
    """
    reg[O] = min(reg[O] + illegal - reg[LAST_ILLEGAL], _LARGEST_WORD)
    reg[LAST_ILLEGAL] = illegal
    if error_input_low and reg[LATCHED] & OWN_FAULTS == 0:
        reg[LATCHED] |= ERROR_INPUT
    if reg[LATCHED] == 0 and abs(reg[TARGET] - reg[POSITION]) >= reg[E]:
        reg[LATCHED] |= TRACKING


@exactly_compiled
def measure(reg: NDArray[np.int64], count: int) -> None:
    """Take position, speed and speed's change, the first and second differences."""
    position = reg[ENCODER_SENSE] * count - reg[ZERO_COUNT]
    speed = position - reg[POSITION]
    reg[CHANGE], reg[SPEED], reg[POSITION] = speed - reg[SPEED], speed, position


@exactly_compiled
def control(reg: NDArray[np.int64], now_ns: int) -> int:
    """Return the control variable in units of T, -T to T.

    The reference follows the setpoint by X at most (row U-A29). The error counts proportionally and summed up, speed
    and its change count against it. The sum is limited to T, then smoothed by N.
    """
    behind = reg[TARGET] * reg[SPEED_DIVISOR] - reg[REFERENCE]
    reg[REFERENCE] += min(max(behind, -reg[X]), reg[X])
    reference = reg[REFERENCE] // reg[SPEED_DIVISOR]
    derive_command(reg, reference)
    error = reference - reg[POSITION]
    error = min(max(error, -_LARGEST_ERROR), _LARGEST_ERROR)
    most = min(reg[T], reg[CONTROL_FULL])
    limit = most * _ONE
    if not holds_integrator(reg, error):
        grown = reg[INTEGRAL] + reg[I] * error * _ONE // reg[INTEGRAL_DIVISOR]
        reg[INTEGRAL] = min(max(grown, -limit), limit)
    demand = reg[P] * error + reg[INTEGRAL] - reg[D] * reg[SPEED] - reg[H] * reg[CHANGE] + feed_forward(reg)
    note_limit(reg, now_ns, 1 if demand >= limit else -1 if demand <= -limit else 0)
    demand = min(max(demand, -limit), limit)
    reg[CONTROL] += (demand - reg[CONTROL]) * reg[N] // (reg[N] + reg[FILTER_OFFSET])
    return int(min(max((reg[CONTROL] + _ONE // 2) // _ONE, -most), most))


@exactly_compiled
def stream_byte(reg: NDArray[np.int64]) -> int:
    """Return the tracking error as a byte with bit 7 set, 0 when none is due (rows U-34 to U-36)."""
    if reg[STREAM_ON] == 0:
        return 0
    reg[STREAM_WAIT] += 1
    if reg[STREAM_WAIT] < reg[STREAM_EVERY]:
        return 0
    reg[STREAM_WAIT] = 0
    value = reg[STREAM_ZERO] + reg[TARGET] - reg[POSITION]
    return int(128 + min(max(value, 0), 127))
