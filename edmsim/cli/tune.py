"""``edmsim tune``: searches of gains, settings of one's own controller, trainings, technologies, servo drives."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from edmsim.cli.console import INTERRUPTED, OUT, Quiet, say
from edmsim.cli.options import SET_UP, Unset, takes
from edmsim.cli.sweep import ProcessCount, Ray, engine_of

if TYPE_CHECKING:
    from edmsim.progress import ShownProgress
    from edmsim.sweep.tune import Tuned

Study = Annotated[Path, typer.Option("--out", help="Folder of the study; an existing one is resumed.")]
Trials = Annotated[int, typer.Option(help="Trials in all.")]
FirstSeed = Annotated[int, typer.Option("--seed", help="First training seed, also the seed of the search.")]
Seeds = Annotated[int, typer.Option(help="Number of training seeds per trial.")]
Environment = Annotated[
    str,
    typer.Argument(metavar="ENV_ID", help="Environment: edmsim/GapFeed-v2 ..., or FILE.py:ID.", show_default=False),
]
Algorithm = Annotated[str, typer.Option(help="As in edmsim train.")]
Steps = Annotated[int | None, typer.Option(help="Windows of each training; default by environment.")]


def gains(
    name: Annotated[str, typer.Argument(help="Feed controller with a file in models/gains.",
                                        show_default=False)],
    out: Study,
    method: Annotated[
        str, typer.Option(help="tpe (Optuna, extra tune), or evolution, one trial after another on this computer.")
    ] = "tpe",
    trials: Trials = 40,
    seed: FirstSeed = 0,
    seeds: Seeds = 5,
    ray: Ray = None,
    processes: ProcessCount = None,
) -> None:  # fmt: skip
    """Search for gains of a feed controller."""
    from edmsim.sweep.tune import tune_gains

    with _searching() as bar:
        found = tune_gains(
            name, out, method=method, trials=trials, seed=seed, seeds=seeds, engine=engine_of(ray, processes),
            watch=lambda found: _show(bar, name, trials, found),
        )  # fmt: skip
    _print_found(name, found, out)


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

    with _searching() as bar:
        found = tune_training(
            env_id, out, algo=algo, steps=steps, trials=trials, seed=seed, seeds=seeds,
            engine=engine_of(ray, processes), watch=lambda found: _show(bar, env_id, trials, found),
        )  # fmt: skip
    _print_found(env_id, found, out)


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
    with _searching("population") as bar:

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
def own(
    name: Annotated[str, typer.Argument(metavar="FILE.py:CLASS", help="Your controller; its BOUNDS list the "
                                        "parameters to search.", show_default=False)],
    out: Study,
    trials: Trials = 40,
    seed: FirstSeed = 0,
    seeds: Annotated[int, typer.Option(help="Number of drawn machines per trial.")] = 5,
    ray: Ray = None,
    processes: ProcessCount = None,
    **options: Any,
) -> None:  # fmt: skip
    """Search for settings of your controller (extra tune)."""
    from edmsim.sweep.own import tune_own
    from edmsim.sweep.tune import BEST

    height = {key: options.pop(key) for key in ("height_mm",) if key in options}
    machine = {"name" if key == "machine" else key: value for key, value in options.items()}
    with _searching() as bar:
        found = tune_own(
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
    OUT.print("\n".join(lines), highlight=False, soft_wrap=True, markup=False)


@takes(
    "height_mm", "wire", "machine", "resolution", "seed", wire="brass-254", machine="production", resolution="fast"
)
def technology(
    material: Annotated[str, typer.Argument(help="Workpiece material, a name or your own file.", show_default=False)],
    passes: Annotated[int, typer.Option(help="Number of passes, rough and trims: 1 to 7.")] = 4,
    out: Annotated[
        Path | None,
        typer.Option(help="TOML file; the height is added to an existing one. Default: MATERIAL-WIRE.toml."),
    ] = None,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Search for offsets and settings of passes by simulated cuts.

    An interrupted search is resumed.
    """
    from edmsim.evaluation.technology import Job, Search, merged, technology_text
    from edmsim.files import make_writable, replacing
    from edmsim.machine.technology import read_technology

    job = Job(material, passes=passes, **options)
    file = Path(f"{Path(material).stem}-{Path(job.wire).stem}.toml") if out is None else out
    job.check()
    make_writable(file.parent)
    known = read_technology(str(file)) if file.exists() else None
    if known is not None:
        job.check_like(known, file)
    journal = file.with_suffix(".runs.jsonl")
    tell = partial(OUT.print, highlight=False, soft_wrap=True, markup=False)
    with _searching("search"):
        found = Search(job, (lambda text: None) if quiet else tell, journal).run()
    source = f"found by simulation: edmsim tune technology {material} --height {job.height_mm:g} --passes {passes}"
    with replacing(file) as partial_file:
        partial_file.write_text(technology_text(job, merged(known, job, found), source), encoding="utf-8")
    journal.unlink(missing_ok=True)
    tell(f"Written: {file}; cut with it: edmsim cut PROGRAM --passes {passes} --technology {file}")


def drive(
    name: Annotated[str, typer.Argument(metavar="DRIVE", help="Drive: uhu or servo-module.", show_default=False)],
    axis: Annotated[
        str, typer.Option(help="Axis: x or y of the machine, bench, table, fast, low-impedance.")
    ] = "bench",
    out: Annotated[Path | None, typer.Option(help="Picture of the axis before and after tuning, .png.")] = None,
) -> None:
    """Tune a servo drive to its axis, and print the lines to type."""
    from edmsim.consoles.servo.command import tune

    OUT.print("\n".join(tune(name, axis, out, say)), highlight=False)


@contextmanager
def _searching(what: str = "study") -> Iterator[ShownProgress]:
    """Give what shows progress; an interruption ends the command with the way to go on."""
    from edmsim.progress import ShownProgress

    with ShownProgress() as bar:
        try:
            yield bar
        except KeyboardInterrupt:
            say(f"interrupted; run the same command to resume the {what}")
            raise typer.Exit(INTERRUPTED) from None


def _show(bar: ShownProgress, name: str, trials: int, found: Tuned) -> None:
    bar.show(name, found.trials, trials, f"{found.value:.4g}")


def _print_found(name: str, found: Tuned, out: Path) -> None:
    score = f"score {found.value:.4g} (before {found.first_value:.4g})"
    _print_values(name, found.values, f"{score}; {found.trials} trials, {found.failed} failed", out)


def _print_values(name: str, values: dict[str, float], score: str, out: Path) -> None:
    from edmsim.sweep.tune import BEST

    listed = ",".join(f"{key}={value:g}" for key, value in values.items())
    OUT.print(f"{name}:{listed}\n{score}. Written: {out / BEST}", highlight=False, soft_wrap=True, markup=False)
    if (out / "policy.json").is_file():
        OUT.print(f"Cut with the best policy: edmsim cut PROGRAM --controller policy:{out / 'policy.json'} --out DIR",
                  highlight=False, soft_wrap=True, markup=False)  # fmt: skip
