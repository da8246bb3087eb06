"""Where results go, each at once and for good: a journal, and a dataset in parquet made of it part by part."""

from __future__ import annotations

import json
import os
import shutil
import urllib.parse
from collections import defaultdict
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from edmsim.files import locked, replacing
from edmsim.sweep.perform import Outcome
from edmsim.sweep.runs import SweepRun
from edmsim.sweep.table import JOURNAL, RESULTS, as_table, journal_rows, read_part

ROWS_PER_PART = 1000
"""Rows of a file of the dataset (ours: some hundred kilobytes, so that a million runs are a thousand files)."""
RECORDINGS = "recordings"


class Store:
    """Results of a sweep in a folder; only one process at a time adds to it.

    A row is written to the journal and forced to the disk before `add` returns, so what has been told as done is
    never done again, whenever the process dies. Full parts go into the dataset; the journal is emptied after that,
    and rows that stand in both count once.

    Parameters
    ----------
    out : path
        Folder, made if there is none.

    Raises
    ------
    InputError
        The folder cannot be written to, or another sweep runs in it.
    """

    def __init__(self, out: str | Path) -> None:
        self.folder = Path(out)
        self._held = ExitStack()
        self._held.enter_context(locked(self.folder, "sweep"))
        self.failed: dict[str, bool] = {}  # of every run that is done, whether it failed
        for part in self._parts():
            kept = read_part(part, ["id", "error"]).to_pydict()
            self.failed |= {name: error is not None for name, error in zip(*kept.values(), strict=True)}
        self._waiting = [row for row in journal_rows(self.folder) if row["id"] not in self.failed]
        self.failed |= {row["id"]: row.get("error") is not None for row in self._waiting}
        self._write_journal(self._waiting)  # without a torn last line, and what a part has already
        self._journal = (self.folder / JOURNAL).open("ab")

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.flush()
        self._journal.close()
        self._held.close()

    def misses(self, run: SweepRun) -> bool:
        """Say whether a run is still to be made: it has no row, or not the recordings that are wanted of it."""
        failed = self.failed.get(run.id)
        return failed is None or (not failed and bool(run.recordings) and not self._recording(run).is_dir())

    def add(self, run: SweepRun, outcome: Outcome) -> None:
        """Keep what a run left; its recordings first, so that a row never promises files that are not there."""
        if outcome.files:
            self._record(run, outcome.files)
        if run.id in self.failed:
            return
        self._journal.write(json.dumps(outcome.row).encode() + b"\n")
        self._journal.flush()
        os.fsync(self._journal.fileno())
        self.failed[run.id] = outcome.row["error"] is not None
        self._waiting.append(outcome.row)
        if len(self._waiting) >= ROWS_PER_PART:
            self.flush()

    def flush(self) -> None:
        """Write the rows of the journal as parts of the dataset."""
        import pyarrow.parquet as pq

        by_task: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
        for row in self._waiting:
            by_task[row["task"]].append(row)
        for task, rows in by_task.items():
            folder = self.folder / RESULTS / f"task={urllib.parse.quote(task, safe='')}"
            folder.mkdir(parents=True, exist_ok=True)
            last = max((int(part.stem.removeprefix("part-")) for part in folder.glob("part-*.parquet")), default=-1)
            with replacing(folder / f"part-{last + 1:06d}.parquet") as partial:
                # the folder's name says the task; readers of hive partitions take it from there
                pq.write_table(as_table(rows).drop_columns("task"), partial, compression="zstd")
        self._waiting = []
        self._write_journal([])
        self._journal.close()
        self._journal = (self.folder / JOURNAL).open("ab")

    def forget_failures(self) -> int:
        """Take out the rows of runs that failed, so that they are made again; returns how many."""
        import pyarrow.compute as pc
        import pyarrow.parquet as pq

        self.flush()
        count = sum(self.failed.values())
        for part in self._parts() if count else ():
            table = pq.read_table(part, partitioning=None)
            with replacing(part) as partial:
                pq.write_table(table.filter(pc.is_null(table["error"])), partial, compression="zstd")
        self.failed = {name: False for name, failed in self.failed.items() if not failed}
        return count

    def _parts(self) -> list[Path]:
        return sorted((self.folder / RESULTS).glob("*/*.parquet"))

    def _recording(self, run: SweepRun) -> Path:
        return self.folder / RECORDINGS / run.id

    def _record(self, run: SweepRun, files: Mapping[str, bytes]) -> None:
        """Write a run's files; they appear together or not at all."""
        target = self._recording(run)
        partial = target.with_name(target.name + ".part")
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        for name, content in files.items():
            (partial / name).write_bytes(content)
        shutil.rmtree(target, ignore_errors=True)
        partial.rename(target)

    def _write_journal(self, rows: list[dict[str, Any]]) -> None:
        with replacing(self.folder / JOURNAL) as partial:
            partial.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
