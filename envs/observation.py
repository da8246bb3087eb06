"""What a learner sees: only what a machine can measure, normalised, with a fixed place for every entry."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Entry(NamedTuple):
    """One entry of the observation.

    Attributes
    ----------
    name : str
    low, high : float
        What it is clipped to.
    meaning : str
        What it is, and by what it is divided.
    """

    name: str
    low: float
    high: float
    meaning: str


MEASURED = (
    Entry("short", 0.0, 1.0, "share of short pulses"),
    Entry("open", 0.0, 1.0, "share of open pulses"),
    Entry("spark", 0.0, 1.0, "share of pulses that ignited (sparks and arcs look alike)"),
    Entry("mean_voltage", 0.0, 1.0, "mean gap voltage / open voltage"),
    Entry("mean_current", 0.0, 4.0, "mean gap current / the generator's limit of mean current"),
    Entry("mean_delay", 0.0, 1.0, "mean ignition delay / longest wait for ignition; 1 if nothing ignited"),
    Entry("commanded_feed", -1.0, 1.0, "commanded feed / max_feed_um_s"),
    Entry("actual_feed", -1.0, 1.0, "travel along the path / duration of the window / max_feed_um_s"),
    Entry("t_on", 0.0, 8.0, "on-time / that at the episode's start"),
    Entry("t_period", 0.0, 16.0, "pulse period / that at the episode's start"),
)
"""Entries of every window; `history` windows stand one behind the other, the last one first. All are 0 where no
window has been fired yet."""
CORNERS = (
    Entry("corner_ahead", 0.0, 1.0, "length of path to the next corner / 1 mm; 1 if there is none within"),
    Entry("corner_turn", -1.0, 1.0, "its turn / 180 degrees, left positive; 0 if there is none within 1 mm"),
    Entry("corner_behind", 0.0, 1.0, "length of path from the last corner / 1 mm; 1 if there is none within"),
)
"""Entries behind all windows, where the program is known."""
LOOK_UM = 1000.0
"""How far along the path corners are told (ours: well beyond the wire's lag and the distance to slow down in)."""


def entries(history: int, knows_corners: bool) -> list[Entry]:
    """Every entry of an observation, in order."""
    windows = [
        entry._replace(name=f"{entry.name}[{-age}]" if age else entry.name)
        for age in range(history)
        for entry in MEASURED
    ]
    return windows + (list(CORNERS) if knows_corners else [])


LOW = np.array([entry.low for entry in MEASURED])
HIGH = np.array([entry.high for entry in MEASURED])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def see(
    lanes: NDArray[np.int64], rows: NDArray[np.void], windows: NDArray[np.void], max_feed_um_s: float, low: Floats,
    high: Floats, seen: NDArray[np.float32],
) -> None:
    """Put the last window's entries before those of the windows before, and forget the oldest.

    Parameters
    ----------
    lanes : (m,)
        Lanes that had a window; of the other arguments, row i belongs to lane i.
    rows : (n,) `motion.LANE`
    windows : (n,) `edmsim.plant.kernel.state.WINDOW`
    max_feed_um_s : float
    low, high : (len(MEASURED),)
        `LOW` and `HIGH`.
    seen : (n, history, len(MEASURED))
        Written.
    """
    entry = np.empty(low.shape[0])
    for j in range(lanes.shape[0]):
        i = lanes[j]
        w, row = windows[i], rows[i]
        pulses = w.counts[0] + w.counts[1] + w.counts[2] + w.counts[3]
        us = w.duration_ns * 1e-3
        entry[0] = w.counts[3] / pulses
        entry[1] = w.counts[0] / pulses
        entry[2] = (w.counts[1] + w.counts[2]) / pulses
        entry[3] = w.voltage_us / us / row.open_V
        entry[4] = w.charge_A_us / us / row.limit_A
        entry[5] = w.delay_us / w.ignitions / row.wait_us if w.ignitions > 0 else 1.0
        entry[6] = row.feed_um_s / max_feed_um_s
        entry[7] = row.travel_um / (us * 1e-6) / max_feed_um_s
        entry[8] = row.setting_us[0] / row.first_setting_us[0]
        entry[9] = row.setting_us[1] / row.first_setting_us[1]
        for age in range(seen.shape[1] - 1, 0, -1):
            for k in range(entry.shape[0]):
                seen[i, age, k] = seen[i, age - 1, k]
        for k in range(entry.shape[0]):
            seen[i, 0, k] = min(max(entry[k], low[k]), high[k])


def corners(places_um: Floats, along_um: Floats, turns_deg: Floats) -> NDArray[np.float32]:
    """Return the entries about corners, (n, len(CORNERS)).

    Parameters
    ----------
    places_um : (n,)
        Length of path behind each lane.
    along_um, turns_deg : (n, most)
        Length of path up to each corner, infinite for the filling, and its turn.
    """
    ahead = along_um - places_um[:, None]
    lane = np.arange(len(places_um))
    following = np.where(ahead > 0, ahead, np.inf)
    k = following.argmin(axis=1)
    distance = following[lane, k]
    behind = np.where(ahead <= 0, -ahead, np.inf).min(axis=1)
    near = distance <= LOOK_UM
    rows = np.empty((len(lane), len(CORNERS)))
    rows[:, 0] = np.minimum(distance / LOOK_UM, 1.0)
    rows[:, 1] = np.where(near, turns_deg[lane, k] / 180.0, 0.0)
    rows[:, 2] = np.minimum(behind / LOOK_UM, 1.0)
    return rows.astype(np.float32)
