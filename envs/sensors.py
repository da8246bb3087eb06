"""Sensors: noise, converters and delay of the measurements."""

from __future__ import annotations

from dataclasses import dataclass

from edmsim.envs.arguments import within
from edmsim.numeric import keep_plain, whole_from


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """Errors of the analogue measurements of a window; the counts of pulses are digital and exact.

    Attributes
    ----------
    noise_share : float
        Standard deviation of mean voltage, current and ignition delay, as a share of each one's divisor in the
        observation (ours: a moving-coil meter or an early converter has about 1 %).
    bits : int
        Resolution of the converters, 1 to 16; full scale is the same divisor. 8 is the word of the 1982 machine, 0 is
        without steps.
    delay_steps : int
        Age of observations in steps (0 by default: the 1982 analyser passes on its counts at the window's end).
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
