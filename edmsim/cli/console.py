"""Standard output and error, progress, and the effect of Ctrl-C, for all commands."""

import codecs
import json
import shlex
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer
from rich.console import Console

if TYPE_CHECKING:
    from edmsim.screen import ShownProgress

OUT = Console()
ERR = Console(stderr=True)
RESUME = "run the same command to resume"
_PLAIN = str.maketrans({"µ": "u", "²": "2", "³": "3", "–": "-", "…": "~", "±": "+-", "°": " deg"})


def accept_any_encoding() -> None:
    """Replace characters that the terminal's encoding lacks, as in units and names of files, by ASCII."""

    def in_ascii(error: UnicodeError) -> tuple[str, int]:
        if not isinstance(error, UnicodeEncodeError):
            raise error
        text = error.object[error.start : error.end].translate(_PLAIN)
        return text.encode("ascii", "backslashreplace").decode(), error.end

    codecs.register_error("edmsim-plain", in_ascii)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="edmsim-plain")


def say(text: str) -> None:
    """Print one line on standard error, however long."""
    ERR.print("edmsim: " + " ".join(text.splitlines()), highlight=False, soft_wrap=True, markup=False)


def print_line(text: str) -> None:
    """Print text on standard output as it is; lines are not broken."""
    OUT.print(text, highlight=False, soft_wrap=True, markup=False)


def print_json(content: object, indent: int | None = None) -> None:
    """Print JSON on standard output; a text is JSON already."""
    sys.stdout.write((content if isinstance(content, str) else json.dumps(content, indent=indent)) + "\n")


def quoted(word: object) -> str:
    """Return a word as one types it in a shell."""
    return shlex.quote(str(word))


def print_use(what: str, **options: object) -> None:
    """Print how to cut with something: `what`, and the command with these options."""
    flags = " ".join(f"--{name} {quoted(value)}" for name, value in options.items())
    print_line(f"{what}: edmsim cut PROGRAM {flags} --out DIR")


def progress(quiet: bool = False, keep: bool = False) -> "ShownProgress":
    """Return a progress display; its module is imported here, because short commands do not need it."""
    from edmsim.screen import ShownProgress

    return ShownProgress(quiet, keep)


@contextmanager
def interruptible(then: str | Callable[[], str] = RESUME, keep: bool = False) -> "Iterator[ShownProgress]":
    """Yield a progress display; Ctrl-C ends the command with one line, `then`, which says how to continue."""
    try:
        with progress(keep=keep) as bar:
            yield bar
    except KeyboardInterrupt as interrupt:
        raise interrupted(interrupt, f"interrupted; {then if isinstance(then, str) else then()}") from None


def interrupted(interrupt: KeyboardInterrupt, said: str) -> typer.Exit:
    """Print a line on standard error; return the exception that ends the command with 128 + the signal's number."""
    say(said)
    return typer.Exit(128 + next(iter(interrupt.args), signal.SIGINT))
