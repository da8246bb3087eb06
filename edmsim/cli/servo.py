"""``edmsim console servo``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from edmsim.cli.console import INTERRUPTED, say


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
    from edmsim.consoles.servo.command import bench_for
    from edmsim.consoles.servo.scope import Scope
    from edmsim.consoles.servo.session import serve
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
