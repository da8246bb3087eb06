"""``edmsim sweep run``: a sweep from its specification to its folder, and the results there.

All combinations are checked before the first run; an `InputError` names values with which no cut can be made. Each
result is saved at once in a journal, whose rows are moved in parts to a Parquet dataset.
"""

import json
import math
import socket
import tempfile
import time
import traceback
import urllib.parse
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import edmsim
from edmsim import files, runs, user_code
from edmsim.controllers.protocols import set_up_controller
from edmsim.envs.registry import resolve
from edmsim.errors import CombinationError, EdmsimError, InputError, refuses_wrong_types
from edmsim.evaluation.episode import Result, cut
from edmsim.job import plan
from edmsim.job.options import CutSettings
from edmsim.machine import options, ranges, setting
from edmsim.program import outline, passes, path
from edmsim.recording import report, windows
from edmsim.sweep.specification import Specification, SweepRun, arguments_of, checked, combinations, runs_of

# The results: columns of their table, and their storage.

RESULTS = "results"  # folder of the Parquet dataset; a subfolder ``task=...`` for each program or environment
JOURNAL = "journal.jsonl"
ROW_TEXTS = "id", "task"  # texts that every row of a journal must have
_WHOLE = {"seed", "machine_sample"}
_NUMBERS = {"int", "int | None", "float", "float | None"}
_TEXTS = {
    "id", "task", "error", "outcome", "report", "files", "edmsim_version", "host",
    *(name for name, field in CutSettings.model_fields.items() if options.kind_of(field.annotation) not in _NUMBERS),
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
    folder = files.folder_of(out)
    tables = [_part(file) for file in _parts(folder)]
    written = {name for table in tables for name in table["id"].to_pylist()}
    rest = [row for row in runs.read_rows(folder / JOURNAL, texts=ROW_TEXTS) if row["id"] not in written]
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
_FILE_OF = {"report": "report.json", "windows": "windows.parquet", "all": report.RECORDING}
"""File that a run has if it was recorded."""


class Store:
    """Results of a sweep in a folder; only one process at a time adds to it."""

    # a full journal is written to the dataset and emptied after that; if a kill leaves rows in both, they count once

    def __init__(self, out: str | Path) -> None:
        self.folder = files.folder_of(out)
        self._held = ExitStack()
        self._held.enter_context(files.locked(self.folder, "sweep"))
        self.failed: dict[str, bool] = {}  # whether each finished run failed, by its id
        for part in _parts(self.folder):
            done = read_part(part, ["id", "error"]).to_pydict()
            self.failed |= {name: error is not None for name, error in zip(*done.values(), strict=True)}
        self._journal = runs.RunTable(self.folder / JOURNAL, texts=ROW_TEXTS)
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
            with files.replacing(folder / f"part-{last + 1:06d}.parquet") as partial:
                # readers of hive partitions take the task from the folder's name
                pq.write_table(as_table(rows).drop_columns("task"), partial, compression="zstd")
        self._journal.keep(())

    def forget_failures(self) -> None:
        """Remove the rows of failed runs, which will be run again."""
        self.flush()
        for part in _parts(self.folder) if any(self.failed.values()) else ():
            table = pq.read_table(part, partitioning=None)
            with files.replacing(part) as partial:
                pq.write_table(table.filter(table["error"].is_null()), partial, compression="zstd")
        self.failed = {name: False for name, failed in self.failed.items() if not failed}

    def _recording(self, run: SweepRun) -> Path:
        return self.folder / RECORDINGS / run.id

    def _record(self, run: SweepRun, recorded: Mapping[str, bytes]) -> None:
        """Write a run's files next to those it has; they appear together or not at all."""
        folder = self._recording(run)
        folder.mkdir(parents=True, exist_ok=True)
        with files.together(folder, report.RECORDING if report.RECORDING in recorded else min(recorded)) as partial:
            for name, content in recorded.items():
                with files.naming(partial / name):
                    (partial / name).write_bytes(content)


# One run.

FIGURES = {
    kind.column: kind
    for record in (report.Report, Result) for kind in report.kinds_of(record).values() if kind.column
}
"""Figures of a run, from a cut's report or an episode's result; null if the run does not measure them."""


def values_of(run: report.Report | Result) -> dict[str, float | None]:
    """Return the figures of a cut or an episode."""
    found: dict[str, float | None] = dict.fromkeys(FIGURES)
    record: Any = type(run)
    for place, kind in report.kinds_of(record).items():
        value = attrgetter(place)(run)
        if kind.column and value is not None and math.isfinite(value):
            found[kind.column] = float(value)
    return found


def perform(run: SweepRun) -> Outcome:
    """Make a run; an exception becomes its error, so that the other runs continue."""
    # except wall_time_s and host, a result depends only on the run, not on computer, process or earlier runs
    started = time.monotonic()
    try:
        for file, expected in run.files.items():
            if runs.digest(file) != expected:
                raise InputError("is missing, or has changed since the sweep began", file)
        found, recorded = _cut(run) if run.is_cut else (_episode(run), {})
    except Exception as error:  # any exception, because it must not end a sweep of a thousand cuts
        found, recorded = {"error": said(error)}, {}
    made = {"wall_time_s": time.monotonic() - started, "host": socket.gethostname()}
    return Outcome({**blank(run), **found, **made}, recorded)


def blank(run: SweepRun) -> dict[str, Any]:
    """Return the row of a run without results."""
    settings = dict(run.settings)
    constants = dict(settings.pop("constants", ()))
    digests = sorted(f"{Path(file).name} {found[:8]}" for file, found in run.files.items())
    return {
        "id": run.id, "task": Path(run.task).name if run.is_cut else run.task, "seed": run.seed,
        "machine_sample": run.machine_sample, **settings, **constants, "error": None, "outcome": None,
        **dict.fromkeys(FIGURES), "report": None, "files": ", ".join(digests),
        "edmsim_version": edmsim.__version__, "wall_time_s": None, "host": None,
    }  # fmt: skip


def said(error: Exception) -> str:
    """Return an error as one line; one that is not an `EdmsimError` includes the file and line that raised it."""
    if isinstance(error, EdmsimError):
        return " ".join(str(error).split())
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return " ".join(f"{type(error).__name__}: {error}{where}".split())


def _cut(run: SweepRun) -> tuple[dict[str, Any], dict[str, bytes]]:
    settings = dict(run.settings)
    drawn = {} if run.machine_sample is None else _drawn(run, run.machine_sample)
    settings["constants"] = {**dict(settings.get("constants", ())), **drawn}
    result = edmsim.cut(run.task, **settings, seed=run.seed)
    shown = {name: value for name, value in result.report.items() if name not in report.CLOCKS}
    row = {"outcome": result.report.outcome, **drawn, **values_of(result.report), "report": json.dumps(shown)}
    return row, _recorded(run, result) if run.recordings else {}


def _drawn(run: SweepRun, sample: int) -> dict[str, float]:
    """Return the constants of a drawn machine; a sample is the same draw for all settings, for comparison."""
    # the machine of a cut in passes is that of a technology
    machine, only = plan.prepared(run.task, CutSettings.model_validate(run.settings)).machine, run.sample_only
    chosen = machine.uncertain() if only is None else ranges.choose(machine, only)
    return ranges.values_of(machine.sample(np.random.default_rng(sample), only), chosen)


def _recorded(run: SweepRun, result: Any) -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if "all" in run.recordings:
            result.write(folder)
        else:
            if "report" in run.recordings:
                report.write_json(result.report, folder / "report.json")
            if "windows" in run.recordings:
                windows.write_windows(result.windows, folder / "windows.parquet")
        return {file.name: file.read_bytes() for file in sorted(folder.iterdir()) if file.is_file()}


def _episode(run: SweepRun) -> dict[str, Any]:
    arguments = arguments_of(run.settings)
    controller, resolution = str(arguments.pop("controller")), str(arguments.pop("resolution"))
    result = cut(resolve(run.task), run.seed, controller, resolution, **arguments)
    return {"outcome": result.outcome, **values_of(result)}


# All runs.

MOST_REASONS = 3  # most reasons in the error (ours), which is one line


def check_runs(specification: Specification, checking: Callable[[int, int], None] | None = None) -> None:
    """Prepare every combination of settings as its cut would; raise `InputError` if a value is always invalid."""
    # If values of a grid are invalid only together, such as a long on-time and a short period, their run fails and
    # the others are made. A value of a Sobol sample has only its own point; its run fails if the values are invalid
    # only together (`CombinationError`, of a pulse setting).
    planner, is_cut = _Planner(), bool(specification.program)
    refused: dict[str, list[dict[str, Any]]] = {}
    possible: set[tuple[str, str]] = set()  # pairs of setting and value in valid combinations
    values_wrong = False
    total = specification.runs // (len(specification.seeds) * max(specification.machine_samples, 1))
    for number, (task, settings_of_run) in enumerate(combinations(specification), 1):
        combination = {"program" if is_cut else "environment": task, **settings_of_run}
        try:
            settings = checked(task, settings_of_run, is_cut)
            if is_cut:
                ready = plan.prepared(task, CutSettings.model_validate(settings), planner)
                ranges.choose(ready.machine, specification.sample_only or ())
                if user_code.named(str(ready.settings.controller)) is None:  # an error of own code is its run's
                    # a law refuses feeds above the greatest when it is reset
                    set_up_controller(ready.controller, ready.machine, ready.path.contours[0].points_um, 0.0)
                    ready.controller.reset(plan.feed_limit(ready.machine, ready.settings.planner)[0])
            possible |= _values(combination)
        except EdmsimError as error:
            values_wrong |= not isinstance(error, CombinationError)
            refused.setdefault(str(error), []).append(combination)
        if checking is not None:
            checking(number, total)
    in_refused = {pair for those in refused.values() for combination in those for pair in _values(combination)}
    if specification.sobol is None:
        values_wrong = not in_refused <= possible
    wrong = sum(map(len, refused.values()))
    if not wrong or not (values_wrong or wrong == total):
        return
    varied = {name for name, values in Counter(name for name, _ in in_refused | possible).items() if values > 1}
    if not varied:
        raise InputError(next(iter(refused)))
    reasons = [f"{_named(those, varied)}{reason}" for reason, those in refused.items()]
    more = f"; and {len(reasons) - MOST_REASONS} more" if len(reasons) > MOST_REASONS else ""
    raise InputError(
        f"{wrong} of {total} combinations cannot be run, so none was: {'; '.join(reasons[:MOST_REASONS])}{more}"
    )


def _values(combination: Mapping[str, Any]) -> set[tuple[str, str]]:
    return {(name, repr(value)) for name, value in combination.items()}


def _named(those: list[dict[str, Any]], varied: set[str]) -> str:
    """Return ``with NAME VALUE: `` for those settings in `varied` that are equal in all these combinations."""
    first = those[0]
    common = [name for name in first if name in varied and all(other[name] == first[name] for other in those)]
    values = ", ".join(f"{name} {_said(first[name])}" for name in common)
    return f"with {values}: " if values else ""


def _said(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


class _Planner:
    """Plans and caches paths, because most settings of a cut do not change its path."""

    _OPTIONS = (
        "planner", "offset", "ignore", "layers", "unit", "offsets", "dialect", "conditions", "upper_layer",
        "taper_deg", "taper_corners", "guide_errors_mm",
    )  # fmt: skip

    def __init__(self) -> None:
        self._known: dict[tuple[Any, ...], path.CutPath | EdmsimError] = {}

    def __call__(
        self, program: str | Path | outline.Program, settings: CutSettings, machines: Sequence[edmsim.Machine],
        of_passes: passes.PassPlan | None = None,
    ) -> path.CutPath:
        decided: Mapping[str, Any] = dict(settings)
        bends = tuple((one.height_mm, *setting.guide_bends(one)) for one in machines)
        key = (str(program), machines[0].auto_offset_mm, machines[0].base.table.model_dump_json(), of_passes, bends,
               *(decided[name] for name in self._OPTIONS))  # fmt: skip
        if key not in self._known:
            try:
                self._known[key] = plan.planned(program, settings, machines, of_passes)
            except EdmsimError as error:
                self._known[key] = error
        found = self._known[key]
        if isinstance(found, EdmsimError):
            raise found
        return found


SPECIFICATION = "specification.json"  # file in a sweep's folder with the specification of its last call


class SweepProgress(NamedTuple):
    """Progress of a sweep."""

    done: int  # finished runs
    total: int
    made: int  # finished by this call
    failed: int  # of the finished ones


@refuses_wrong_types
def sweep(
    specification: Specification, out: str | Path, *, engine: runs.Engine | None = None, retry_failed: bool = False,
    watch: Callable[[SweepProgress], None] | None = None, checking: Callable[[int, int], None] | None = None,
) -> SweepProgress:
    """Make all runs of a sweep that are not finished.

    Parameters
    ----------
    specification : Specification
    out : path
        Folder of the results; see `read`. Finished runs stay: if you add seeds, only those are run.
    engine : Engine, optional
        By default all processors of this computer.
    retry_failed : bool
        Whether to repeat failed runs.
    watch : callable, optional
        Called with a `SweepProgress` at the start and after every run.
    checking : callable, optional
        Called with the numbers of checked and of all combinations of settings; all are checked before the first
        run.

    Returns
    -------
    SweepProgress
        Progress at the end. A failed run is a row with its error.

    Raises
    ------
    InputError
        If a combination of settings cannot be run, or the folder is not writable.
    KeyboardInterrupt
        If interrupted; finished runs are saved, and the same call resumes.

    Examples
    --------
    >>> from edmsim.sweep.specification import Specification
    >>> spec = Specification(environment="edmsim/GapFeed-v2", seeds=4, grid={"controller": "counts,voltage"})
    >>> spec.runs
    8
    """
    check_runs(specification, checking)  # before a folder is made
    with Store(out) as store:
        if retry_failed:
            store.forget_failures()
        with files.replacing(store.folder / SPECIFICATION) as partial:
            partial.write_text(specification.model_dump_json(indent=2) + "\n", encoding="utf-8")
        now = SweepProgress(0, specification.runs, 0, 0)

        def count(failed: bool, made: int) -> None:
            nonlocal now
            now = SweepProgress(now.done + 1, now.total, now.made + made, now.failed + failed)

        def missing() -> Iterator[SweepRun]:
            for run in runs_of(specification):
                if store.misses(run):
                    yield run
                else:
                    count(store.failed[run.id], 0)

        tell = watch or (lambda _: None)
        tell(now)
        for run, answer in (engine or runs.Processes()).done(perform, missing()):
            outcome = Outcome({**blank(run), "error": answer.why}, {}) if isinstance(answer, runs.LostJob) else answer
            store.add(run, outcome)
            count(outcome.row["error"] is not None, 1)
            tell(now)
        if not now.made:
            tell(now)
        return now
