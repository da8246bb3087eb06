"""Shared by all commands: standard output and error, exit statuses, and common options."""

import codecs
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

if TYPE_CHECKING:
    from edmsim.progress import ShownProgress

OUT = Console()
ERR = Console(stderr=True)
RESUME = "run the same command to resume"
Program = Annotated[Path, typer.Argument(help="Part program: .ngc .nc .gcode .iso .txt .dxf", show_default=False)]
Environment = Annotated[
    str,
    typer.Argument(metavar="ENV_ID", help="Environment: edmsim/GapFeed-v2 ..., or FILE.py:ID.", show_default=False),
]
DriveAxis = Annotated[str, typer.Option(help="Axis: x or y of the machine, bench, table, fast, low-impedance.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print errors only.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]
_PLAIN = str.maketrans({"µ": "u", "²": "2", "³": "3", "–": "-", "…": "~", "±": "+-", "°": " deg"})


def take_any_terminal() -> None:
    """Print on terminals of any encoding: what they lack, a figure's unit or a file's name, is spelt plainly."""

    def spelt_plainly(error: UnicodeError) -> tuple[str, int]:
        if not isinstance(error, UnicodeEncodeError):
            raise error
        text = error.object[error.start : error.end].translate(_PLAIN)
        return text.encode("ascii", "backslashreplace").decode(), error.end

    codecs.register_error("edmsim-plain", spelt_plainly)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="edmsim-plain")


def say(text: str) -> None:
    """Print one line on standard error, however long."""
    ERR.print("edmsim: " + " ".join(text.splitlines()), highlight=False, soft_wrap=True, markup=False)


def print_line(text: str) -> None:
    """Print text on standard output as it is; lines are not broken."""
    OUT.print(text, highlight=False, soft_wrap=True, markup=False)


@contextmanager
def interruptible(then: str | Callable[[], str] = RESUME, keep: bool = False) -> "Iterator[ShownProgress]":
    """Yield what shows progress; Ctrl-C ends the command with one line, which says what to do then."""
    from edmsim.progress import ShownProgress

    try:
        with ShownProgress(keep=keep) as bar:
            yield bar
    except KeyboardInterrupt as interrupt:
        say(f"interrupted; {then if isinstance(then, str) else then()}")
        raise typer.Exit(128 + next(iter(interrupt.args), signal.SIGINT)) from None  # as shells have it


def default_folder(program: Path) -> Path:
    """Return the folder for the outputs of a program that was given none."""
    return Path("out") / program.stem
