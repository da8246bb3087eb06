"""``edmsim console 1982``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from edmsim.cli.console import ERR, INTERRUPTED
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
    from edmsim.consoles.computer_1982.command import choose_faults, run
    from edmsim.consoles.computer_1982.rig import Rig
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
