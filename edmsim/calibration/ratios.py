"""A log of ratios, as a controller of an open machine writes one, made into windows.

Such a log has a row some times a second: shares of short and open pulses since the row before, and where the axes
are. A row may be longer than a window or shorter; a window gets the mean over its time.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edmsim.calibration.log_file import read_table
from edmsim.errors import InputError
from edmsim.machine.setting import WINDOW_PULSES

Array = NDArray[np.float64]
NEEDED = ("t_s", "x_um", "y_um", "short_ratio", "open_ratio", "t_on_us", "t_period_us")
"""Columns that a log of ratios must have; the last two are the generator's setting."""
MEANS = ("mean_voltage_V", "mean_current_A")  # columns it may have: means since the row before
RATE_HZ = (2.0, 100.0)
FEED_SPAN_S = 4.0
"""The feed is the way over so long a time (ours: at 5 um/s ten motor steps, so that one more or less is little)."""
_MOST = 1e6  # no figure of a log is as large (ours)


def read(file: Path) -> dict[str, Array] | None:
    """Return the windows of a log of ratios; None for a file without their columns.

    Raises
    ------
    InputError
        As `windows_of`, or the file cannot be read.
    """
    mark = "short_ratio"
    try:
        table = read_table(file, (mark,), [name for name in (*NEEDED, *MEANS) if name != mark])
    except InputError as error:
        if f"column {mark} is missing" in error.reason:
            return None
        raise
    return windows_of(table.columns, file)


def windows_of(columns: Mapping[str, Array], file: str | Path) -> dict[str, Array]:
    """Return the columns of windows that a log of ratios comes to, with the names of `edmsim.calibration.log`."""
    # counts are shares of 255 pulses, and no whole numbers. Delays are not known; voltage and current are if
    # the log has them. The feed is the speed at which the place has moved over `FEED_SPAN_S`, forward or back
    missing = [name for name in NEEDED if name not in columns]
    if missing:
        raise InputError(f"column {missing[0]} is missing; a log of ratios needs {' '.join(NEEDED)}", file)
    _check(columns, file)
    parts = [_of_setting(columns, first, last) for first, last in _settings(columns)]
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    if not len(whole["short"]):
        raise InputError("is too short: it has less than a window of 255 pulses", file)
    return whole


def _check(columns: Mapping[str, Array], file: str | Path) -> None:
    time = columns["t_s"]
    if len(time) < 2:
        raise InputError("has fewer than two rows", file)
    short, open_ = columns["short_ratio"], columns["open_ratio"]
    period = columns["t_period_us"]
    wrong = {
        "t_s": ~(np.diff(time, prepend=time[0] - 1.0) > 0),
        "short_ratio": ~((short >= 0) & (short <= 1)), "open_ratio": ~((open_ >= 0) & (short + open_ <= 1.0001)),
        "t_on_us": ~(columns["t_on_us"] > 0), "t_period_us": ~((period > columns["t_on_us"]) & (period < _MOST)),
        **{name: ~(np.abs(columns[name]) < _MOST) for name in ("x_um", "y_um", *MEANS) if name in columns},
    }  # fmt: skip
    for name, rows in wrong.items():
        if rows.any():
            row = int(rows.argmax())
            raise InputError(
                f"row {row + 1}: {name} {columns[name][row]:g} cannot be; times grow, ratios are shares from 0 to 1 "
                "of the pulses since the row before, and the period is longer than the on-time", file,
            )  # fmt: skip
    rate_Hz = 1.0 / float(np.median(np.diff(time)))
    low, high = RATE_HZ
    if not 0.99 * low <= rate_Hz <= 1.01 * high:
        raise InputError(f"has {rate_Hz:.3g} rows per second; a log of ratios has {low:g} to {high:g}", file)


def _settings(columns: Mapping[str, Array]) -> list[tuple[int, int]]:
    """First row and the one behind the last, of every run of rows at one setting."""
    changes = (np.diff(columns["t_on_us"]) != 0) | (np.diff(columns["t_period_us"]) != 0)
    return list(pairwise([0, *(np.flatnonzero(changes) + 1).tolist(), len(columns["t_s"])]))


def _of_setting(columns: Mapping[str, Array], first: int, last: int) -> dict[str, Array]:
    rows = {name: values[first:last] for name, values in columns.items()}
    time, on_us, period_us = rows["t_s"], rows["t_on_us"][0], rows["t_period_us"][0]
    window_s = WINDOW_PULSES * period_us * 1e-6
    # the first row closes a span whose begin is not known
    ends = time[0] + window_s * np.arange(1, int((time[-1] - time[0]) / window_s + 1e-9) + 1)
    begins = ends - window_s

    def mean(name: str) -> Array:
        upto = np.concatenate([[0.0], np.cumsum(rows[name][1:] * np.diff(time))])
        return np.asarray((np.interp(ends, time, upto) - np.interp(begins, time, upto)) / window_s)

    places = {name: np.interp(ends, time, rows[name]) for name in ("x_um", "y_um")}
    before, behind = np.maximum(ends - FEED_SPAN_S / 2, time[0]), np.minimum(ends + FEED_SPAN_S / 2, time[-1])
    ways = [np.interp(behind, time, rows[name]) - np.interp(before, time, rows[name]) for name in places]
    unknown = np.full(len(ends), np.nan)
    return {
        "feed_um_s": np.hypot(*ways) / np.maximum(behind - before, 1e-9),
        "short": WINDOW_PULSES * mean("short_ratio"), "open": WINDOW_PULSES * mean("open_ratio"),
        **{name: mean(name) if name in rows else unknown for name in MEANS}, "mean_delay_us": unknown,
        "t_on_us": np.full(len(ends), on_us), "t_period_us": np.full(len(ends), period_us), **places,
    }  # fmt: skip
