"""The servo of the action `servo`: it holds a share of open pulses, and retracts from shorts.

It is the law of the controller `counts` without its processor. The error is the share of open pulses, less that of
short pulses, less the target. The feed is a proportional plus an integral part of the low-passed error.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.plant.kernel.state import ARC, OPEN, SHORT, SPARK

GAINS = (10.0, 30.0)  # feed in um/s per unit of the error, and its growth in um/s per s: those of `counts`
TARGET_SHARE = (0.0, 0.3)
"""Target shares of open pulses for actions of -1 and 1 (ours: from the narrowest gap to a wide one)."""
FILTER_S = 0.1
SHORTED_SHARE, PATIENCE_S = 0.5, 0.15
"""Share of short pulses from which a window is shorted, and time after which the wire retracts; as in `counts`."""
RETRACT_UM_S = 20.0  # greatest speed backwards, as in `counts`
INTEGRAL_SHARE = 0.5
"""Share of the integral that remains after a retract, as in the classic servos (`controllers.feed.law`)."""

SERVO = np.dtype(
    [
        ("target", "f8"),  # target share of open pulses less shorts
        ("error", "f8"),  # low-passed error
        ("integral_um_s", "f8"),  # integral part of the feed
        ("shorted_s", "f8"),  # time shorted
        ("retracting", "i8"),
        ("feed_um_s", "f8"),  # commanded feed
    ]
)
"""State of a servo."""


def begin(row: Any, feed_um_s: float) -> None:
    """Begin with a feed; `row` is a record of `SERVO`."""
    row["error"] = row["shorted_s"] = row["retracting"] = 0
    row["integral_um_s"] = row["feed_um_s"] = feed_um_s


def target_of(action: Any, bounds: tuple[float, float]) -> Any:
    """Return the targets for actions within -1..1: the ends of the range at -1 and 1."""
    low, high = bounds
    return low + (high - low) * (action + 1.0) / 2.0


@exactly_compiled
def respond(
    indices: NDArray[np.int64], servos: NDArray[np.void], windows: NDArray[np.void], limit_um_s: float,
    proportional: float, integral: float,
) -> None:
    """Update the servos of some sub-environments (m,) after a window each (n,), by the shares of its pulses."""
    for j in range(indices.shape[0]):
        i = indices[j]
        counts, duration_s = windows[i].counts, windows[i].duration_ns * 1e-9
        pulses = counts[SHORT] + counts[OPEN] + counts[SPARK] + counts[ARC]
        short = counts[SHORT] / pulses
        error = counts[OPEN] / pulses - short - servos[i].target
        shorted = short >= SHORTED_SHARE
        servos[i].shorted_s = servos[i].shorted_s + duration_s if shorted else 0.0
        if shorted and servos[i].shorted_s >= PATIENCE_S:
            servos[i].retracting = 1
            servos[i].feed_um_s = -min(RETRACT_UM_S, limit_um_s)
            continue
        if servos[i].retracting:
            servos[i].retracting = 0
            servos[i].error = error
            servos[i].integral_um_s *= INTEGRAL_SHARE
        servos[i].error -= math.expm1(-duration_s / FILTER_S) * (error - servos[i].error)
        grown = servos[i].integral_um_s + integral * servos[i].error * duration_s
        servos[i].integral_um_s = min(max(grown, 0.0), limit_um_s)
        feed = servos[i].integral_um_s + proportional * servos[i].error
        servos[i].feed_um_s = min(max(feed, -min(RETRACT_UM_S, limit_um_s)), limit_um_s)
