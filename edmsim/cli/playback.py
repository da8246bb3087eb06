"""``edmsim view`` and ``report``: looking at a cut that is over."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from edmsim.cli.console import ERR, OUT, say
from edmsim.errors import InputError


def view(
    directory: Annotated[Path, typer.Argument(help="Folder of a cut.", show_default=False)],
    other: Annotated[
        Path | None, typer.Argument(help="Folder of another cut, shown side by side.", show_default=False)
    ] = None,
) -> None:
    """Play a cut back in rerun, or two side by side."""
    from edmsim.recording import compare as show_both
    from edmsim.recording import view as show

    raise typer.Exit(show(directory) if other is None else show_both(directory, other))


def report(
    directory: Annotated[Path, typer.Argument(help="Folder of a cut.", show_default=False)],
    film: Annotated[Path | None, typer.Option(help="Film of the cut, .mp4 or .gif.")] = None,
    seconds: Annotated[float, typer.Option(help="Length of the film.")] = 12.0,
    screenshots: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder for pictures of the viewer; needs no screen.")
    ] = None,
    figures: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Folder for figures.")] = None,
    format: Annotated[str, typer.Option(help="Format of the figures: pdf, svg or png.")] = "pdf",
    contour: Annotated[Path | None, typer.Option(help="File for the cut contour, .dxf .csv or .svg.")] = None,
    contour_height: Annotated[
        float | None, typer.Option(help="Height of the contour in mm; default: that of the kerf at mid height.")
    ] = None,
    face: Annotated[Path | None, typer.Option(help="File for the part's cut face, .stl or .glb (glTF).")] = None,
) -> None:
    """Write a cut's report.html again, or a film, figures, a contour.

    Without options it writes report.html, with options only the files they name.
    """
    from edmsim.job.result import remake
    from edmsim.recording import find_recording, take_screenshots
    from edmsim.recording.cut_folder import read_cut
    from edmsim.recording.exports import write_contour, write_faces

    if contour is None and contour_height is not None:
        raise InputError("--contour-height is that of a contour: give the file with --contour")
    written: list[Path] = []
    if film is not None:
        written.append(_film(directory, film, seconds))
    if screenshots is not None:
        with ERR.status("opening the viewer without a window"):
            written += take_screenshots(find_recording(directory), screenshots)
    if contour is not None:
        write_contour(read_cut(directory).scene, contour, contour_height)
        written.append(contour)
    if face is not None:
        write_faces(read_cut(directory).scene, face)
        written.append(face)
    if figures is not None or not written:
        written += remake(directory, figures, format, say)
    for file in written:
        OUT.print(str(file), highlight=False, soft_wrap=True, markup=False)


def _film(directory: Path, film: Path, seconds: float) -> Path:
    from edmsim.recording import find_recording, render
    from edmsim.recording.film import check_film

    recording = find_recording(directory)
    check_film(film, seconds)
    with ERR.status(f"drawing {film.name}"):
        render(recording, film, seconds)
    return film
