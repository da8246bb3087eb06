"""What happened in a cut, in words: retracts, corners, threading, changes of the setting, how it ended."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.cosim.stops import WORDS, StopCause
from edmsim.recording.pauses import pause_rows
from edmsim.recording.scene import Scene
from edmsim.recording.windows import column

if TYPE_CHECKING:
    import pyarrow as pa

MOST = 300
"""Most events of a kind that are told; of more, evenly spaced ones."""
_NEAR_MM = 0.5
"""The wire passes a corner of the drawing at most this far away."""
_LEVELS = {words.report: words.level for words in WORDS.values()}
_ALARM = WORDS[StopCause.PERSISTENT_SHORT].report


class Event(NamedTuple):
    """One event: the row of the table of windows it belongs to, its weight, and what happened."""

    row: int
    level: str
    text: str


def events(windows: pa.Table, scene: Scene, report: Mapping[str, Any]) -> list[Event]:
    """Return the events of a cut in order of time.

    Parameters
    ----------
    windows : pyarrow.Table
    scene : Scene
    report : mapping
        For how the cut ended.

    Returns
    -------
    list of Event
        Places are in the program's coordinates.
        Levels as rerun shows them: INFO, WARN, ERROR, CRITICAL.
    """
    if len(windows) == 0:
        return []
    scene, origin_um = scene.in_program(), 1e3 * np.array(scene.origin_mm or (0.0, 0.0))
    t_s = column(windows, "t_s")
    place = np.column_stack([column(windows, n) for n in ("x_um", "y_um")]) - origin_um
    last = len(windows) - 1
    reason = f": {report['reason']}" if report["reason"] else ""
    found = [Event(0, "INFO", f"begins at {_at(place[0])}")]
    found += _retracts(windows, place)
    found += _threadings(t_s, place)
    found += _settings(windows)
    found += _corners(scene, place)
    kind = "alarm: " if report["outcome"] == _ALARM else ""
    found.append(Event(last, _LEVELS[report["outcome"]], f"{kind}{report['outcome']}{reason}"))
    return sorted(found, key=lambda event: event.row)


def _at(place_um: NDArray[np.float64]) -> str:
    x_mm, y_mm = np.round(place_um * 1e-3, 6) + 0.0  # not -0.000
    return f"X {x_mm:.3f} Y {y_mm:.3f} mm"


def _thinned(found: list[Event]) -> list[Event]:
    keep = np.unique(np.linspace(0, len(found) - 1, min(len(found), MOST)).astype(int))
    return [found[i] for i in keep]


def _retracts(windows: pa.Table, place: NDArray[np.float64]) -> list[Event]:
    back = column(windows, "feed_um_s") < 0
    begins = np.flatnonzero(back & ~np.concatenate([[False], back[:-1]]))
    ends = np.flatnonzero(back & ~np.concatenate([back[1:], [False]]))
    path, short = column(windows, "path_um"), column(windows, "short") / 2.55
    return _thinned(
        [
            Event(a, "WARN", f"retract at {_at(place[a])}: {short[max(a - 1, 0)]:.0f} % short, "
                                  f"{path[max(a - 1, 0)] - path[b]:.0f} µm back")
            for a, b in zip(begins.tolist(), ends.tolist(), strict=True)
        ]
    )  # fmt: skip


def _threadings(t_s: NDArray[np.float64], place: NDArray[np.float64]) -> list[Event]:
    gone = pause_rows(t_s)
    return _thinned(
        [Event(int(i), "INFO", f"wire threaded at {_at(place[i])} after {t_s[i] - t_s[i - 1]:.0f} s") for i in gone]
    )


def _settings(windows: pa.Table) -> list[Event]:
    on, period = column(windows, "t_on_us"), column(windows, "t_period_us")
    changed = np.flatnonzero((np.diff(on) != 0) | (np.diff(period) != 0)) + 1
    return _thinned(
        [Event(int(i), "INFO", f"generator set to {on[i]:g} µs of {period[i]:g} µs") for i in changed]
    )


def _corners(scene: Scene, place: NDArray[np.float64]) -> list[Event]:
    found = []
    for corner in scene.corners:
        away = np.hypot(*(place / 1000.0 - (corner.x_mm, corner.y_mm)).T)
        nearest = int(away.argmin())
        if away[nearest] <= _NEAR_MM:
            error = f", error {corner.error_um:+.1f} µm" if np.isfinite(corner.error_um) else ""
            where = _at(np.array([corner.x_mm, corner.y_mm]) * 1000.0)
            found.append(Event(nearest, "INFO", f"corner of {corner.turn_deg:+.0f}° at {where}{error}"))
    return _thinned(found)
