"""``edmsim console positioner``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from edmsim.cli.console import OUT, say

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
    from edmsim.consoles.servo.positioner import Station, contactors_of, press_of, run_and_tell
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
