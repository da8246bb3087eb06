"""How much memory a process holds, and whether that grows."""

import gc
import os
from typing import NamedTuple

import numpy as np
from scipy import stats

BATCHES = 10
"""Stretches of a run whose growth is compared (ours): enough for an interval, and long."""
SETTLED = 0.2
"""Share of a run before which memory may still grow (ours): pools of libraries fill, code is loaded."""


def resident_bytes() -> int:
    """Return what this process holds in memory, after a collection."""
    gc.collect()
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGESIZE")


class Growth(NamedTuple):
    """How fast memory grows: the mean over a run, and the ends of its 95 % interval."""

    mean: float
    low: float
    high: float


def growth(at: list[float], held: list[float]) -> Growth:
    """Return how fast `held` grows along `at` once it has settled.

    The rest of the run is cut into stretches; their growths are taken as draws of one normal distribution (Student).

    Parameters
    ----------
    at : list of float
        Rising: time, or steps.
    held : list of float
        Bytes at these.
    """
    x, y = np.array(at), np.array(held)
    later = x >= x[0] + SETTLED * (x[-1] - x[0])
    x, y = x[later], y[later]
    ends = np.linspace(0, len(x) - 1, BATCHES + 1).round().astype(int)
    rates = np.diff(y[ends]) / np.diff(x[ends])
    half = float(stats.t.ppf(0.975, BATCHES - 1) * rates.std(ddof=1) / np.sqrt(BATCHES))
    return Growth(float(rates.mean()), float(rates.mean()) - half, float(rates.mean()) + half)
