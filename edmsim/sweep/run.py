"""A sweep from its specification to its folder: what ``edmsim sweep`` does."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from edmsim.files import replacing
from edmsim.sweep.check import check_runs
from edmsim.sweep.engine import Engine, Lost, Processes
from edmsim.sweep.perform import Outcome, lost, perform
from edmsim.sweep.runs import SweepRun, runs_of
from edmsim.sweep.specification import Specification
from edmsim.sweep.store import Store

SPECIFICATION = "specification.json"
"""File in which a sweep's folder keeps the specification last run there."""


class SweepProgress(NamedTuple):
    """How far a sweep is.

    Attributes
    ----------
    done, total : int
        Runs that need not be made any more, and all.
    made, failed : int
        Runs made just now, and those of all done that failed.
    """

    done: int
    total: int
    made: int
    failed: int


def sweep(
    specification: Specification, out: str | Path, *, engine: Engine | None = None, retry_failed: bool = False,
    watch: Callable[[SweepProgress], None] | None = None, checking: Callable[[int, int], None] | None = None,
) -> SweepProgress:
    """Make all runs of a sweep that are not done yet.

    Parameters
    ----------
    specification : Specification
    out : path
        Folder of the results; see `read`. What is there already stays: give more seeds, and only those are run.
    engine : Engine, optional
        Where runs are made; all processors of this computer by default.
    retry_failed : bool
        Make again what failed.
    watch : callable, optional
        Called with a `SweepProgress` at the beginning and after every run.
    checking : callable, optional
        Called before that with the combinations of settings looked at and to look at: all are prepared as for a cut
        before the first run.

    Returns
    -------
    SweepProgress
        At the end. A run that failed is a row with its error.

    Raises
    ------
    InputError
        A combination of settings that cannot be run, or a folder that cannot be written to.
    KeyboardInterrupt
        All that was done is kept; the same call goes on.

    Examples
    --------
    >>> from edmsim.sweep.specification import Specification
    >>> spec = Specification(environment="edmsim/GapFeed-v1", seeds=4, grid={"controller": "counts,voltage"})
    >>> spec.runs
    8
    """
    check_runs(specification, checking)  # before a folder is made
    with Store(out) as store:
        if retry_failed:
            store.forget_failures()
        with replacing(store.folder / SPECIFICATION) as partial:
            partial.write_text(specification.model_dump_json(indent=2) + "\n", encoding="utf-8")
        counts = _Counts(specification.runs, watch)
        counts.tell()
        for run, answer in (engine or Processes()).done(perform, _missing(specification, store, counts)):
            outcome = lost(run, answer.why) if isinstance(answer, Lost) else answer
            store.add(run, outcome)
            counts.made_one(outcome)
        return counts.progress


class _Counts:
    """Counts of a sweep, told to whoever watches."""

    def __init__(self, total: int, watch: Callable[[SweepProgress], None] | None) -> None:
        self.progress = SweepProgress(0, total, 0, 0)
        self._watch = watch

    def tell(self) -> None:
        if self._watch is not None:
            self._watch(self.progress)

    def skip_one(self, failed: bool) -> None:
        now = self.progress
        self.progress = now._replace(done=now.done + 1, failed=now.failed + failed)

    def made_one(self, outcome: Outcome) -> None:
        now = self.progress
        failed = now.failed + (outcome.row["error"] is not None)
        self.progress = now._replace(done=now.done + 1, made=now.made + 1, failed=failed)
        self.tell()


def _missing(specification: Specification, store: Store, counts: _Counts) -> Iterator[SweepRun]:
    """Yield the runs that are still to be made, as they are asked for."""
    for run in runs_of(specification):
        if store.misses(run):
            yield run
        else:
            counts.skip_one(store.failed[run.id])
