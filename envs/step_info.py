"""Compiled numbers of `info` at every step; a real machine does not measure all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled

STEP_INFO = np.dtype(
    [
        ("time_s", "f8"),  # machine time at the end of the step
        ("dt_s", "f8"),  # that of the step
        ("path_um", "f8"),  # length of path behind the wire by the planner, over all legs
        ("feed_um_s", "f8"),
        ("offset_um", "f8"),
        ("t_on_us", "f8"),
        ("t_period_us", "f8"),
        ("energy_mJ", "f8"),  # of a discharge of the setting
        ("short", "i8"),  # pulses of the step by class
        ("open", "i8"),
        ("spark", "i8"),
        ("arc", "i8"),
        ("gap_um", "f8"),  # mean of the last window's ignitions; -1 without any, as checkers take no NaN for another
        ("wire_temperature_K", "f8"),  # greatest of the last window
        ("debris", "f8"),  # at its end
        ("error_um", "f8"),  # distance of the wire from the path at its end
        ("area_mm2", "f8"),  # cut in the step
        ("wires_lost", "i8"),  # in the episode
        ("cost", "f8"),  # of the step
    ]
)
"""What a sub-environment's step was."""


@exactly_compiled
def fill(
    rows: NDArray[np.void], states: NDArray[np.void], windows: NDArray[np.void], shown: NDArray[np.void],
    accounts: NDArray[np.void], infos: NDArray[np.void],
) -> None:
    """Write `STEP_INFO` (n,) of all sub-environments, from the records of their plants, observations and rewards."""
    for i in range(infos.shape[0]):
        info, row, window, sums, account = infos[i], rows[i], windows[i], shown[i], accounts[i]
        setting_us, ignitions = row.setting_us, window.ignitions
        info.time_s = states[i].time_ns * 1e-9
        info.dt_s = row.step_ns * 1e-9
        info.path_um = row.before_um + row.path_um
        info.feed_um_s = row.feed_um_s
        info.offset_um = row.offset_um
        info.t_on_us = setting_us[0]
        info.t_period_us = setting_us[1]
        info.energy_mJ = row.energy_mJ
        info.short = sums.short
        info.open = sums.open
        info.spark = sums.ignited - sums.arc
        info.arc = sums.arc
        info.gap_um = window.gap_um / ignitions if ignitions > 0 else -1.0
        info.wire_temperature_K = window.temperature_max_K
        info.debris = window.debris
        info.error_um = row.error_um
        info.area_mm2 = account.area_mm2
        info.wires_lost = row.wires_lost
        info.cost = account.cost
