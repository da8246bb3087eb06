"""Positioning of an axis as ISO 230-2 evaluates it: targets approached from both sides, several times.

Deviations are where the axis truly is less its target. A compensation table holds the opposite.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError

Floats = NDArray[np.float64]
COVERAGE = 2.0
"""Standard deviations on either side of a mean that repeatability and accuracy take in (ISO 230-2)."""


@dataclass(frozen=True)
class Positioning:
    """Deviations of an axis, and what follows from them; all in um but the targets.

    Attributes
    ----------
    targets_mm : array (targets,)
    up_um, down_um : array (runs, targets)
        Deviations where the target was approached from below and from above.
    """

    targets_mm: Floats
    up_um: Floats
    down_um: Floats

    def __post_init__(self) -> None:
        """Refuse what cannot be evaluated."""
        shape = self.up_um.shape
        if shape != self.down_um.shape or len(shape) != 2 or shape[1:] != self.targets_mm.shape or shape[0] < 2:
            raise InputError(f"deviations need two runs or more to every target either way, not a shape of {shape}")

    @property
    def mean_up_um(self) -> Floats:
        """Mean deviation of every target approached from below."""
        return np.asarray(self.up_um.mean(axis=0))

    @property
    def mean_down_um(self) -> Floats:
        """Mean deviation of every target approached from above."""
        return np.asarray(self.down_um.mean(axis=0))

    @property
    def spread_up_um(self) -> Floats:
        """Standard deviation of the runs to every target from below."""
        return np.asarray(self.up_um.std(axis=0, ddof=1))

    @property
    def spread_down_um(self) -> Floats:
        """Standard deviation of the runs to every target from above."""
        return np.asarray(self.down_um.std(axis=0, ddof=1))

    @property
    def mean_um(self) -> Floats:
        """Bidirectional mean deviation of every target."""
        return 0.5 * (self.mean_up_um + self.mean_down_um)

    @property
    def reversal_um(self) -> Floats:
        """Reversal value of every target: mean from below less mean from above."""
        return self.mean_up_um - self.mean_down_um

    def figures(self) -> dict[str, float]:
        """Return the figures of the standard by name, in um.

        ``accuracy`` (A), ``systematic`` (E), ``mean_range`` (M), ``reversal`` (B, the greatest), ``mean_reversal``,
        ``repeatability`` (R, bidirectional), ``repeatability_up`` and ``_down``.
        """
        up, down = self.mean_up_um, self.mean_down_um
        spread_up, spread_down = COVERAGE * self.spread_up_um, COVERAGE * self.spread_down_um
        high = np.maximum(up + spread_up, down + spread_down)
        low = np.minimum(up - spread_up, down - spread_down)
        both = np.maximum(spread_up + spread_down + np.abs(self.reversal_um), 2 * np.maximum(spread_up, spread_down))
        return {
            "accuracy": float(high.max() - low.min()),
            "systematic": float(np.maximum(up, down).max() - np.minimum(up, down).min()),
            "mean_range": float(np.ptp(self.mean_um)),
            "reversal": float(np.abs(self.reversal_um).max()),
            "mean_reversal": float(self.reversal_um.mean()),
            "repeatability": float(both.max()),
            "repeatability_up": float(2 * spread_up.max()),
            "repeatability_down": float(2 * spread_down.max()),
        }
