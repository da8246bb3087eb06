"""Servo on the mean ignition delay: a wide gap ignites late.

Sources: ETH's open wire-EDM simulator SPARC, whose machines are controlled in proportion to the mean voltage or the
mean ignition delay; a monitor of wire-EDM turning that replaces the voltage by the mean delay over 200 ms
(doi:10.1177/0954405414543488). The integral part and the counting of shorts and opens are ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from edmsim.controllers.feed.gap_servo import Gains, ServoController
from edmsim.controllers.protocols import WindowObservation
from edmsim.controllers.pulse_counters import WINDOW_PULSES


@dataclass
class DelayController(ServoController):
    """Holds the mean ignition delay of all pulses at a reference.

    A short counts as ignited at once, an open pulse as one that waited `open_delay_us`; so the mean is there even
    where nothing ignites. Further parameters: see `ServoController`.

    Parameters
    ----------
    reference_us : float
        Mean delay held.
    proportional_um_s_us : float
        Feed per us above the reference, um/s.
    integral_um_s2_us : float
        Growth of the feed per us above the reference, um/s per s.
    open_delay_us : float
        What an open pulse counts as (ours: the on-time of the default setting, the least it can have waited).
    """

    name: ClassVar[str] = "delay"

    reference_us: float = 12.0
    proportional_um_s_us: float = 1.0
    integral_um_s2_us: float = 1.0
    open_delay_us: float = 30.0

    def gains(self) -> Gains:
        """How the servo answers."""
        return Gains(self.proportional_um_s_us, self.integral_um_s2_us, self.filter_s)

    def error(self, window: WindowObservation) -> float:
        """Microseconds above the reference."""
        ignited = WINDOW_PULSES - window.short - window.open
        waited = window.open * self.open_delay_us
        if ignited:  # without any the mean delay is none at all
            waited += ignited * window.mean_delay_us
        return waited / WINDOW_PULSES - self.reference_us
