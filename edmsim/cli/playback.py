"""``edmsim view``, ``render`` and ``report``: looking at a cut that is over."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from edmsim.cli.console import ERR, OUT, say
from edmsim.errors import InputError


def view(
    directory: Annotated[Path | None, typer.Argument(help="Folder of a cut.", show_default=False)] = None,
    compare: Annotated[
        tuple[Path, Path] | None, typer.Option(metavar="A B", help="Folders of two cuts to lay side by side.")
    ] = None,
) -> None:
    """Play a cut back in rerun, or two side by side."""
    from edmsim.recording import compare as show_both
    from edmsim.recording import view as show

    if directory is not None and compare is None:
        raise typer.Exit(show(directory))
    if directory is None and compare is not None:
        raise typer.Exit(show_both(*compare))
    raise InputError("give the folder of a cut, or two folders with --compare A B")


def render(
    directory: Annotated[Path, typer.Argument(help="Folder of a cut.", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="Film to write: .mp4 or .gif.")] = None,
    seconds: Annotated[float, typer.Option(help="Length of the film.")] = 12.0,
    screenshots: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Pictures of the viewer, made without a screen.")
    ] = None,
) -> None:
    """Make a film of a cut, or screenshots of its recording, without a screen."""
    from edmsim.recording import find_recording, take_screenshots
    from edmsim.recording import render as make_film
    from edmsim.recording.film import check_film

    if out is None and screenshots is None:
        raise InputError("give a film to write, --out cut.mp4 or cut.gif, or a folder for --screenshots")
    recording = find_recording(directory)
    if out is not None:
        check_film(out, seconds)
        with ERR.status(f"drawing {out.name}"):
            make_film(recording, out, seconds)
        OUT.print(f"Written: {out}", highlight=False, soft_wrap=True, markup=False)
    if screenshots is not None:
        with ERR.status("opening the viewer without a window"):
            written = take_screenshots(recording, screenshots)
        names = " ".join(str(file) for file in written)
        OUT.print(f"Written: {names}", highlight=False, soft_wrap=True, markup=False)


def report(
    directory: Annotated[Path, typer.Argument(help="Folder of a cut.", show_default=False)],
    figures: Annotated[
        Path | None, typer.Option(help="Write the figures for a paper into this folder instead.")
    ] = None,
    format: Annotated[str, typer.Option(help="Of these figures: pdf, svg or png.")] = "pdf",
    contour: Annotated[
        Path | None, typer.Option(help="Write the contour as cut into this file instead: .dxf .csv or .svg.")
    ] = None,
    contour_height: Annotated[
        float | None, typer.Option(help="Height in mm of that contour of the part; default: the kerf, mid height.")
    ] = None,
    face: Annotated[
        Path | None, typer.Option(help="Write the part's cut face into this file instead: .stl, or .glb (glTF).")
    ] = None,
) -> None:
    """Make report.html of a cut again, or its figures or contour or cut face as files."""
    from edmsim.job.remake import remake
    from edmsim.recording.contour_file import write_contour
    from edmsim.recording.cut_folder import read_cut
    from edmsim.recording.face_file import write_faces

    if contour is None and contour_height is not None:
        raise InputError("--contour-height is that of a contour: give the file with --contour")
    if contour is not None:
        write_contour(read_cut(directory).scene, contour, contour_height)
    if face is not None:
        write_faces(read_cut(directory).scene, face)
    written = [file for file in (contour, face) if file is not None]
    for file in written:
        OUT.print(str(file), highlight=False, soft_wrap=True, markup=False)
    if written and figures is None:
        return
    for file in remake(directory, figures, format, say):
        OUT.print(str(file), highlight=False, soft_wrap=True, markup=False)
