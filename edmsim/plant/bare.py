"""A window without a wire: what passes in a machine that has not noticed that its wire broke."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.plant.kernel.state import GRID, OPEN, Timing
from edmsim.plant.window import wrong_step

if TYPE_CHECKING:
    from edmsim.plant.axes.drives import Drives


def pass_window(
    state: NDArray[np.void], window: NDArray[np.void], drives: Drives, timing: Timing, events: NDArray[np.int64],
    step_um: float, pulses: int,
) -> None:
    """Let pulses pass that find no wire, open ones of the longest wait; the axes take their steps as in a rapid."""
    if wrong := wrong_step(events, int(state["time_ns"][0]), drives.axes.loops > 0):
        raise InputError(wrong)
    period_ns = timing.period_ns
    if period_ns == 0:
        spans = min(int((timing.wait_us + timing.pause_us) / timing.grid_us + 0.5), GRID)
        period_ns = int(spans * timing.grid_us * 1e3 + 0.5)
    start_ns, duration_ns = int(state["time_ns"][0]), pulses * period_ns
    drives.follow(state, events, start_ns + duration_ns, step_um)
    state["time_ns"] += duration_ns
    state["pulses"] += pulses
    window[:] = 0
    window["start_ns"], window["duration_ns"] = start_ns, duration_ns
    window["counts"][0, OPEN] = pulses
    window["temperature_max_K"] = np.nan  # there is no wire
    window["voltage_us"] = pulses * timing.open_V * timing.wait_us
