"""A machine's table as ISO 230 evaluates it: positioning of an axis (230-2), and the circular test (230-4).

Targets are approached from both sides, several times; deviations are where the axis truly is less its target, and a
compensation table holds the opposite. The circular test says how round, and how large, a circle is that two axes go
round together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError

Floats = NDArray[np.float64]
COVERAGE = 2.0  # standard deviations on either side of a mean that repeatability and accuracy take in (ISO 230-2)


@dataclass(frozen=True)
class Positioning:
    """Deviations of an axis and the standard's figures, in um; targets in mm.

    Attributes
    ----------
    targets_mm : array (targets,)
    up_um, down_um : array (runs, targets)
        Deviations at targets approached from below and from above.
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


@dataclass(frozen=True)
class CircularTest:
    """True places of the table on a circle, in both directions.

    Attributes
    ----------
    radius_mm : float
        Programmed.
    anticlockwise_um, clockwise_um : array (n, 2)
        Places from the programmed centre, at equal steps of the angle from +x, both in anticlockwise order.
    """

    radius_mm: float
    anticlockwise_um: Floats
    clockwise_um: Floats

    @property
    def angle_rad(self) -> Floats:
        """Programmed angle of every place."""
        return np.asarray(2 * np.pi * np.arange(len(self.anticlockwise_um)) / len(self.anticlockwise_um))

    def deviation_um(self, clockwise: bool = False) -> Floats:
        """Return the radius of every place about the least-squares centre, less the programmed one, in um."""
        places = self.clockwise_um if clockwise else self.anticlockwise_um
        return np.asarray(np.hypot(*(places - _centre(places)).T) - self.radius_mm * 1e3)

    def figures(self) -> dict[str, float]:
        """Return the figures of the standard by name, in um.

        ``circular_deviation`` and ``circular_deviation_clockwise`` (G, about the least-squares centre),
        ``hysteresis`` (H, largest difference of the directions), ``radial_high`` and ``radial_low`` (F) of both.
        """
        first, second = self.deviation_um(), self.deviation_um(clockwise=True)
        centre = 0.5 * (_centre(self.anticlockwise_um) + _centre(self.clockwise_um))
        radii = [np.hypot(*(places - centre).T) for places in (self.anticlockwise_um, self.clockwise_um)]
        about_programmed = np.concatenate([
            np.hypot(*places.T) - self.radius_mm * 1e3 for places in (self.anticlockwise_um, self.clockwise_um)
        ])  # fmt: skip
        return {
            "circular_deviation": float(np.ptp(first)),
            "circular_deviation_clockwise": float(np.ptp(second)),
            "hysteresis": float(np.abs(radii[0] - radii[1]).max()),
            "radial_high": float(about_programmed.max()),
            "radial_low": float(about_programmed.min()),
        }


def _centre(places: Floats) -> Floats:
    """Centre of the circle nearest to some places, by two steps of Gauss and Newton."""
    centre = places.mean(axis=0)
    for _ in range(2):
        away = places - centre
        radii = np.hypot(*away.T)
        normal = np.column_stack([away / radii[:, None], np.ones(len(places))])
        centre = centre + np.linalg.lstsq(normal, radii, rcond=None)[0][:2]
    return np.asarray(centre)
