"""What an ELCAM module stands between: axes whose places it reads, and a control that can be out of order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


class CamAxis(Protocol):
    """What ELCAM reads of an axis, in its unit; `auxiliary` is by a stepper's own encoder, if that is used."""

    @property
    def setpoint(self) -> float:
        """Its commanded place."""
        ...

    @property
    def actual(self) -> float:
        """Where it is."""
        ...

    @property
    def auxiliary(self) -> float | None:
        """Where its own encoder says a stepper is."""
        ...


@dataclass
class CamPlace:
    """An axis that is nothing but its places."""

    setpoint: float = 0.0
    actual: float = 0.0
    auxiliary: float | None = None


@dataclass
class ControlFaults:
    """Faults of the control to switch on."""

    rebooted: bool = False  # another program boots it while a table is loaded
    system: bool = False  # the same, seen later
    memory: bool = False  # the library cannot reach the tables' memory
