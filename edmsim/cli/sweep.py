"""``edmsim sweep`` and ``tune``: many cuts, and the search of gains and training settings."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from edmsim.cli.console import ERR, INTERRUPTED, OUT, STOPPED, say
from edmsim.errors import InputError

if TYPE_CHECKING:
    from edmsim.sweep.engine import Engine
    from edmsim.sweep.run import SweepProgress
    from edmsim.sweep.specification import Specification

Ray = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Ray cluster: auto, or HOST:PORT (extra cluster).")
]
ProcessCount = Annotated[
    int | None, typer.Option("--processes", help="Processes on this computer; one a processor by default.")
]
SHORT_FORM = {"ignore_unknown_options": True, "allow_extra_args": True}


def sweep(
    context: typer.Context,
    what: Annotated[
        str, typer.Argument(help="Specification (.toml), part program, or environment; none with --show.")
    ] = "",
    out: Annotated[Path | None, typer.Option(help="Folder for the results.")] = None,
    seeds: Annotated[int | None, typer.Option(help="Seeds of every combination; 1 by default.")] = None,
    machine_samples: Annotated[
        int | None, typer.Option(help="Machines drawn within the ranges of their constants, for every combination.")
    ] = None,
    record: Annotated[
        list[str] | None, typer.Option(help="Keep of each cut: report, windows or all; may be given again.")
    ] = None,
    ray: Ray = None,
    processes: ProcessCount = None,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Make again what failed.")] = False,
    show: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Show the results of a sweep, and draw DIR/pareto.png.")
    ] = None,
) -> None:
    """Make many cuts from one specification.

    Every combination of settings, seeds and machines is cut. Any option of a cut or an environment takes values:
    --height 5,10,20 --t-on 10:40:5 --gap.critical_um 4,5.
    Interrupted and started again, a sweep makes only what is missing.
    """
    if show is not None:
        if what or context.args:
            raise InputError("--show DIR shows results; it takes no specification")
        _show(show)
        return
    if not what or out is None:
        raise InputError("give what to sweep, and a folder: edmsim sweep SPEC.toml --out DIR")
    from edmsim.sweep.run import sweep as run

    specification = _specification(what, context.args, seeds, machine_samples, record)
    engine = _engine(ray, processes)
    bar = _SweepBar()
    try:
        with bar:
            last = run(specification, out, engine=engine, retry_failed=retry_failed, watch=bar.show,
                       checking=bar.check)
    except KeyboardInterrupt:
        say("interrupted; the same command goes on with what is missing")
        raise typer.Exit(INTERRUPTED) from None
    OUT.print(f"{last.done} runs, {last.made} made now, {last.failed} failed.", highlight=False)
    OUT.print(f"Look at them with: edmsim sweep --show {out}", highlight=False, soft_wrap=True, markup=False)
    if last.failed:
        raise typer.Exit(STOPPED)


def tune(
    name: Annotated[
        str, typer.Argument(help="Feed controller, or environment to train in; none with --own.", show_default=False)
    ] = "",
    out: Annotated[Path | None, typer.Option(help="Folder of the study; one that is there goes on.")] = None,
    own: Annotated[
        str | None, typer.Option(metavar="FILE.py:CLASS", help="Search the settings of a controller of your own.")
    ] = None,
    machine: Annotated[str | None, typer.Option(help="With --own: machine; default agiecut-dem15.")] = None,
    generator: Annotated[str | None, typer.Option(help="With --own: generator; default iso-pulse.")] = None,
    material: Annotated[str | None, typer.Option(help="With --own: material; default tool-steel.")] = None,
    wire: Annotated[str | None, typer.Option(help="With --own: wire; default brass.")] = None,
    height: Annotated[
        float | None, typer.Option(help="With --own: workpiece height in mm; default drawn, 4 to 40.")
    ] = None,
    trials: Annotated[int, typer.Option(help="Trials in all.")] = 40,
    seed: Annotated[int, typer.Option(help="First training seed, and seed of the search.")] = 0,
    seeds: Annotated[int, typer.Option(help="Training seeds a trial is judged by.")] = 5,
    algo: Annotated[str, typer.Option(help="Of a training: as in edmsim train.")] = "ppo",
    steps: Annotated[int | None, typer.Option(help="Windows of each training; default by environment.")] = None,
    population: Annotated[
        int | None, typer.Option(help="Population-based training instead: learners, 4 or more, with --ray.")
    ] = None,
    generations: Annotated[int, typer.Option(help="How often a population is compared.")] = 10,
    ray: Ray = None,
    processes: ProcessCount = None,
) -> None:
    """Search gains or training settings (needs the extra tune).

    With --own it searches the settings of a controller of your own, on drawn machines.
    """
    if out is None:
        raise InputError("a search needs a folder for its study: give --out DIR")
    set_up = {"name": machine, "generator": generator, "material": material, "wire": wire}
    given = {key: value for key, value in set_up.items() if value is not None}
    if own is not None:
        if name or population is not None:
            raise InputError("--own searches the settings of one controller: leave out the name and --population")
        _tune_own(own, out, given, height, trials, seed, seeds, _engine(ray, processes))
        return
    if given or height is not None:
        raise InputError("the set-up of a search without --own is that of its environments")
    if not name:
        raise InputError("name a feed controller or an environment, or give --own FILE.py:CLASS")
    if population is not None:
        if ray is None or processes is not None:
            raise InputError("a population trains on a Ray cluster: give --ray, and no --processes")
        _breed(name, out, ray, population, generations, {"seed": seed, "seeds": seeds, "algo": algo, "steps": steps})
        return
    from edmsim.sweep.tune import Tuned
    from edmsim.sweep.tune import tune as search

    engine = _engine(ray, processes)
    with _searching(name, trials, "study") as show:

        def watch(found: Tuned) -> None:
            show(completed=found.trials, description=f"{name}: {found.value:.4g}")

        found = search(
            name, out, trials=trials, seed=seed, seeds=seeds, algo=algo, steps=steps, engine=engine, watch=watch
        )
    scores = f"score {found.value:.4g} (before {found.first_value:.4g})"
    score_text = f"{scores}; {found.trials} trials, {found.failed} failed"
    _print_found(name, found.values, score_text, out)


def _tune_own(
    own: str, out: Path, set_up: dict[str, str], height: float | None, trials: int, seed: int, seeds: int,
    engine: Engine,
) -> None:
    from edmsim.sweep.own import tune_own
    from edmsim.sweep.tune import BEST

    options: dict[str, Any] = {"machine": set_up} if set_up else {}
    if height is not None:
        options["height_mm"] = height
    with _searching(own, trials, "study") as show:

        def watch(made: int, best: float) -> None:
            show(completed=made, description=f"{own}: {best:.4g}")

        found = tune_own(own, out, trials=trials, seed=seed, seeds=seeds, engine=engine, watch=watch, **options)
    listed = ",".join(f"{key}={value:g}" for key, value in found.values.items())
    tried = sorted(found.tried_again.items(), key=lambda item: item[1][1].worst)
    lines = [
        *(f"{'in use' if number < 0 else f'trial {number}'}: {spread}" for number, (_, spread) in tried),
        f"{own}:{listed}", f"on {found.machines} other machines: {found.spread}",
        f"settings in use:      {found.first_spread}",
        f"{found.trials} trials, {found.failed} failed. Written: {out / BEST}",
    ]  # fmt: skip
    OUT.print("\n".join(lines), highlight=False, soft_wrap=True, markup=False)


def _breed(name: str, out: Path, ray: str, population: int, generations: int, chosen: dict[str, Any]) -> None:
    """Train a population, and say what came of it."""
    from edmsim.sweep.population import PopulationResult, train_population

    with _searching(name, population * generations, "population") as show:

        def watch(result: PopulationResult) -> None:
            show(advance=1, description=f"{name}: generation {result.generation}, {result.value:.4g}")

        found = train_population(
            name, out, address=ray, population=population, generations=generations, watch=watch, **chosen
        )
    _print_found(name, found.values, f"worth {found.value:.4g}; {population} learners", out)


@contextmanager
def _searching(name: str, total: int, what: str) -> Iterator[Callable[..., None]]:
    """Give what shows progress; an interruption ends the command with the way to go on."""
    from edmsim.screen import ScreenProgress

    bar = ScreenProgress(console=ERR, transient=True)
    task = bar.add_task(name, total=total)

    def show(**changes: Any) -> None:
        bar.start()  # not before the first result: bad input shall print its one line only
        bar.update(task, **changes)

    try:
        yield show
    except KeyboardInterrupt:
        say(f"interrupted; the same command goes on with the {what}")
        raise typer.Exit(INTERRUPTED) from None
    finally:
        if bar.live.is_started:
            bar.stop()


def _print_found(name: str, values: dict[str, float], score: str, out: Path) -> None:
    from edmsim.sweep.tune import BEST

    listed = ",".join(f"{key}={value:g}" for key, value in values.items())
    OUT.print(f"{name}:{listed}\n{score}. Written: {out / BEST}", highlight=False, soft_wrap=True, markup=False)
    if (out / "policy.json").is_file():
        OUT.print(f"Cut with the best policy: edmsim cut PROGRAM --controller policy:{out / 'policy.json'} --out DIR",
                  highlight=False, soft_wrap=True, markup=False)  # fmt: skip


def _specification(
    what: str, words: list[str], seeds: int | None, machine_samples: int | None, record: list[str] | None
) -> Specification:
    """Return the specification of a file, or of the short form."""
    from edmsim.sweep.specification import Specification, read_specification

    over = {"seeds": seeds, "machine_samples": machine_samples, "recordings": record or None}
    chosen = {name: value for name, value in over.items() if value is not None}
    if what.endswith(".toml"):
        if words or chosen:
            raise InputError(f"a specification says all itself: leave out {' '.join(words) or ', '.join(chosen)}")
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


def _engine(ray: str | None, processes: int | None) -> Engine:
    if ray is None:
        from edmsim.sweep.engine import Processes

        return Processes(processes)
    if processes is not None:
        raise InputError("--processes are those of this computer: leave them out with --ray")
    from edmsim.sweep.engine import Cluster

    return Cluster(ray)


def _show(folder: Path) -> None:
    from edmsim.recording.figures import write_figure
    from edmsim.sweep.summary import pareto_figure, render
    from edmsim.sweep.table import read

    table = read(folder)
    OUT.print(render(table))
    write_figure(pareto_figure(table), folder / "pareto.png")
    OUT.print(f"Written: {folder / 'pareto.png'}", highlight=False, soft_wrap=True, markup=False)


class _SweepBar:
    """Runs done, time left, failures."""

    def __init__(self) -> None:
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        from edmsim.screen import ScreenProgress

        self._bar = ScreenProgress(
            MofNCompleteColumn(), BarColumn(bar_width=24), TextColumn("{task.percentage:5.1f} %"),
            TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(), TextColumn("{task.fields[failed]}"),
            console=ERR,
        )  # fmt: skip
        self._task = self._bar.add_task("sweep", total=None, failed="")
        self._from_s = time.monotonic() + 2.0

    def __enter__(self) -> _SweepBar:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar.live.is_started:
            self._bar.stop()

    def check(self, done: int, total: int) -> None:
        """Take in a combination looked at; shown where that takes a while."""
        if time.monotonic() > self._from_s:
            self._bar.start()
            self._bar.update(self._task, completed=done, total=total, failed="looked at before the first run")

    def show(self, progress: SweepProgress) -> None:
        """Take in a run."""
        self._bar.start()  # not before the first: bad input shall print its one line only
        failed = f"{progress.failed} failed" if progress.failed else ""
        self._bar.update(self._task, completed=progress.done, total=progress.total, failed=failed)
