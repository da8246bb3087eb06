"""``edmsim console``: the computer of 1982, a servo drive, a positioner's control."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from edmsim.cli.console import ERR, INTERRUPTED, OUT, say
from edmsim.cli.options import takes


@takes("machine", "material", "wire", "height_mm", "tension", "planner", "resolution", "seed")
def terminal(
    host: Annotated[Path | None, typer.Option(help="File that the host sends when LOAD asks for a program.")] = None,
    speed: Annotated[
        float | None, typer.Option(help="Machine seconds per second; default: 1, or full speed in a pipe.")
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="Inject a fault: serial-noise, drop-out, stuck-end-switch, stuck-wire-sensor; repeatable."
        ),
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
    axis: Annotated[
        str, typer.Option(help="Axis: x or y of the machine, bench, table, fast, low-impedance.")
    ] = "bench",
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
    from edmsim.errors import InputError

    presses = [press_of(text) for text in press or []]
    contactors = contactors_of(contactor or [])
    if not seconds > 0:
        raise InputError(f"--seconds is above 0, not {seconds:g}")
    try:
        station = Station.of_files(configuration, program, axis, contactors)
    except QclError as error:
        for problem in error.problems[1:_SHOWN]:
            say(f"{error.file}:{problem.line}: {problem.what}")
        raise
    tell = partial(OUT.print, highlight=False, soft_wrap=True, markup=False)
    run_and_tell(station, seconds, presses, tell)
