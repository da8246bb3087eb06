"""What all commands share: the two streams, how a line is printed, exit statuses, and options of one meaning."""

from __future__ import annotations

import codecs
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from edmsim.errors import InputError

OUT = Console()
ERR = Console(stderr=True)

STOPPED, INTERRUPTED = 3, 130
"""Exit statuses besides those of `edmsim.errors`: the machine stopped before the end; interrupted by the user."""

Material = Annotated[
    str,
    typer.Option(
        help="Workpiece material: aluminium, cemented-carbide, copper, graphite, nickel-alloy, "
        "polycrystalline-diamond, stainless-steel, titanium-alloy, tool-steel, or an own file."
    ),
]
Height = Annotated[float, typer.Option(help="Workpiece height in mm.")]
Wire = Annotated[
    str,
    typer.Option(
        help="Wire: brass, copper, diffusion-annealed, molybdenum, zinc-coated-brass, with a diameter in um if "
        "wanted, copper-100."
    ),
]
Machine = Annotated[
    str, typer.Option(help="Machine: agiecut-dem15, production, production-400, worn-table, or an own file.")
]
Generator = Annotated[
    str,
    typer.Option(
        help="Generator: equalising, fine, ignition-pulse, iso-energetic, iso-pulse, powercore-v2, powercore-v3, "
        "production, spark-pulser, or a file."
    ),
]
Tension = Annotated[float | None, typer.Option(help="Wire tension in N; default by wire.")]
Resolution = Annotated[str, typer.Option(help="fast, default or fine.")]
Program = Annotated[Path, typer.Argument(help="Part program: .ngc .nc .gcode .iso .txt .dxf", show_default=False)]
Offset = Annotated[str, typer.Option(help="Wire offset: auto, none, or mm.")]
Offsets = Annotated[
    Path | None, typer.Option(help="File with offset registers, lines as D1 = 0.155; by default the program's own.")
]
Dialect = Annotated[
    str,
    typer.Option(
        help="Dialect of the program: auto, sodick, mitsubishi, skd2, charmilles, fanuc, linuxcnc, freecad, iso."
    ),
]
Conditions = Annotated[
    Path | None, typer.Option(help="Settings of the program's conditions: TOML file with a section [C001] for each.")
]
Ignore = Annotated[
    str, typer.Option(metavar="WORDS", help="Words of the program to leave out: M77,U", show_default=False)
]
Layers = Annotated[
    str, typer.Option(metavar="NAMES", help="Layers of a drawing to cut; default all shown.", show_default=False)
]
TaperDeg = Annotated[
    float, typer.Option(help="Angle of the wall in degrees: positive where the part is smaller above than below.")
]
TaperCorners = Annotated[
    str, typer.Option(help="What corners and arcs become higher up: conical, sharp, cylindrical or rounded.")
]
Upper = Annotated[
    str | None, typer.Option(metavar="LAYER", help="Layer of a drawing with the contours of the upper face.")
]
GuideErrors = Annotated[
    str | None,
    typer.Option(metavar="LOWER:UPPER", help="How much higher the guides are than the machine's file says, in mm."),
]
Unit = Annotated[str | None, typer.Option(help="Unit of a drawing: mm, um, cm, m, in, ft, mil; default by drawing.")]
Passes = Annotated[
    int | None, typer.Option(help="Cut in so many passes, rough and trims; by default in one, or as the program.")
]
Technology = Annotated[
    str | None, typer.Option(help="Technology of the passes, a name or a file .toml; default by material.")
]
Tab = Annotated[float, typer.Option(help="Length in mm that is cut last and holds the piece; 0 for none.")]
Overlap = Annotated[float, typer.Option(help="How far passes go on over what is already cut, in mm.")]
AfterTab = Annotated[str, typer.Option(help="stop: the piece is held before its tab is cut; cut: the slug falls.")]
Seed = Annotated[int, typer.Option(help="Seed of every draw.")]


_PLAIN = str.maketrans({"µ": "u", "²": "2", "³": "3", "–": "-", "…": "~", "±": "+-", "°": " deg"})


def take_any_terminal() -> None:
    """Print on terminals of any encoding: what they lack, a figure's unit or a file's name, is spelt plainly."""
    codecs.register_error("edmsim-plain", _spelt_plainly)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="edmsim-plain")


def _spelt_plainly(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end].translate(_PLAIN)
    return text.encode("ascii", "backslashreplace").decode(), error.end


def say(text: str) -> None:
    """Print one line on standard error, however long."""
    ERR.print("edmsim: " + " ".join(text.splitlines()), highlight=False, soft_wrap=True, markup=False)


def named(text: str) -> list[str]:
    """Return the names of a list with commas, none if it is empty."""
    return [name.strip() for name in text.split(",") if name.strip()]


def path_text(file: Path | None) -> str | None:
    """Return a file as settings hold it."""
    return None if file is None else str(file)


def default_folder(program: Path) -> Path:
    """Return the folder for the outputs of a program that was given none."""
    return Path("out") / program.stem


def parse_guide_errors(text: str | None) -> tuple[float, float] | None:
    """Read the errors of the guides' heights.

    Raises
    ------
    InputError
        They are no two numbers.
    """
    if text is None:
        return None
    try:
        lower, upper = (float(part) for part in text.split(":"))
    except ValueError:
        raise InputError(f"the guides' errors are {text!r}: give two numbers in mm, as 0.1:-0.05") from None
    return lower, upper
