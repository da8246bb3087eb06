"""What is added up over a cut."""

from __future__ import annotations

from dataclasses import dataclass

from edmsim.plant.window import PulseWindow


@dataclass
class Sums:
    """Pulses of each class, energy and voltage over time of a cut; all pulses count, those before a break as well."""

    short: int = 0
    open: int = 0
    spark: int = 0
    arc: int = 0
    energy: float = 0.0
    voltage_s: float = 0.0
    crater_um3: float = 0.0
    vibration2_pulses: float = 0.0

    def add(self, window: PulseWindow) -> None:
        """Add one window."""
        self.short += window.short
        self.open += window.open
        self.spark += window.spark
        self.arc += window.arc
        self.energy += window.energy_J
        self.voltage_s += window.mean_voltage_V * window.duration_ns * 1e-9
        self.crater_um3 += window.crater_um3
        self.vibration2_pulses += window.vibration2_um2 * window.pulses

    @property
    def pulses(self) -> int:
        """Pulses of all classes."""
        return self.short + self.open + self.spark + self.arc
