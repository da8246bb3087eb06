"""What a controller may know before a cut begins: the set-up and the program."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from edmsim.machine.machine import Machine


@runtime_checkable
class KnowsSetup(Protocol):
    """A controller that is told the set-up, as an operator who reads the dials and the drawing tells it."""

    def set_up(self, machine: Machine, points_um: NDArray[Any]) -> None:
        """Take in the set-up and the corners (n, 2) of the path in um; called before `FeedController.reset`."""


def tell(controller: object, machine: Machine, points_um: NDArray[Any]) -> None:
    """Tell a controller the set-up if it wants to know it."""
    if isinstance(controller, KnowsSetup):
        controller.set_up(machine, np.asarray(points_um, np.float64))
