"""Why a cut, an episode or a dialogue stops: the causes, a function that finds them, and limit switches.

The functions are compiled, because environments call them for every sub-environment.
"""

from enum import IntEnum
from typing import NamedTuple

from edmsim.compiled.jit import compiled


class StopCause(IntEnum):
    """Why a cut stopped."""

    RUNNING = 0
    FINISHED = 1
    """The end of the path, or of the leg passed to `stop_cause`."""
    WIRE_BREAK = 2
    LIMIT_SWITCH = 3
    PERSISTENT_SHORT = 4
    OUT_OF_RANGE = 5
    """The wire's deflection exceeds the range of the plant's model; `stop_cause` never returns it."""
    TIME_LIMIT = 6
    DRIVE_TRIP = 7
    """The drive of an axis reports a fault, most often a following error over its limit."""
    EMERGENCY_STOP = 8
    """Emergency stop; `stop_cause` never returns it."""


class Words(NamedTuple):
    """Names of a cause."""

    report: str  # in ``report.json``
    info: str  # in an environment's ``info["cause"]``
    episode: str  # in an evaluation
    level: str  # severity in rerun's terms: INFO, WARN, ERROR, CRITICAL


WORDS = {
    StopCause.RUNNING: Words("running", "running", "running", "INFO"),
    StopCause.FINISHED: Words("finished", "done", "finished", "INFO"),
    StopCause.WIRE_BREAK: Words("wire-break", "wire-break", "wire break", "CRITICAL"),
    StopCause.LIMIT_SWITCH: Words("limit-switch", "limit-switch", "jammed", "ERROR"),
    StopCause.PERSISTENT_SHORT: Words("persistent-short", "persistent-short", "jammed", "ERROR"),
    StopCause.OUT_OF_RANGE: Words("out-of-range", "out-of-range", "jammed", "ERROR"),
    StopCause.TIME_LIMIT: Words("time-limit", "time-limit", "time", "WARN"),
    StopCause.DRIVE_TRIP: Words("drive-trip", "drive-trip", "jammed", "ERROR"),
    StopCause.EMERGENCY_STOP: Words("emergency-stop", "emergency-stop", "stopped", "ERROR"),
}  # fmt: skip

(
    _RUNNING, _FINISHED, _WIRE_BREAK, _LIMIT_SWITCH, _PERSISTENT_SHORT, _, _TIME_LIMIT, _DRIVE_TRIP,
) = list(map(int, StopCause))[:8]  # fmt: skip


@compiled
def switches_open(place_um: float, travel_um: float, slack_um: float) -> int:
    """Return which end switch of an axis is open: -1 the lower, 0 none, 1 the upper; `slack_um` beyond the travel."""
    # the slack of a motor step allows reaching the ends themselves
    if -slack_um <= place_um <= travel_um + slack_um:
        return 0
    return 1 if place_um > 0.0 else -1


@compiled
def stop_cause(broken: bool, switch: bool, tripped: bool, shorted: bool, late: bool, leg_done: bool) -> int:
    """Return why the machine stops after a window, as a `StopCause`; of several causes the first one."""
    if broken:
        return _WIRE_BREAK
    if switch:
        return _LIMIT_SWITCH
    if tripped:
        return _DRIVE_TRIP
    if shorted:
        return _PERSISTENT_SHORT
    if late:
        return _TIME_LIMIT
    return _FINISHED if leg_done else _RUNNING
