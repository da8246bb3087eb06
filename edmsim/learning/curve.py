"""A learning curve in words: from when on it rises.

>>> in_words([1_000, 2_000, 3_000, 4_000, 5_000], [0.0, 1.0, 0.0, 60.0, 100.0])
'flat until about 3,000 steps, then from 0 to 100'
>>> in_words([1_000, 2_000, 3_000], [5.0, 5.0, 4.0])
'flat to the end, 3,000 steps: from 5 to 4'
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

AT_ENDS = 10
"""Points of a curve's first and last part; their means say where it begins and ends (ours: single ones are noise)."""
RISEN = 0.2  # share of the whole rise from which on a curve has begun to rise (ours)
LEAST_RISE = 3.0  # least rise that counts, over the spread of the first part (ours)


def in_words(steps: Sequence[int], returns: Sequence[float]) -> str:
    """Say from when on a learning curve rises: mean returns (NaN before the first ended) over steps or decisions."""
    known = [(step, value) for step, value in zip(steps, returns, strict=True) if not math.isnan(value)]
    if not known:
        return "no episode has ended"
    at, values = (np.array(column, float) for column in zip(*known, strict=True))
    part = max(len(values) // AT_ENDS, 1)
    begin, end = float(np.median(values[:part])), float(np.median(values[-part:]))
    if end - begin <= LEAST_RISE * float(np.ptp(values[:part])) or end <= begin:
        return f"flat to the end, {at[-1]:,.0f} steps: from {begin:.0f} to {end:.0f}"
    below = np.flatnonzero(values < begin + RISEN * (end - begin))
    last = int(below[-1]) if len(below) else 0
    if last < part:
        return f"rising from the begin, from {begin:.0f} to {end:.0f}"
    digits = -max(int(math.log10(max(at[last], 1.0))) - 1, 0)
    return f"flat until about {round(at[last], digits):,.0f} steps, then from {begin:.0f} to {end:.0f}"
