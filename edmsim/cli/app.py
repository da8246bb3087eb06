"""The command line: ``edmsim cut``, ``view``, ``report``, ``train``, ``evaluate``, ``terminal`` and the rest."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from edmsim import __version__
from edmsim.errors import EdmsimError, InputError

if TYPE_CHECKING:
    from rich.progress import TaskID

app = typer.Typer(
    add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False,
    help="A wire-EDM machine, simulated discharge by discharge.",
)
_OUT = Console()
_ERR = Console(stderr=True)

FAILED, BAD_INPUT, STOPPED, INTERRUPTED = 1, 2, 3, 130
"""Exit statuses: the model left its validity; bad usage or input; the machine stopped before the end;
interrupted from the keyboard."""

# options that several commands share
_Material = Annotated[str, typer.Option(help="Workpiece material.")]
_Height = Annotated[float, typer.Option(help="Workpiece height in mm.")]
_Wire = Annotated[str, typer.Option(help="Wire, with a diameter in um if wanted: brass, copper-100.")]
_Tension = Annotated[float | None, typer.Option(help="Wire tension in N; default by wire.")]
_Generator = Annotated[str, typer.Option(help="Pulse generator.")]
_Resolution = Annotated[str, typer.Option(help="fast, default or fine.")]
_Seed = Annotated[int, typer.Option(help="Seed of every draw.")]


@app.callback(invoke_without_command=True)
def _version(
    version: Annotated[bool, typer.Option("--version", help="Print the version and leave.")] = False,
) -> None:
    if version:
        _OUT.print(__version__, highlight=False)
        raise typer.Exit


@app.command()
def cut(
    program: Annotated[Path, typer.Argument(help="Part program: .ngc .nc .gcode .iso .dxf", show_default=False)],
    out: Annotated[Path, typer.Option(help="Folder for report, windows, picture and recording.")],
    machine: Annotated[str, typer.Option(help="Machine, a name or an own TOML file.")] = "agiecut-dem15",
    material: _Material = "tool-steel",
    height: _Height = 20.0,
    height_at: Annotated[
        list[str] | None,
        typer.Option(metavar="MM:MM", help="From that length of path on, that height; may be given again."),
    ] = None,
    wire: _Wire = "brass",
    tension: _Tension = None,
    generator: _Generator = "iso-pulse",
    t_on: Annotated[float | None, typer.Option(help="On-time in us; default by generator.")] = None,
    t_period: Annotated[float | None, typer.Option(help="Period in us; default by generator.")] = None,
    controller: Annotated[
        str, typer.Option(help="Feed controller, with parameters if wanted: fixed:feed_um_s=20, own.py:Own.")
    ] = "counts",
    drive: Annotated[str, typer.Option(help="Axis drive.")] = "stepper",
    planner: Annotated[str, typer.Option(help="poscal, poscal-literal, dda or sine-table.")] = "poscal",
    mechanics: Annotated[str, typer.Option(help="Integrator of table and wire.")] = "modal",
    resolution: _Resolution = "default",
    offset: Annotated[str, typer.Option(help="Wire offset: auto, none, or mm.")] = "auto",
    seed: _Seed = 0,
    max_time: Annotated[float | None, typer.Option(help="Machine time in s after which to stop.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Take up the interrupted cut of the folder.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> None:
    """Simulate a part program."""
    from edmsim.cli.progress import ProgressBar
    from edmsim.cosim.simulation import FINISHED
    from edmsim.job.cut import cut as run_cut
    from edmsim.program.heights import parse_height

    watcher = ProgressBar(quiet, _ERR)
    try:
        with watcher:
            result = run_cut(
                program, out=out, machine=machine, material=material, height_mm=height,
                heights=[parse_height(text) for text in height_at or ()], wire=wire, tension=tension,
                generator=generator, t_on_us=t_on, t_period_us=t_period, controller=controller, drive=drive,
                planner=planner, mechanics=mechanics, resolution=resolution, offset=offset, seed=seed,
                max_time_s=max_time, resume=resume, watch=watcher.show,
            )
    except KeyboardInterrupt:
        _say("interrupted; take an interrupted cut up again with --resume")
        raise typer.Exit(INTERRUPTED) from None
    if not quiet:
        from edmsim.recording.report import render_table

        _OUT.print(render_table(result.report))
        _OUT.print(f"Written to {out}; play it back with: edmsim view {out}", highlight=False, soft_wrap=True)
    if result.report["outcome"] != FINISHED:
        raise typer.Exit(STOPPED)


@app.command()
def view(
    directory: Annotated[Path | None, typer.Argument(help="Folder of a cut.", show_default=False)] = None,
    compare: Annotated[
        tuple[Path, Path] | None, typer.Option(metavar="A B", help="Folders of two cuts to lay side by side.")
    ] = None,
) -> None:
    """Play a cut back in rerun, or two side by side."""
    from edmsim.recording import compare as show_both
    from edmsim.recording import view as show

    if directory is not None and compare is None:
        raise typer.Exit(show(directory))
    if directory is None and compare is not None:
        raise typer.Exit(show_both(*compare))
    raise InputError("give the folder of a cut, or two folders with --compare A B")


@app.command()
def render(
    directory: Annotated[Path, typer.Argument(help="Folder of a cut.", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="Film to write: .mp4 or .gif.")] = None,
    seconds: Annotated[float, typer.Option(help="Length of the film.")] = 12.0,
    screenshots: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Pictures of the viewer, made without a screen.")
    ] = None,
) -> None:
    """Make a film of a cut, or screenshots of its recording, without a screen."""
    from edmsim.recording import find_recording, take_screenshots
    from edmsim.recording import render as make_film
    from edmsim.recording.video import check_film

    if out is None and screenshots is None:
        raise InputError("give a film to write, --out cut.mp4 or cut.gif, or a folder for --screenshots")
    recording = find_recording(directory)
    if out is not None:
        check_film(out, seconds)
        with _ERR.status(f"drawing {out.name}"):
            make_film(recording, out, seconds)
        _OUT.print(f"Written: {out}", highlight=False, soft_wrap=True, markup=False)
    if screenshots is not None:
        with _ERR.status("opening the viewer without a window"):
            written = take_screenshots(recording, screenshots)
        names = " ".join(str(file) for file in written)
        _OUT.print(f"Written: {names}", highlight=False, soft_wrap=True, markup=False)


@app.command()
def report(
    directory: Annotated[Path, typer.Argument(help="Folder of a cut.", show_default=False)],
    figures: Annotated[
        Path | None, typer.Option(help="Write the figures for a paper into this folder instead.")
    ] = None,
    format: Annotated[str, typer.Option(help="Of these figures: pdf, svg or png.")] = "pdf",
) -> None:
    """Make report.html of a cut anew, or its figures as files."""
    from edmsim.recording.cut_folder import remake

    for file in remake(directory, figures, format, _say):
        _OUT.print(str(file), highlight=False, soft_wrap=True, markup=False)


@app.command()
def train(
    env_id: Annotated[
        str, typer.Argument(help="Environment: edmsim/GapFeed-v0 ..., or FILE.py:ID.", show_default=False)
    ],
    out: Annotated[Path, typer.Option(help="Folder for policy, checkpoint and tensorboard logs.")],
    algo: Annotated[str, typer.Option(help="ppo or sac.")] = "ppo",
    steps: Annotated[int | None, typer.Option(help="Windows in all; default by environment.")] = None,
    seed: _Seed = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the folder's checkpoint.")] = False,
    score: Annotated[
        int, typer.Option(metavar="EPISODES", help="Held-back episodes to compare the policy with counts on.")
    ] = 20,
) -> None:
    """Train a feed controller (needs the extra rl)."""
    from edmsim.learning.command import run

    try:
        table = run(env_id, algo, out, steps, seed, resume, score, _ERR)
    except KeyboardInterrupt:
        _say("interrupted; take an interrupted training up again with --resume")
        raise typer.Exit(INTERRUPTED) from None
    if table is not None:
        _OUT.print(table)
    _OUT.print(f"Cut with it: edmsim cut PROGRAM --controller policy:{out / 'policy.json'} --out DIR",
               highlight=False, soft_wrap=True, markup=False)


@app.command()
def evaluate(
    env_ids: Annotated[
        list[str],
        typer.Argument(metavar="ENV_ID...", help="Environments: edmsim/GapFeed-v0 ..., FILE.py:ID, or all."),
    ],
    controllers: Annotated[
        str | None, typer.Option(metavar="A,B", help="Feed controllers, as edmsim cut takes them; all by default.")
    ] = None,
    seeds: Annotated[int, typer.Option(help="Cuts of each controller.")] = 20,
    resolution: _Resolution = "default",
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    write: Annotated[Path | None, typer.Option(help="Write the page docs/benchmark.md into this file.")] = None,
) -> None:
    """Compare feed controllers on the same randomised machines."""
    from rich.progress import Progress as Bar

    from edmsim.envs.registration import resolve
    from edmsim.evaluation.bars import told
    from edmsim.evaluation.compare import check, evaluate, usual
    from edmsim.evaluation.compare import env_ids as all_ids
    from edmsim.evaluation.page import as_json, page, render

    chosen = {
        env_id: usual(env_id) if controllers is None else controllers.split(",")
        for env_id in (all_ids() if env_ids == ["all"] else map(resolve, env_ids))
    }
    for env_id, named in chosen.items():
        check(env_id, named, seeds, resolution)
    if write is not None:
        _make_file(write)
    found = []
    with Bar(console=_ERR, transient=True) as bar:
        for env_id, named in chosen.items():
            task = bar.add_task(env_id, total=None)

            def watch(done: int, total: int, task: TaskID = task) -> None:
                bar.update(task, completed=done, total=total)

            found.append(evaluate(env_id, named, seeds, resolution=resolution, watch=watch))
    if write is not None:
        asked = "" if controllers is None else f" --controllers {controllers}"
        command = f"edmsim evaluate {' '.join(env_ids)}{asked} --seeds {seeds} --resolution {resolution}"
        write.write_text(page(found, f"{command} --write {write}"), encoding="utf-8")
    if json:
        sys.stdout.write(as_json(found) + "\n")
    else:
        for comparison in found:
            _OUT.print(render(comparison, _OUT.width))
            for text in told(comparison):
                _OUT.print(text, highlight=False, markup=False)


@app.command()
def calibrate(
    log: Annotated[Path, typer.Argument(help="Table of windows, .parquet or CSV.", show_default=False)],
    out: Annotated[Path, typer.Option(help="TOML file for the fitted machine; material and wire go beside it.")],
    fit: Annotated[
        str | None, typer.Option(metavar="A,B", help="Constants or sections to fit; by default the usual three.")
    ] = None,
    machine: Annotated[str, typer.Option(help="Machine to start from.")] = "agiecut-dem15",
    material: _Material = "tool-steel",
    height: _Height = 20.0,
    wire: _Wire = "brass",
    tension: _Tension = None,
    generator: _Generator = "iso-pulse",
    resolution: _Resolution = "fast",
    seed: _Seed = 0,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Fit the model's constants to a machine's log."""
    from edmsim.calibration import DEFAULT_CONSTANTS, read_log
    from edmsim.calibration import calibrate as run
    from edmsim.calibration.output import as_json, check_writable, render, write
    from edmsim.machine.machine import Machine
    from edmsim.plant.resolution import resolution as check_resolution

    check_resolution(resolution)
    check_writable(out)
    set_up = Machine.load(
        machine, material=material, wire=wire, generator=generator, height_mm=height, tension=tension
    )
    table = read_log(log)
    try:
        with _ERR.status("calibrate") as status:
            found = run(
                table, set_up, DEFAULT_CONSTANTS if fit is None else fit.split(","), seed=seed, resolution=resolution,
                watch=lambda p: status.update(f"{p.cuts} cuts simulated, misfit {p.misfit:.2f}"),
            )
    except KeyboardInterrupt:
        _say("interrupted; nothing was written")
        raise typer.Exit(INTERRUPTED) from None
    files = write(found, table.name, out)
    if json:
        sys.stdout.write(as_json(found, files) + "\n")
        return
    _OUT.print(render(found))
    options = " ".join(f"--{part} {file}" for part, file in files.items())
    _OUT.print(f"Cut with it: edmsim cut PROGRAM {options} --out DIR", highlight=False, soft_wrap=True, markup=False)


@app.command()
def validate(
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    write: Annotated[
        Path | None, typer.Option(help="Folder of the docs: write validation.md, refresh the tables of theory/.")
    ] = None,
) -> None:
    """Compare the model with what was published, row by row."""
    from rich.progress import Progress as Bar

    from edmsim.validation import run
    from edmsim.validation.pages import check_folder
    from edmsim.validation.pages import write as write_pages
    from edmsim.validation.report import as_json, render

    if write is not None:
        check_folder(write)
    with Bar(console=_ERR, transient=True) as bar:
        task = bar.add_task("validate", total=None)
        rows = run(lambda done, total: bar.update(task, completed=done, total=total))
    if write is not None:
        write_pages(write, rows)
    if json:
        sys.stdout.write(as_json(rows) + "\n")
    else:
        _OUT.print(render(rows))
    if any(row.unexpected for row in rows):
        raise typer.Exit(FAILED)


@app.command()
def bench(
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    convergence: Annotated[
        Path | None, typer.Option(help="Compare the resolutions instead, and write the table into this file.")
    ] = None,
    planners: Annotated[
        Path | None,
        typer.Option(help="Measure the errors of the planners instead, and write the page and its picture there."),
    ] = None,
) -> None:
    """Measure the speed of this machine."""
    from edmsim.bench.plant import measure, render

    if convergence is not None:
        from edmsim.convergence import page

        _make_file(convergence)
        with _ERR.status("fast") as status:
            convergence.write_text(page(status.update), encoding="utf-8")
        return
    if planners is not None:
        from edmsim.planner_page import write as write_planners

        _make_file(planners)
        with _ERR.status("poscal") as status:
            write_planners(planners, status.update)
        return
    figures = measure()
    if json:
        import json as codec

        sys.stdout.write(codec.dumps(figures, indent=2) + "\n")
    else:
        _OUT.print(render(figures))


@app.command()
def terminal(
    machine: Annotated[str, typer.Option(help="Machine, a name or an own TOML file.")] = "agiecut-dem15",
    material: _Material = "tool-steel",
    height: _Height = 20.0,
    wire: _Wire = "brass",
    tension: _Tension = None,
    planner: Annotated[str, typer.Option(help="poscal, poscal-literal, dda or sine-table.")] = "poscal",
    resolution: _Resolution = "default",
    seed: _Seed = 0,
    host: Annotated[Path | None, typer.Option(help="File that the host sends when LOAD asks for a program.")] = None,
    speed: Annotated[
        float | None, typer.Option(help="Machine seconds per second; default 1, or as fast as can be in a pipe.")
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(help="A fault of 1982 to inject: serial-noise, drop-out; may be given again."),
    ] = None,
    view: Annotated[bool, typer.Option(help="Live view of digits and pulses at a real terminal.")] = True,
) -> None:
    """Sit at the 1982 controller's terminal."""
    from edmsim.machine.machine import Machine
    from edmsim.terminal.command import choose_faults, run
    from edmsim.terminal.rig import Rig

    faults = choose_faults(fault or (), seed)
    set_up = Machine.load(machine, material=material, height_mm=height, wire=wire, tension=tension)
    try:
        with _ERR.status("starting; the first time, the pulse loop is compiled"):
            rig = Rig(set_up, seed, resolution=resolution, planner=planner, faults=faults)
            rig.warm_up()
        raise typer.Exit(run(rig, host, speed, view))
    except KeyboardInterrupt:
        raise typer.Exit(INTERRUPTED) from None


def _make_file(file: Path) -> None:
    """See that a file can be written before the work begins."""
    try:
        file.touch()
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", file) from None


def _say(text: str) -> None:
    """Print one line on standard error, however long."""
    _ERR.print("edmsim: " + " ".join(text.splitlines()), highlight=False, soft_wrap=True, markup=False)


def main(run: Callable[[], None] = app) -> None:
    """Run the command line; bad input is one line on standard error and exit status 2."""
    try:
        run()
    except EdmsimError as error:
        _say(str(error))
        sys.exit(BAD_INPUT if isinstance(error, InputError) else FAILED)
