"""Speed of servo drives and of the positioner on their bench: their figures in ``edmsim bench``."""

from __future__ import annotations

import time

from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis import CHIPS, tuned

SPAN_S = 1.0
"""Simulated time of a run."""
REPEATS = 6
"""Runs per figure, whose best counts, as other programs use the computer too."""


def servo_realtime_factor() -> float:
    """Simulated seconds per second of the processor: the slower of two drives that move an axis to and fro."""
    return min(_factor(name) for name in CHIPS)


def positioner_realtime_factor() -> float:
    """Simulated seconds per second of the processor: an EANPOS at a sample of 1 ms that moves an axis to and fro."""
    return _factor("eanpos")


def _factor(name: str) -> float:
    bench = AxisBench({"x": tuned(name)})
    bench.run(0.1)
    best_s = float("inf")
    for _ in range(REPEATS):
        bench.steps("x", 100, 300.0, 3_000.0)
        bench.steps("x", -100, 300.0, 3_000.0)
        started = time.process_time()
        bench.run(SPAN_S)
        best_s = min(best_s, time.process_time() - started)
    return SPAN_S / best_s
