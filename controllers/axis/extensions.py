"""What a drive may do beyond its manual: opt-in settings of both chips, all of them 0 in compatible mode.

They are what LinuxCNC's components ``pid`` and ``encoder`` offer (its manual pages pid(9) and encoder(9); ideas, no
code): anti-windup, the time a loop has been saturated, the command's derivatives and three feed-forwards; and a recorder of
four channels that keeps what was before its trigger. The settings stand in registers `FIRST` to `LAST` of a drive's
record and are set by name, ``drive.extensions["anti_windup"] = 1``. A drive's sample calls `derive_command` and
`feed_forward`, asks `holds_integrator`, and tells `note_saturation` and `record_sample` what it did.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled

FIRST, LAST = 96, 127
"""Registers of both chips' records that are kept for this file."""
(
    ANTI_WINDUP, COMMAND_FILTER, VELOCITY_FEED_FORWARD, ACCELERATION_FEED_FORWARD, JERK_FEED_FORWARD, SATURATING,
    RECORDER_TRIGGER, RECORDER_LEVEL, RECORDER_BEFORE, RECORDER_EVERY,
) = range(FIRST, FIRST + 10)
COMMAND, VELOCITY, ACCELERATION, JERK, SATURATED_SINCE_NS, SATURATED_NS, SATURATED_SIGN = range(FIRST + 12, FIRST + 19)
"""The command of the last sample, its filtered derivatives in 1/256 counts per interval, and the saturation."""
RECORDED, RECORDER_WAIT, TRIGGERED_AT, RECORDED_COMMAND_SIGN, RECORDER_STATE = range(FIRST + 20, FIRST + 25)

PLACES = {
    "anti_windup": ANTI_WINDUP,
    "command_filter": COMMAND_FILTER,
    "velocity_feed_forward": VELOCITY_FEED_FORWARD,
    "acceleration_feed_forward": ACCELERATION_FEED_FORWARD,
    "jerk_feed_forward": JERK_FEED_FORWARD,
    "saturating_arithmetic": SATURATING,
    "recorder_trigger": RECORDER_TRIGGER,
    "recorder_level": RECORDER_LEVEL,
    "recorder_before": RECORDER_BEFORE,
    "recorder_every": RECORDER_EVERY,
}
"""Settings by name; -32768 to 32767 each."""
