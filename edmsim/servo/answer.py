"""What an axis does after a step of its setpoint, and what is read from it: overshoot, settling time, oscillation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_SWING_BACK, _LEAST_COUNTS, _RESTLESS_COUNTS = 0.08, 2.5, 2
"""What is no oscillation (ours): a swing back behind the overshoot up to a share of the step, or a few counts, which
are the encoder's and friction's; and an end that moves by no more than so many counts."""
_SETTLED_COUNTS = 1
"""The axis has settled when it stays this near: the encoder tells no more."""


class Answer(NamedTuple):
    """What is seen after a step or a move.

    Attributes
    ----------
    time_s : float64 array (n,)
        Times since then.
    error : int64 array (n,)
        Setpoint less position in counts; after a step, positive is short of the setpoint, whichever way it went.
    """

    time_s: NDArray[np.float64]
    error: NDArray[np.int64]

    def overshoot(self, counts: int) -> float:
        """Return how far it went beyond a step of so many counts, as a share of it; 0 if it did not."""
        return max(float(-self.error.min()) / counts, 0.0)

    @property
    def settling_s(self) -> float:
        """Time after which the error stays within a count; the whole time if it never does."""
        outside = np.flatnonzero(np.abs(self.error) > _SETTLED_COUNTS)
        return float(self.time_s[outside[-1]]) if len(outside) else 0.0

    @property
    def rms(self) -> float:
        """Root mean square of the error in counts."""
        return float(np.sqrt(np.mean(self.error.astype(np.float64) ** 2)))

    def oscillates(self, counts: int, most_overshoot: float) -> bool:
        """Return whether the answer to a step swings instead of going there and staying.

        Parameters
        ----------
        counts : int
            Size of the step.
        most_overshoot : float
            What of it an answer may go beyond.
        """
        end = self.error[len(self.error) * 3 // 4 :]
        if not len(end) or np.ptp(end) > _RESTLESS_COUNTS:
            return True
        there = np.flatnonzero(self.error <= 0)
        if not len(there):
            return False
        beyond = self.error[there[0] :]
        lowest = int(beyond.argmin())
        back = float(beyond[lowest:].max())
        too_far = float(-beyond[lowest]) > max(most_overshoot * counts, _LEAST_COUNTS)
        return too_far or back > max(_SWING_BACK * counts, _LEAST_COUNTS)
