"""What an ELCAM module stands between: axes whose places it reads, and a control that can be out of order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


class CamAxis(Protocol):
    """What ELCAM reads of an axis; places in the axis' unit.

    Attributes
    ----------
    auxiliary : float or None
        By a stepper's own encoder, where its system data say that it is used.
    """

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
    """ControlFaults of the control to switch on.

    Attributes
    ----------
    rebooted : bool
        Another program boots it while a table is loaded.
    system : bool
        The same, seen later.
    memory : bool
        The library cannot reach the tables' memory.
    """

    rebooted: bool = False
    system: bool = False
    memory: bool = False
