"""The interface through which recorders observe every window of a cut."""

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from edmsim.machine.machine import Machine
from edmsim.machine.pulse_window import PulseWindow
from edmsim.plant.gap.generator import OppositePulses
from edmsim.plant.kernel.state import Timing
from edmsim.plant.resolution import Resolution


class Turn(NamedTuple):
    """One turn of the cycle: a window, and how the wire was moved in it."""

    window: PulseWindow  # what happened in the gap
    time_ns: int  # machine time at the window's end
    feed_um_s: float  # feed in force at the window's end
    path_um: float  # length of path behind the wire by the position counters, over all legs
    opposite: OppositePulses | None = None  # equalising pulses of the window, if the generator gives any


class PlantView(Protocol):
    """What an observer may read of a plant; the values are those of the window just over."""

    @property
    def machine(self) -> Machine:
        """Set-up, with the generator's setting of that window."""

    @property
    def resolution(self) -> Resolution:
        """Slices and rays of the model."""

    @property
    def timing(self) -> Timing:
        """The generator's setting as the pulse loop has it."""

    @property
    def commanded_um(self) -> tuple[float, float]:
        """Position the motor steps add up to."""

    @property
    def following_error_um(self) -> tuple[float, float]:
        """How far x and y are behind it."""

    def deflections_um(self) -> NDArray[np.float64]:
        """Deflection of the wire, (slices, 2)."""

    def coverage(self) -> NDArray[np.float64]:
        """Share of the wire's front that gas covers, (slices,)."""

    def walls_um(self, slice_index: int) -> tuple[tuple[float, float], NDArray[np.float32]]:
        """Where a slice's wire was when its rays were last traced, and every ray's gap then."""

    def watch_pulses(self) -> None:
        """From the next window on, keep every pulse for `last_pulses`."""

    def last_pulses(self) -> NDArray[np.void]:
        """Return the pulses of the window, if they are watched."""


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
