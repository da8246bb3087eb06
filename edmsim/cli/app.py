"""The command line: its commands, the version, and how errors end it."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer

from edmsim import __version__
from edmsim.cli.bench import bench
from edmsim.cli.check import check
from edmsim.cli.console import OUT, take_any_terminal
from edmsim.cli.cut import cut
from edmsim.cli.evaluate import evaluate, search_gains
from edmsim.cli.export import export
from edmsim.cli.find_guides import find_guides
from edmsim.cli.gap import gap
from edmsim.cli.learn import dataset, score, train
from edmsim.cli.measure_table import measure_table
from edmsim.cli.options import Command
from edmsim.cli.playback import render, report, view
from edmsim.cli.positioner import positioner
from edmsim.cli.servo import servo
from edmsim.cli.studies import calibrate, validate
from edmsim.cli.sweep import SHORT_FORM, sweep, tune
from edmsim.cli.technology import technology
from edmsim.cli.terminal import terminal
from edmsim.cli.warm_up import warm_up
from edmsim.errors import BAD_INPUT, FAILED, InputError, run_command

app = typer.Typer(
    add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False,
    help="A wire-EDM machine, simulated discharge by discharge.",
)
_COMMANDS = (
    cut, check, view, render, report, train, score, dataset, evaluate, search_gains, calibrate, validate, bench,
    technology, measure_table, find_guides, gap, export, tune, warm_up,
)  # fmt: skip
_UsageError: Any = typer.BadParameter.__base__
"""Of click, which newer releases of typer hold inside themselves."""

for _command in _COMMANDS:
    app.command(cls=Command)(_command)
app.command(context_settings=SHORT_FORM)(sweep)

console = typer.Typer(
    no_args_is_help=True,
    help="Operate the 1982 controller, a servo drive or a positioner by hand, by script or from another program.",
)
console.command("1982", cls=Command)(terminal)
console.command()(servo)
console.command()(positioner)
app.add_typer(console, name="console")


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
    run_command(_run)


def _run() -> None:
    try:
        status = app(prog_name="edmsim", standalone_mode=False)
    except _UsageError as error:
        if not sys.argv[1:]:
            error.show()
            sys.exit(BAD_INPUT)
        command = error.ctx.command_path if error.ctx is not None else "edmsim"
        reason = error.format_message().strip().rstrip(".")
        raise InputError(f"{reason[:1].lower()}{reason[1:]}; see {command} --help") from None
    except typer.Abort:
        sys.exit(FAILED)
    sys.exit(status if isinstance(status, int) else 0)
