"""Commands of machines: measure, gap, console."""

import math
import shlex
import sys
from contextlib import ExitStack
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Annotated, Any

import typer

from edmsim.cli.console import ERR, OUT, DriveAxis, Json, Quiet, print_line, say
from edmsim.cli.options import SET_UP, Among, Unset, takes
from edmsim.errors import BAD_INPUT, INTERRUPTED, InputError
from edmsim.files import check_suffix, make_writable, replacing

if TYPE_CHECKING:
    from edmsim.hil.boards import Rig
    from edmsim.job.settings import CutSettings
    from edmsim.machine.machine import Machine


@takes(
    "machine", "compensation", "seed",
    compensation=Unset("What is written is then what these tables, in force, have left."),
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
    from edmsim.job.settings import CutSettings
    from edmsim.measure import as_json, headline, measure_table, render, table_figure
    from edmsim.recording.figures.style import check_figure, write_figure

    if plot is not None:
        check_figure(plot)
    if out is not None:
        check_suffix(out, "a compensation file", ".toml")
    settings = CutSettings.model_validate(options)
    compensation = settings.compensation
    loaded = None if compensation is None else load_tables(read_tables(compensation), compensation)
    worn = settings.load_machine()
    for file in (out, plot):
        if file is not None:
            make_writable(file.parent)
    found = measure_table(worn, interval_mm=interval, runs=runs, seed=settings.seed, compensation=loaded)
    if out is not None:
        left = "" if compensation is None else f" with {Path(compensation).name} in force"
        about = f"Errors of the table of {settings.machine}{left}: what an axis indicates less where it truly is."
        with replacing(out) as partial:
            partial.write_text(text_of(found.tables(cubic), [about, *headline(found)]), encoding="utf-8")
    if plot is not None:
        write_figure(table_figure({"measured": found}), plot)
    if json:
        sys.stdout.write(as_json(found) + "\n")
        return
    OUT.print(render(found))
    if out is not None and compensation is None:
        use = f"--machine {shlex.quote(settings.machine)} --compensation {shlex.quote(str(out))}"
        print_line(f"Cut with it: edmsim cut PROGRAM {use} --out DIR")


@takes(
    "machine", "height_mm", "wire", "constants", "taper_deg", "guide_errors_mm", "resolution", "seed",
    resolution="fast", taper_deg=10.0,
)  # fmt: skip
def guides(json: Json = False, quiet: Quiet = False, **options: Any) -> None:
    """Measure the heights of the wire guides by a test cut."""
    from json import dumps

    from edmsim.job.cut import CutProgress
    from edmsim.job.settings import CutSettings
    from edmsim.measure import measure_guides
    from edmsim.progress import ShownProgress

    settings = CutSettings.model_validate(options)
    with ShownProgress(quiet) as bar:
        found = measure_guides(
            settings.load_machine(), settings.taper_deg, settings.guide_errors_mm or (0.0, 0.0), seed=settings.seed,
            resolution=settings.resolution, watch=CutProgress(bar, "test cut").show,
        )
    lower_mm, upper_mm = found.uncertainty_mm
    if json:
        sys.stdout.write(dumps({
            "lower_mm": found.lower_mm, "upper_mm": found.upper_mm, "uncertainty_mm": found.uncertainty_mm,
            "heights_mm": found.heights_mm.tolist(), "shift_um": found.shift_um.tolist(),
        }) + "\n")  # fmt: skip
        return
    for name, error, own in (("lower", found.lower_mm, lower_mm), ("upper", found.upper_mm, upper_mm)):
        OUT.print(f"the {name} guide is {error:+.3f} mm higher than its file says, ±{own:.3f} mm", highlight=False)
    errors = f"--guide-errors={found.lower_mm:.3f}:{found.upper_mm:.3f}"
    print_line(f"Cut with it: edmsim cut PROGRAM --machine {shlex.quote(settings.machine)} {errors} --out DIR")


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
    from edmsim.hil.boards import PlainGenerator, Rig, make_board
    from edmsim.hil.samples import RatioLog, SampleFile, Sensing
    from edmsim.job.settings import CutSettings

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
    board = None if serial is None else make_board(serial)
    of_board = {} if board is None else {"generator": board.generator}
    settings = CutSettings.model_validate({**of_board, **options})
    set_up, seed = settings.load_machine(), settings.seed
    if fmu is not None:
        _write_fmu(settings, fmu, gap)
    if delays is not None:
        _write_delays(set_up, delays, seed)
    if not is_run:
        return
    for file in (samples, log):
        if file is not None:
            make_writable(file.parent)
    rig = Rig(board or PlainGenerator(set_up), set_up, seed=seed, gap_um=gap, resolution=settings.resolution)
    with ExitStack() as files:
        sensing = Sensing(**chosen, seed=seed)
        sampled = files.enter_context(SampleFile(samples, sensing, rig.time_s)) if samples else None
        logged = files.enter_context(RatioLog(log, rig, 10.0 if log_rate is None else log_rate)) if log else None
        for taker in (sampled, logged):
            if taker is not None:
                rig.watch(taker.frame)
        _run(rig, serial is not None, 1.0 if speed is None else speed, seconds, 5.0 if feed is None else feed)
    if sampled is not None:
        say(f"{sampled.count} samples in {samples}" + (f": {sampled.notice}" if sampled.notice else ""))
    if logged is not None:
        say(f"{logged.count} rows in {log}")
    if rig.gap.lost and serial is None:
        say(rig.gap.lost)


def _run(rig: "Rig", has_ports: bool, speed: float, seconds: float | None, feed: float) -> None:
    if seconds is not None and not 0 < seconds < math.inf:
        raise InputError(f"--seconds is above 0, not {seconds:g}")
    if has_ports:
        from edmsim.hil.session import serve

        serve(rig, speed=speed, seconds=seconds, say=say)
        return
    from edmsim.consoles.devices import Interrupts

    interrupts = Interrupts()
    with interrupts.caught():
        until_s = rig.time_s + (1.0 if seconds is None else seconds)
        while rig.time_s < until_s and not interrupts.pending:
            rig.gap.setpoints.move_at((feed, 0.0), rig.gap.plant.time_ns)
            rig.frame()


def _write_delays(set_up: "Machine", file: Path, seed: int) -> None:
    from edmsim.hil.delays import delay_table, write_delays
    from edmsim.progress import ShownProgress

    check_suffix(file, "a table of delays", ".csv")
    make_writable(file.parent)
    with ShownProgress() as bar:
        rows = delay_table(set_up, seed=seed, watch=bar.of("delays"))
    write_delays(rows, file)
    say(f"{len(rows)} gaps and voltages in {file}")


def _write_fmu(settings: "CutSettings", file: Path, gap_um: float) -> None:
    from edmsim.hil.fmu import export_fmu

    step_s = export_fmu(
        file, seed=settings.seed, resolution=settings.resolution, gap_um=gap_um, name=settings.machine,
        **settings.set_up,
    )  # fmt: skip
    say(f"written: {file}; its step is {step_s:.9g} s")


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
    from edmsim.consoles.computer_1982.rig import Rig
    from edmsim.consoles.computer_1982.session import choose_faults, run
    from edmsim.job.settings import CutSettings

    settings = CutSettings.model_validate(options)
    faults = choose_faults(fault or (), settings.seed)
    try:
        with ERR.status("starting; the first time, the pulse loop is compiled"):
            rig = Rig(
                settings.load_machine(), settings.seed, resolution=settings.resolution, planner=settings.planner,
                faults=faults,
            )
            rig.warm_up()
        raise typer.Exit(run(rig, host, speed, view, monitor, tapes))
    except KeyboardInterrupt:
        raise typer.Exit(INTERRUPTED) from None


def servo(
    drive: Annotated[str, typer.Argument(help="Drive: uhu or servo-module.", show_default=False)],
    axis: DriveAxis = "bench",
    tuned: Annotated[bool, typer.Option("--tuned", help="Start with parameters tuned for the axis.")] = False,
    pty: Annotated[bool, typer.Option("--pty", help="Open a serial port for a terminal program.")] = False,
    speed: Annotated[
        float | None, typer.Option(help="Simulated seconds per second; default: 1; scripts run at full speed.")
    ] = None,
    scope: Annotated[
        bool, typer.Option("--scope", help="Draw tracking error, duty, current, position, speed live in rerun.")
    ] = False,
    record: Annotated[Path | None, typer.Option(help="File for these curves, .rrd.")] = None,
) -> None:
    """Operate a servo drive at its serial terminal."""
    from edmsim.consoles.servo import Scope, bench_for, serve
    from edmsim.controllers.axis import Uhu

    bench = bench_for(drive, axis, tuned)
    streams = isinstance(bench.drive(), Uhu)
    screen = Scope(scope, record, streams) if scope or record is not None else None
    bench.trace = screen is not None
    if screen is not None and screen.notice:
        say(screen.notice)
    try:
        serve(bench, pty=pty, speed=speed, scope=screen, say=say)
    except KeyboardInterrupt:
        raise typer.Exit(INTERRUPTED) from None
    finally:
        if screen is not None:
            screen.close()


_SHOWN = 10  # problems of a text that are listed (ours): the manual's example has fewer


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
) -> None:
    """Run a QCL program on EANPOS positioners and their axes."""
    from edmsim.consoles.positioner import Station, contactors_of, press_of, run_and_tell
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
    run_and_tell(station, seconds, presses, print_line)
