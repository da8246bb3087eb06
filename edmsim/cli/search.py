"""Commands with many runs: sweep, and tune, which searches gains, settings, trainings, technologies, drives."""

import shlex
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from edmsim.cli.console import OUT, DriveAxis, Environment, Quiet, interruptible, print_line, say
from edmsim.cli.options import SET_UP, Unset, takes
from edmsim.errors import STOPPED, InputError
from edmsim.files import check_suffix, make_writable, replacing

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
    from edmsim.sweep.run import sweep

    specification = _specification(what, context.args, seeds, machine_samples, record)
    engine = engine_of(ray, processes)
    with interruptible("run the same command to make the missing runs", keep=True) as bar:

        def watch(progress: "SweepProgress") -> None:
            failed = f", {progress.failed} failed" if progress.failed else ""
            text = f"{progress.done} of {progress.total}{failed}"
            bar.show("runs", progress.done, progress.total, text)

        def checking(done: int, total: int) -> None:
            if time.monotonic() > slow_s:
                bar.show("looked at before the first run", done, total)

        slow_s = time.monotonic() + 2.0
        last = sweep(specification, out, engine=engine, retry_failed=retry_failed, watch=watch, checking=checking)
    OUT.print(f"{last.done} runs, {last.made} made now, {last.failed} failed.", highlight=False)
    print_line(f"Look at them with: edmsim sweep show {shlex.quote(str(out))}")
    if last.failed:
        raise typer.Exit(STOPPED)


def show(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a sweep.", show_default=False)],
) -> None:
    """Show the results of a sweep, and draw DIR/pareto.png."""
    from edmsim.recording.figures.style import write_figure
    from edmsim.sweep.summary import pareto_figure, render
    from edmsim.sweep.table import read

    table = read(folder)
    OUT.print(render(table))
    write_figure(pareto_figure(table), folder / "pareto.png")
    print_line(f"Written: {folder / 'pareto.png'}")


_FLAGS = {"seeds": "--seeds", "machine_samples": "--machine-samples", "recordings": "--record"}


def _specification(
    what: str, words: list[str], seeds: int | None, machine_samples: int | None, record: list[str] | None
) -> "Specification":
    """Return the specification of a file, or of the short form."""
    from edmsim.sweep.specification import Specification, read_specification
    from edmsim.user_code import named

    over = {"seeds": seeds, "machine_samples": machine_samples, "recordings": record or None}
    chosen = {name: value for name, value in over.items() if value is not None}
    if what.endswith(".toml"):
        if superfluous := [*(_FLAGS[name] for name in chosen), *words]:
            raise InputError(f"a specification has all settings: leave out {' '.join(superfluous)}")
        return read_specification(what)
    is_program = named(what) is None and (Path(what).is_file() or Path(what).suffix)
    kind = "program" if is_program else "environment"
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


def engine_of(ray: str | None, processes: int | None) -> "Engine":
    """Return where runs are made: the processes of this computer, or a cluster's."""
    from edmsim.numeric import whole_from
    from edmsim.runs import Cluster, Processes

    if ray is None:
        return Processes(None if processes is None else whole_from("--processes", processes, 1))
    if processes is not None:
        raise InputError("--processes are those of this computer: leave them out with --ray")
    return Cluster(ray)


Study = Annotated[Path, typer.Option("--out", help="Folder of the study; an existing one is resumed.")]
Trials = Annotated[int, typer.Option(help="Trials in all.")]
FirstSeed = Annotated[int, typer.Option("--seed", help="First training seed, also the seed of the search.")]
Seeds = Annotated[int, typer.Option(help="Number of training seeds per trial.")]
Algorithm = Annotated[str, typer.Option(help="As in edmsim train.")]
Steps = Annotated[int | None, typer.Option(help="Windows of each training; default by environment.")]


def training(
    env_id: Environment,
    out: Study,
    algo: Algorithm = "ppo",
    steps: Steps = None,
    trials: Trials = 40,
    seed: FirstSeed = 0,
    seeds: Seeds = 5,
    ray: Ray = None,
    processes: ProcessCount = None,
) -> None:
    """Search for settings of a training (extras rl and tune)."""
    from edmsim.sweep.tune import tune_training

    with interruptible() as bar:
        found = tune_training(
            env_id, out, algo=algo, steps=steps, trials=trials, seed=seed, seeds=seeds,
            engine=engine_of(ray, processes), watch=lambda made, best: bar.show(env_id, made, trials, f"{best:.4g}"),
        )  # fmt: skip
    score = f"score {found.value:.4g} (before {found.first_value:.4g})"
    _print_values(env_id, found.values, f"{score}; {found.trials} trials, {found.failed} failed", out)


def population(
    env_id: Environment,
    out: Annotated[Path, typer.Option(help="Folder that all nodes share; an existing population is resumed.")],
    ray: Annotated[str, typer.Option(metavar="ADDRESS", help="Ray cluster: auto, or HOST:PORT.")] = "auto",
    learners: Annotated[int, typer.Option(help="Number of learners, at least 4, with a processor each.")] = 8,
    generations: Annotated[int, typer.Option(help="Number of comparisons of the learners.")] = 10,
    algo: Algorithm = "ppo",
    steps: Annotated[int | None, typer.Option(help="Windows per learner; default by environment.")] = None,
    seed: FirstSeed = 0,
    seeds: Seeds = 5,
) -> None:
    """Train a population on a Ray cluster (extras cluster, rl, tune)."""
    from edmsim.sweep.population import PopulationResult, train_population

    made = iter(range(1, learners * generations + 1))
    with interruptible() as bar:

        def watch(result: PopulationResult) -> None:
            text = f"generation {result.generation}, {result.value:.4g}"
            bar.show(env_id, next(made, learners * generations), learners * generations, text)

        found = train_population(
            env_id, out, address=ray, population=learners, generations=generations, steps=steps, algo=algo, seed=seed,
            seeds=seeds, watch=watch,
        )  # fmt: skip
    _print_values(env_id, found.values, f"worth {found.value:.4g}; {learners} learners", out)


@takes("machine", SET_UP, machine=Unset(""), material=Unset(""), wire=Unset(""), generator=Unset(""),
       height_mm=Unset("Default: drawn, 4 to 40."))  # fmt: skip
def controller(
    name: Annotated[str, typer.Argument(help="Feed controller of edmsim, or FILE.py:CLASS, whose "
                                        "BOUNDS list the parameters to search.", show_default=False)],
    out: Study,
    trials: Trials = 40,
    seed: FirstSeed = 0,
    seeds: Annotated[int, typer.Option(help="Number of drawn machines per trial.")] = 5,
    ray: Ray = None,
    processes: ProcessCount = None,
    **options: Any,
) -> None:  # fmt: skip
    """Search for settings of a controller on drawn machines (extra tune)."""
    from edmsim.sweep.tune import BEST, tune_controller

    height = {key: options.pop(key) for key in ("height_mm",) if key in options}
    machine = {"name" if key == "machine" else key: value for key, value in options.items()}
    with interruptible() as bar:
        found = tune_controller(
            name, out, trials=trials, seed=seed, seeds=seeds, engine=engine_of(ray, processes),
            watch=lambda made, best: bar.show(name, made, trials, f"{best:.4g}"),
            **({"machine": machine} if machine else {}), **height,
        )  # fmt: skip
    listed = ",".join(f"{key}={value:g}" for key, value in found.values.items())
    tried = sorted(found.tried_again.items(), key=lambda item: item[1][1].worst)
    lines = [
        *(f"{'in use' if number < 0 else f'trial {number}'}: {spread}" for number, (_, spread) in tried),
        f"{name}:{listed}", f"on {found.machines} other machines: {found.spread}",
        f"settings in use:      {found.first_spread}",
        f"{found.trials} trials, {found.failed} failed. Written: {out / BEST}",
    ]  # fmt: skip
    print_line("\n".join(lines))


@takes("height_mm", "wire", "machine", "resolution", "seed", wire="brass-254", machine="production")
def technology(
    material: Annotated[str, typer.Argument(help="Workpiece material, a name or your own file.", show_default=False)],
    passes: Annotated[int, typer.Option(help="Number of passes, rough and trims: 1 to 7.")] = 4,
    out: Annotated[
        Path | None,
        typer.Option(
            help="TOML file. In an existing one a height is added, or the offsets of its passes are measured again. "
            "Default: MATERIAL-WIRE.toml."
        ),
    ] = None,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Search for offsets and settings of passes by simulated cuts.

    An interrupted search is resumed.
    """
    from edmsim.evaluation.technology_search import Job, Search, at_height, merged, technology_text
    from edmsim.machine.technology import read_technology

    job = Job(material, passes=passes, **options)
    file = Path(f"{Path(material).stem}-{Path(job.wire).stem}.toml") if out is None else out
    job.check()
    check_suffix(file, "a technology", ".toml")
    make_writable(file.parent)
    known = read_technology(str(file)) if file.exists() else None
    if known is not None:
        job.check_like(known, file)
    journal = file.with_suffix(".runs.jsonl")
    with interruptible():
        found = Search(job, (lambda text: None) if quiet else print_line, journal, at_height(known, job)).run()
    with replacing(file) as partial:
        partial.write_text(technology_text(job.technology(merged(known, found))), encoding="utf-8")
    journal.unlink(missing_ok=True)
    quoted = shlex.quote(str(file))
    print_line(f"Written: {file}; cut with it: edmsim cut PROGRAM --passes {passes} --technology {quoted}")


def drive(
    name: Annotated[str, typer.Argument(metavar="DRIVE", help="Drive: uhu or servo-module.", show_default=False)],
    axis: DriveAxis = "bench",
    out: Annotated[Path | None, typer.Option(help="Picture before and after tuning: .png, .svg or .pdf.")] = None,
) -> None:
    """Tune a servo drive to its axis, and print the lines to type."""
    from edmsim.consoles.autotune import tune

    OUT.print("\n".join(tune(name, axis, out, say)), highlight=False)


def _print_values(name: str, values: dict[str, float], score: str, out: Path) -> None:
    from edmsim.sweep.tune import BEST

    listed = ",".join(f"{key}={value:g}" for key, value in values.items())
    print_line(f"{name}:{listed}\n{score}. Written: {out / BEST}")
    if (out / "policy.json").is_file():
        policy = shlex.quote(f"policy:{out / 'policy.json'}")
        print_line(f"Cut with the best policy: edmsim cut PROGRAM --controller {policy} --out DIR")
