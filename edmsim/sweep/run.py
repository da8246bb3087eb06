"""``edmsim sweep run``: a sweep from its specification to its folder.

All combinations are checked before the first run; an `InputError` names values with which no cut can be made.
"""

import json
import math
import socket
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from edmsim import __version__
from edmsim.envs.registry import resolve
from edmsim.errors import CombinationError, EdmsimError, InputError, refuses_wrong_types
from edmsim.evaluation.episode import Result, cut
from edmsim.files import replacing
from edmsim.job.options import CutSettings
from edmsim.job.plan import planned, prepared
from edmsim.machine.machine import Machine
from edmsim.machine.ranges import choose
from edmsim.machine.setting import guide_bends
from edmsim.program.outline import Program
from edmsim.program.passes import PassPlan
from edmsim.program.path import CutPath
from edmsim.recording.report import CLOCKS, Report, kinds_of, write_json
from edmsim.recording.windows import write_windows
from edmsim.runs import Engine, LostJob, Processes, digest
from edmsim.sweep.specification import Specification, SweepRun, arguments_of, checked, combinations, runs_of
from edmsim.sweep.table import Outcome, Store

FIGURES = {kind.column: kind for kind in (*kinds_of(Report).values(), *kinds_of(Result).values()) if kind.column}
"""Figures of a run, from a cut's report or an episode's result; null if the run does not measure them."""


def values_of(run: Report | Result) -> dict[str, float | None]:
    """Return the figures of a cut or an episode."""
    found: dict[str, float | None] = dict.fromkeys(FIGURES)
    record: Any = type(run)
    for place, kind in kinds_of(record).items():
        value = attrgetter(place)(run)
        if kind.column and value is not None and math.isfinite(value):
            found[kind.column] = float(value)
    return found


def perform(run: SweepRun) -> Outcome:
    """Make a run; an exception becomes its error, so that the other runs continue."""
    # except wall_time_s and host, a result depends only on the run, not on computer, process or earlier runs
    started = time.monotonic()
    try:
        _same_files(run)
        found, files = _cut(run) if run.is_cut else (_episode(run), {})
    except Exception as error:  # any exception, because it must not end a sweep of a thousand cuts
        found, files = {"error": said(error)}, {}
    return Outcome({
        **blank(run), **found, "wall_time_s": time.monotonic() - started, "host": socket.gethostname(),
    }, files)  # fmt: skip


def blank(run: SweepRun) -> dict[str, Any]:
    """Return the row of a run without results."""
    settings = dict(run.settings)
    constants = dict(settings.pop("constants", ()))
    files = sorted(f"{Path(file).name} {found[:8]}" for file, found in run.files.items())
    return {
        "id": run.id, "task": Path(run.task).name if run.is_cut else run.task, "seed": run.seed,
        "machine_sample": run.machine_sample, **settings, **constants, "error": None, "outcome": None,
        **dict.fromkeys(FIGURES), "report": None, "files": ", ".join(files),
        "edmsim_version": __version__, "wall_time_s": None, "host": None,
    }  # fmt: skip


def said(error: Exception) -> str:
    """Return an error as one line; one that is not an `EdmsimError` includes the file and line that raised it."""
    if isinstance(error, EdmsimError):
        return " ".join(str(error).split())
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return " ".join(f"{type(error).__name__}: {error}{where}".split())


def _same_files(run: SweepRun) -> None:
    for file, expected in run.files.items():
        if digest(file) != expected:
            raise InputError("is missing, or has changed since the sweep began", file)


def _cut(run: SweepRun) -> tuple[dict[str, Any], dict[str, bytes]]:
    import edmsim

    settings = dict(run.settings)
    drawn = {} if run.machine_sample is None else _drawn(run, run.machine_sample)
    settings["constants"] = {**dict(settings.get("constants", ())), **drawn}
    result = edmsim.cut(run.task, **settings, seed=run.seed)
    report = {name: value for name, value in result.report.items() if name not in CLOCKS}
    row = {"outcome": result.report.outcome, **drawn, **values_of(result.report), "report": json.dumps(report)}
    return row, _recorded(run, result) if run.recordings else {}


def _drawn(run: SweepRun, sample: int) -> dict[str, float]:
    """Return the constants of a drawn machine; a sample is the same draw for all settings, for comparison."""
    machine = prepared(run.task, CutSettings.model_validate(run.settings)).machine  # with passes that of a technology
    only = run.sample_only
    chosen = machine.uncertain() if only is None else choose(machine, only)
    known = machine.sample(np.random.default_rng(sample), only).uncertain()
    return {name: known[name].value for name in chosen}


def _recorded(run: SweepRun, result: Any) -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if "all" in run.recordings:
            result.write(folder)
        else:
            if "report" in run.recordings:
                write_json(result.report, folder / "report.json")
            if "windows" in run.recordings:
                write_windows(result.windows, folder / "windows.parquet")
        return {file.name: file.read_bytes() for file in sorted(folder.iterdir()) if file.is_file()}


def _episode(run: SweepRun) -> dict[str, Any]:
    options = arguments_of(run.settings)
    controller, resolution = str(options.pop("controller")), str(options.pop("resolution"))
    result = cut(resolve(run.task), run.seed, controller, resolution, **options)
    return {"outcome": result.outcome, **values_of(result)}


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
                ready = prepared(task, CutSettings.model_validate(settings), planner)
                choose(ready.machine, specification.sample_only or ())
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
        self._known: dict[tuple[Any, ...], CutPath | EdmsimError] = {}

    def __call__(
        self, program: str | Path | Program, settings: CutSettings, machines: Sequence[Machine],
        passes: PassPlan | None = None,
    ) -> CutPath:
        options: Mapping[str, Any] = dict(settings)
        bends = tuple((one.height_mm, *guide_bends(one)) for one in machines)
        key = (str(program), machines[0].auto_offset_mm, machines[0].base.table.model_dump_json(), passes, bends,
               *(options[name] for name in self._OPTIONS))  # fmt: skip
        if key not in self._known:
            try:
                self._known[key] = planned(program, settings, machines, passes)
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
    specification: Specification, out: str | Path, *, engine: Engine | None = None, retry_failed: bool = False,
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
        with replacing(store.folder / SPECIFICATION) as partial:
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
        for run, answer in (engine or Processes()).done(perform, missing()):
            outcome = Outcome({**blank(run), "error": answer.why}, {}) if isinstance(answer, LostJob) else answer
            store.add(run, outcome)
            count(outcome.row["error"] is not None, 1)
            tell(now)
        if not now.made:
            tell(now)
        return now
