"""The interface through which recorders observe every window of a cut."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from edmsim.machine.pulse_window import PulseWindow
from edmsim.plant.gap.generator import OppositePulses

if TYPE_CHECKING:
    from edmsim.plant.plant import Plant

PlantView: TypeAlias = "Plant"
"""The plant as observers have it: they read what it says of the window just over, and change nothing."""


class Turn(NamedTuple):
    """One turn of the cycle: a window, and how the wire was moved in it."""

    window: PulseWindow  # what happened in the gap
    time_ns: int  # machine time at the window's end
    feed_um_s: float  # feed in force at the window's end
    path_um: float  # length of path behind the wire by the position counters, over all legs
    opposite: OppositePulses | None = None  # equalising pulses of the window, if the generator gives any


class Observer(Protocol):
    """Looks on at a cut and changes nothing."""

    name: ClassVar[str]  # under this name its snapshot is part of the checkpoint; no two observers of a cut share one

    def begin(self, plant: PlantView) -> None:
        """See the plant before the first window."""
        return

    def leg(self, points_um: NDArray[np.int64], start_um: float) -> None:
        """See the points (n, 2) of the leg that begins where `Turn.path_um` is `start_um`."""
        return

    def window(self, turn: Turn, plant: PlantView) -> None:
        """See a window that is just over."""

    def snapshot(self) -> Mapping[str, NDArray[Any]]:
        """Everything that changes, as arrays; a copy."""

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue where `snapshot` was taken."""
