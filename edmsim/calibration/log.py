"""A machine's log: the table of windows, and the steady stretches of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edmsim.calibration.log_file import LogTable, read_ratios, read_table
from edmsim.errors import InputError
from edmsim.geometry import arc_lengths
from edmsim.job.settings import METADATA_KEY, CutSettings
from edmsim.machine.setting import WINDOW_PULSES

Array = NDArray[np.float64]

COLUMNS = (
    "feed_um_s", "short", "open", "mean_voltage_V", "mean_current_A", "mean_delay_us", "t_on_us", "t_period_us",
)
"""Columns a log must have, with the meanings and units of ``windows.parquet``."""
PLACES = ("x_um", "y_um")
"""Columns a log may have: where the guides are. With them, stretches in which the path turns are left out."""
STATISTICS = ("short", "open", "mean_voltage_V", "mean_current_A", "mean_delay_us")
"""What of a stretch is compared: shares of short and open, and means; see `statistics`."""
STRETCH_WINDOWS = 400  # windows of a stretch: 10 s at a period of 100 us (ours)
BATCH_WINDOWS = 40
"""Windows whose mean counts as one independent observation: 1 s at 100 us (ours: a gap forgets in less)."""
AIR_SHARE = 0.9  # a stretch with more open pulses than this has no metal near the wire (ours)
FEED_SPREAD = 0.15  # a stretch is steady if its feed's standard deviation is at most this share of its mean (ours)
LEAST_FEED_UM_S = 0.5  # a stretch with less feed does not cut (ours)
TURN_DEG = 45.0
"""A stretch is straight if its directions, from where it settles on, lie within this (ours: past a corner other metal
faces the wire, and on an arc of less than a millimetre the front is bent)."""
PLACE_UM = 50.0
"""Travel between two places of which directions are taken (ours: many motor steps, so that these do not count)."""
_SIGNED = ("feed_um_s", "mean_voltage_V", "mean_current_A", *PLACES)  # columns of which negative numbers are taken
_MOST = 1e6  # no figure of a log is as large (ours): times of a second, feeds of a metre per second


@dataclass(frozen=True)
class Log:
    """A machine's log, window by window.

    Attributes
    ----------
    name : str
        Name of its file.
    columns : mapping of str to float64 array (n,)
        `COLUMNS`, and `PLACES` if the file has both; ``mean_delay_us`` is NaN if no pulse ignited.
    settings : CutSettings or None
        Settings of a simulated cut; None if the file has none.
    """

    name: str
    columns: Mapping[str, Array]
    settings: CutSettings | None = None

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self.columns["short"])


@dataclass(frozen=True)
class Stretch:
    """Consecutive windows at one setting and nearly one feed."""

    first: int  # number of its first window in the log, from 0
    feed_um_s: float  # feed_um_s, t_on_us, t_period_us: mean feed, and the generator's setting
    t_on_us: float
    t_period_us: float
    batches: Array  # (b, 5): `STATISTICS` of batches of `BATCH_WINDOWS` windows
    travelled_um: float = 0.0  # travel at this feed and setting before it

    @property
    def mean(self) -> Array:
        """`STATISTICS` of the whole stretch, (5,); NaN where no batch has one."""
        known = np.isfinite(self.batches)
        total = np.where(known, self.batches, 0.0).sum(axis=0)
        return np.asarray(np.divide(total, known.sum(axis=0), out=np.full(5, np.nan), where=known.any(axis=0)))


def read_log(file: str | Path) -> Log:
    """Read a log.

    Parameters
    ----------
    file : path
        Parquet, or CSV with a header row of `COLUMNS`: separated by commas, semicolons or tabs, with decimal point
        or comma, in UTF-8 or UTF-16. Or a log of ratios, see `edmsim.calibration.log_file`.

    Raises
    ------
    InputError
        If the file cannot be read, has no rows, lacks a column, or has impossible values; or its metadata are not
        valid settings of a cut.
    """
    try:
        table = read_table(Path(file), COLUMNS, PLACES)
    except InputError:
        of_ratios = read_ratios(Path(file))
        if of_ratios is None:
            raise
        return Log(Path(file).name, of_ratios)
    columns = {name: values for name, values in table.columns.items() if name in COLUMNS or _has_places(table)}
    if len(columns["short"]) == 0:
        raise InputError("no windows in it", file)
    _check(columns, file)
    return Log(Path(file).name, columns, _settings(table, file))


def _has_places(table: LogTable) -> bool:
    return set(PLACES) <= set(table.columns)


def _settings(table: LogTable, file: str | Path) -> CutSettings | None:
    """Return the cut's settings from the table's metadata; None if the table is not a cut's."""
    text = table.metadata.get(METADATA_KEY)
    try:
        return None if text is None else CutSettings.of_json(text)
    except InputError as error:
        raise InputError(f"the settings in its metadata cannot be read: {error.reason}", file) from None


def _check(columns: Mapping[str, Array], file: str | Path) -> None:
    pulses = columns["short"] + columns["open"]
    wrong = {
        "short": ~((columns["short"] >= 0) & (pulses <= WINDOW_PULSES)),
        "open": ~(columns["open"] >= 0),
        "t_on_us": ~(columns["t_on_us"] > 0),
        "t_period_us": ~((columns["t_period_us"] > columns["t_on_us"]) & (columns["t_period_us"] < _MOST)),
        "mean_delay_us": (columns["mean_delay_us"] < 0) | (columns["mean_delay_us"] > _MOST),
        **{name: ~(np.abs(columns[name]) < _MOST) for name in _SIGNED if name in columns},
    }
    for name, rows in wrong.items():
        if rows.any():
            row = int(rows.argmax())
            raise InputError(
                f"window {row + 1}: {name} {columns[name][row]:g} cannot be; short and open are counts of "
                f"{WINDOW_PULSES} pulses, times are us and the period is longer than the on-time", file,
            )  # fmt: skip


def stretches(log: Log, settle_um: float) -> list[Stretch]:
    """Cut a log into its steady stretches of `STRETCH_WINDOWS`, `settle_um` of travel behind every change."""
    # a new run begins where the setting changes or the feed jumps. Stretches in air, at rest, with an unsteady
    # feed, and along a path that turns, if the log says where it was, are left out
    found = []
    for begin, end in _runs(log):
        window_s = WINDOW_PULSES * log.columns["t_period_us"][begin] * 1e-6
        travel_um = np.cumsum(np.maximum(log.columns["feed_um_s"][begin:end], 0.0)) * window_s
        settled = begin + int(np.searchsorted(travel_um, settle_um))
        for first in range(settled, end - STRETCH_WINDOWS + 1, STRETCH_WINDOWS):
            stretch = _stretch(log, first, float(travel_um[first - begin]))
            if stretch is not None and _turn_deg(log, first, settle_um) <= TURN_DEG:
                found.append(stretch)
    return found


def _runs(log: Log) -> list[tuple[int, int]]:
    """First window of each run of equal settings and without jumps of the feed, and the one behind its last."""
    feed, on, period = (log.columns[name] for name in ("feed_um_s", "t_on_us", "t_period_us"))
    changes = (np.diff(on) != 0) | (np.diff(period) != 0)
    # a jump: means over a batch before and after differ, at the place where they do so most
    width = BATCH_WINDOWS
    if len(feed) > 2 * width:
        mean = np.convolve(feed, np.ones(width) / width, "valid")
        step = np.abs(mean[width:] - mean[:-width])
        size = np.maximum(np.abs(mean[width:]), np.abs(mean[:-width]))
        for place in np.flatnonzero(step > FEED_SPREAD * np.maximum(size, LEAST_FEED_UM_S)):
            near = step[max(0, place - width) : place + width + 1]
            if step[place] == near.max():
                changes[place + width - 1] = True
    edges = [0, *(np.flatnonzero(changes) + 1).tolist(), len(feed)]
    return list(pairwise(edges))


def _stretch(log: Log, first: int, travelled_um: float) -> Stretch | None:
    rows = {name: values[first : first + STRETCH_WINDOWS] for name, values in log.columns.items()}
    feed = rows["feed_um_s"]
    mean = float(feed.mean())
    if mean < LEAST_FEED_UM_S or float(feed.std()) > FEED_SPREAD * mean:
        return None
    if rows["open"].mean() > AIR_SHARE * WINDOW_PULSES:
        return None
    return Stretch(
        first, mean, float(rows["t_on_us"][0]), float(rows["t_period_us"][0]),
        statistics(*(rows[name] for name in STATISTICS)), travelled_um,
    )  # fmt: skip


def _turn_deg(log: Log, first: int, settle_um: float) -> float:
    """How far apart the path's directions are in a stretch and where it settles before; 0 if unknown."""
    if PLACES[0] not in log.columns:
        return 0.0
    end = first + STRETCH_WINDOWS
    places = np.column_stack([log.columns[name][:end] for name in PLACES])
    travel_um = arc_lengths(places)
    begin_um = max(travel_um[first] - settle_um, 0.0)
    chosen = np.searchsorted(travel_um, np.arange(begin_um, travel_um[-1], PLACE_UM))
    ways = np.diff(places[chosen], axis=0)
    return float(np.degrees(np.ptp(np.unwrap(np.arctan2(ways[:, 1], ways[:, 0])))))


def statistics(short: Array, open_: Array, voltage_V: Array, current_A: Array, delay_us: Array) -> Array:
    """Return `STATISTICS` of whole batches of windows, (batches, 5); the delay is that of ignited pulses, or NaN."""
    count = len(short) // BATCH_WINDOWS
    lit = np.where(np.isfinite(delay_us), WINDOW_PULSES - short - open_, 0.0)
    columns = [short / WINDOW_PULSES, open_ / WINDOW_PULSES, voltage_V, current_A, lit, lit * np.nan_to_num(delay_us)]
    means = [column[: count * BATCH_WINDOWS].reshape(count, -1).mean(axis=1) for column in columns]
    delay = np.divide(means[5], means[4], out=np.full(count, np.nan), where=means[4] > 0)
    return np.column_stack([*means[:4], delay])
