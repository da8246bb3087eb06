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
"""Interface of the plant for observers, which read the last window and change nothing."""


class Turn(NamedTuple):
    """One turn of the cycle: a window, and the motion of the wire in it."""

    window: PulseWindow  # results of the window
    time_ns: int  # machine time at the window's end
    feed_um_s: float  # feed at the window's end
    path_um: float  # path length travelled by the position counters, over all legs
    opposite: OppositePulses | None = None  # equalising pulses of the window, if the generator has them


class Observer(Protocol):
    """Observes a cut and changes nothing."""

    name: ClassVar[str]  # key of its snapshot in the checkpoint, unique among the observers of a cut

    def begin(self, plant: PlantView) -> None:
        """Observe the plant before the first window."""
        return

    def leg(self, points_um: NDArray[np.int64], start_um: float) -> None:
        """Observe the points (n, 2) of the leg that begins at `Turn.path_um` == `start_um`."""
        return

    def window(self, turn: Turn, plant: PlantView) -> None:
        """Observe a window after it ended."""

    def snapshot(self) -> Mapping[str, NDArray[Any]]:
        """Return a copy of the state as arrays."""

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Load a snapshot."""
