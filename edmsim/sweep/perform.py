"""One run on whatever computer it was sent to: a row of the table, and the files asked for."""

from __future__ import annotations

import json
import math
import socket
import tempfile
import time
import traceback
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from edmsim import __version__
from edmsim.errors import EdmsimError, InputError
from edmsim.evaluation.episode import Result, cut
from edmsim.recording.report import CLOCKS, Report, kinds_of
from edmsim.runs import digest
from edmsim.sweep.runs import SweepRun

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


class Outcome(NamedTuple):
    """What a run leaves."""

    row: dict[str, Any]  # settings, figures and error, by the names of columns; see `table`
    files: dict[str, bytes]  # recordings by name


def perform(run: SweepRun) -> Outcome:
    """Make a run; whatever goes wrong in it becomes its error, and no other run suffers."""
    # a result depends on the run alone, not on computer, process, or what ran before; but for wall_time_s and host
    started = time.monotonic()
    try:
        _same_files(run)
        found, files = _cut(run) if run.is_cut else (_episode(run), {})
    except Exception as error:  # whatever it is: a sweep of a thousand cuts goes on
        found, files = {"error": said(error)}, {}
    return Outcome({
        **blank(run), **found, "wall_time_s": time.monotonic() - started, "host": socket.gethostname(),
    }, files)  # fmt: skip


def lost(run: SweepRun, why: str) -> Outcome:
    """Return the outcome of a run that took its process with it."""
    return Outcome({**blank(run), "error": why}, {})


def blank(run: SweepRun) -> dict[str, Any]:
    """Return the row of a run without results."""
    settings = dict(run.settings)
    constants = dict(settings.pop("constants", ()))
    return {
        "id": run.id, "task": Path(run.task).name if run.is_cut else run.task, "seed": run.seed,
        "machine_sample": run.machine_sample, **settings, **constants, "error": None, "outcome": None,
        **dict.fromkeys(FIGURES), "report": None, "edmsim_version": __version__, "wall_time_s": None,
        "host": None,
    }  # fmt: skip


def said(error: Exception) -> str:
    """Return an error as one line; an unexpected one with the place where it arose."""
    if isinstance(error, EdmsimError):
        return " ".join(str(error).split())
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return " ".join(f"{type(error).__name__}: {error}{where}".split())


def _same_files(run: SweepRun) -> None:
    for file, expected in run.files.items():
        if digest(file) != expected:
            raise InputError("is not there, or not the file the sweep began with", file)


def _cut(run: SweepRun) -> tuple[dict[str, Any], dict[str, bytes]]:
    import edmsim

    settings = dict(run.settings)
    drawn = {} if run.machine_sample is None else _drawn(run, run.machine_sample)
    settings["constants"] = {**dict(settings.get("constants", ())), **drawn}
    result = edmsim.cut(run.task, **settings, seed=run.seed)
    report = {name: value for name, value in result.report.items() if name not in CLOCKS}
    row = {
        "outcome": result.report.outcome, **drawn, **values_of(result.report),
        "report": json.dumps(report, default=dict),
    }
    return row, _recorded(run, result) if run.recordings else {}


def _drawn(run: SweepRun, sample: int) -> dict[str, float]:
    """Return the constants of a drawn machine; every setting gets the same draw, for comparison."""
    from edmsim.job.settings import CutSettings
    from edmsim.machine.ranges import choose

    machine = CutSettings.model_validate(run.settings).load_machine()
    only = run.sample_only
    chosen = machine.uncertain() if only is None else choose(machine, only)
    known = machine.sample(np.random.default_rng(sample), only).uncertain()
    return {name: known[name].value for name in chosen}


def _recorded(run: SweepRun, result: Any) -> dict[str, bytes]:
    from edmsim.recording import write_json, write_windows

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
    from edmsim.envs.registry import resolve

    options = dict(run.settings)
    controller, resolution = str(options.pop("controller")), str(options.pop("resolution"))
    result = cut(resolve(run.task), run.seed, controller, resolution, **options)
    return {"outcome": result.outcome, **values_of(result)}
