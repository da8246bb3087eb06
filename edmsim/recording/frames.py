"""The wire's shape over the cut, thinned so that a cut of any length keeps only so many frames."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray


class Frames:
    """Every `stride`-th window's wire shape; the stride doubles whenever the store is full.

    What is kept depends only on the number of windows seen, so equal cuts keep equal frames.

    Parameters
    ----------
    n_slices : int
        Slices of the workpiece height, bottom first.
    capacity : int
        Most frames kept, at least 2.

    Attributes
    ----------
    stride : int
        Windows from one kept frame to the next.
    """

    def __init__(self, n_slices: int, capacity: int = 2000) -> None:
        if capacity < 2:
            raise ValueError(f"capacity {capacity} frames is too small, at least 2 are needed")
        self.n_slices = n_slices
        self.capacity = capacity
        self.stride = 1
        self._seen = 0
        self._used = 0
        self._rows: NDArray[np.float64] = np.empty((capacity, 4 + 2 * n_slices))

    def __len__(self) -> int:
        """Return the number of frames kept."""
        return self._used

    def offer(
        self, t_s: float, x_um: float, y_um: float, path_um: float, deflection_um: NDArray[np.float64]
    ) -> None:
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
        """
        if self.wants_next and self._used == self.capacity:
            self._halve()
        if self.wants_next:
            row = self._rows[self._used]
            row[0], row[1], row[2], row[3] = t_s, x_um, y_um, path_um
            row[4:] = deflection_um.ravel()
            self._used += 1
        self._seen += 1

    @property
    def wants_next(self) -> bool:
        """Whether the next window's turn has come; if not, it may as well be passed over with `skip`."""
        return self._seen % self.stride == 0

    def skip(self) -> None:
        """Let a window pass whose turn has not come."""
        self._seen += 1

    def _halve(self) -> None:
        kept = self._rows[: self._used : 2].copy()
        self._rows[: len(kept)] = kept
        self._used = len(kept)
        self.stride *= 2

    @property
    def t_s(self) -> NDArray[np.float64]:
        """Machine time of every frame in s, shape (n,)."""
        return self._rows[: self._used, 0]

    @property
    def guides_um(self) -> NDArray[np.float64]:
        """Wire guides on the table in um, shape (n, 2)."""
        return self._rows[: self._used, 1:3]

    @property
    def path_um(self) -> NDArray[np.float64]:
        """Place along the wire path in um, shape (n,)."""
        return self._rows[: self._used, 3]

    @property
    def deflection_um(self) -> NDArray[np.float64]:
        """Wire minus guides in um, shape (n, n_slices, 2)."""
        return self._rows[: self._used, 4:].reshape(self._used, self.n_slices, 2)

    def snapshot(self) -> dict[str, NDArray[np.generic]]:
        """Return a copy of everything that changes, as arrays."""
        return {"rows": self._rows[: self._used].copy(), "progress": np.array([self._seen, self.stride])}

    def restore(self, state: Mapping[str, NDArray[np.generic]]) -> None:
        """Take back a `snapshot`.

        Raises
        ------
        ValueError
            If it was made with another number of slices or holds more frames than fit.
        """
        rows = np.asarray(state["rows"], np.float64)
        if len(rows) > self.capacity or rows.shape[1] != self._rows.shape[1]:
            raise ValueError(f"snapshot of shape {rows.shape} does not fit {self._rows.shape}")
        self._used = len(rows)
        self._rows[: self._used] = rows
        self._seen, self.stride = (int(v) for v in np.asarray(state["progress"], np.int64))
