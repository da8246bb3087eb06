"""The table of results: its columns and their types, and how it is read."""

from __future__ import annotations

import json
import urllib.parse
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from edmsim.errors import InputError
from edmsim.job.settings import CutSettings

if TYPE_CHECKING:
    import pyarrow as pa

RESULTS = "results"
"""Folder of the parquet dataset, a folder ``task=...`` in it for each program or environment."""
JOURNAL = "journal.jsonl"
_WHOLE = {"seed", "machine_sample"}
_KINDS = {name: {field.annotation, *get_args(field.annotation)} for name, field in CutSettings.model_fields.items()}
_TEXTS = {
    "id", "task", "error", "outcome", "report", "edmsim_version", "host",
    *(name for name, kinds in _KINDS.items() if str in kinds),
}  # fmt: skip


def as_table(rows: Iterable[Mapping[str, Any]]) -> pa.Table:
    """Return rows as a table; a column's type follows from its name, so that all parts of a dataset agree."""
    import pyarrow as pa

    listed = list(rows)
    names = list(dict.fromkeys(name for row in listed for name in row))
    columns = {name: [row.get(name) for row in listed] for name in names}
    return pa.table({name: pa.array(*_typed(name, values)) for name, values in columns.items()})


def _typed(name: str, values: list[Any]) -> tuple[list[Any], Any]:
    """Return a column's values and type; what is neither number nor text is told as JSON."""
    import pyarrow as pa

    if name in _WHOLE:
        return values, pa.int64()
    are_numbers = all(value is None or type(value) in (int, float) for value in values)
    if are_numbers and name not in _TEXTS:
        return [None if value is None else float(value) for value in values], pa.float64()
    return [value if value is None or isinstance(value, str) else json.dumps(value) for value in values], pa.string()


def read(out: str | Path) -> pa.Table:
    """Read the results of a sweep, also of one that is still running.

    Parameters
    ----------
    out : path
        The sweep's folder.

    Returns
    -------
    pyarrow.Table
        A row per run, in the order of their ids: id, task, seed, settings, constants, ``error`` (null where the run
        ended as it should), ``outcome``, the figures of `edmsim.sweep.figures.FIGURES`, ``report`` (JSON, of cuts),
        ``edmsim_version``, ``wall_time_s`` and ``host``.

    Raises
    ------
    InputError
        There is no sweep in this folder.
    """
    import pyarrow as pa

    folder = Path(out)
    tables = [_part(file) for file in sorted((folder / RESULTS).glob("*/*.parquet"))]
    written = {identity for table in tables for identity in table["id"].to_pylist()}
    rest = [row for row in journal_rows(folder) if row["id"] not in written]
    try:
        if rest:
            tables.append(as_table(rest))
        if tables:
            return pa.concat_tables(_agreeing(tables), promote_options="permissive").sort_by("id")
    except (pa.ArrowException, OverflowError) as error:
        raise InputError(f"its rows are damaged, or not of one sweep: {error}", folder) from None
    raise InputError("there is no result of a sweep in this folder", folder)


def _part(file: Path) -> pa.Table:
    """Read a part; the name of its folder says the task."""
    import pyarrow as pa

    table = read_part(file)
    task = urllib.parse.unquote(file.parent.name.removeprefix("task="))
    return table.add_column(1, "task", pa.array([task] * len(table)))


def read_part(file: Path, columns: list[str] | None = None) -> pa.Table:
    """Read a file of the dataset, or some of its columns.

    Raises
    ------
    InputError
        It is damaged, or none of a sweep.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(file, columns=columns, partitioning=None)
        missing = {"id", "error"} - set(table.column_names)  # which are decoded only here
    except (pa.ArrowException, OSError, UnicodeError) as error:
        reason = [*str(error).splitlines(), "damaged"][0]
        told = f"no part of a sweep's results ({reason}): without it its runs are made again"
        raise InputError(told, file) from None
    if missing:
        raise InputError(f"no part of a sweep's results: it has no column {min(missing)}", file)
    return table


def _agreeing(tables: list[pa.Table]) -> list[pa.Table]:
    """Make text of an argument that is a number in one sweep of the folder and a range in another."""
    import pyarrow as pa

    kinds: dict[str, set[Any]] = {}
    for table in tables:
        for field in table.schema:
            kinds.setdefault(field.name, set()).add(field.type)
    mixed = {name for name, found in kinds.items() if len(found) > 1}

    def told(schema: pa.Schema) -> pa.Schema:
        return pa.schema([field.with_type(pa.string()) if field.name in mixed else field for field in schema])

    return [table.cast(told(table.schema)) for table in tables]


def journal_rows(folder: Path) -> list[dict[str, Any]]:
    """Return the rows that stand in the journal; a last line that was cut off is none.

    Raises
    ------
    InputError
        Another line is damaged.
    """
    try:
        lines = (folder / JOURNAL).read_bytes().split(b"\n")
    except FileNotFoundError:
        return []
    rows = []
    for number, line in enumerate(lines[:-1], 1):
        try:
            row = json.loads(line)
            if not (isinstance(row, dict) and all(isinstance(row.get(name), str) for name in ("id", "task"))):
                raise ValueError("no row of a run")
        except (ValueError, RecursionError) as error:
            raise InputError(f"the journal is damaged ({error}): without this line its run is made again",
                             folder / JOURNAL, number) from None
        rows.append(row)
    return rows
