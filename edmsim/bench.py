"""Speed of this machine: the figures of ``edmsim bench``."""

from __future__ import annotations

import subprocess
import sys
import time
from typing import TYPE_CHECKING

from .machine import Machine
from .plant.plant import Plant
from .plant.state import PULSES_PER_WINDOW

if TYPE_CHECKING:
    from rich.console import RenderableType

FEED_UM_S = 28.0
"""Feed of the straight cut that is timed: well into the metal, most pulses spark."""
SETTLE_WINDOWS = 400
"""Windows before timing, so that the wire cuts a full kerf."""
TIMED_WINDOWS = 1000
REPEATS = 3
_COLD = (
    "import edmsim\n"
    "plant = edmsim.Plant(edmsim.Machine.load(), seed=0)\n"
    "plant.advance()\n"
)


def pulses_per_s(resolution: str) -> float:
    """Pulses per second of one core in a straight cut; the best of three runs, as others use the machine too."""
    plant = Plant(Machine.load(), seed=0, resolution=resolution)
    interval_ns = round(2e9 / FEED_UM_S)
    upcoming = interval_ns

    def advance(windows: int) -> float:
        nonlocal upcoming
        started = time.perf_counter()
        for _ in range(windows):
            end = plant.time_ns + plant.window_ns
            steps = [(t, 0, 1) for t in range(upcoming, end, interval_ns)]
            upcoming += len(steps) * interval_ns
            plant.advance(steps)
        return time.perf_counter() - started

    advance(SETTLE_WINDOWS)
    return TIMED_WINDOWS * PULSES_PER_WINDOW / min(advance(TIMED_WINDOWS) for _ in range(REPEATS))


def cold_start_s() -> float:
    """Seconds from starting Python to the end of the first window, with the loop compiled before."""
    command = [sys.executable, "-c", _COLD]
    subprocess.run(command, check=True)
    started = time.perf_counter()
    subprocess.run(command, check=True)
    return time.perf_counter() - started


def measure() -> dict[str, float]:
    """Return all figures by name; ``realtime_factor`` is that of the default resolution at its own period."""
    default = pulses_per_s("default")
    return {
        "pulses_per_s": default,
        "realtime_factor": default * Machine.load().t_period_us * 1e-6,
        "pulses_per_s_fast": pulses_per_s("fast"),
        "pulses_per_s_fine": pulses_per_s("fine"),
        "cold_start_s": cold_start_s(),
    }


def render(figures: dict[str, float]) -> RenderableType:
    """Return the figures as a table for the terminal."""
    from rich.table import Table

    table = Table("figure", "value", title="edmsim bench, one core")
    table.columns[1].justify = "right"
    for name, value in figures.items():
        table.add_row(name, f"{value:,.0f}" if value > 1000 else f"{value:,.2f}")
    return table
