"""The servo processor module's registers: the words of ``DRIVE.reg`` that its loop and its dialogue share.

Imported as ``at``, so that ``reg[at.SETPOINT]`` is the setpoint.
"""

from __future__ import annotations

PARAMETERS = (
    ACCELERATION_FF, CLAMP, DERIVATIVE, ERROR_LIMIT, ERROR_SCALE, INTEGRAL, REGION, SCALE, DIVIDER, OFFSET,
    PROPORTIONAL, INTERVAL, VELOCITY_FF, MULTIPLIER, FILTER,
) = tuple(range(15))  # fmt: skip
"""A C D E F I J K L O P T V X Y: what S saves, as it was entered."""

SETTINGS = (
    GAIN_SCALE, STEP_SENSE, ENCODER_SENSE, REST_NS, SAVE_NS, LED_RUN_NS, LED_RECORDER_NS, LED_REPEAT_NS, LED_FLASH_NS,
) = tuple(range(15, 24))  # fmt: skip
"""The table ``law`` of ``models/drives/servo_module.toml``, in its order."""

CHIP = DUTY_CENTRE, GREATEST_CLAMP, BYTE_NS = tuple(range(24, 27))
"""Of its table ``chip``; the last is the time that a byte takes on the serial line."""

(
    STATUS, FRESH, SETPOINT, POSITION, ORIGIN, EDGES, ERROR, VELOCITY, COMMANDED, LAST_SETPOINT, LAST_POSITION,
    LAST_ERROR, ACCUMULATED, TICK, OUTPUT, DUTY, LIMIT, PEAK, NOW_NS, MOVED_NS, SAVED_FROM_NS, SAVING, CODE, RECORDED,
    DUMPING, DUMPED, LINE_FREE_NS, RELEASING,
) = range(27, 55)  # fmt: skip
"""State of the loop: counts, counts per cycle, duty counts, and times of the plant's clock. ``FRESH`` lasts from
power-up to the first cycle; ``ORIGIN`` is what the encoder's counter showed where the position is 0, ``ACCUMULATED``
the integral times ``GAIN_SCALE``, ``SAVING`` whether the EEPROM is being written, ``CODE`` that of the recorder,
``RECORDED`` the cycles since its trigger; ``DUMPING`` the line of its memory being sent, counted from 1, 0 for none,
``DUMPED`` the characters sent of it, and ``LINE_FREE_NS`` when the serial line takes the next. ``RELEASING`` is set
for the cycle in which the fault output is let go, which may be what holds the fault input low."""

IMAGE, N_IMAGE = 64, 62
"""The bytes that a save writes, eight to a word: 15 parameters and a checksum in their code
(`edmsim.controllers.axis.eeprom`). Words from 96 on are those of `edmsim.controllers.axis.extensions`."""
N_MEMORY = 128  # words of the recorder's memory (row M-A4)

FAULT_BIT, FOLLOWING_BIT, EXTERNAL_BIT = 1 << 0, 1 << 1, 1 << 2
RECORDER_BIT, TRIGGERED_BIT, SATURATED_BIT, NEGATIVE_BIT = 1 << 7, 1 << 8, 1 << 10, 1 << 11
RECEIVE_BIT, TRANSMIT_BIT = 1 << 14, 1 << 15  # bits of ``STATUS`` (guide 4.6.8)
CLEARED_BY_RESET = FAULT_BIT | FOLLOWING_BIT | EXTERNAL_BIT | SATURATED_BIT | RECEIVE_BIT | TRANSMIT_BIT
"""Guide 4.14: "all internal error flags" and the saturation flag (row M-A15)."""
NO_ERROR_LIMIT = 32767  # guide 4.4: an error limit above this one never trips
