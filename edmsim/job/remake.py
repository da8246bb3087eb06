"""The page and the figures of a cut made again from what the cut left in its folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from edmsim.errors import InputError, one_of
from edmsim.files import locked, make_writable
from edmsim.job.result import sample_or_reason
from edmsim.recording.cut_folder import read_cut
from edmsim.recording.figures.catalogue import pictures
from edmsim.recording.figures.profile import profile_png
from edmsim.recording.html_report import write_html

FORMATS = ("pdf", "svg", "png")  # kinds of files that figures are written as


def remake(
    directory: str | Path, figures: str | Path | None, kind: str, leave_out: Callable[[str], None]
) -> list[Path]:
    """Write a folder's ``report.html`` again, or its figures as files of their own; returns the files written."""
    if kind not in FORMATS:
        raise InputError(f"figures cannot be written as '{kind}'; there are: {one_of(kind, FORMATS)}")
    cut = read_cut(directory)
    sample = sample_or_reason(cut.report, cut.windows)
    target = Path(directory if figures is None else figures)
    if figures is None:
        with locked(target):
            profile = profile_png(cut.scene, cut.windows, cut.report, cut.title)
            write_html(*cut, sample, cut.title, profile, target / "report.html")
        return [target / "report.html"]
    make_writable(target)
    written = []
    for picture in pictures(*cut, sample, leave_out):
        file = target / f"{picture.name}.{kind}"
        picture.figure.savefig(file)
        written.append(file)
    return written
