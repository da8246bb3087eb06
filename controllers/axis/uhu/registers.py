"""The UHU's registers: the words of ``DRIVE.reg`` that its loop and its dialogue share.

Imported as ``at``, so that ``reg[at.TARGET]`` is the setpoint.
"""

from __future__ import annotations

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
STREAM_ON, STREAM_WAIT = 34, 35  # whether the stream of tracking errors is on, and intervals since its last byte
