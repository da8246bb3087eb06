"""Sensors: what noise, converters and delay leave of what the gap shows."""

from __future__ import annotations

from dataclasses import dataclass

from edmsim.envs.arguments import within
from edmsim.numeric import keep_plain, whole_from


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """How the analogue quantities of a window are measured; the counts of pulses are digital, and exact.

    Attributes
    ----------
    noise_share : float
        Standard deviation of mean voltage, current and ignition delay, as a share of what each is divided by in the
        observation (ours: a moving-coil meter or an early converter holds some 1 %).
    bits : int
        Of the converters whose full scale that is, 1 to 16: 8, as every word of the machine of 1982 has. 0 for
        no steps.
    delay_steps : int
        Observations are as many steps old (none by default: the analyser of 1982 hands over its counts at the
        window's end).
    """

    noise_share: float = 0.01
    bits: int = 8
    delay_steps: int = 0

    def __post_init__(self) -> None:
        """Refuse what cannot be used."""
        keep_plain(self)
        within("noise_share", self.noise_share, 0.0, 1.0)
        whole_from("bits", self.bits, 0)
        within("bits", self.bits, 0, 16)
        whole_from("delay_steps", self.delay_steps, 0)

    @property
    def step(self) -> float:
        """Step of the converters, as a share of full scale; 0 for none."""
        return 1.0 / (2**self.bits - 1) if self.bits else 0.0


EXACT = Sensors(noise_share=0.0, bits=0)  # sensors that show what is
