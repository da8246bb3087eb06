"""A log's file: Parquet, or CSV as machines and spreadsheets write it; of windows, or of ratios.

A controller of an open machine writes a log of ratios: a row some times a second with shares of short and open
pulses since the row before, and where the axes are. A row may be longer than a window or shorter; a window gets the
mean over its time.
"""

from __future__ import annotations

import codecs
import csv
import io
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.machine.setting import WINDOW_PULSES

if TYPE_CHECKING:
    import pyarrow as pa


Array = NDArray[np.float64]
PARQUET = b"PAR1"
_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF32_LE: "utf-32", codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16",
}  # fmt: skip
"""Byte order marks, the longer ones first where one begins another."""
_SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs"}
_NO_NUMBER = {"", "nan", "na", "n/a", "null", "-"}  # what stands for a number that is not there, in small letters


class LogTable(NamedTuple):
    """Columns by name, and the metadata of the file, if it has some."""

    columns: dict[str, Array]
    metadata: dict[bytes, bytes]


def read_table(file: Path, needed: Sequence[str], optional: Sequence[str]) -> LogTable:
    """Read the columns that are needed, and those wanted that are there, of Parquet or CSV."""
    # a file is Parquet if it begins as one. Of a CSV file the heading says the separator; a comma may be the
    # decimal sign where it is not the separator
    try:
        content = file.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file, a machine's log is needed", file) from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file) from None
    if content.startswith(PARQUET):
        return _of_parquet(content, needed, optional, file)
    if file.suffix == ".parquet":
        raise InputError("is not a Parquet file; a log as CSV has a name that ends in .csv", file)
    return LogTable(_of_csv(_text(content, file), needed, optional, file), {})


def _of_parquet(content: bytes, needed: Sequence[str], optional: Sequence[str], file: Path) -> LogTable:
    import pyarrow as pa
    import pyarrow.parquet

    try:
        table = pa.parquet.read_table(pa.BufferReader(content))
        there = list(table.column_names)  # which are decoded only here
    except (pa.ArrowException, OSError, UnicodeError):
        raise InputError("is a damaged Parquet file, or was not written to its end: copy it again", file) from None
    names = _chosen(there, needed, optional, file)
    columns = {name: _numbers(table, name, file) for name in names}
    return LogTable(columns, dict(table.schema.metadata or {}))


def _numbers(table: pa.Table, name: str, file: Path) -> Array:
    import pyarrow as pa

    try:
        return np.asarray(table.column(name).cast(pa.float64()).to_numpy(), np.float64)
    except (pa.ArrowException, UnicodeError):
        raise InputError(f"column {name} holds something that is not a number", file) from None


def _text(content: bytes, file: Path) -> str:
    """Decode a CSV file: by its byte order mark, else as UTF-8, or as European spreadsheets write it."""
    marked = next((name for mark, name in _MARKS.items() if content.startswith(mark)), None)
    if marked is None and b"\0" in content[:1000]:
        # of UTF-16 without a mark every second byte of the heading is zero
        even, odd = content[:1000:2].count(0), content[1:1000:2].count(0)
        if content.startswith(b"PK") or 4 * max(even, odd) < min(len(content), 1000):
            raise InputError("is not text: a log is CSV or Parquet; save a spreadsheet as CSV", file)
        marked = "utf-16-be" if even > odd else "utf-16-le"
    try:
        return content.decode(marked or "utf-8")
    except UnicodeDecodeError:
        if marked is None and not content.startswith((b"PK", b"\x1f\x8b", b"\xd0\xcf")):
            return content.decode("cp1252", "replace")
        what = "damaged: its encoding is not that of its byte order mark" if marked else "not text"
        raise InputError(f"is {what}; a log is CSV in UTF-8, or Parquet", file) from None


def _of_csv(text: str, needed: Sequence[str], optional: Sequence[str], file: Path) -> dict[str, Array]:
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    first = next((number for number, line in enumerate(lines) if line.strip()), None)
    if first is None:
        raise InputError("is empty; a log has a heading and a line for every window", file)
    separator = None
    if lines[first].lower().startswith("sep=") and len(lines[first].strip('" ')) <= len("sep=x"):
        separator = lines[first].strip('" ')[4:] or "\t"  # as spreadsheets note it
        first += 1
    heading = lines[first] if first < len(lines) else ""
    if separator not in _SEPARATORS:
        separator = max(_SEPARATORS, key=lambda s: len({*needed, *optional} & set(_heading(heading, s))))
    names = _heading(heading, separator)
    chosen = _chosen(names, needed, optional, file)
    rows = _rows(lines, first + 1, separator, len(names), file)
    if not rows:
        raise InputError("no windows in it: it has a heading only", file)
    has_decimal_comma = separator != "," or any("," in row[names.index(name)] for _, row in rows for name in chosen)
    return {name: _column(name, names.index(name), rows, has_decimal_comma, file) for name in chosen}


def _heading(line: str, separator: str) -> list[str]:
    return [name.strip() for name in next(csv.reader([line], delimiter=separator), [])]


def _rows(lines: list[str], first: int, separator: str, fields: int, file: Path) -> list[tuple[int, list[str]]]:
    """Return the fields of every line with its number; empty lines are left out."""
    rows: list[tuple[int, list[str]]] = []
    reader = csv.reader(io.StringIO("\n".join(lines[first:])), delimiter=separator)
    try:
        for row in reader:
            if not any(field.strip() for field in row):
                continue
            number = first + reader.line_num
            if len(row) != fields:
                raise InputError(
                    f"it has {len(row)} fields where the heading has {fields}, separated by "
                    f"{_SEPARATORS[separator]}; a number with a decimal comma then needs quotes, or semicolons "
                    "between the fields", file, number,
                )  # fmt: skip
            rows.append((number, row))
    except csv.Error as error:
        raise InputError(f"is not CSV: {error}", file, first + reader.line_num) from None
    return rows


def _chosen(there: Sequence[str], needed: Sequence[str], optional: Sequence[str], file: Path) -> list[str]:
    missing = [name for name in needed if name not in there]
    if missing:
        said = f"; its first line has: {', '.join(there)[:200]}" if set(there).isdisjoint(needed) else ""
        raise InputError(f"column {missing[0]} is missing; a log needs {' '.join(needed)}{said}", file)
    chosen = [*needed, *(name for name in optional if name in there)]
    for name in chosen:
        if there.count(name) > 1:
            raise InputError(f"column {name} is there {there.count(name)} times: leave one", file)
    return chosen


def _column(name: str, place: int, rows: list[tuple[int, list[str]]], has_decimal_comma: bool, file: Path) -> Array:
    found = np.empty(len(rows))
    for k, (number, row) in enumerate(rows):
        text = row[place].strip()
        plain = text.replace(",", ".") if has_decimal_comma and "." not in text else text
        try:
            # underscores and inf are numbers to Python, and none of a log
            found[k] = np.nan if plain.lower() in _NO_NUMBER else float(plain if "_" not in plain else "")
        except ValueError:
            raise InputError(f"{name} is '{text}': give a number, as 12.5 or 12,5", file, number) from None
    return found


RATIO_COLUMNS = ("t_s", "x_um", "y_um", "short_ratio", "open_ratio", "t_on_us", "t_period_us")
"""Columns that a log of ratios must have; the last two are the generator's setting."""
MEANS = ("mean_voltage_V", "mean_current_A")  # columns it may have: means since the row before
RATE_HZ = (2.0, 100.0)
FEED_SPAN_S = 4.0
"""The feed is the way over so long a time (ours: at 5 um/s ten motor steps, so that one more or less is little)."""
_MOST = 1e6  # no figure of a log is as large (ours)


def read_ratios(file: Path) -> dict[str, Array] | None:
    """Return the windows of a log of ratios; None for a file without their columns.

    Raises
    ------
    InputError
        As `windows_of`, or the file cannot be read.
    """
    mark = "short_ratio"
    try:
        table = read_table(file, (mark,), [name for name in (*RATIO_COLUMNS, *MEANS) if name != mark])
    except InputError as error:
        if f"column {mark} is missing" in error.reason:
            return None
        raise
    return windows_of(table.columns, file)


def windows_of(columns: Mapping[str, Array], file: str | Path) -> dict[str, Array]:
    """Return the columns of windows that a log of ratios comes to, with the names of `edmsim.calibration.log`."""
    # counts are shares of 255 pulses, and no whole numbers. Delays are not known; voltage and current are if
    # the log has them. The feed is the speed at which the place has moved over `FEED_SPAN_S`, forward or back
    missing = [name for name in RATIO_COLUMNS if name not in columns]
    if missing:
        raise InputError(f"column {missing[0]} is missing; a log of ratios needs {' '.join(RATIO_COLUMNS)}", file)
    _check_ratios(columns, file)
    parts = [_of_setting(columns, first, last) for first, last in _runs_of_setting(columns)]
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    if not len(whole["short"]):
        raise InputError("is too short: it has less than a window of 255 pulses", file)
    return whole


def _check_ratios(columns: Mapping[str, Array], file: str | Path) -> None:
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


def _runs_of_setting(columns: Mapping[str, Array]) -> list[tuple[int, int]]:
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
