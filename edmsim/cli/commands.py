"""Commands without a group: from a part program to its cut, policies, comparisons, the gap alone."""

import math
import tempfile
import warnings
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Annotated, Any

import typer

import edmsim
from edmsim import files, user_code
from edmsim.cli import console
from edmsim.cli.console import ERR, OUT, RESUME, interruptible, print_json, print_line, print_use, quoted, say
from edmsim.cli.options import SET_UP, Environment, Json, Program, Quiet, Unset, settings_of, takes
from edmsim.errors import BAD_INPUT, FAILED, INTERRUPTED, STOPPED, InputError


@takes(out=Unset("Default out/PROGRAM."))
def cut(
    program: Program,
    traces: Annotated[
        Path | None, typer.Option(help="File for samples of gap voltage and current, .parquet.")
    ] = None,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Cut a part program."""
    from edmsim.job.cut import CHECKPOINT, CutProgress

    folder = Path(options.pop("out", Path("out") / program.stem))
    files.make_room(traces, "a file of traces", ".parquet")
    result = None
    try:
        with console.progress(quiet, keep=True) as bar, warnings.catch_warnings():
            warnings.showwarning = lambda message, *_, **__: say(str(message))
            shown = CutProgress(bar, program.name)
            result = edmsim.cut(program, out=folder, **options, watch=shown.show, enter=shown.enter)
    except KeyboardInterrupt as interrupt:
        if result is None:
            resumable = "interrupted; run the same command with --resume to continue"
            said = resumable if (folder / CHECKPOINT).exists() else "interrupted before the cut began"
            raise console.interrupted(interrupt, said) from None
    if traces is not None:
        try:
            result.write_traces(traces)
        except KeyboardInterrupt:
            say(f"interrupted: the results are in {folder}, the traces are not written")
            raise typer.Exit(INTERRUPTED) from None
    with suppress(KeyboardInterrupt):  # all files are written
        if not quiet:
            OUT.print(result.report)
            print_line(f"Written to {folder}; play it back with: edmsim view {quoted(folder)}")
    if result.report.outcome != "finished":
        raise typer.Exit(STOPPED)


@takes(
    "machine", SET_UP, "heights", "constants", "planner", "offset", "offsets", "ignore", "dialect", "conditions",
    "layers", "upper_layer", "taper_deg", "taper_corners", "guide_errors_mm", "unit", "passes", "technology",
    "tab_mm", "overlap_mm", "after_tab",
)  # fmt: skip
def check(
    program: Program,
    out: Annotated[
        Path | None, typer.Option(help="Picture of the path: .png .svg or .pdf; default out/PROGRAM/path.png.")
    ] = None,
    **options: Any,
) -> None:
    """Check a program before the cut: path, notices, time."""
    from edmsim.job import plan
    from edmsim.program.blocks import UnknownWordsError, offered_to_ignore
    from edmsim.recording.figures import profile, style

    picture = Path("out") / program.stem / "path.png" if out is None else out
    style.check_figure(picture)
    settings = settings_of(options)
    unknown: dict[str, list[int]] = {}

    try:
        found = plan.check(program, settings)
    except UnknownWordsError as error:
        unknown = error.words
        for word, lines in unknown.items():
            times = "" if len(lines) == 1 else f", {len(lines)} times"
            say(f"{program}:{lines[0]}: unknown word {word}{times}")
        deciding = [word for word in unknown if word not in offered_to_ignore(unknown)]
        if deciding:
            these = "it" if len(deciding) == 1 else "them"
            say(f"{', '.join(deciding)} may decide the contour: correct or delete {these}{error.hint}")
            raise typer.Exit(BAD_INPUT) from None
        say("the rest is shown without them, as with --ignore " + ",".join(unknown))
        found = plan.check(program, settings.model_copy(update={"ignore": (*settings.ignore, *unknown)}))
    for name, text in plan.lines_of(found):
        print_line(f"{name:<12}{text}")
    for notice in found.path.notices:
        print_line(f"note: {notice}")
    title = program.name.encode("utf-8", "replace").decode()
    style.write_figure(profile.path_figure(found.path, title, 2e3 * found.machine.auto_offset_mm), picture)
    print_line(f"Written: {picture}")
    if unknown:
        raise typer.Exit(BAD_INPUT)


def view(
    directory: Annotated[Path, typer.Argument(help="Folder of a cut.", show_default=False)],
    other: Annotated[
        Path | None, typer.Argument(help="Folder of another cut, shown side by side.", show_default=False)
    ] = None,
) -> None:
    """Play a cut back in rerun, or two side by side."""
    from edmsim.recording.rerun import viewer

    raise typer.Exit(viewer.view(directory) if other is None else viewer.compare(directory, other))


def report(
    directory: Annotated[Path, typer.Argument(help="Folder of a cut.", show_default=False)],
    film: Annotated[Path | None, typer.Option(help="Film of the cut, .mp4 or .gif.")] = None,
    seconds: Annotated[float | None, typer.Option(help="Length of the film; default: 12.")] = None,
    screenshots: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder for pictures of the viewer; needs no screen.")
    ] = None,
    figures: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Folder for figures.")] = None,
    format: Annotated[str | None, typer.Option(help="Format of the figures: pdf, svg or png; default: pdf.")] = None,
    contour: Annotated[Path | None, typer.Option(help="File for the cut contour, .dxf .csv or .svg.")] = None,
    contour_height: Annotated[
        float | None, typer.Option(help="Height of the contour in mm; default: that of the kerf at mid height.")
    ] = None,
    face: Annotated[Path | None, typer.Option(help="File for the part's cut face, .stl or .glb (glTF).")] = None,
) -> None:
    """Write a cut's report.html again, or a film, figures, a contour.

    Without options it writes report.html, with options only the files they name.
    """
    from edmsim.job.result import remake
    from edmsim.recording.exports import write_contour, write_faces
    from edmsim.recording.report import read_cut
    from edmsim.recording.rerun import playback, viewer

    if contour is None and contour_height is not None:
        raise InputError("--contour-height is that of a contour: give the file with --contour")
    if film is None and seconds is not None:
        raise InputError("--seconds is the length of a film: give the file with --film")
    if figures is None and format is not None:
        raise InputError("--format is that of figures: give the folder with --figures")
    written: list[Path] = []
    if film is not None:
        from edmsim.recording.video import SECONDS, check_film, render  # loads Matplotlib

        recording, length_s = playback.find_recording(directory), SECONDS if seconds is None else seconds
        check_film(film, length_s)
        try:
            with ERR.status(f"drawing {film.name}"):
                render(recording, film, length_s)
        except KeyboardInterrupt as interrupt:
            raise console.interrupted(interrupt, "interrupted: the film is not written") from None
        written.append(film)
    if screenshots is not None:
        with ERR.status("opening the viewer without a window"):
            written += viewer.take_screenshots(playback.find_recording(directory), screenshots)
    if contour is not None:
        write_contour(read_cut(directory).scene, contour, contour_height)
        written.append(contour)
    if face is not None:
        write_faces(read_cut(directory).scene, face)
        written.append(face)
    if figures is not None or not written:
        written += remake(directory, figures, format or "pdf", say)
    for file in written:
        print_line(str(file))


@takes("seed")
def train(
    env_id: Environment,
    out: Annotated[Path, typer.Option(help="Folder for policy, checkpoint and tensorboard logs.")],
    algo: Annotated[str, typer.Option(help="ppo, recurrent-ppo, ppo-lag, sac, tqc, imitation or bandit.")] = "ppo",
    steps: Annotated[
        int | None, typer.Option(help="Total number of steps, rounded up to whole rollouts; default by environment.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Resume from the folder's checkpoint.")] = False,
    score: Annotated[
        int, typer.Option(metavar="EPISODES", help="Number of held-back episodes to score the policy; 0 for none.")
    ] = 20,
    settings: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Hyperparameters to change, such as best.toml of edmsim tune.")
    ] = None,
    residual: Annotated[
        str | None, typer.Option(metavar="LAW", help="Let the policy correct the feed of this controller.")
    ] = None,
    teacher: Annotated[
        str | None, typer.Option(metavar="CONTROLLER", help="Controller to imitate; it may see the true gap.")
    ] = None,
    privileged_critic: Annotated[
        bool, typer.Option("--privileged-critic", help="Let the value network see gap, heat and constants.")
    ] = False,
    start: Annotated[
        str | None, typer.Option(metavar="POLICY", help="Start from this policy: policy:GapFeed-ppo, or policy:FILE.")
    ] = None,
    record_every: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Record every N-th episode of the first sub-environment.")
    ] = None,
    live: Annotated[bool, typer.Option("--live", help="Show them in rerun's viewer when they end.")] = False,
    safe: Annotated[
        int | None,
        typer.Option(
            metavar="MACHINES",
            help="Accept the policy only if on as many other machines it earns at most 2 % less than its start.",
        ),
    ] = None,
    **options: Any,
) -> None:
    """Train a policy (extra rl, except for the bandit)."""
    from edmsim.evaluation.episode import is_part
    from edmsim.learning.hyperparameters import has_training
    from edmsim.learning.score import BANDIT, TrainOptions, train_and_score

    kinds = TrainOptions(settings, residual, teacher, privileged_critic, start, record_every, live, safe)
    words = ["edmsim", "train", env_id, "--algo", algo, "--seed", str(options["seed"]), "--resume", "--out", str(out)]
    for name, value in (("--steps", steps), ("--score", score), ("--record-every", record_every)):
        words += [] if value is None else [name, str(value)]
    words += ["--live"] if live else []
    again = f"to continue: {' '.join(map(quoted, words))}"
    with interruptible(lambda: again if has_training(out) else "nothing was trained"):
        tables = train_and_score(env_id, algo, out, steps, options["seed"], resume, score, kinds)
    for table in tables:
        OUT.print(table)
    policy = f"policy:{out / 'policy.json'}"
    if is_part(edmsim.envs.registry.resolve(env_id)) or algo == BANDIT:  # a bandit's law may be too fast for a cut
        print_line(f"Compare it: edmsim evaluate {env_id} --controllers {quoted(policy)}")
    else:
        print_use("Cut with it", controller=policy)


@takes("seed")
def dataset(
    env_id: Environment,
    out: Annotated[Path, typer.Option(help="Folder for the data sets; an interrupted recording is resumed.")],
    controllers: Annotated[
        str, typer.Option(metavar="A,B", help="Feed controllers: {controllers}.")
    ] = "fixed,counts,voltage",
    steps: Annotated[int, typer.Option(help="Windows per controller, rounded up to whole episodes.")] = 100_000,
    **options: Any,
) -> None:
    """Record controllers as data sets of Minari (extra offline)."""
    from edmsim.learning.dataset import record

    with interruptible() as bar:
        resolved, named = edmsim.envs.registry.resolve(env_id), user_code.listed(controllers)
        made = record(resolved, named, steps, out, watch=bar.show, **options)
    for row in made:
        print_line(
            f"{row.dataset_id}: {row.episodes} episodes, {row.steps} steps, {row.breaks} with a broken wire, "
            f"mean return {row.mean_return:.1f}"
        )
    print_line(
        f"Load them: MINARI_DATASETS_PATH={quoted(out)} python -c 'import minari; "
        f"print(minari.load_dataset(\"{made[0].dataset_id}\"))'"
    )


USUAL_EPISODES = 20  # number of held-back episodes for scoring a policy at each resolution (ours)


@takes("resolution", resolution=Unset("Default: that of the environment; for a policy all, fast in Part and shifts."))
def evaluate(
    env_ids: Annotated[
        list[str] | None,
        typer.Argument(metavar="[ENV_ID...]", help="Environments: edmsim/GapFeed-v2 ..., FILE.py:ID, or all."),
    ] = None,
    controllers: Annotated[
        str | None, typer.Option(metavar="A,B", help="Feed controllers: {controllers}; default: those of the task.")
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(help="Number of cuts per controller; default by environment, 20 for a policy.")
    ] = None,
    record: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for recordings of all cuts, for edmsim view.")
    ] = None,
    leaderboard: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Table of all cuts, .jsonl; those it has are not made again.")
    ] = None,
    page: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a page with a table and figures, .md.")
    ] = None,
    policy: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Evaluate a policy in its own environment, with counts and voltage: a "
                                          "file, or a name under models/policies. Repeatable."),
    ] = None,
    write_card: Annotated[bool, typer.Option("--write-card", help="Write the scores to the policy file.")] = False,
    json: Json = False,
    **options: Any,
) -> None:
    """Compare feed controllers on the same randomised machines."""
    from edmsim import numeric, runs
    from edmsim.evaluation import compare, episode
    from edmsim.learning import policy_file, score

    resolution, named = options.get("resolution"), env_ids or []
    if write_card and not policy:
        raise InputError("--write-card writes to a policy's file: give the policy with --policy")
    if not named and not policy:
        raise InputError("name an environment, or a policy with --policy; see edmsim evaluate --help")
    if named and policy:
        names = ",".join(f"policy:{user_code.policy_of(name)}" for name in policy)
        raise InputError(f"--policy is for a policy's own environment: compare it in others by --controllers {names}")
    of_envs = {"--controllers": controllers, "--record": record, "--leaderboard": leaderboard, "--page": page}
    if not named and (without := [flag for flag, value in of_envs.items() if value is not None]):
        raise InputError(f"{without[0]} is for environments: name one, or leave it out")
    if "all" in named and len(named) > 1:
        raise InputError("all names every environment: leave out the others, or all")
    if policy and seeds is not None:
        numeric.whole_from("seeds", seeds, 2)
    chosen = {
        env_id: compare.usual(env_id) if controllers is None else user_code.listed(controllers)
        for env_id in (compare.env_ids() if named == ["all"] else map(edmsim.envs.registry.resolve, named))
    }
    for name in policy or ():
        score.env_id_of(name)  # an unknown policy is refused before the first cut
    for env_id, laws in chosen.items():
        compare.check(env_id, laws, episode.lines_of(env_id).seeds if seeds is None else seeds, resolution)
    for file, what, suffix in ((page, "a page", ".md"), (leaderboard, "a leaderboard", ".jsonl")):
        if file is not None:
            files.check_suffix(file, what, suffix)
    for file in (leaderboard, page):
        if file is not None:
            files.make_writable(file.parent)
    until_written = page or (policy_file.locate(policy[0]) if policy and write_card else None)
    journal = None if until_written is None else until_written.with_suffix(".runs.jsonl")
    finished = runs.RunTable(journal)
    cuts = finished if leaderboard is None else runs.RunTable(leaderboard, texts=compare.CUT_TEXTS)
    saved = leaderboard is not None or journal is not None
    found, scores = [], {}
    unsaved = "nothing was saved; --leaderboard, --page and --write-card save finished cuts"
    with interruptible(RESUME if saved else unsaved) as bar:
        for env_id, laws in chosen.items():
            watch = bar.of(env_id)
            found.append(
                compare.evaluate(env_id, laws, seeds, resolution=resolution, record=record, watch=watch, table=cuts)
            )
        for name in policy or ():
            scores[name] = score.measure(
                score.env_id_of(name), name, USUAL_EPISODES if seeds is None else seeds, bar.show,
                () if resolution is None else (resolution,), finished,
            )  # fmt: skip
            if write_card:
                score.write_card(name, scores[name])
    if page is not None:
        compare.write_page(page, found)
    if journal is not None:
        journal.unlink(missing_ok=True)
    if json:
        print_json(compare.as_json(found, scores))
        return
    of_policies = (score.render(name, score.env_id_of(name), rows) for name, rows in scores.items())
    for shown in (*(compare.render(made, OUT.width) for made in found), *of_policies):
        OUT.print(shown)


_BY_LOG = Unset("Default: as in the log.")


@takes(
    "machine", SET_UP, "resolution", "seed",
    **dict.fromkeys(("machine", "material", "wire", "generator", "height_mm"), _BY_LOG),
    resolution=Unset("Default: as in the log, or fast."),
)
def calibrate(
    log: Annotated[Path, typer.Argument(help="Table of windows, .parquet or CSV.", show_default=False)],
    out: Annotated[Path, typer.Option(help="TOML file for the machine; material and wire go to the same folder.")],
    fit: Annotated[
        str | None, typer.Option(metavar="A,B", help="Constants or sections to fit; default: the usual three.")
    ] = None,
    json: Json = False,
    **options: Any,
) -> None:
    """Fit the model's constants to a machine's log."""
    from edmsim import calibration, runs
    from edmsim.calibration import comparison, output
    from edmsim.calibration import fit as fitting

    files.make_room(out, "the fitted machine", ".toml")
    table = calibration.read_log(log)
    seed = options.pop("seed")
    settings, notices = calibration.settings_for(table, **options)
    chosen = calibration.DEFAULT_CONSTANTS if fit is None else user_code.listed(fit)
    journal = out.with_suffix(".runs.jsonl")
    set_up = fitting.machine_of(settings)
    for notice in (*notices, *fitting.held(settings, set_up, chosen)):
        say(notice)
    with files.locked_file(out, "edmsim calibrate"):
        with interruptible() as bar:

            def watch(progress: comparison.CalibrationProgress) -> None:
                misfit = "" if math.isnan(progress.misfit) else f", misfit {progress.misfit:.2f}"
                bar.show("calibrate", text=f"{progress.cuts} of some {progress.usual} cuts simulated{misfit}")

            found = calibration.calibrate(
                table, set_up, chosen, seed=seed, resolution=settings.resolution, table=runs.RunTable(journal),
                watch=watch,
            )
        written = output.write(found, table.name, out, [name for name, _ in settings.overrides])
        journal.unlink(missing_ok=True)
    if json:
        print_json(output.as_json(found, written))
        return
    OUT.print(output.render(found, settings.resolution))
    usual, of_set_up = settings_of({}), ("material", "wire", "generator", "resolution")
    others = {name: now for name in of_set_up if (now := getattr(settings, name)) != getattr(usual, name)}
    print_use("Cut with it", **{**others, **written})


def validate(
    failed: Annotated[bool, typer.Option("--failed", help="Show only rows that fail, with the reasons.")] = False,
    topics: Annotated[
        str | None, typer.Option(metavar="A,B", help="Topics of the rows to compare; default: all.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Table of finished checks, .jsonl; those it has are not made again."),
    ] = None,
    json: Json = False,
) -> None:
    """Compare the model with publications, row by row."""
    from edmsim.runs import Processes, RunTable
    from edmsim.validation import CHECK_TEXTS, checks, report, run

    chosen = None if topics is None else user_code.listed(topics)
    checks(topics=chosen)  # an unknown topic is refused before a folder is made
    files.make_room(out, "a table of checks", ".jsonl")
    table = RunTable(out, texts=CHECK_TEXTS)
    with interruptible("nothing was saved; --out saves finished checks" if out is None else RESUME) as bar:
        rows = run(bar.of("validate"), engine=Processes(), topics=chosen, table=table)
    if json:
        print_json(report.as_json(rows, report.failed(rows) if failed else None))
    else:
        OUT.print(report.render_failed(rows) if failed else report.render(rows))
    if any(row.unexpected for row in rows):
        raise typer.Exit(FAILED)


def bench(
    against: Annotated[
        str | None, typer.Option(metavar="REVISION", help="Compare with a revision of this checkout, in pairs.")
    ] = None,
    pairs: Annotated[int | None, typer.Option(min=1, help="Pairs of --against; default: 10.")] = None,
    profile: Annotated[bool, typer.Option("--profile", help="Show the time of each part of a pulse.")] = False,
    serial: Annotated[bool, typer.Option("--serial", help="Measure edmsim gap --serial.")] = False,
    training: Annotated[
        bool, typer.Option("--training", help="Measure a training with PPO, compared with HalfCheetah-v5 (extra rl).")
    ] = False,
    figure: Annotated[Path | None, typer.Option(help="Picture of the profile: .png, .svg or .pdf.")] = None,
    json: Json = False,
) -> None:
    """Measure the speed of this computer in processor time."""
    from edmsim.bench.figures import measured

    with interruptible("no measurement was completed") as bar:
        found = measured(
            lambda phase: bar.show("measure", text=phase), against, pairs, profile, serial, training, figure
        )
    if json:
        numbers = {name: numbers for name, (numbers, _) in found.items()}
        print_json(numbers if len(found) > 1 else next(iter(numbers.values())), indent=2)
    else:
        for _, table in found.values():
            OUT.print(table)


@takes("machine", SET_UP, "resolution", "seed", resolution="fast",
       generator=Unset("Default: the board's, or iso-pulse."))  # fmt: skip
def gap(
    serial: Annotated[
        str | None, typer.Option(metavar="BOARD", help="Serial ports of a board: powercore, powercore-v2, spark.")
    ] = None,
    samples: Annotated[
        Path | None,
        typer.Option(help="File for samples of gap voltage and current, .parquet or .wav."),
    ] = None,
    log: Annotated[
        Path | None, typer.Option(help="File for ratios and positions, .csv, for edmsim calibrate.")
    ] = None,
    delays: Annotated[Path | None, typer.Option(help="File for quantiles of ignition delays, .csv.")] = None,
    fmu: Annotated[Path | None, typer.Option(help="File for an FMU, FMI 3.0 for co-simulation, .fmu.")] = None,
    gap: Annotated[float, typer.Option(help="Gap round the wire at the start in um.")] = 30.0,
    feed: Annotated[float | None, typer.Option(help="Without --serial: speed of x in um/s; default: 5.")] = None,
    seconds: Annotated[
        float | None, typer.Option(help="Machine time in s after which to stop; default without --serial: 1.")
    ] = None,
    speed: Annotated[
        float | None, typer.Option(help="With --serial: machine seconds per second; default: 1.")
    ] = None,
    rate: Annotated[float | None, typer.Option(help="Samples per second, 10000 to 100000; default: 50000.")] = None,
    low_pass: Annotated[
        float | None,
        typer.Option(help="Cut-off frequency of a low-pass filter before the converter in Hz; default: no filter."),
    ] = None,
    noise: Annotated[float | None, typer.Option(help="Noise of the voltage samples, rms in V; default: 0.")] = None,
    current_noise: Annotated[
        float | None, typer.Option(help="Noise of the current samples, rms in A; default: 0.")
    ] = None,
    log_rate: Annotated[float | None, typer.Option(help="Rows of --log per second, 2 to 100; default: 10.")] = None,
    **options: Any,
) -> None:
    """Simulate the gap for a real controller or another simulator."""
    from edmsim.hil import boards, session
    from edmsim.hil.samples import RatioLog, SampleFile, Sensing

    is_run = not (serial is None and samples is None and log is None)
    if not is_run and delays is None and fmu is None:
        raise InputError("give --serial BOARD for ports, --samples, --log, --delays or --fmu FILE for files; see "
                         "edmsim gap --help")
    if serial is None and speed is not None:
        raise InputError("--speed is that of ports: give --serial BOARD")
    if not is_run and (seconds is not None or feed is not None):
        raise InputError("--seconds and --feed are those of a run: give --serial BOARD, --samples or --log FILE")
    if serial is not None and feed is not None:
        raise InputError("--feed is that of a run without ports: with --serial the axes' port moves the wire")
    sensed = {"rate_Hz": rate, "low_pass_Hz": low_pass, "noise_V": noise, "noise_A": current_noise}
    chosen = {name: value for name, value in sensed.items() if value is not None}
    if samples is None and chosen:
        raise InputError("--rate, --low-pass, --noise and --current-noise are those of samples: give the file with "
                         "--samples")  # fmt: skip
    if log is None and log_rate is not None:
        raise InputError("--log-rate is that of a log: give the file with --log")
    board = None if serial is None else boards.make_board(serial)
    of_board = {} if board is None else {"generator": board.generator}
    settings = settings_of({**of_board, **options})
    if board is not None:
        chosen_pulse = settings.t_on_us, settings.t_period_us, settings.open_voltage_V, settings.peak_current_A
        flags = "--t-on", "--t-period", "--open-voltage", "--peak-current"
        for flag, requested, own in zip(flags, chosen_pulse, board.output()[2:], strict=True):
            if requested is not None and own is not None:
                raise InputError(f"{flag} has no effect, as the board {serial} sets it: leave it out")
    set_up, seed = settings.load_machine(), settings.seed
    if fmu is not None:
        from edmsim.hil.fmu import export_fmu

        step_s = export_fmu(
            fmu, seed=seed, resolution=settings.resolution, gap_um=gap, name=settings.machine, **settings.set_up
        )
        say(f"written: {fmu}; its step is {step_s:.9g} s")
    if delays is not None:
        from edmsim.hil.gap import delay_table, write_delays

        files.make_room(delays, "a table of delays", ".csv")
        with console.progress() as bar:
            rows = delay_table(set_up, seed=seed, watch=bar.of("delays"))
        write_delays(rows, delays)
        say(f"{len(rows)} gaps and voltages in {delays}")
    if not is_run:
        return
    if seconds is not None and not 0 < seconds < math.inf:
        raise InputError(f"--seconds is above 0, not {seconds:g}")
    for file in (samples, log):
        if file is not None:
            files.make_writable(file.parent)
    pulser = board or boards.PlainGenerator(set_up)
    rig = boards.Rig(pulser, set_up, seed=seed, gap_um=gap, resolution=settings.resolution)
    ended: SystemExit | None = None
    with ExitStack() as opened:
        sensing = Sensing(**chosen, seed=seed)
        sampled = opened.enter_context(SampleFile(samples, sensing, rig.time_s)) if samples else None
        logged = opened.enter_context(RatioLog(log, rig, 10.0 if log_rate is None else log_rate)) if log else None
        for taker in filter(None, (sampled, logged)):
            rig.watch(taker.frame)
        try:
            if serial is None:
                lasts_s = 1.0 if seconds is None else seconds
                session.run_alone(rig, feed_um_s=5.0 if feed is None else feed, seconds=lasts_s)
            else:
                session.serve(rig, speed=1.0 if speed is None else speed, seconds=seconds, say=say)
        except SystemExit as signalled:  # SIGTERM, SIGHUP: the files are kept as after Ctrl-C, so their lines as well
            ended = signalled
    if sampled is not None:
        say(f"{sampled.count} samples in {samples}" + (f": {sampled.notice}" if sampled.notice else ""))
    if logged is not None:
        say(f"{logged.count} rows in {log}")
    if rig.gap.lost and serial is None:
        say(rig.gap.lost)
    if ended is not None:
        raise ended





def warm_up() -> None:
    """Compile the code of cuts and environments in advance."""
    from edmsim.plant.kernel.memory import window_function
    from edmsim.plant.plant import shapes
    from edmsim.runs import perform

    total = len(shapes()) + 1
    with interruptible("what is compiled is kept") as bar:
        bar.show("compile", 0, total)
        perform(lambda shape: window_function(*shape), shapes(), lambda done, _: bar.show("compile", done, total))
        _use_once()
        bar.show("compile", total, total)
    OUT.print("The usual code of cuts and environments is compiled, for all resolutions.")


def _use_once() -> None:
    """Run a cut and a step of two environments, which compile planners, servo, offset, observations and rewards."""
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "line.ngc"
        program.write_text("G0 X0 Y0\nG1 X0.5\nM2\n", encoding="ascii")
        edmsim.cut(program, offset="none", resolution="fast", max_time_s=0.1)
    for task in ("GapFeed", "Corner"):  # in Corner a servo sets the feed, and an action offsets the guides
        env = edmsim.envs.EdmEnv(task, resolution="fast")
        env.reset(seed=0)
        env.step(env.action_space.sample())
        env.close()
