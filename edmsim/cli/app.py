"""The command line: its commands, the version, and how errors end it."""

import gc
import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer

import edmsim
from edmsim.cli import commands, console, groups, options
from edmsim.errors import BAD_INPUT, FAILED, InputError, run_command


class _Commands(typer.core.TyperGroup):
    """All commands; the usage line names the two options, so that the list of commands fits a screen of 24 lines."""

    def get_help_option(self, ctx: Any) -> Any:
        """Return ``--help``, which is not listed."""
        option = super().get_help_option(ctx)
        if option is not None:
            option.hidden = True
        return option


app = typer.Typer(
    add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False, cls=_Commands,
    options_metavar="[--version | --help]", help="A wire-EDM machine, simulated discharge by discharge.",
)
_UsageError: Any = typer.BadParameter.__base__  # that of click, which newer releases of typer contain

COMMANDS: dict[str, tuple[str, dict[str, Callable[..., None]]]] = {
    "": ("", {
        "cut": commands.cut, "check": commands.check, "view": commands.view, "report": commands.report,
        "train": commands.train, "dataset": commands.dataset, "evaluate": commands.evaluate,
        "calibrate": commands.calibrate, "validate": commands.validate, "bench": commands.bench, "gap": commands.gap,
        "warm-up": commands.warm_up,
    }),
    "sweep": ("Run many cuts from one specification.", {"run": groups.run, "show": groups.show}),
    "tune": ("Search settings, trainings, technologies; tune a drive.", {
        "controller": groups.controller, "training": groups.training, "population": groups.population,
        "technology": groups.technology, "drive": groups.drive,
    }),
    "measure": ("Measure a machine's table, or its wire guides.", {
        "table": groups.table, "guides": groups.guides,
    }),
    "console": ("Operate the controller of 1982, a servo drive or a positioner.", {
        "1982": groups.terminal, "servo": groups.servo, "positioner": groups.positioner,
    }),
}  # fmt: skip
"""Purpose and commands of each group; those of the group ``""`` are commands without a group."""

for _name, (_purpose, _commands) in COMMANDS.items():
    _group = typer.Typer(no_args_is_help=True, help=_purpose) if _name else app
    for _word, _command in _commands.items():
        _settings = groups.SHORT_FORM if _command is groups.run else {}
        _declare = _group.command(_word, cls=options.Command, context_settings=_settings, options_metavar="[OPTIONS]")
        _declare(_command)
    if _name:
        app.add_typer(_group, name=_name, options_metavar="[OPTIONS]")


@app.callback(invoke_without_command=True)
def _version(version: Annotated[bool, typer.Option("--version", hidden=True)] = False) -> None:
    if version:
        console.OUT.print(edmsim.__version__, highlight=False)
        raise typer.Exit


def main() -> None:
    """Run the command line; bad input is one line on standard error and exit status 2."""
    # by default the garbage collector scans all objects four times in a short cut; most belong to libraries
    gc.set_threshold(50_000, 10, 10)
    console.accept_any_encoding()
    run_command(_run)


def _run() -> None:
    try:
        status = app(prog_name="edmsim", standalone_mode=False)
        console.OUT.file.flush()  # so that a full disk is reported here, and not by Python at exit
    except _UsageError as error:
        command = error.ctx.command_path if error.ctx is not None else "edmsim"
        reason = error.format_message().strip().rstrip(".")
        if not reason:  # called without a command or arguments: the help has been printed
            sys.exit(BAD_INPUT)
        raise InputError(f"{reason[:1].lower()}{reason[1:]}; see {command} --help") from None
    except typer.Abort:
        sys.exit(FAILED)
    sys.exit(status if isinstance(status, int) else 0)
