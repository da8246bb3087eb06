"""What a drive reads of its axis at a sample: encoder, index mark, end switches."""

from __future__ import annotations

import math

import numpy as np

from edmsim.compiled.axis_rows import HIGH_END, LOW_END
from edmsim.compiled.jit import compiled
from edmsim.plant.kernel.state import Axes


@compiled
def read_axis(axes: Axes, axis: int, now_ns: int) -> None:
    """Read encoder, index and end switches of an axis at a time.

    The counter follows the encoder no faster than its input takes edges: what it is behind by then are edges it
    misses for good, so that a drive which outruns its encoder loses its place, as a real one does.
    """
    row, motor = axes.rows[axis], axes.motors[axis]
    true_count = math.floor((row.place_um - row.zero_um) * motor.counts_per_um + 0.5) - row.missed
    most = np.int64(motor.edge_rate_Hz * (now_ns - row.time_ns) * 1e-9)
    before = row.count
    row.count = min(max(true_count, before - most), before + most)
    row.missed += true_count - row.count
    mark = math.floor(row.place_um / motor.index_um)
    if mark != row.mark:
        row.indexes += abs(mark - row.mark)
        passed_um = (mark if mark > row.mark else mark + 1) * motor.index_um
        row.index_at = row.count - math.floor((row.place_um - passed_um) * motor.counts_per_um + 0.5)
        row.mark = mark
    row.ends = (LOW_END if row.place_um < row.low_um else 0) | (HIGH_END if row.place_um > row.high_um else 0)
    row.time_ns = now_ns
