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
        float | None, typer.Option(help="Machine seconds per second; default 1, or as fast as can be in a pipe.")
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="A fault to inject: serial-noise, drop-out, stuck-end-switch, stuck-wire-sensor; may be given again."
        ),
    ] = None,
    monitor: Annotated[bool, typer.Option("--monitor", help="Begin in the monitor; G 0400 starts MAIN.")] = False,
    tapes: Annotated[Path | None, typer.Option(help="Folder of tapes, Intel HEX; default here.")] = None,
    view: Annotated[bool, typer.Option(help="Live view of digits and pulses at a real terminal.")] = True,
    **options: Any,
) -> None:
    """Sit at the 1982 controller's terminal."""
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
