"""The observation: only what a machine can measure, normalised, with a fixed place for every entry."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.plant.kernel.state import ARC, OPEN, SHORT, SPARK

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
"""How far along the path corners are shown (ours: well beyond the wire's lag and the distance to slow down in)."""


def entries(history: int, knows_corners: bool) -> list[Entry]:
    """Every entry of an observation, in order."""
    windows = [
        entry._replace(name=f"{entry.name}[{-age}]" if age else entry.name)
        for age in range(history)
        for entry in MEASURED
    ]
    return windows + (list(CORNERS) if knows_corners else [])


_LOW = tuple(entry.low for entry in MEASURED)
_HIGH = tuple(entry.high for entry in MEASURED)


class Shown(NamedTuple):
    """What one window showed.

    Attributes
    ----------
    short, open, ignited : int
        Pulses of each kind.
    duration_us : float
    voltage_V_us, charge_A_us : float
        Gap voltage and current, each summed over the window's time.
    ignitions : int
    delay_us : float
        Sum of their delays.
    feed_um_s : float
        Commanded.
    travel_um : float
        Along the path, by the counters.
    t_on_us, t_period_us : float
        Setting of the generator.
    """

    short: int
    open: int
    ignited: int
    duration_us: float
    voltage_V_us: float
    charge_A_us: float
    ignitions: int
    delay_us: float
    feed_um_s: float
    travel_um: float
    t_on_us: float
    t_period_us: float


class Scale(NamedTuple):
    """By what the entries are divided: see `MEASURED`."""

    open_V: float
    limit_A: float
    wait_us: float
    max_feed_um_s: float
    first_on_us: float
    first_period_us: float


@exactly_compiled
def show(shown: Shown, scale: Scale, seen: NDArray[np.float32]) -> None:
    """Put a window's entries before those of the windows before, and forget the oldest.

    Parameters
    ----------
    shown : Shown
    scale : Scale
    seen : (history, len(MEASURED))
        Written.
    """
    pulses = shown.short + shown.open + shown.ignited
    values = (
        shown.short / pulses,
        shown.open / pulses,
        shown.ignited / pulses,
        shown.voltage_V_us / shown.duration_us / scale.open_V,
        shown.charge_A_us / shown.duration_us / scale.limit_A,
        shown.delay_us / shown.ignitions / scale.wait_us if shown.ignitions > 0 else 1.0,
        shown.feed_um_s / scale.max_feed_um_s,
        shown.travel_um / (shown.duration_us * 1e-6) / scale.max_feed_um_s,
        shown.t_on_us / scale.first_on_us,
        shown.t_period_us / scale.first_period_us,
    )
    for age in range(seen.shape[0] - 1, 0, -1):
        for k in range(seen.shape[1]):
            seen[age, k] = seen[age - 1, k]
    for k in range(len(values)):
        seen[0, k] = min(max(values[k], _LOW[k]), _HIGH[k])


@exactly_compiled
def see(
    lanes: NDArray[np.int64], rows: NDArray[np.void], windows: NDArray[np.void], max_feed_um_s: float,
    seen: NDArray[np.float32],
) -> None:
    """`show` the last window of some lanes.

    Parameters
    ----------
    lanes : (m,)
        Lanes that had a window; of the other arguments, row i belongs to lane i.
    rows : (n,) `path_follower.LANE`
    windows : (n,) `edmsim.plant.kernel.state.WINDOW`
    max_feed_um_s : float
    seen : (n, history, len(MEASURED))
        Written.
    """
    for j in range(lanes.shape[0]):
        i = lanes[j]
        w, row = windows[i], rows[i]
        shown = Shown(
            w.counts[SHORT], w.counts[OPEN], w.counts[SPARK] + w.counts[ARC], w.duration_ns * 1e-3,
            w.voltage_us, w.charge_A_us, w.ignitions, w.delay_us,
            row.feed_um_s, row.travel_um, row.setting_us[0], row.setting_us[1],
        )
        scale = Scale(
            row.open_V, row.limit_A, row.wait_us, max_feed_um_s, row.first_setting_us[0], row.first_setting_us[1]
        )
        show(shown, scale, seen[i])


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
