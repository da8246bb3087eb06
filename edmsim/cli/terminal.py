"""``edmsim console 1982``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from edmsim.cli.console import ERR, INTERRUPTED, Height, Machine, Material, Resolution, Seed, Tension, Wire


def terminal(
    machine: Machine = "agiecut-dem15",
    material: Material = "tool-steel",
    height: Height = 20.0,
    wire: Wire = "brass",
    tension: Tension = None,
    planner: Annotated[str, typer.Option(help="poscal, poscal-literal, dda or sine-table.")] = "poscal",
    resolution: Resolution = "default",
    seed: Seed = 0,
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
) -> None:
    """Sit at the 1982 controller's terminal."""
    from edmsim.consoles.computer_1982.command import choose_faults, run
    from edmsim.consoles.computer_1982.rig import Rig
    from edmsim.machine.machine import Machine

    faults = choose_faults(fault or (), seed)
    set_up = Machine.load(machine, material=material, height_mm=height, wire=wire, tension=tension)
    try:
        with ERR.status("starting; the first time, the pulse loop is compiled"):
            rig = Rig(set_up, seed, resolution=resolution, planner=planner, faults=faults)
            rig.warm_up()
        raise typer.Exit(run(rig, host, speed, view, monitor, tapes))
    except KeyboardInterrupt:
        raise typer.Exit(INTERRUPTED) from None
