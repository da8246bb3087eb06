"""The results of a sweep: columns of their table, and their storage.

Each result is saved at once in a journal, whose rows are moved in parts to a Parquet dataset.
"""

import json
import shutil
import urllib.parse
from collections import defaultdict
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple, Self

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from edmsim.errors import InputError, refuses_wrong_types
from edmsim.files import folder_of, locked, naming, replacing
from edmsim.job.options import CutSettings
from edmsim.machine.options import kind_of
from edmsim.recording.report import RECORDING
from edmsim.runs import RunTable, read_rows
from edmsim.sweep.specification import SweepRun

RESULTS = "results"  # folder of the Parquet dataset; a subfolder ``task=...`` for each program or environment
JOURNAL = "journal.jsonl"
ROW_TEXTS = "id", "task"  # texts that every row of a journal must have
_WHOLE = {"seed", "machine_sample"}
_NUMBERS = {"int", "int | None", "float", "float | None"}
_TEXTS = {
    "id", "task", "error", "outcome", "report", "files", "edmsim_version", "host",
    *(name for name, field in CutSettings.model_fields.items() if kind_of(field.annotation) not in _NUMBERS),
}  # fmt: skip


class Outcome(NamedTuple):
    """Results of a run."""

    row: dict[str, Any]  # settings, figures and error, by the names of columns; see `read`
    files: dict[str, bytes]  # recordings by name


def as_table(rows: Iterable[Mapping[str, Any]]) -> pa.Table:
    """Return rows as a table; types of known columns follow from their names, so all parts of a dataset agree."""
    listed = list(rows)
    names = list(dict.fromkeys(name for row in listed for name in row))
    columns = {name: [row.get(name) for row in listed] for name in names}
    return pa.table({name: pa.array(*_typed(name, values)) for name, values in columns.items()})


def _typed(name: str, values: list[Any]) -> tuple[list[Any], Any]:
    """Return a column's values and type; values that are neither number nor text become JSON."""
    if name in _WHOLE:
        return values, pa.int64()
    are_numbers = all(value is None or type(value) in (int, float) for value in values)
    if are_numbers and name not in _TEXTS:
        return [None if value is None else float(value) for value in values], pa.float64()
    return [value if value is None or isinstance(value, str) else json.dumps(value) for value in values], pa.string()


@refuses_wrong_types
def read(out: str | Path) -> pa.Table:
    """Read the results of a sweep, even while it is running.

    Parameters
    ----------
    out : path
        The sweep's folder.

    Returns
    -------
    pyarrow.Table
        One row per run, ordered by id: id, task, seed, settings, constants, ``error`` (null if the run succeeded),
        ``outcome``, the figures of `edmsim.sweep.run.FIGURES`, ``report`` (JSON, of cuts),
        ``files`` (names and digests of program and own files), ``edmsim_version``, ``wall_time_s`` and ``host``.

    Raises
    ------
    InputError
        If the folder has no sweep.
    """
    folder = folder_of(out)
    tables = [_part(file) for file in _parts(folder)]
    written = {identity for table in tables for identity in table["id"].to_pylist()}
    rest = [row for row in read_rows(folder / JOURNAL, texts=ROW_TEXTS) if row["id"] not in written]
    try:
        if rest:
            tables.append(as_table(rest))
        if tables:
            return pa.concat_tables(_agreeing(tables), promote_options="permissive").sort_by("id")
    except (pa.ArrowException, OverflowError) as error:
        raise InputError(f"its rows are damaged, or not of one sweep: {error}", folder) from None
    raise InputError("there is no result of a sweep in this folder", folder)


def _parts(folder: Path) -> list[Path]:
    return sorted((folder / RESULTS).glob("*/*.parquet"))


def _part(file: Path) -> pa.Table:
    """Read a part, and add the task from the name of its folder."""
    table = read_part(file)
    task = urllib.parse.unquote(file.parent.name.removeprefix("task="))
    return table.add_column(1, "task", pa.array([task] * len(table)))


def read_part(file: Path, columns: list[str] | None = None) -> pa.Table:
    """Read a file of the dataset, or some of its columns; raise `InputError` if it is damaged or not of a sweep."""
    try:
        table = pq.read_table(file, columns=columns, partitioning=None)
        missing = {"id", "error"} - set(table.column_names)  # the names are decoded only here
    except (pa.ArrowException, OSError, UnicodeError) as error:
        reason = [*str(error).splitlines(), "damaged"][0]
        message = f"no part of a sweep's results ({reason}); if you delete it, its runs are made again"
        raise InputError(message, file) from None
    if missing:
        raise InputError(f"no part of a sweep's results: it has no column {min(missing)}", file)
    return table


def _agreeing(tables: list[pa.Table]) -> list[pa.Table]:
    """Cast columns of different types to text: an argument is a number in one sweep and a range in another."""
    kinds: dict[str, set[Any]] = {}
    for table in tables:
        for field in table.schema:
            kinds.setdefault(field.name, set()).add(field.type)
    mixed = {name for name, found in kinds.items() if len(found) > 1}

    def as_text(schema: pa.Schema) -> pa.Schema:
        return pa.schema([field.with_type(pa.string()) if field.name in mixed else field for field in schema])

    return [table.cast(as_text(table.schema)) for table in tables]


ROWS_PER_PART = 1000
"""Rows per file of the dataset (ours: some hundred kilobytes; a million runs are a thousand files)."""
RECORDINGS = "recordings"
_FILE_OF = {"report": "report.json", "windows": "windows.parquet", "all": RECORDING}
"""File that a run has if it was recorded."""


class Store:
    """Results of a sweep in a folder; only one process at a time adds to it."""

    # a full journal is written to the dataset and emptied after that; if a kill leaves rows in both, they count once

    def __init__(self, out: str | Path) -> None:
        self.folder = folder_of(out)
        self._held = ExitStack()
        self._held.enter_context(locked(self.folder, "sweep"))
        self.failed: dict[str, bool] = {}  # whether each finished run failed, by its id
        for part in _parts(self.folder):
            done = read_part(part, ["id", "error"]).to_pydict()
            self.failed |= {name: error is not None for name, error in zip(*done.values(), strict=True)}
        self._journal = RunTable(self.folder / JOURNAL, texts=ROW_TEXTS)
        self._journal.keep([row for name, row in self._journal.rows.items() if name not in self.failed])
        self.failed |= {name: row.get("error") is not None for name, row in self._journal.rows.items()}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.flush()
        self._held.close()

    def misses(self, run: SweepRun) -> bool:
        """Return whether a run must be made: it has no row, or it succeeded without the requested recordings."""
        recorded = all((self._recording(run) / _FILE_OF[which]).is_file() for which in run.recordings)
        return run.id not in self.failed or not (self.failed[run.id] or recorded)

    def add(self, run: SweepRun, outcome: Outcome) -> None:
        """Save the results of a run, recordings first, so no row lacks its files."""
        if outcome.files:
            self._record(run, outcome.files)
        if run.id in self.failed:
            return
        self._journal.add(outcome.row)
        self.failed[run.id] = outcome.row["error"] is not None
        if len(self._journal.rows) >= ROWS_PER_PART:
            self.flush()

    def flush(self) -> None:
        """Write the rows of the journal as parts of the dataset."""
        by_task: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
        for row in self._journal.rows.values():
            by_task[row["task"]].append(row)
        for task, rows in by_task.items():
            folder = self.folder / RESULTS / f"task={urllib.parse.quote(task, safe='')}"
            folder.mkdir(parents=True, exist_ok=True)
            last = max((int(part.stem.removeprefix("part-")) for part in folder.glob("part-*.parquet")), default=-1)
            with replacing(folder / f"part-{last + 1:06d}.parquet") as partial:
                # readers of hive partitions take the task from the folder's name
                pq.write_table(as_table(rows).drop_columns("task"), partial, compression="zstd")
        self._journal.keep(())

    def forget_failures(self) -> None:
        """Remove the rows of failed runs, which will be run again."""
        self.flush()
        for part in _parts(self.folder) if any(self.failed.values()) else ():
            table = pq.read_table(part, partitioning=None)
            with replacing(part) as partial:
                pq.write_table(table.filter(pc.is_null(table["error"])), partial, compression="zstd")
        self.failed = {name: False for name, failed in self.failed.items() if not failed}

    def _recording(self, run: SweepRun) -> Path:
        return self.folder / RECORDINGS / run.id

    def _record(self, run: SweepRun, files: Mapping[str, bytes]) -> None:
        """Write a run's files next to those it has; they appear together or not at all."""
        target = self._recording(run)
        partial = target.with_name(target.name + ".part")
        shutil.rmtree(partial, ignore_errors=True)
        if target.exists():
            shutil.copytree(target, partial)
        partial.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            with naming(partial / name):
                (partial / name).write_bytes(content)
        shutil.rmtree(target, ignore_errors=True)
        partial.rename(target)
