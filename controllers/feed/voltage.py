"""The classic servo on the mean gap voltage: ``v = K (U - U_ref)``, backwards on shorts.

Sources: US 4296302 (servo on average gap voltage and power), CA 1049621 (servo of a wire machine, 1976); the law
is the simplest of the classic machines. The integral part is ours (see `edmsim.controllers.feed.gap_servo`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from edmsim.controllers.feed.gap_servo import Gains, ServoController
from edmsim.controllers.protocols import WindowObservation


@dataclass
class VoltageController(ServoController):
    """Holds the mean gap voltage at a reference.

    The voltage is averaged over whole periods, pauses included, as a moving-coil meter would: the reference belongs
    to a duty factor. Further parameters: see `ServoController`.

    Parameters
    ----------
    reference_V : float
        Mean gap voltage held.
    proportional_um_s_V : float
        Feed per volt above the reference, um/s.
    integral_um_s2_V : float
        Growth of the feed per volt above the reference, um/s per s.
    """

    name: ClassVar[str] = "voltage"

    reference_V: float = 15.0
    proportional_um_s_V: float = 1.0
    integral_um_s2_V: float = 1.0

    def gains(self) -> Gains:
        """How the servo answers."""
        return Gains(self.proportional_um_s_V, self.integral_um_s2_V, self.filter_s)

    def error(self, window: WindowObservation) -> float:
        """Volts above the reference."""
        return window.mean_voltage_V - self.reference_V
