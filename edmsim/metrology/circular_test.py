"""The circular test of ISO 230-4: how round, and how large, a circle is that two axes go round together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class CircularTest:
    """Where the table truly was on a circle, both ways round.

    Attributes
    ----------
    radius_mm : float
        As programmed.
    anticlockwise_um, clockwise_um : array (n, 2)
        Places from the programmed centre, at equal steps of the angle from +x on, both in anticlockwise order.
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
        ``hysteresis`` (H, the greatest difference of both ways), ``radial_high`` and ``radial_low`` (F) of both ways.
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
