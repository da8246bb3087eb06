"""``edmsim check``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from edmsim.cli.console import OUT, Program, default_folder, say
from edmsim.cli.options import SET_UP, takes
from edmsim.errors import BAD_INPUT, InputError


@takes(
    "machine", SET_UP, "planner", "offset", "offsets", "ignore", "dialect", "conditions", "layers", "upper_layer",
    "taper_deg", "taper_corners", "guide_errors_mm", "unit", "passes", "technology", "tab_mm", "overlap_mm",
    "after_tab",
)  # fmt: skip
def check(
    program: Program,
    out: Annotated[
        Path | None, typer.Option(help="Picture of the path: .png .svg or .pdf; default out/PROGRAM/path.png.")
    ] = None,
    **options: Any,
) -> None:
    """Check a program before the cut: path, notices, time."""
    from edmsim.files import make_writable, replacing
    from edmsim.job.check import check as look_at
    from edmsim.job.check import lines_of
    from edmsim.job.settings import CutSettings
    from edmsim.program.blocks import UnknownWordsError, offered_to_ignore
    from edmsim.recording.figures.path import path_figure

    picture = default_folder(program) / "path.png" if out is None else out
    if picture.suffix not in (".png", ".svg", ".pdf"):
        raise InputError("the picture must end in .png, .svg or .pdf", picture)
    settings = CutSettings.model_validate(options)
    unknown: dict[str, list[int]] = {}

    try:
        found = look_at(program, settings)
    except UnknownWordsError as error:
        unknown = error.words
        for word, lines in unknown.items():
            times = "" if len(lines) == 1 else f", {len(lines)} times"
            say(f"{program}:{lines[0]}: unknown word {word}{times}")
        deciding = [word for word in unknown if word not in offered_to_ignore(unknown)]
        if deciding:
            these = "it" if len(deciding) == 1 else "them"
            say(f"{', '.join(deciding)} may decide the contour: correct or delete {these}")
            raise typer.Exit(BAD_INPUT) from None
        say("the rest is shown without them, as with --ignore " + ",".join(unknown))
        found = look_at(program, settings.model_copy(update={"ignore": (*settings.ignore, *unknown)}))
    for name, text in lines_of(found):
        OUT.print(f"{name:<12}{text}", highlight=False, soft_wrap=True, markup=False)
    for notice in found.path.notices:
        OUT.print(f"note: {notice}", highlight=False, soft_wrap=True, markup=False)
    make_writable(picture.parent)
    figure = path_figure(found.path, program.name, 2e3 * found.machine.auto_offset_mm)
    with replacing(picture) as partial:
        figure.savefig(partial, format=picture.suffix.removeprefix("."))
    OUT.print(f"Written: {picture}", highlight=False, soft_wrap=True, markup=False)
    if unknown:
        raise typer.Exit(BAD_INPUT)
