"""Commands in groups: sweeps and searches of many runs, measurements of a machine, consoles."""

import math
import time
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Any

import typer

from edmsim import files
from edmsim.cli.console import ERR, OUT, interruptible, print_json, print_line, print_use, progress, quoted, say
from edmsim.cli.options import SET_UP, Among, DriveAxis, Environment, Json, Quiet, Unset, settings_of, takes
from edmsim.errors import BAD_INPUT, INTERRUPTED, STOPPED, InputError

Ray = Annotated[str | None, typer.Option(metavar="ADDRESS", help="Ray cluster: auto, or HOST:PORT (extra cluster).")]
ProcessCount = Annotated[
    int | None, typer.Option("--processes", help="Processes on this computer; default: one per processor.")
]
SHORT_FORM = {"ignore_unknown_options": True, "allow_extra_args": True}


def _engine(ray: str | None, processes: int | None) -> Any:
    from edmsim.runs import engine_of

    return engine_of(ray, processes)


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
    from edmsim.sweep.run import SweepProgress, sweep
    from edmsim.sweep.specification import specification_of

    specification = specification_of(
        what, context.args, seeds=seeds, machine_samples=machine_samples, recordings=record
    )
    engine = _engine(ray, processes)
    with interruptible("run the same command to make the missing runs", keep=True) as bar:

        def watch(progress: SweepProgress) -> None:
            failed = f", {progress.failed} failed" if progress.failed else ""
            text = f"{progress.done} of {progress.total}{failed}"
            bar.show("runs", progress.done, progress.total, text)

        def checking(done: int, total: int) -> None:
            if time.monotonic() > slow_s:
                bar.show("check", done, total, f"{done} of {total} combinations")

        slow_s = time.monotonic() + 2.0
        last = sweep(specification, out, engine=engine, retry_failed=retry_failed, watch=watch, checking=checking)
    OUT.print(f"{last.done} runs, {last.made} made now, {last.failed} failed.", highlight=False)
    print_line(f"Look at them with: edmsim sweep show {quoted(out)}")
    if last.failed:
        raise typer.Exit(STOPPED)


def show(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a sweep.", show_default=False)],
) -> None:
    """Show the results of a sweep, and draw DIR/pareto.png."""
    from edmsim.recording.figures.style import write_figure
    from edmsim.sweep.run import read
    from edmsim.sweep.summary import pareto_figure, render

    table = read(folder)
    OUT.print(render(table))
    write_figure(pareto_figure(table), folder / "pareto.png")
    print_line(f"Written: {folder / 'pareto.png'}")


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
            engine=_engine(ray, processes), watch=lambda made, best: bar.show(env_id, made, trials, f"{best:.4g}"),
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
    _print_values(env_id, found.values, f"score {found.value:.4g}; {learners} learners", out)


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
    from edmsim.sweep.tune import tune_controller

    height = {key: options.pop(key) for key in ("height_mm",) if key in options}
    machine = {"name" if key == "machine" else key: value for key, value in options.items()}
    with interruptible() as bar:
        found = tune_controller(
            name, out, trials=trials, seed=seed, seeds=seeds, engine=_engine(ray, processes),
            watch=lambda made, best: bar.show(name, made, trials, f"{best:.4g}"),
            **({"machine": machine} if machine else {}), **height,
        )  # fmt: skip
    tried = sorted(found.tried_again.items(), key=lambda item: item[1][1].worst)
    for number, (_, spread) in tried:
        print_line(f"{'in use' if number < 0 else f'trial {number}'}: {spread}")
    _print_values(
        name, found.values, f"on {found.machines} other machines: {found.spread}\n"
        f"settings in use:      {found.first_spread}\n{found.trials} trials, {found.failed} failed", out,
    )  # fmt: skip


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
    files.make_room(file, "a technology", ".toml")
    journal = file.with_suffix(".runs.jsonl")
    with files.locked_file(file, "edmsim tune technology"):
        known = read_technology(str(file)) if file.exists() else None
        if known is not None:
            job.check_like(known, file)
        with interruptible():
            found = Search(job, (lambda text: None) if quiet else print_line, journal, at_height(known, job)).run()
        with files.replacing(file) as partial:
            partial.write_text(technology_text(job.technology(merged(known, found), known)), encoding="utf-8")
        journal.unlink(missing_ok=True)
    set_up = f"--material {quoted(material)} --height {job.height_mm:g} --resolution {job.resolution}"
    of_passes = f"--passes {passes} --technology {quoted(file)}"
    print_line(f"Written: {file}; cut with it: edmsim cut PROGRAM {set_up} {of_passes}")


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

    listed = ",".join(f"{key}={value:.15g}" for key, value in values.items())
    print_line(f"{name}:{listed}\n{score}. Written: {out / BEST}")
    if (out / "policy.json").is_file():
        print_use("Cut with the best policy", controller=f"policy:{out / 'policy.json'}")


@takes(
    "machine", "compensation", "seed",
    compensation=Unset("The errors written are those that remain with these tables."),
)
def table(
    out: Annotated[Path | None, typer.Option(help="File for the compensation tables, .toml.")] = None,
    interval: Annotated[float | None, typer.Option(help="Distance between targets in mm; default: 0.5.")] = None,
    runs: Annotated[int | None, typer.Option(help="Runs to every target in each direction; default: 5.")] = None,
    cubic: Annotated[bool, typer.Option("--cubic", help="Interpolate the tables by curves.")] = False,
    plot: Annotated[Path | None, typer.Option(help="File for the figure, .png .svg or .pdf.")] = None,
    json: Json = False,
    **options: Any,
) -> None:
    """Measure a machine's table as a laser interferometer does."""
    from edmsim.controllers.axis.elcam.file import load_tables, read_tables, text_of
    from edmsim.measure import as_json, headline, measure_table, render, table_figure
    from edmsim.recording.figures.style import check_figure, write_figure

    if plot is not None:
        check_figure(plot)
    if out is not None:
        files.check_suffix(out, "a compensation file", ".toml")
    settings = settings_of(options)
    compensation = settings.compensation
    loaded = None if compensation is None else load_tables(read_tables(compensation), compensation)
    worn = settings.load_machine()
    for file in (out, plot):
        if file is not None:
            files.make_writable(file.parent)
    found = measure_table(worn, interval_mm=interval, runs=runs, seed=settings.seed, compensation=loaded)
    if out is not None:
        left = "" if compensation is None else f" with {Path(compensation).name} in force"
        about = f"Errors of the table of {settings.machine}{left}: indicated less true position of an axis."
        with files.replacing(out) as partial:
            partial.write_text(text_of(found.tables(cubic), [about, *headline(found)]), encoding="utf-8")
    if plot is not None:
        write_figure(table_figure({"measured": found}), plot)
    if json:
        print_json(as_json(found))
        return
    OUT.print(render(found))
    if out is not None and compensation is None:
        print_use("Cut with it", machine=settings.machine, compensation=out)


@takes(
    "machine", "height_mm", "wire", "constants", "taper_deg", "guide_errors_mm", "resolution", "seed",
    resolution="fast", taper_deg=10.0,
)  # fmt: skip
def guides(json: Json = False, quiet: Quiet = False, **options: Any) -> None:
    """Measure the heights of the wire guides by a test cut."""
    from edmsim.job.cut import CutProgress
    from edmsim.measure import measure_guides

    settings = settings_of(options)
    with progress(quiet) as bar:
        found = measure_guides(
            settings.load_machine(), settings.taper_deg, settings.guide_errors_mm or (0.0, 0.0), seed=settings.seed,
            resolution=settings.resolution, watch=CutProgress(bar, "test cut").show,
        )
    lower_mm, upper_mm = found.uncertainty_mm
    if json:
        print_json({
            "lower_mm": found.lower_mm, "upper_mm": found.upper_mm, "uncertainty_mm": found.uncertainty_mm,
            "heights_mm": found.heights_mm.tolist(), "shift_um": found.shift_um.tolist(),
        })  # fmt: skip
        return
    for name, error, own in (("lower", found.lower_mm, lower_mm), ("upper", found.upper_mm, upper_mm)):
        OUT.print(f"the {name} guide is {error:+.3f} mm higher than its file says, ±{own:.3f} mm", highlight=False)
    errors = f"--guide-errors={found.lower_mm:.3f}:{found.upper_mm:.3f}"
    print_line(f"Cut with it: edmsim cut PROGRAM --machine {quoted(settings.machine)} {errors} --out DIR")


@takes("machine", "material", "wire", "height_mm", "tension", "planner", "resolution", "seed",
       planner=Among(lambda: resolve_name("edmsim.controllers.planner.registry:counting")()))  # fmt: skip
def terminal(
    host: Annotated[Path | None, typer.Option(help="File that the host sends when LOAD asks for a program.")] = None,
    speed: Annotated[
        float | None, typer.Option(help="Machine seconds per second; default: 1, or full speed in a pipe.")
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(help="Inject a fault: serial-noise, drop-out, stuck-end-switch, stuck-wire-sensor; repeatable."),
    ] = None,
    monitor: Annotated[bool, typer.Option("--monitor", help="Begin in the monitor; G 0400 starts MAIN.")] = False,
    tapes: Annotated[Path | None, typer.Option(help="Folder of tapes, Intel HEX; default: the current one.")] = None,
    view: Annotated[bool, typer.Option(help="Show digits and pulses live in a terminal.")] = True,
    **options: Any,
) -> None:
    """Operate the controller of 1982 at its terminal."""
    from edmsim.consoles.computer_1982 import rig, session

    settings = settings_of(options)
    faults = session.choose_faults(fault or (), settings.seed)
    try:
        with ERR.status("starting; the first time, the pulse loop is compiled"):
            made = rig.Rig(
                settings.load_machine(), settings.seed, resolution=settings.resolution, planner=settings.planner,
                faults=faults,
            )
            made.warm_up()
        raise typer.Exit(session.run(made, host, speed, view, monitor, tapes))
    except KeyboardInterrupt:
        raise typer.Exit(INTERRUPTED) from None


def servo(
    drive: Annotated[str, typer.Argument(help="Drive: uhu or servo-module.", show_default=False)],
    axis: DriveAxis = "bench",
    tuned: Annotated[bool, typer.Option("--tuned", help="Start with parameters tuned for the axis.")] = False,
    pty: Annotated[bool, typer.Option("--pty", help="Open a serial port for a terminal program.")] = False,
    speed: Annotated[
        float | None, typer.Option(help="Simulated seconds per second; default: 1, or full speed in a pipe.")
    ] = None,
    scope: Annotated[
        bool, typer.Option("--scope", help="Draw tracking error, duty, current, position, speed live in rerun.")
    ] = False,
    record: Annotated[Path | None, typer.Option(help="File for these curves, .rrd.")] = None,
) -> None:
    """Operate a servo drive at its serial terminal."""
    from edmsim.consoles.scope import scope_for
    from edmsim.consoles.servo import bench_for, curves_of, serve

    bench = bench_for(drive, axis, tuned)
    with scope_for(scope, record, curves_of(bench), say) as screen:
        try:
            serve(bench, pty=pty, speed=speed, scope=screen, say=say)
        except KeyboardInterrupt:
            raise typer.Exit(INTERRUPTED) from None


_SHOWN = 10  # problems of a text that are listed (ours); the manual's example has fewer


def positioner(
    configuration: Annotated[Path, typer.Argument(help="Configuration, .CNF.", show_default=False)],
    program: Annotated[Path, typer.Argument(help="Program in QCL, .MOD.", show_default=False)],
    seconds: Annotated[float, typer.Option(help="Simulated time in s.")] = 10.0,
    press: Annotated[list[str] | None, typer.Option(help="Close an input, NAME=FROM:TO in s; repeatable.")] = None,
    contactor: Annotated[
        list[str] | None,
        typer.Option(
            metavar="OUTPUT=DEVICE", help="Output that connects a shared drive to a motor, OUTPUT=DEVICE; repeatable."
        ),
    ] = None,
    axis: Annotated[str, typer.Option(help="Motor, screw and table: analogue or analogue-table.")] = "analogue",
    record: Annotated[
        Path | None, typer.Option(help="File for output, current, position, speed of every axis, .rrd.")
    ] = None,
) -> None:
    """Run a QCL program on EANPOS positioners and their axes."""
    from edmsim.consoles.positioner import Station, contactors_of, press_of, run_and_report
    from edmsim.consoles.scope import scope_for
    from edmsim.controllers.qcl import QclError

    presses = [press_of(text) for text in press or []]
    contactors = contactors_of(contactor or [])
    if not 0 < seconds < math.inf:
        raise InputError(f"--seconds is above 0, not {seconds:g}")
    try:
        station = Station.of_files(configuration, program, axis, contactors)
    except QclError as error:
        for problem in error.problems[:_SHOWN]:
            say(f"{error.file}:{problem.line}: {problem.what}")
        if (more := len(error.problems) - _SHOWN) > 0:
            say(f"and {more} more")
        raise typer.Exit(BAD_INPUT) from None
    with scope_for(False, record, station.curves, say) as screen:
        run_and_report(station, seconds, presses, print_line, screen)
