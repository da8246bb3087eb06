"""A machine's log: its windows as a table, and its steady stretches."""

import codecs
import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
from numpy.typing import NDArray

from edmsim.errors import InputError, refuses_wrong_types
from edmsim.geometry import Floats, arc_lengths
from edmsim.job.options import METADATA_KEY, CutSettings
from edmsim.machine.setting import AIR_SHARE, WINDOW_PULSES
from edmsim.metrology.profile import finite_mean

# Reading a log's file: Parquet, or CSV of machines and spreadsheets, with commas, semicolons or tabs.

PARQUET = b"PAR1"
_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF32_LE: "utf-32", codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16",
}  # fmt: skip
"""Byte order marks; a longer one comes before its own prefix."""
_SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs"}
_NO_NUMBER = {"", "nan", "na", "n/a", "null", "-"}  # texts of a missing number, in lower case


def read_table(file: Path) -> tuple[dict[str, Floats], dict[bytes, bytes]]:
    """Return the columns of a log (`_chosen`) by name, and the metadata, from a Parquet or CSV file."""
    # A file that begins with `PARQUET` is Parquet. The separator of a CSV file follows from its heading; if it is not
    # the comma, a comma may be the decimal sign.
    try:
        content = file.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file, a machine's log is needed", file) from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file) from None
    if content.startswith(PARQUET):
        return _of_parquet(content, file)
    if file.suffix == ".parquet":
        raise InputError("is not a Parquet file; a log as CSV has a name that ends in .csv", file)
    return _of_csv(_text(content, file), file), {}


def _of_parquet(content: bytes, file: Path) -> tuple[dict[str, Floats], dict[bytes, bytes]]:
    try:
        table = pa.parquet.read_table(pa.BufferReader(content))
        there = list(table.column_names)  # the names are decoded only here
    except (pa.ArrowException, OSError, UnicodeError):
        raise InputError("is a damaged Parquet file, or was not written to its end: copy it again", file) from None
    columns = {name: _numbers(table, name, file) for name in _chosen(there, file)}
    return columns, dict(table.schema.metadata or {})


def _numbers(table: pa.Table, name: str, file: Path) -> Floats:
    try:
        return np.asarray(table.column(name).cast(pa.float64()).to_numpy(), np.float64)
    except (pa.ArrowException, UnicodeError):
        raise InputError(f"column {name} holds something that is not a number", file) from None


def _text(content: bytes, file: Path) -> str:
    """Decode a CSV file by its byte order mark, else as UTF-8, else as cp1252, which European spreadsheets write."""
    marked = next((name for mark, name in _MARKS.items() if content.startswith(mark)), None)
    if marked is None and b"\0" in content[:1000]:
        # in UTF-16 without a mark, every second byte of the heading is zero
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


def _of_csv(text: str, file: Path) -> dict[str, Floats]:
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    first = next((number for number, line in enumerate(lines) if line.strip()), None)
    if first is None:
        raise InputError("is empty; a log has a heading and a line for every window", file)
    separator = None
    if lines[first].lower().startswith("sep=") and len(lines[first].strip('" ')) <= len("sep=x"):
        separator = lines[first].strip('" ')[4:] or "\t"  # the separator line of spreadsheets
        first += 1
    heading = lines[first] if first < len(lines) else ""
    if separator not in _SEPARATORS:
        expected = {*COLUMNS, *PLACES, *NEEDED}
        separator = max(_SEPARATORS, key=lambda s: len(expected & set(_heading(heading, s))))
    names = _heading(heading, separator)
    chosen = _chosen(names, file)
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
    reader = csv.reader((f"{line}\n" for line in lines[first:]), delimiter=separator)
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


def _chosen(there: Sequence[str], file: Path) -> list[str]:
    """Return the columns to read: those of a log of windows, or of a log of ratios."""
    of_ratios = "short_ratio" in there and not set(COLUMNS) <= set(there)
    needed, optional = (NEEDED, MEANS) if of_ratios else (COLUMNS, PLACES)
    if missing := [name for name in needed if name not in there]:
        said = f"column {missing[0]} is missing; a log{' of ratios' * of_ratios} needs {' '.join(needed)}"
        if set(there).isdisjoint(needed):
            said += (
                f"; its first line has: {', '.join(there)[:200]}; a log of ratios needs {' '.join(NEEDED)}: rename "
                f"columns, and convert them to um, s, counts of {WINDOW_PULSES} pulses or ratios from 0 to 1"
            )
        raise InputError(said, file)
    chosen = [*needed, *(name for name in optional if name in there)]
    for name in chosen:
        if there.count(name) > 1:
            raise InputError(f"column {name} is there {there.count(name)} times: leave one", file)
    return chosen


def _column(name: str, place: int, rows: list[tuple[int, list[str]]], has_decimal_comma: bool, file: Path) -> Floats:
    found = np.empty(len(rows))
    for k, (number, row) in enumerate(rows):
        text = row[place].strip()
        plain = text.replace(",", ".") if has_decimal_comma and "." not in text else text
        try:
            # Python accepts underscores in numbers, a log does not
            found[k] = np.nan if plain.lower() in _NO_NUMBER else float(plain if "_" not in plain else "")
        except ValueError:
            raise InputError(f"{name} is '{text}': give a number, as 12.5 or 12,5", file, number) from None
    return found


# Conversion of a log of ratios, which controllers of open machines write, to windows. Such a log has some rows per
# second, with the shares of short and open pulses since the row before, and the positions of the axes. A row may be
# longer or shorter than a window; a window gets the mean over its time.

NEEDED = ("t_s", "x_um", "y_um", "short_ratio", "open_ratio", "t_on_us", "t_period_us")
"""Columns that a log of ratios must have; the last two are the generator's setting."""
MEANS = ("mean_voltage_V", "mean_current_A")  # optional columns: means since the row before
RATE_HZ = (2.0, 100.0)
PAUSE_S = 2.0  # a longer time between rows is a pause without data (ours: four of the longest rows)
FEED_SPAN_S = 4.0
"""Time over which the feed is averaged (ours: ten motor steps at 5 um/s, so one step changes it little)."""
_MOST = 1e6  # greater values of a log are invalid (ours): 1 s as time, 1 m/s as feed


def windows_of(columns: Mapping[str, Floats], file: str | Path) -> dict[str, Floats]:
    """Convert a log of ratios to windows; return their columns by the names of `COLUMNS`."""
    # Counts are shares times 255 pulses, so they are not integers. Delays are unknown, and so are voltage and current
    # unless the log has them. The feed is the speed of the position over `FEED_SPAN_S`, forward or back.
    _check_ratios(columns, file)
    parts = [_of_run(columns, first, last) for first, last in _runs_of_rows(columns)]
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    if not len(whole["short"]):
        raise InputError("is too short: it has less than a window of 255 pulses", file)
    return whole


def _check_ratios(columns: Mapping[str, Floats], file: str | Path) -> None:
    time = columns["t_s"]
    if len(time) < 2:
        raise InputError("has fewer than two rows", file)
    short, open_ = columns["short_ratio"], columns["open_ratio"]
    period = columns["t_period_us"]
    wrong = {
        "t_s": ~((np.diff(time, prepend=time[0] - 1.0) > 0) & (time < np.inf)),
        "short_ratio": ~((short >= 0) & (short <= 1)), "open_ratio": ~((open_ >= 0) & (short + open_ <= 1.0001)),
        "t_on_us": ~(columns["t_on_us"] > 0), "t_period_us": ~((period > columns["t_on_us"]) & (period < _MOST)),
        **_out_of_range(columns, ("x_um", "y_um", *MEANS)),
    }  # fmt: skip
    _refuse(
        wrong, columns, "row", "times grow, ratios are shares from 0 to 1 of the pulses since the row before, and "
        "the period is longer than the on-time", file,
    )  # fmt: skip
    rate_Hz = 1.0 / float(np.median(np.diff(time)))
    low, high = RATE_HZ
    if not 0.99 * low <= rate_Hz <= 1.01 * high:
        raise InputError(f"has {rate_Hz:.3g} rows per second; a log of ratios has {low:g} to {high:g}", file)


def _out_of_range(columns: Mapping[str, Floats], names: Sequence[str]) -> dict[str, NDArray[np.bool_]]:
    """Return rows with impossible values of signed columns; a mean may be missing in all rows, but not in some."""
    there = [name for name in names if name in columns and not (name in MEANS and np.isnan(columns[name]).all())]
    return {name: ~(np.abs(columns[name]) < _MOST) for name in there}


def _refuse(
    wrong: Mapping[str, NDArray[np.bool_]], columns: Mapping[str, Floats], what: str, rule: str, file: str | Path
) -> None:
    """Raise `InputError` for the first row of the first column in which a value is wrong."""
    for name, rows in wrong.items():
        if rows.any():
            row = int(rows.argmax())
            raise InputError(f"{what} {row + 1}: {name} {columns[name][row]:g} cannot be; {rule}", file)


def _runs_of_rows(columns: Mapping[str, Floats]) -> list[tuple[int, int]]:
    """Return first row and end (exclusive) of every run of rows at one setting without a pause."""
    changes = _changes_of_setting(columns) | (np.diff(columns["t_s"]) > PAUSE_S)
    return list(pairwise([0, *(np.flatnonzero(changes) + 1).tolist(), len(columns["t_s"])]))


def _changes_of_setting(columns: Mapping[str, Floats]) -> NDArray[np.bool_]:
    """Return for all rows but the last whether the next has another setting; not if it differs by rounding errors."""
    settings = np.array([columns["t_on_us"], columns["t_period_us"]])
    same = np.isclose(settings[:, 1:], settings[:, :-1], rtol=1e-6, atol=0.0)
    return np.asarray(~same.all(axis=0))


def _of_run(columns: Mapping[str, Floats], first: int, last: int) -> dict[str, Floats]:
    rows = {name: values[first:last] for name, values in columns.items()}
    time, on_us, period_us = rows["t_s"], rows["t_on_us"][0], rows["t_period_us"][0]
    window_s = WINDOW_PULSES * period_us * 1e-6
    # the first row ends a span whose start is unknown
    ends = time[0] + window_s * np.arange(1, int((time[-1] - time[0]) / window_s + 1e-9) + 1)
    begins = ends - window_s

    def mean(name: str) -> Floats:
        upto = np.concatenate([[0.0], np.cumsum(rows[name][1:] * np.diff(time))])
        return np.asarray((np.interp(ends, time, upto) - np.interp(begins, time, upto)) / window_s)

    places = {name: np.interp(ends, time, rows[name]) for name in ("x_um", "y_um")}
    before, behind = np.maximum(ends - FEED_SPAN_S / 2, time[0]), np.minimum(ends + FEED_SPAN_S / 2, time[-1])
    moved = [np.interp(behind, time, rows[name]) - np.interp(before, time, rows[name]) for name in places]
    unknown = np.full(len(ends), np.nan)
    return {
        "feed_um_s": np.hypot(*moved) / np.maximum(behind - before, 1e-9),
        "short": WINDOW_PULSES * mean("short_ratio"), "open": WINDOW_PULSES * mean("open_ratio"),
        **{name: mean(name) if name in rows else unknown for name in MEANS}, "mean_delay_us": unknown,
        "t_on_us": np.full(len(ends), on_us), "t_period_us": np.full(len(ends), period_us), **places,
    }  # fmt: skip


COLUMNS = (
    "feed_um_s", "short", "open", "mean_voltage_V", "mean_current_A", "mean_delay_us", "t_on_us", "t_period_us",
)
"""Columns that a log must have, with the meanings and units of ``windows.parquet``."""
PLACES = ("x_um", "y_um")
"""Optional columns of a log: positions of the guides. With them, stretches in which the path turns are left out."""
STATISTICS = ("short", "open", "mean_voltage_V", "mean_current_A", "mean_delay_us")
"""Statistics of a stretch that are compared: shares of short and open, and means; see `statistics`."""
STRETCH_WINDOWS = 400  # windows of a stretch: 10 s at a period of 100 us (ours)
BATCH_WINDOWS = 40
"""Windows whose mean counts as one independent observation: 1 s at 100 us (ours: the gap's memory is shorter)."""
FEED_SPREAD = 0.15  # a stretch is steady if its feed's standard deviation is at most this share of its mean (ours)
LEAST_FEED_UM_S = 0.5  # a stretch with less feed does not cut (ours)
TURN_DEG = 45.0
"""A stretch is straight if its directions, including its settling travel, lie within this angle (ours: after a corner
other metal faces the wire, and on an arc of less than a millimetre the front is curved)."""
PLACE_UM = 50.0
"""Travel between two positions that give a direction (ours: many motor steps, so single steps do not matter)."""
PLACES_SHARE = 0.5
"""Least share of the feed's travel by which positions must move (ours: else they are in mm, or not the guides')."""
_SIGNED = ("feed_um_s", "mean_voltage_V", "mean_current_A", *PLACES)  # columns that may be negative


@dataclass(frozen=True, eq=False)
class Log:
    """A machine's log, window by window."""

    name: str  # name of its file
    # (n,): `COLUMNS`, and `PLACES` if the file has both; ``mean_delay_us`` is NaN if no pulse ignited
    columns: Mapping[str, Floats]
    settings: CutSettings | None = None  # settings of a simulated cut; None if the file has none
    feed_span_s: float = 0.0  # time over which each feed is averaged; a jump of the feed takes this time

    def __len__(self) -> int:
        return len(self.columns["short"])


@dataclass(frozen=True)
class Stretch:
    """Consecutive windows at one setting and nearly one feed."""

    first: int  # number of its first window in the log, from 0
    feed_um_s: float  # feed_um_s, t_on_us, t_period_us: mean feed, and the generator's setting
    t_on_us: float
    t_period_us: float
    batches: Floats  # (b, 5): `STATISTICS` of batches of `BATCH_WINDOWS` windows
    travelled_um: float = 0.0  # travel at this feed and setting before it

    @property
    def mean(self) -> Floats:
        """`STATISTICS` of the whole stretch, (5,); NaN for one that no batch has."""
        return finite_mean(self.batches, axis=0)


@refuses_wrong_types
def read_log(file: str | Path) -> Log:
    """Read a log.

    Parameters
    ----------
    file : path
        Parquet, or CSV with a header row of `COLUMNS`: separated by commas, semicolons or tabs, with decimal point
        or comma, in UTF-8 or UTF-16. Or a log of ratios, with those of `NEEDED`.

    Raises
    ------
    InputError
        If the file cannot be read, has no rows, lacks a column, or has impossible values; or its metadata are not
        valid settings of a cut.
    """
    found, metadata = read_table(Path(file))
    if NEEDED[0] in found:
        return Log(Path(file).name, windows_of(found, file), feed_span_s=FEED_SPAN_S)
    known = found if set(PLACES) <= set(found) else COLUMNS
    columns = {name: values for name, values in found.items() if name in known}
    if len(columns["short"]) == 0:
        raise InputError("no windows in it", file)
    _check(columns, file)
    return Log(Path(file).name, columns, _settings(metadata, file))


def _settings(metadata: Mapping[bytes, bytes], file: str | Path) -> CutSettings | None:
    """Return the cut's settings from a table's metadata; None if the table is not a cut's."""
    text = metadata.get(METADATA_KEY)
    try:
        settings = None if text is None else CutSettings.of_json(text)
    except InputError as error:
        raise InputError(f"the settings in its metadata cannot be read: {error.reason}", file) from None
    if settings is not None and (settings.passes or 1) > 1:
        raise InputError(f"it is the log of a cut in {settings.passes} passes: trims have other settings, and "
                         "metal on one side only; give the log of a cut in one pass", file)
    return settings


def _check(columns: Mapping[str, Floats], file: str | Path) -> None:
    pulses = columns["short"] + columns["open"]
    with np.errstate(invalid="ignore"):  # of an infinite count, which is refused
        parts = columns["open"] % 1 + columns["short"] % 1
    wrong = {
        "short": ~((columns["short"] >= 0) & (pulses <= WINDOW_PULSES)),
        # shares or percentages in place of counts
        "open": ~(columns["open"] >= 0) | ((pulses.max() <= 100) & (parts > 0)),
        "t_on_us": ~(columns["t_on_us"] > 0),
        "t_period_us": ~((columns["t_period_us"] > columns["t_on_us"]) & (columns["t_period_us"] < _MOST)),
        "mean_delay_us": (columns["mean_delay_us"] < 0) | (columns["mean_delay_us"] > _MOST),
        **_out_of_range(columns, _SIGNED),
    }
    _refuse(
        wrong, columns, "window", f"short and open are counts of {WINDOW_PULSES} pulses, times are us and the period "
        "is longer than the on-time", file,
    )  # fmt: skip
    if PLACES[0] in columns:
        cut_um = float((np.maximum(columns["feed_um_s"], 0.0) * columns["t_period_us"]).sum()) * WINDOW_PULSES * 1e-6
        moved_um = float(arc_lengths(np.column_stack([columns[name] for name in PLACES]))[-1])
        if moved_um < PLACES_SHARE * cut_um:
            raise InputError(
                f"{' and '.join(PLACES)} move by {moved_um:g} um, feed_um_s leads over {cut_um:g} um: give places "
                "of the guides in um, or none", file,
            )  # fmt: skip


def stretches(log: Log, settle_um: float) -> list[Stretch]:
    """Return the steady stretches of a log, each `STRETCH_WINDOWS` long and `settle_um` of travel after a change.

    Raises `InputError` if the log has no such stretch.
    """
    # A new run begins when the setting changes or the feed jumps. Stretches are left out if they are in air, at rest,
    # with an unsteady feed, or, if the log has positions, along a path that turns.
    found = []
    places = np.column_stack([log.columns[name] for name in PLACES]) if PLACES[0] in log.columns else np.zeros((0, 2))
    along_um = arc_lengths(places)
    for begin, end in _runs(log):
        window_s = WINDOW_PULSES * log.columns["t_period_us"][begin] * 1e-6
        travel_um = np.cumsum(np.maximum(log.columns["feed_um_s"][begin:end], 0.0)) * window_s
        settled = begin + int(np.searchsorted(travel_um, settle_um))
        for first in range(settled, end - STRETCH_WINDOWS + 1, STRETCH_WINDOWS):
            stretch = _stretch(log, first, float(travel_um[first - begin]))
            if stretch is not None and _turn_deg(places, along_um, first, settle_um) <= TURN_DEG:
                found.append(stretch)
    if not found:
        raise InputError(
            f"no stretch of {STRETCH_WINDOWS} windows can be used: after {settle_um:.0f} um of travel it must have "
            f"one setting, a feed of {LEAST_FEED_UM_S:g} um/s or more that varies by at most "
            f"{100 * FEED_SPREAD:g} %, at most {100 * AIR_SHARE:g} % open pulses, and no turn of more than "
            f"{TURN_DEG:g} degrees; the median feed of the log is {np.median(log.columns['feed_um_s']):.3g} um/s",
            log.name,
        )
    return found


def _runs(log: Log) -> list[tuple[int, int]]:
    """Return first window and end (exclusive) of each run of equal settings without jumps of the feed."""
    feed, period = log.columns["feed_um_s"], log.columns["t_period_us"]
    changes = _changes_of_setting(log.columns)
    # a jump is where the means over a batch before and a batch after differ, and differ most
    width = BATCH_WINDOWS
    apart = width + round(log.feed_span_s / (WINDOW_PULSES * float(np.median(period)) * 1e-6))
    if len(feed) > apart + width:
        mean = np.convolve(feed, np.ones(width) / width, "valid")
        step = np.abs(mean[apart:] - mean[:-apart])
        size = np.maximum(np.abs(mean[apart:]), np.abs(mean[:-apart]))
        for place in np.flatnonzero(step > FEED_SPREAD * np.maximum(size, LEAST_FEED_UM_S)):
            near = step[max(0, place - apart) : place + apart + 1]
            if step[place] == near.max():
                changes[[place + width - 1, place + apart - 1]] = True  # begin and end of the jump
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
    stretch = Stretch(
        first, mean, float(rows["t_on_us"][0]), float(rows["t_period_us"][0]),
        statistics(*(rows[name] for name in STATISTICS)), travelled_um,
    )  # fmt: skip
    for name, value in zip(STATISTICS[2:], stretch.mean[2:].tolist(), strict=True):
        if value == 0.0:
            raise InputError(
                f"windows {first + 1} to {first + STRETCH_WINDOWS}: {name} is 0 in all of them; leave the column "
                "empty if the machine does not measure it", log.name,
            )  # fmt: skip
    return stretch


def _turn_deg(places: Floats, along_um: Floats, first: int, settle_um: float) -> float:
    """Return the range of the path's directions in a stretch and its settling travel; 0 if unknown or too short."""
    if not len(places):
        return 0.0
    upto_um = along_um[: first + STRETCH_WINDOWS]
    begin_um = max(upto_um[first] - settle_um, 0.0)
    chosen = np.unique(np.searchsorted(upto_um, np.arange(begin_um, upto_um[-1], PLACE_UM)))
    moves = np.diff(places[chosen], axis=0)
    if not len(moves):
        return 0.0
    return float(np.degrees(np.ptp(np.unwrap(np.arctan2(moves[:, 1], moves[:, 0])))))


def statistics(short: Floats, open_: Floats, voltage_V: Floats, current_A: Floats, delay_us: Floats) -> Floats:
    """Return `STATISTICS` of whole batches of windows, (batches, 5); the delay is that of ignited pulses, or NaN."""
    count = len(short) // BATCH_WINDOWS
    lit = np.where(np.isfinite(delay_us), WINDOW_PULSES - short - open_, 0.0)
    columns = [short / WINDOW_PULSES, open_ / WINDOW_PULSES, voltage_V, current_A, lit, lit * np.nan_to_num(delay_us)]
    means = [column[: count * BATCH_WINDOWS].reshape(count, -1).mean(axis=1) for column in columns]
    delay = np.divide(means[5], means[4], out=np.full(count, np.nan), where=means[4] > 0)
    return np.column_stack([*means[:4], delay])
