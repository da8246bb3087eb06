"""The UHU's recalculation, in whole numbers: an extended PID with feedback of speed and of speed's change.

Gains are 16-bit words of 8.8 fixed point (row U-12). The control variable is in units of T, 255 of them for the full
range of the duty cycle, with eight more bits inside the loop. The manual's log names a 16-bit limiter and 16 x 16
multiplication; here nothing wraps: the error is limited to 16 bits, sums have 64.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis.extensions import derive_command, feed_forward, holds_integrator, note_limit
from edmsim.controllers.axis.uhu import registers as at

_ONE = 256
_LARGEST_ERROR = 32767
_LARGEST_WORD = 65535


@exactly_compiled
def take_steps(reg: NDArray[np.int64], edges: int) -> None:
    """Let the step edges since the last call move the setpoint, each by M + 1 counts (row U-22)."""
    reg[at.TARGET] += reg[at.STEP_SENSE] * (edges - reg[at.LAST_EDGES]) * (reg[at.M] + 1)
    reg[at.LAST_EDGES] = edges


@exactly_compiled
def restart(reg: NDArray[np.int64], edges: int, count: int, illegal: int) -> None:
    """Carry out a reset: the setpoint becomes the position (row U-A25); a hard reset counts from 0 again."""
    if reg[at.RESTART] == at.HARD:
        reg[at.ZERO_COUNT] = reg[at.ENCODER_SENSE] * count
        reg[at.LAST_ILLEGAL] = illegal
    reg[at.RESTART] = 0
    reg[at.TARGET] = reg[at.POSITION] = reg[at.ENCODER_SENSE] * count - reg[at.ZERO_COUNT]
    reg[at.REFERENCE] = reg[at.TARGET] * reg[at.SPEED_DIVISOR]
    reg[at.LAST_EDGES] = edges
    reg[at.SPEED] = reg[at.CHANGE] = reg[at.INTEGRAL] = reg[at.CONTROL] = 0


@exactly_compiled
def judge(reg: NDArray[np.int64], illegal: int, error_input_low: bool) -> None:
    """Count false transitions of the encoder, and latch what shuts the output off (rows U-6, U-21, U-50)."""
    reg[at.O] = min(reg[at.O] + illegal - reg[at.LAST_ILLEGAL], _LARGEST_WORD)
    reg[at.LAST_ILLEGAL] = illegal
    if error_input_low and reg[at.LATCHED] & at.OWN_FAULTS == 0:
        reg[at.LATCHED] |= at.ERROR_INPUT
    if reg[at.LATCHED] == 0 and abs(reg[at.TARGET] - reg[at.POSITION]) >= reg[at.E]:
        reg[at.LATCHED] |= at.TRACKING


@exactly_compiled
def measure(reg: NDArray[np.int64], count: int) -> None:
    """Take position, speed and speed's change, the first and second differences."""
    position = reg[at.ENCODER_SENSE] * count - reg[at.ZERO_COUNT]
    speed = position - reg[at.POSITION]
    reg[at.CHANGE], reg[at.SPEED], reg[at.POSITION] = speed - reg[at.SPEED], speed, position


@exactly_compiled
def control(reg: NDArray[np.int64], now_ns: int) -> int:
    """Return the control variable, -T to T; the reference follows the setpoint by X at most (row U-A29)."""
    behind = reg[at.TARGET] * reg[at.SPEED_DIVISOR] - reg[at.REFERENCE]
    reg[at.REFERENCE] += min(max(behind, -reg[at.X]), reg[at.X])
    reference = reg[at.REFERENCE] // reg[at.SPEED_DIVISOR]
    derive_command(reg, reference)
    error = reference - reg[at.POSITION]
    error = min(max(error, -_LARGEST_ERROR), _LARGEST_ERROR)
    most = min(reg[at.T], reg[at.CONTROL_FULL])
    limit = most * _ONE
    if not holds_integrator(reg, error):
        grown = reg[at.INTEGRAL] + reg[at.I] * error * _ONE // reg[at.INTEGRAL_DIVISOR]
        reg[at.INTEGRAL] = min(max(grown, -limit), limit)
    damping = reg[at.D] * reg[at.SPEED] + reg[at.H] * reg[at.CHANGE]
    demand = reg[at.P] * error + reg[at.INTEGRAL] - damping + feed_forward(reg)
    note_limit(reg, now_ns, 1 if demand >= limit else -1 if demand <= -limit else 0)
    demand = min(max(demand, -limit), limit)
    reg[at.CONTROL] += (demand - reg[at.CONTROL]) * reg[at.N] // (reg[at.N] + reg[at.FILTER_OFFSET])
    return int(min(max((reg[at.CONTROL] + _ONE // 2) // _ONE, -most), most))


@exactly_compiled
def stream_byte(reg: NDArray[np.int64]) -> int:
    """Return the tracking error as a byte with bit 7 set, 0 when none is due (rows U-34 to U-36)."""
    if reg[at.STREAM_ON] == 0:
        return 0
    reg[at.STREAM_WAIT] += 1
    if reg[at.STREAM_WAIT] < reg[at.STREAM_EVERY]:
        return 0
    reg[at.STREAM_WAIT] = 0
    value = reg[at.STREAM_ZERO] + reg[at.TARGET] - reg[at.POSITION]
    return int(128 + min(max(value, 0), 127))
