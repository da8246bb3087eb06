"""A store of rows that never grows beyond a bound: the more rows are shown, the fewer of them are kept."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
"""Rows as bytes, (size,) or (n, size)."""


def bytes_of(rows: NDArray[np.void]) -> Bytes:
    """Look at rows (..., n) as bytes (..., n, size): numpy copies records field by field, twenty times as slowly."""
    return rows.view(np.uint8).reshape(*rows.shape, rows.itemsize)


class Thinned:
    """Every `stride`-th row; the stride doubles whenever the store is full.

    What is kept depends only on the number of rows shown, so equal cuts keep equal rows.

    Parameters
    ----------
    kind : dtype
        Of a row.
    capacity : int
        Most rows kept, at least 2.

    Attributes
    ----------
    stride : int
        Rows shown from one kept to the next.
    """

    def __init__(self, kind: np.dtype[np.void], capacity: int) -> None:
        if capacity < 2:
            raise ValueError(f"a capacity of {capacity} is too small, at least 2 rows are needed")
        self._rows = np.zeros(capacity, kind)
        self._bytes = bytes_of(self._rows)
        self.stride = 1
        self._seen = self._used = 0

    def __len__(self) -> int:
        """Return the number of rows kept."""
        return self._used

    @property
    def wants_next(self) -> bool:
        """Whether the next row's turn has come; if not, it may as well be passed over with `skip`."""
        return self._seen % self.stride == 0

    def skip(self) -> None:
        """Let a row pass whose turn has not come."""
        self._seen += 1

    def offer(self, row: Bytes) -> None:
        """Show one row, its bytes; it is kept if its turn has come."""
        if self.wants_next and self._used == len(self._rows):
            self._halve()
        if self.wants_next:
            self._bytes[self._used] = row
            self._used += 1
        self._seen += 1

    def _halve(self) -> None:
        kept = self._bytes[: self._used : 2].copy()
        self._used = len(kept)
        self._bytes[: self._used] = kept
        self.stride *= 2

    @property
    def rows(self) -> NDArray[np.void]:
        """Rows kept, (n,)."""
        return self._rows[: self._used]

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Everything that changes, as arrays; a copy."""
        return {"rows": self.rows.copy(), "progress": np.array([self._seen, self.stride])}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue where `snapshot` was taken.

        Raises
        ------
        ValueError
            If it holds rows of another type, or more than fit.
        """
        rows = state["rows"]
        if rows.dtype != self._rows.dtype or len(rows) > len(self._rows):
            raise ValueError(
                f"a snapshot of {len(rows)} rows of type {rows.dtype} does not fit {len(self._rows)} of type "
                f"{self._rows.dtype}"
            )
        self._used = len(rows)
        self._rows[: self._used] = rows
        self._seen, self.stride = (int(v) for v in state["progress"])
