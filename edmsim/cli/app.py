"""The command line: its commands, the version, and how errors end it."""

from __future__ import annotations

from typing import Annotated

import typer

from edmsim import __version__
from edmsim.cli.console import OUT, take_any_terminal
from edmsim.cli.cut import cut
from edmsim.cli.evaluate import evaluate, search_gains
from edmsim.cli.learn import dataset, score, train
from edmsim.cli.measure_table import measure_table
from edmsim.cli.playback import render, report, view
from edmsim.cli.positioner import positioner
from edmsim.cli.servo import servo
from edmsim.cli.studies import bench, calibrate, validate
from edmsim.cli.sweep import SHORT_FORM, sweep, tune
from edmsim.cli.terminal import terminal
from edmsim.errors import run_command

app = typer.Typer(
    add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False,
    help="A wire-EDM machine, simulated discharge by discharge.",
)
_COMMANDS = (
    cut, view, render, report, train, score, dataset, evaluate, search_gains, calibrate, validate, bench, terminal,
    servo, positioner, measure_table, tune,
)  # fmt: skip
for _command in _COMMANDS:
    app.command()(_command)
app.command(context_settings=SHORT_FORM)(sweep)


@app.callback(invoke_without_command=True)
def _version(
    version: Annotated[bool, typer.Option("--version", help="Print the version and leave.")] = False,
) -> None:
    if version:
        OUT.print(__version__, highlight=False)
        raise typer.Exit


def main() -> None:
    """Run the command line; bad input is one line on standard error and exit status 2."""
    take_any_terminal()
    run_command(app)
