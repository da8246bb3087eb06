"""``edmsim sweep``: many cuts from one specification, and what came of them."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from edmsim.cli.console import INTERRUPTED, OUT, STOPPED, say
from edmsim.errors import InputError

if TYPE_CHECKING:
    from edmsim.runs import Engine
    from edmsim.sweep.run import SweepProgress
    from edmsim.sweep.specification import Specification

Ray = Annotated[str | None, typer.Option(metavar="ADDRESS", help="Ray cluster: auto, or HOST:PORT (extra cluster).")]
ProcessCount = Annotated[
    int | None, typer.Option("--processes", help="Processes on this computer; default: one per processor.")
]
SHORT_FORM = {"ignore_unknown_options": True, "allow_extra_args": True}


def run(
    context: typer.Context,
    what: Annotated[str, typer.Argument(help="Specification (.toml), part program, or environment.")],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    seeds: Annotated[int | None, typer.Option(help="Seeds per combination; default: 1.")] = None,
    machine_samples: Annotated[
        int | None, typer.Option(help="Machines drawn within the ranges of their constants, for every combination.")
    ] = None,
    record: Annotated[
        list[str] | None, typer.Option(help="Store of each cut: report, windows or all; repeatable.")
    ] = None,
    ray: Ray = None,
    processes: ProcessCount = None,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Repeat failed runs.")] = False,
) -> None:
    """Run many cuts from one specification.

    Every combination of settings, seeds and machines is cut. Any option of a cut or an environment takes values:
    --height 5,10,20 --t-on 10:40:5 --gap.critical_um 4,5.
    If a sweep was interrupted, the same command makes only the missing runs.
    """
    from edmsim.progress import ShownProgress
    from edmsim.sweep.run import sweep

    specification = _specification(what, context.args, seeds, machine_samples, record)
    engine = engine_of(ray, processes)
    try:
        with ShownProgress(keep=True) as bar:

            def watch(progress: SweepProgress) -> None:
                failed = f", {progress.failed} failed" if progress.failed else ""
                text = f"{progress.done} of {progress.total}{failed}"
                bar.show("runs", progress.done, progress.total, text)

            def checking(done: int, total: int) -> None:
                if time.monotonic() > slow_s:
                    bar.show("looked at before the first run", done, total)

            slow_s = time.monotonic() + 2.0
            last = sweep(specification, out, engine=engine, retry_failed=retry_failed, watch=watch, checking=checking)
    except KeyboardInterrupt:
        say("interrupted; run the same command to make the missing runs")
        raise typer.Exit(INTERRUPTED) from None
    OUT.print(f"{last.done} runs, {last.made} made now, {last.failed} failed.", highlight=False)
    OUT.print(f"Look at them with: edmsim sweep show {out}", highlight=False, soft_wrap=True, markup=False)
    if last.failed:
        raise typer.Exit(STOPPED)


def show(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a sweep.", show_default=False)],
) -> None:
    """Show the results of a sweep, and draw DIR/pareto.png."""
    from edmsim.recording.figures import write_figure
    from edmsim.sweep.summary import pareto_figure, render
    from edmsim.sweep.table import read

    table = read(folder)
    OUT.print(render(table))
    write_figure(pareto_figure(table), folder / "pareto.png")
    OUT.print(f"Written: {folder / 'pareto.png'}", highlight=False, soft_wrap=True, markup=False)


def _specification(
    what: str, words: list[str], seeds: int | None, machine_samples: int | None, record: list[str] | None
) -> Specification:
    """Return the specification of a file, or of the short form."""
    from edmsim.sweep.specification import Specification, read_specification

    over = {"seeds": seeds, "machine_samples": machine_samples, "recordings": record or None}
    chosen = {name: value for name, value in over.items() if value is not None}
    if what.endswith(".toml"):
        if words or chosen:
            raise InputError(f"a specification has all settings: leave out {' '.join(words) or ', '.join(chosen)}")
        return read_specification(what)
    kind = "program" if Path(what).is_file() or Path(what).suffix not in ("", ".py") else "environment"
    return Specification.model_validate({kind: what, "grid": _options(words), **chosen})


def _options(words: list[str]) -> dict[str, Any]:
    """Take ``--height 5,10 --t-on=10:40:5`` apart."""
    found: dict[str, Any] = {}
    left = list(words)
    while left:
        name, joined, value = left.pop(0).partition("=")
        if not name.startswith("--"):
            raise InputError(f"'{name}' belongs to no option; values are given as --height 5,10,20")
        if not joined:
            if not left:
                raise InputError(f"{name} has no values: give some, as {name} 5,10,20")
            value = left.pop(0)
        key = name.removeprefix("--")
        found[key] = f"{found[key]},{value}" if key in found else value
    return found


def engine_of(ray: str | None, processes: int | None) -> Engine:
    """Return where runs are made: the processes of this computer, or a cluster's."""
    from edmsim.runs import Cluster, Processes

    if ray is None:
        return Processes(processes)
    if processes is not None:
        raise InputError("--processes are those of this computer: leave them out with --ray")
    return Cluster(ray)
