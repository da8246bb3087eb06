"""The wire's shape and the gas on it over the cut, thinned so that a cut of any length keeps only so many frames."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from edmsim.cosim.observers import Observer, PlantView, Turn
from edmsim.recording.thinned import Thinned, bytes_of


class Frames(Observer):
    """Every `stride`-th window's wire shape and gas; the stride doubles whenever the store is full.

    What is kept depends only on the number of windows seen, so equal cuts keep equal frames.

    Parameters
    ----------
    n_slices : int
        Slices of the workpiece height, bottom first.
    capacity : int
        Most frames kept, at least 2.

    Attributes
    ----------
    n_slices : int
    """

    name: ClassVar[str] = "frames"

    def __init__(self, n_slices: int, capacity: int = 2000) -> None:
        self.n_slices = n_slices
        kind = [
            ("t_s", "f8"), ("guides_um", "f8", 2), ("path_um", "f8"), ("deflection_um", "f8", (n_slices, 2)),
            ("coverage", "f4", (n_slices,)),
        ]  # fmt: skip
        self._row: NDArray[np.void] = np.zeros(1, np.dtype(kind))
        self._kept = Thinned(self._row.dtype, capacity)

    def __len__(self) -> int:
        """Return the number of frames kept."""
        return len(self._kept)

    @property
    def stride(self) -> int:
        """Windows from one kept frame to the next."""
        return self._kept.stride

    def window(self, turn: Turn, plant: PlantView) -> None:
        """See a window; it is kept if its turn has come."""
        if self._kept.wants_next:
            x_um, y_um = plant.commanded_um
            self.offer(
                turn.time_ns * 1e-9, x_um, y_um, turn.path_um, plant.deflections_um(), plant.coverage()
            )  # fmt: skip
        else:
            self._kept.skip()

    def offer(
        self, t_s: float, x_um: float, y_um: float, path_um: float, deflection_um: NDArray[np.float64],
        coverage: NDArray[np.float64],
    ) -> None:  # fmt: skip
        """Show one window; it is kept if its turn has come.

        Parameters
        ----------
        t_s : float
            Machine time at the end of the window.
        x_um, y_um : float
            Wire guides on the table.
        path_um : float
            Place along the wire path.
        deflection_um : float64 array (n_slices, 2)
            Wire minus guides, per slice from the bottom.
        coverage : float64 array (n_slices,)
            Share of the wire's front that gas covers, 0 to 1.
        """
        row = self._row[0]
        row["t_s"], row["guides_um"], row["path_um"], row["deflection_um"] = t_s, (x_um, y_um), path_um, deflection_um
        row["coverage"] = coverage
        self._kept.offer(bytes_of(self._row)[0])

    @property
    def t_s(self) -> NDArray[np.float64]:
        """Machine time of every frame in s, shape (n,)."""
        return np.asarray(self._kept.rows["t_s"])

    @property
    def guides_um(self) -> NDArray[np.float64]:
        """Wire guides on the table in um, shape (n, 2)."""
        return np.asarray(self._kept.rows["guides_um"])

    @property
    def path_um(self) -> NDArray[np.float64]:
        """Place along the wire path in um, shape (n,)."""
        return np.asarray(self._kept.rows["path_um"])

    @property
    def deflection_um(self) -> NDArray[np.float64]:
        """Wire minus guides in um, shape (n, n_slices, 2)."""
        return np.asarray(self._kept.rows["deflection_um"])

    @property
    def coverage(self) -> NDArray[np.float32]:
        """Share of the wire's front that gas covers, shape (n, n_slices)."""
        return np.asarray(self._kept.rows["coverage"])

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Everything that changes, as arrays; a copy."""
        return self._kept.snapshot()

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take back a `snapshot`; refuses one of another number of slices, or that holds more frames than fit."""
        self._kept.restore(state)
