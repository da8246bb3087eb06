"""What is added up over a cut."""

from __future__ import annotations

from dataclasses import dataclass

from edmsim.plant.gap.equalising import OppositePulses
from edmsim.plant.window import PulseWindow


@dataclass
class Sums:
    """Pulses of each class, energy and voltage over time of a cut; all pulses count, those before a break as well."""

    # the voltage is that of the gap with its sign, equalising pulses included; their supply's energy is by
    # itself

    short: int = 0
    open: int = 0
    spark: int = 0
    arc: int = 0
    energy: float = 0.0
    voltage_s: float = 0.0
    crater_um3: float = 0.0
    vibration2_pulses: float = 0.0
    equalising_J: float = 0.0

    def add(self, window: PulseWindow, opposite: OppositePulses | None) -> None:
        """Add one window and its equalising pulses, if there are any."""
        duration_s = window.duration_ns * 1e-9
        net_V = window.mean_voltage_V if opposite is None else opposite.net_voltage_V
        self.short += window.short
        self.open += window.open
        self.spark += window.spark
        self.arc += window.arc
        self.energy += window.energy_J
        self.voltage_s += net_V * duration_s
        self.equalising_J += 0.0 if opposite is None else opposite.power_W * duration_s
        self.crater_um3 += window.crater_um3
        self.vibration2_pulses += window.vibration2_um2 * window.pulses

    @property
    def pulses(self) -> int:
        """Pulses of all classes."""
        return self.short + self.open + self.spark + self.arc
