"""Fleet: several plants advanced side by side by one compiled call per thread."""

import functools
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.plant.kernel.memory import CALL
from edmsim.plant.kernel.state import BROKEN, FINE, NO_TILES, STATE, STEP_EARLY, STEP_WRONG, WINDOW
from edmsim.plant.plant import Plant

_LEAST_PLANTS = 4  # least number of plants per thread (ours): waking a thread takes a large part of a window


class Fleet:
    """Plants of one resolution and mechanics; a plant's bits depend neither on the others nor on the threads."""

    def __init__(self, plants: Sequence[Plant], threads: int = 1) -> None:
        kinds = {(plant.resolution, plant.mechanics) for plant in plants}
        if len(kinds) != 1:
            raise InputError("a fleet needs plants of one resolution and one mechanics")
        self.plants = list(plants)
        self.threads = threads
        self.states: NDArray[np.void] = np.zeros(len(plants), STATE)  # (n,) `STATE` of every plant
        self.windows: NDArray[np.void] = np.zeros(len(plants), WINDOW)  # (n,) `WINDOW`: last window of every plant
        self._calls = np.zeros((len(plants), CALL), np.int64)
        self._calls[:, 3] = WINDOW_PULSES
        self.make_room(8)  # motor steps of most windows
        for i, plant in enumerate(plants):
            plant.move_rows(self.states[i : i + 1], self.windows[i : i + 1])
            self._calls[i, 0] = plant.address
        self._pool: ThreadPoolExecutor | None = None
        self._pool_process = 0  # process that has its threads

    def make_room(self, most: int) -> None:
        """Allocate room for more motor steps per window; present ones are lost."""
        # (n, most, 3): time, axis and direction of the steps of every plant's next window
        self.steps: NDArray[np.int64] = np.zeros((len(self.plants), most, 3), np.int64)
        self._calls[:, 1] = self.steps.ctypes.data + np.arange(len(self.plants)) * self.steps.strides[0]

    def advance(self, indices: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
        """Fire 255 pulses in plants (m,), with the first `counts` (n,) of `steps`; return the plants that failed."""
        calls = self._calls.take(indices, axis=0)  # several times faster than with an index
        calls[:, 2] = counts[indices]
        self._fire(calls)
        status = calls[:, 4]
        if not status.any():  # the usual case: all are `FINE`
            return indices[:0]
        lacking = np.flatnonzero(status == NO_TILES)
        if len(lacking):
            for k in lacking:
                self.plants[indices[k]].make_tiles()
            again = calls[lacking]
            self._fire(again)
            calls[lacking] = again
            if not status.any():
                return indices[:0]
        if np.any((status == STEP_WRONG) | (status == STEP_EARLY)):
            raise InputError("a motor step has a wrong axis or direction, or is out of order")
        for k in np.flatnonzero(status == BROKEN):
            plant = self.plants[indices[k]]
            raise plant.left_validity(BROKEN, plant.window())
        return np.asarray(indices[status != FINE])

    def _fire(self, calls: NDArray[np.int64]) -> None:
        if self.threads > 1 and self._pool_process != os.getpid():  # a forked process has no threads of its parent
            self._pool, self._pool_process = ThreadPoolExecutor(self.threads - 1, "edmsim-fleet"), os.getpid()
        threads = max(min(self.threads, len(calls) // _LEAST_PLANTS), 1)
        shares = iter(_shares(len(calls), threads))
        done = [self._pool.submit(self._take, calls, shares) for _ in range(threads - 1)] if self._pool else []
        self._take(calls, shares)
        for part in done:
            part.result()

    def _take(self, calls: NDArray[np.int64], shares: Iterator[tuple[int, int]]) -> None:
        """Fire shares of the plants one after another, until no thread has any left."""
        fire, address, row = self.plants[0].fire, calls.ctypes.data, calls.strides[0]
        for first, count in shares:
            fire(address + first * row, count)

    def close(self) -> None:
        """Shut down the threads."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool, self._pool_process = None, 0

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for a pickle or copy: the plants, and the number of threads."""
        return {"plants": self.plants, "threads": self.threads}

    def __setstate__(self, state: dict[str, Any]) -> None:
        Fleet.__init__(self, state["plants"], state["threads"])


@functools.cache
def _shares(plants: int, threads: int) -> tuple[tuple[int, int], ...]:
    """Return the first plant and size of each share, in falling sizes, so that threads end at about the same time."""
    shares, first = [], 0
    while first < plants:
        count = max((plants - first) // (2 * threads), 1) if threads > 1 else plants
        shares.append((first, count))
        first += count
    return tuple(shares)
