"""Commands of a part program and its cut: cut, check, view, report."""

import shlex
import signal
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from edmsim.cli.console import ERR, OUT, Program, Quiet, default_folder, print_line, say
from edmsim.cli.options import SET_UP, Unset, takes
from edmsim.errors import BAD_INPUT, INTERRUPTED, STOPPED, InputError
from edmsim.files import check_suffix, make_writable


@takes(out=Unset("Default out/PROGRAM."))
def cut(
    program: Program,
    traces: Annotated[
        Path | None, typer.Option(help="File for samples of gap voltage and current, .parquet.")
    ] = None,
    quiet: Quiet = False,
    **options: Any,
) -> None:
    """Cut a part program."""
    from edmsim.cosim.stops import WORDS, StopCause
    from edmsim.job.cut import CHECKPOINT, CutProgress
    from edmsim.job.cut import cut as run_cut
    from edmsim.progress import ShownProgress

    folder = Path(options.pop("out", default_folder(program)))
    if traces is not None:
        check_suffix(traces, "a file of traces", ".parquet")
        make_writable(traces.parent)
    result = None
    try:
        with ShownProgress(quiet, keep=True) as bar, warnings.catch_warnings():
            warnings.showwarning = lambda message, *_, **__: say(str(message))
            shown = CutProgress(bar, program.name)
            result = run_cut(program, out=folder, **options, watch=shown.show, enter=shown.enter)
    except KeyboardInterrupt as interrupt:
        if result is None:
            has_checkpoint = (folder / CHECKPOINT).exists()
            resumable = "interrupted; run the same command with --resume to continue"
            say(resumable if has_checkpoint else "interrupted before the cut began")
            number = next(iter(interrupt.args), signal.SIGINT)
            raise typer.Exit(128 + number) from None  # as shells have it
    if traces is not None:
        try:
            result.write_traces(traces)
        except KeyboardInterrupt:
            say(f"interrupted: the results are in {folder}, the traces are not written")
            raise typer.Exit(INTERRUPTED) from None
    with suppress(KeyboardInterrupt):  # all is written
        if not quiet:
            from edmsim.recording.report import render_table

            OUT.print(render_table(result.report))
            where = f"Written to {folder}; play it back with: edmsim view {shlex.quote(str(folder))}"
            print_line(where)
    if result.report.outcome != WORDS[StopCause.FINISHED].report:
        raise typer.Exit(STOPPED)


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
    from edmsim.job.plan import check as look_at
    from edmsim.job.plan import lines_of
    from edmsim.job.settings import CutSettings
    from edmsim.program.blocks import UnknownWordsError, offered_to_ignore
    from edmsim.recording.figures.profile import path_figure
    from edmsim.recording.figures.style import check_figure, write_figure

    picture = default_folder(program) / "path.png" if out is None else out
    check_figure(picture)
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
            say(f"{', '.join(deciding)} may decide the contour: correct or delete {these}{error.hint}")
            raise typer.Exit(BAD_INPUT) from None
        say("the rest is shown without them, as with --ignore " + ",".join(unknown))
        found = look_at(program, settings.model_copy(update={"ignore": (*settings.ignore, *unknown)}))
    for name, text in lines_of(found):
        print_line(f"{name:<12}{text}")
    for notice in found.path.notices:
        print_line(f"note: {notice}")
    write_figure(path_figure(found.path, program.name, 2e3 * found.machine.auto_offset_mm), picture)
    print_line(f"Written: {picture}")
    if unknown:
        raise typer.Exit(BAD_INPUT)


def view(
    directory: Annotated[Path, typer.Argument(help="Folder of a cut.", show_default=False)],
    other: Annotated[
        Path | None, typer.Argument(help="Folder of another cut, shown side by side.", show_default=False)
    ] = None,
) -> None:
    """Play a cut back in rerun, or two side by side."""
    from edmsim.recording.rerun.viewer import compare as show_both
    from edmsim.recording.rerun.viewer import view as show

    raise typer.Exit(show(directory) if other is None else show_both(directory, other))


def report(
    directory: Annotated[Path, typer.Argument(help="Folder of a cut.", show_default=False)],
    film: Annotated[Path | None, typer.Option(help="Film of the cut, .mp4 or .gif.")] = None,
    seconds: Annotated[float | None, typer.Option(help="Length of the film; default: 12.")] = None,
    screenshots: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder for pictures of the viewer; needs no screen.")
    ] = None,
    figures: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Folder for figures.")] = None,
    format: Annotated[str | None, typer.Option(help="Format of the figures: pdf, svg or png; default: pdf.")] = None,
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
    from edmsim.recording.exports import write_contour, write_faces
    from edmsim.recording.report import read_cut
    from edmsim.recording.rerun.playback import find_recording
    from edmsim.recording.rerun.viewer import take_screenshots

    if contour is None and contour_height is not None:
        raise InputError("--contour-height is that of a contour: give the file with --contour")
    if film is None and seconds is not None:
        raise InputError("--seconds is the length of a film: give the file with --film")
    if figures is None and format is not None:
        raise InputError("--format is that of figures: give the folder with --figures")
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
        written += remake(directory, figures, format or "pdf", say)
    for file in written:
        print_line(str(file))


def _film(directory: Path, film: Path, seconds: float | None) -> Path:
    from edmsim.recording.film import SECONDS, check_film, render
    from edmsim.recording.rerun.playback import find_recording

    recording = find_recording(directory)
    length_s = SECONDS if seconds is None else seconds
    check_film(film, length_s)
    with ERR.status(f"drawing {film.name}"):
        render(recording, film, length_s)
    return film
