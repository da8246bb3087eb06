"""``edmsim check``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from edmsim.cli.console import (
    OUT,
    AfterTab,
    Conditions,
    Dialect,
    Generator,
    GuideErrors,
    Height,
    Ignore,
    Layers,
    Machine,
    Material,
    Offset,
    Offsets,
    Overlap,
    Passes,
    Program,
    Tab,
    TaperCorners,
    TaperDeg,
    Technology,
    Unit,
    Upper,
    Wire,
    default_folder,
    named,
    parse_guide_errors,
    path_text,
    say,
)
from edmsim.errors import BAD_INPUT, InputError


def check(
    program: Program,
    out: Annotated[
        Path | None, typer.Option(help="Picture of the path: .png .svg or .pdf; default out/PROGRAM/path.png.")
    ] = None,
    machine: Machine = "agiecut-dem15",
    material: Material = "tool-steel",
    height: Height = 20.0,
    wire: Wire = "brass",
    generator: Generator = "iso-pulse",
    offset: Offset = "auto",
    ignore: Ignore = "",
    offsets: Offsets = None,
    dialect: Dialect = "auto",
    conditions: Conditions = None,
    layers: Layers = "",
    upper_layer: Upper = None,
    taper_deg: TaperDeg = 0.0,
    taper_corners: TaperCorners = "conical",
    guide_errors: GuideErrors = None,
    unit: Unit = None,
    passes: Passes = None,
    technology: Technology = None,
    tab: Tab = 1.5,
    overlap: Overlap = 0.1,
    after_tab: AfterTab = "stop",
) -> None:
    """Look at a program before the cut: path, notices, time."""
    from edmsim.files import make_writable, replacing
    from edmsim.job.check import check as look_at
    from edmsim.job.check import lines_of
    from edmsim.job.settings import CutSettings
    from edmsim.program.blocks import UnknownWordsError, offered_to_ignore
    from edmsim.recording.figures.path import path_figure

    picture = default_folder(program) / "path.png" if out is None else out
    if picture.suffix not in (".png", ".svg", ".pdf"):
        raise InputError("the picture must end in .png, .svg or .pdf", picture)
    options = {
        "machine": machine, "material": material, "height_mm": height, "wire": wire, "generator": generator,
        "offset": offset, "offsets": path_text(offsets), "layers": named(layers), "unit": unit,
        "dialect": dialect, "conditions": path_text(conditions),
        "upper_layer": upper_layer, "taper_deg": taper_deg, "taper_corners": taper_corners,
        "guide_errors_mm": parse_guide_errors(guide_errors),
        "passes": passes, "technology": technology, "tab_mm": tab, "overlap_mm": overlap, "after_tab": after_tab,
    }
    unknown: dict[str, list[int]] = {}

    try:
        found = look_at(program, CutSettings.model_validate({**options, "ignore": named(ignore)}))
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
        say("what follows leaves them out, as --ignore " + ",".join(unknown))
        found = look_at(program, CutSettings.model_validate({**options, "ignore": [*named(ignore), *unknown]}))
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
