"""A log's file: Parquet, or CSV as machines and spreadsheets write it, with commas, semicolons or tabs."""

from __future__ import annotations

import codecs
import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError

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
